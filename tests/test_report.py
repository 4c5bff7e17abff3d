"""From a finished study to files: keys of result.json, the HTML page, the figures."""

from __future__ import annotations

import dataclasses
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import xarray as xr
from matplotlib import pyplot

from pymc_backbone._common.checks import InputError
from pymc_backbone._common.text import in_words
from pymc_backbone.discrepancy.results.design import Design
from pymc_backbone.discrepancy.results.entries import Candidate, Remainder
from pymc_backbone.discrepancy.results.locate import mean_gap
from pymc_backbone.discrepancy.results.verdict import NamedLevel, Status, Verdict
from pymc_backbone.effects import LIBRARY
from pymc_backbone.reporting.candidate_plots import plot_candidates
from pymc_backbone.reporting.html import MOST_RECORDS, noted, number, prose, table, unit
from pymc_backbone.reporting.model_script import model_script
from pymc_backbone.reporting.output_folder import DIAGNOSIS_FIGURES, FIGURES, read_result
from pymc_backbone.reporting.report import report_html
from pymc_backbone.reporting.report_model import parameters
from pymc_backbone.reporting.study_files import DIAGNOSIS_KEYS, study_entries, write_study
from pymc_backbone.reporting.study_plots import study_figures
from pymc_backbone.reporting.words import percent, remaining, remaining_by_mechanism
from pymc_backbone.survey.structure import Structure, summary_of
from pymc_backbone.survey.survey import effects_in_words

from .study_cases import make_study
from .test_plots import drawn_without_overlap

HOSTILE = [
    "<script>alert(1)</script>",
    "a&b \"q\" 'x'",
    "$x_{\\frac$",
    "line\nbreak \x1b[31m",
    "\N{SNOWMAN}\N{CJK UNIFIED IDEOGRAPH-6A4B}",
]
VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Reads a page; fails on tags that are not closed, and keeps what it links to and shows."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        names = dict(attrs)
        assert not [name for name in names if name.startswith("on")]
        self.links += [names[name] for name in ("src", "href", "srcset", "action") if name in names]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text += data


@pytest.fixture(scope="module")
def studies():
    return {verdict: make_study(verdict) for verdict in Verdict}


@pytest.mark.parametrize("verdict", Verdict)
def test_result_has_the_documented_keys(studies, tmp_path, verdict):
    study = studies[verdict]
    files = write_study(study, tmp_path / "out", command="pymc-backbone diagnose x")
    result = read_result(tmp_path / "out")
    assert set(result) == set(DIAGNOSIS_KEYS)
    assert result["files"] == files and all((tmp_path / "out" / name).stat().st_size for name in files)
    assert result["verdict"] == verdict and result["base_effects"] == ["linear_stiffness", "viscous_damping"]
    shares = [item["probability"] for item in result["candidates"]]
    assert shares == sorted(shares, reverse=True) and len(shares) == len(study.candidates)
    for item in result["candidates"]:
        assert {"effects", "probability", "reduced_chi_square", "log_evidence", "status"} <= set(item)
        assert item["log_evidence"] is None or np.isfinite(item["log_evidence"])
    assert any(item["status"] == "failed" and item["reduced_chi_square"] is None for item in result["candidates"])
    for item in result["where"]:
        assert set(item) == {
            *("observable", "amplitude_low", "amplitude_high", "gap", "unit", "standard_errors", "direction")
        }
    assert {"before", "after"} <= set(result["gap"]["held_out_levels"]) & set(result["gap"]["held_out_specimens"])
    assert {"shrink", "shrink_low", "shrink_high"} <= set(result["gap"])
    assert all(set(check) == {"check", "passed", "message"} for check in result["data_checks"])
    assert isinstance(result["seconds"], float) and isinstance(result["seed"], int)
    assert bool(result["missing_effects"]) == (verdict == "found")
    assert bool(result["ambiguous_sets"]) == (verdict == "ambiguous")
    if verdict == "found":
        (entry,) = result["missing_effects"]
        assert entry["name"] == "coulomb_friction"
        known = {"mean", "sd", "hdi_low", "hdi_high", "unit", "is_low_open", "is_high_open"}
        assert set(entry["parameters"]["friction_force"]) == known
    if verdict == "adequate":
        assert result["gap"]["shrink"] is None and result["equation_after"] is None
        assert result["adequate_by"] == "statistics"


def test_scatter_of_the_effects_and_what_evidence_rests_on_are_told(studies, tmp_path):
    study = studies[Verdict.FOUND]
    write_study(study, tmp_path / "out")
    result = read_result(tmp_path / "out")
    page = Page((tmp_path / "out" / "report.html").read_text(encoding="utf-8")).text.replace("\N{NO-BREAK SPACE}", " ")
    assert result["scatter"] == {"median": 0.062, "low": 0.021, "high": 0.17}
    assert "Between specimens the effects differ by 6.2 %" in page and "2.1 to 17 %" in page
    friction = next(item for item in result["candidates"] if item["effects"] == ["coulomb_friction"])
    assert (friction["evidence_shift"], friction["pareto_k"]) == (-0.47, 0.31)
    assert (
        "-0.47 (k 0.3)" in page.replace("\N{MINUS SIGN}", "-")
        and "The evidence of the 2 leading sets is corrected" in page
    )
    assert result["evidence_basis"]["sets"] == 2
    write_study(studies[Verdict.ADEQUATE], tmp_path / "none")
    assert read_result(tmp_path / "none")["scatter"] is None


def test_a_named_mechanism_comes_first_and_no_law_is_named(studies, tmp_path):
    study = dataclasses.replace(studies["found"], named_level=NamedLevel.MECHANISM, missing_effects=())
    write_study(study, tmp_path / "out")
    result = read_result(tmp_path / "out")
    assert result["named_level"] == "mechanism" and result["missing_effects"] == []
    (entry,) = result["mechanisms"]
    assert (entry["mechanism"], entry["probability"], entry["share_of_gap"]) == ("hysteresis", 0.98, 0.94)
    assert entry["laws"][0] == {"effect": "coulomb_friction", "probability": 0.6}
    assert entry["parameters"] == {"friction_force": {"value": 0.1, "standard_error": 0.01}}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "probability of friction-like hysteresis" in page and "agree on its mechanism" in page
    assert page.index("<h2>Mechanisms</h2>") < page.index("<h2>Candidates</h2>")
    row = page[page.index("<h2>Mechanisms</h2>") : page.index("<h2>Candidates</h2>")]
    assert "<details" in row and "Jenkins 38&nbsp;%" in row and "94 %" in row
    said = summary_of(result)
    assert said["mechanisms"] == ("hysteresis",) and said["missing_effects"] == ()
    assert effects_in_words(Structure("a", verdict="found", mechanisms=("hysteresis",))) == "hysteresis"
    # where the law is named the mechanism is beside it, not in its place
    write_study(studies["found"], tmp_path / "law")
    result = read_result(tmp_path / "law")
    assert result["named_level"] == "law" and result["mechanisms"] and summary_of(result)["mechanisms"] == ()


def test_what_remains_possible_adds_up_to_certainty(studies):
    """Sets that hold 20, 2.9 and 0.26 %: the page says that 77 % are elsewhere, and calls none of them rejected."""
    sets = (("coulomb_friction",), ("jenkins",), ("iwan",))
    chances = dict(zip(sets, (0.202, 0.029, 0.0026), strict=True))
    study = studies[Verdict.AMBIGUOUS]
    rows = [dataclasses.replace(c, probability=chances.get(c.effects, 0.0)) for c in study.candidates]
    study = dataclasses.replace(study, ambiguous_sets=sets, candidates=tuple(rows), probability=0.202)
    text = Page(report_html(study, {}, version="0.0")).text.replace("\N{NO-BREAK SPACE}", " ")
    assert "equally well" not in text
    for told in ("Coulomb friction: 20.2 %", "Jenkins: 2.9 %", "Iwan: 0.26 %", "any other explanation: 76.6 %"):
        assert told in text
    assert remaining(studies[Verdict.FOUND]) == []
    shares = [float(line.split(": ")[1].split()[0]) for line in remaining(study)]
    assert sum(shares) == pytest.approx(100.0, abs=0.1)  # of three digits each


def test_sets_that_are_exact_and_agree_on_the_mechanism_are_told_beside_it(studies):
    named = dataclasses.replace(
        studies[Verdict.FOUND], named_level=NamedLevel.MECHANISM, missing_effects=(),
        ambiguous_sets=(("coulomb_friction",), ("jenkins",)), advice=("the rest is told by larger releases.",),
    )  # fmt: skip
    words = Page(report_html(named, {}, version="0.0")).text
    assert "leave no more than noise" in words and "What remains possible" in words and "The rest is told" in words
    # negative control: where none is exact there are no such sets, and what is allowed for is said
    left = Remainder("frequency", 1e-3, "Hz", 5.0, 0.1, 0.1, 0.5, (0.1,), (1e-3,), (2e-4,))
    inexact = dataclasses.replace(named, ambiguous_sets=(), remainder=(left,))
    words = Page(report_html(inexact, {}, version="0.0")).text
    assert "a smooth departure of unknown size" in words and "What remains possible" not in words
    # nor is that said of a law that leaves noise, and may be another one
    alike = Page(report_html(dataclasses.replace(inexact, remainder=()), {}, version="0.0")).text
    assert "would look much the same" in alike and "a smooth departure" not in alike


def test_many_sets_that_remain_are_told_by_their_mechanisms(studies):
    """Laws of one mechanism are a row that opens, with the sum of their probabilities; a set alone is told as it is."""
    chances = {
        ("coulomb_friction",): 0.3,
        ("jenkins",): 0.1,
        ("iwan",): 0.05,
        ("bouc_wen",): 0.05,
        ("cubic_stiffness", "quadratic_damping"): 0.15,
        ("cubic_damping", "quintic_stiffness"): 0.1,
        ("freeplay",): 0.05,
    }
    study = studies[Verdict.AMBIGUOUS]
    rows = [Candidate(names, chance, 1.0, 1.0, 1.0, Status.POSSIBLE, "fits") for names, chance in chances.items()]
    study = dataclasses.replace(study, ambiguous_sets=tuple(chances), candidates=tuple(rows))
    assert [(title, len(sets)) for title, sets in remaining_by_mechanism(study)] == [
        ("friction-like hysteresis: 50 %", 4),
        ("damping that rises with speed + hardening or softening of the spring: 25 %", 2),
        ("clearance or contact: 5 %", 1),
    ]
    text = Page(report_html(study, {}, version="0.0")).text.replace("\N{NO-BREAK SPACE}", " ")
    for told in (
        "friction-like hysteresis: 50 % (4 sets)",
        "Iwan: 5 %",
        "freeplay: 5 %",
        "any other explanation: 20 %",
    ):
        assert told in text


def test_the_probability_on_top_is_that_of_the_set_it_names(studies):
    """The best set, with what is below the tolerance, need not be the first of the table."""
    study = studies[Verdict.FOUND]
    table = (Candidate(("coulomb_friction", "iwan"), 0.6, 1.0, 1.0, 1.0, Status.POSSIBLE, "fits"), *study.candidates)
    text = Page(report_html(dataclasses.replace(study, candidates=table), {}, version="0.0")).text
    assert "97 %probability of Coulomb friction" in text and "probability of Coulomb friction + Iwan" not in text


def test_of_what_the_waveforms_alone_show_no_factor_is_told(studies):
    """A spring of two sides need not change the backbones: "1 x less gap" would say that nothing was gained."""
    found = studies[Verdict.FOUND]
    assert "41.3 \N{MULTIPLICATION SIGN}" in Page(report_html(found, {}, version="0.0")).text
    held = dataclasses.replace(found.held_out_specimens, before=0.9, after=0.9)
    present = Design(0.012, 5, 4.0, 400.0, 1e-5)
    study = dataclasses.replace(found, shrink=1.004, held_out_specimens=held, present=present)
    text = Page(report_html(study, {}, version="0.0")).text
    assert "\N{MULTIPLICATION SIGN}less gap" not in text and "The gap shrinks" not in text
    left = next(item.reduced_chi_square for item in study.candidates if item.status == Status.BEST)
    assert f"41 \N{RIGHTWARDS ARROW} {left:.3g}reduced" in text
    assert f"whose reduced chi-square falls from 41 to {left:.3g}." in text
    # of backbones alone there are no waveforms to look at
    text = Page(report_html(dataclasses.replace(study, present=None), {}, version="0.0")).text
    assert "waveforms, whose" not in text and "The gap shrinks by a factor of 1" in text


@pytest.mark.parametrize(("after", "is_said"), [(1.3, False), (4.2, True)])
def test_what_is_left_of_held_out_specimens_is_told_where_it_is_much(studies, after, is_said):
    found = studies[Verdict.FOUND]
    study = dataclasses.replace(found, held_out_specimens=dataclasses.replace(found.held_out_specimens, after=after))
    text = Page(report_html(study, {}, version="0.0")).text
    assert (f"What is left on held-out specimens is {after} times what noise gives" in text) == is_said


def test_evidences_are_told_to_a_tenth_however_large(studies):
    """Two sets whose evidence differs by a few differ in the table as well."""
    study = studies[Verdict.FOUND]
    rows = [dataclasses.replace(study.candidates[0], log_evidence=value) for value in (-12341.26, -12344.18)]
    text = Page(
        report_html(dataclasses.replace(study, candidates=(*rows, *study.candidates[1:])), {}, version="0")
    ).text
    assert "\N{MINUS SIGN}12341.3" in text and "\N{MINUS SIGN}12344.2" in text


@pytest.mark.parametrize(
    ("p_value", "said"), [(0.41, "agree within measurement error"), (0.0017, "Such a gap is rare")]
)
def test_an_adequate_model_agrees_only_where_the_test_says_so(studies, p_value, said):
    study = dataclasses.replace(studies[Verdict.ADEQUATE], missing_p_value=p_value, sentence="Adequate.")
    text = Page(report_html(study, {}, version="0.0")).text
    assert said in text and ("within measurement error" in text) == (p_value > 0.01)


def test_a_range_of_one_level_is_one_number(studies):
    known = studies[Verdict.FOUND]
    first = known.where[0]
    levels = known.backbones["level"].values
    single = dataclasses.replace(first, amplitude_low=float(levels[1]), amplitude_high=float(levels[1]))
    text = Page(report_html(dataclasses.replace(known, where=(single,)), {}, version="0.0")).text
    said = f"{1e3 * levels[1]:.3g} mm"
    assert said in text and f" to {said}" not in text


def test_effects_are_in_words_wherever_people_read(studies):
    """Underscores stay where something is typed: settings, the command."""
    for study in studies.values():
        study = dataclasses.replace(study, settings={})
        page = re.sub(r"<pre>.*?</pre>", "", report_html(study, {}, version="0.0"), flags=re.DOTALL)
        text = Page(page).text
        assert not [name for name in LIBRARY if "_" in name and name in text]
        assert "coulomb" not in text and "jenkins" not in text
    assert "Coulomb friction" in Page(report_html(studies[Verdict.FOUND], {}, version="0.0")).text


def test_result_is_strict_json(studies, tmp_path):
    """NaN is no JSON: a strict reader must take the file."""
    broken = dataclasses.replace(studies["found"], probability=np.nan, missing_p_value=np.nan)
    write_study(broken, tmp_path / "out")
    text = (tmp_path / "out" / "result.json").read_text(encoding="utf-8")

    def fail(name):
        raise AssertionError(name)

    assert json.loads(text, parse_constant=fail)["probability"] is None


def test_a_folder_in_use_is_left_alone(studies, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not empty"):
        write_study(studies["adequate"], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_second_study_removes_what_it_did_not_write(studies, tmp_path):
    write_study(studies["adequate"], tmp_path / "out")
    assert (tmp_path / "out" / "figures" / "detectable.png").exists()
    write_study(studies["found"], tmp_path / "out", overwrite=True)
    assert not (tmp_path / "out" / "figures" / "detectable.png").exists()


@pytest.mark.parametrize("verdict", Verdict)
def test_page_is_whole_and_holds_everything_inside(studies, verdict):
    study = studies[verdict]
    figures = study_figures(study)
    text = report_html(study, figures, version="1.2.3", command="pymc-backbone diagnose 'my records' --seed 3")
    page = Page(text)
    assert all(link.startswith("data:image/png;base64,") for link in page.links) and len(page.links) == len(figures)
    assert "script" not in page.tags and "url(" not in text and "@import" not in text
    assert not re.search(r"https?:|//[a-z]", re.sub(r"base64,[A-Za-z0-9+/=]+", "", text))
    words = page.text.replace("\N{NO-BREAK SPACE}", " ")
    assert study.sentence in words and verdict.capitalize() in words
    for item in study.candidates:
        assert all(in_words(name) in words for name in item.effects)
        assert item.reason in words
    notes = [note.partition(": ")[2] or note for note in study.notes]  # the record stands in a column of its own
    for sentence in (*study.reasons, *study.advice, *notes, *(check.message for check in study.checks)):
        assert Page(prose(sentence)).text.replace("\N{NO-BREAK SPACE}", " ") in words
    assert "pymc-backbone diagnose 'my records' --seed 3" in words and "1.2.3" in words
    assert study.base.equation.splitlines()[0] in words
    if study.extended is not None:
        assert study.extended.equation.splitlines()[0] in words


def test_what_was_cut_is_said_in_the_open_record_by_record():
    names = [f"run {i + 1}" for i in range(14)]
    common = [f"{name}: no unit was given, m was assumed" for name in names]
    own = [f"{name}: the first {i + 1} s were dropped" for i, name in enumerate(names) if i != 3]
    page = noted([*common, *own, "run 2: warning: it beats", "levels were shared", "left out: run 99: silent"], names)
    visible = page.partition("<details")[0]
    assert visible.count("<tr") == 1 + MOST_RECORDS  # a head, all of them, and what the first ones have of their own
    assert "all 14" in visible and visible.count("no unit was given") == 1 and "the first 1 s were dropped" in visible
    assert "run 4<" not in page  # of which nothing more is to be said
    assert "warning: it beats" in visible and "left out: run 99" in visible and visible.count("it beats") == 1
    assert "2 more records" in page and "the first 14 s were dropped" not in visible and "levels were shared" in page
    for name in ("run 1", "<b>"):
        page = noted([f"{name}: cut", "other"], [name])
        assert "<b>" not in page and "cut" in page.partition("<details")[0]


def test_two_uncertainties_of_one_number_have_names(studies):
    study = studies["found"]
    drawn = parameters(dataclasses.replace(study, posterior=xr.DataTree(), convergence={"r_hat": 1.005}), {})
    assert "sd, posterior" in drawn and "sd, fit" in drawn
    best = next(item for item in study.candidates if item.effects == ("coulomb_friction",))
    row = next(line for line in drawn.split("</tr>") if "friction force" in line)
    cells = [str(number(value, 2)) for value in (study.parameters["coulomb_friction"]["friction_force"].sd,
                                                 best.parameters["friction_force"][1])]  # fmt: skip
    assert cells[0] != cells[1] and row.index(f">{cells[0]}<") < row.index(f">{cells[1]}<")
    assert "95 % HDI" in drawn
    unsampled = parameters(dataclasses.replace(study, posterior=None), {})
    assert "sd, posterior" not in unsampled and "HDI" not in unsampled and "95 % of the fit" in unsampled
    unmixed = parameters(dataclasses.replace(study, posterior=xr.DataTree(), convergence={"r_hat": 2.5}), {})
    assert "HDI" not in unmixed and "The draws did not mix: intervals are those of the fit" in unmixed


def test_names_from_files_cannot_become_markup():
    study = make_study("found", names=HOSTILE)
    text = "</style></title><img src=x onerror=alert(2)>"
    study = dataclasses.replace(
        study, sentence=text, notes=(text,), findings=(text,), settings={**study.settings, "records": text}
    )
    figures = study_figures(study)
    for figure in figures.values():
        figure.canvas.draw()
    html = report_html(study, figures, version="1", command=text)
    page = Page(html)
    assert "script" not in page.tags and page.tags.count("img") == len(figures)
    assert HOSTILE[0] in page.text and text in page.text and "\x1b" not in html


def test_one_specimen_in_radians_and_three_observables():
    study = make_study(
        "found", specimens=1, unit="rad", amplitude=0.3, frequency=0.4, observables=("frequency", "damping", "offset")
    )
    figures = study_figures(study)
    assert {"gap_offset", "backbones_offset"} <= set(figures) and "held_out_specimens" not in figures
    assert "[rad]" in figures["gap_offset"].axes[0].get_xlabel()
    text = Page(report_html(study, figures, version="1")).text
    assert "[N m/rad]" in text and "[kg m^2]" in text and "N/m" not in text and "rotation" not in text
    assert figures["parameters"].axes[1].get_xlabel() == "Viscous damping [N m s/rad]"
    result = study_entries(study, "1")
    assert result["parameters"]["linear_stiffness"]["linear_stiffness"]["unit"] == "N m/rad"
    assert "mass = 1.2 [kg m^2]" in result["equation_after"] and "[N m s/rad]" in result["equation_before"]
    assert "[N m/rad]" in model_script(study, "1") and "N/m" not in model_script(study, "1")


@pytest.mark.parametrize(
    ("specimens", "amplitude", "unit", "label"),
    [
        (1, 0.3, "rad", "[rad]"),
        (3, 0.35, "m", "[mm]"),
        (12, 2e-5, "m", "[\N{GREEK SMALL LETTER MU}m]"),
        (14, 0.01, "m", "[mm]"),
    ],
)
def test_figures_are_drawn_in_readable_units_without_overlap(specimens, amplitude, unit, label):
    verdict = "unexplained" if specimens == 1 else "ambiguous"
    figures = study_figures(make_study(verdict, specimens=specimens, amplitude=amplitude, unit=unit))
    assert set(figures) <= {*DIAGNOSIS_FIGURES, *FIGURES}
    assert label in figures["gap_damping"].axes[0].get_xlabel()
    for figure in figures.values():
        drawn_without_overlap(figure)
        assert any(axis.lines or axis.collections or axis.patches for axis in figure.axes)


def test_figures_of_an_adequate_model(studies):
    figures = study_figures(studies["adequate"])
    assert "detectable" in figures
    assert len(figures["backbones_frequency"].axes) == 1  # there is no after
    for figure in figures.values():
        drawn_without_overlap(figure)


def test_no_figure_stays_open(studies):
    before = set(pyplot.get_fignums())
    study_figures(studies["found"])
    assert set(pyplot.get_fignums()) == before


def test_gap_is_the_mean_over_the_specimens_that_are_there():
    levels = [0.1, 0.2]
    coordinates = {"specimen": ["a", "b"], "observable": ["frequency"], "level": levels}
    dims = ("specimen", "observable", "level")
    measured = xr.Dataset(
        {
            "value": (dims, [[[3.0, 4.0]], [[5.0, np.nan]]]),
            "standard_error": (dims, [[[0.3, 0.3]], [[0.4, np.nan]]]),
        },
        coords=coordinates,
    )
    simulated = measured.assign(value=(dims, [[[1.0, 1.0]], [[1.0, 1.0]]]))
    gap, error = mean_gap(measured, simulated)
    np.testing.assert_allclose(gap[0], [3.0, 3.0])
    np.testing.assert_allclose(error[0], [0.25, 0.3])  # sqrt(0.3^2 + 0.4^2) / 2, and one specimen alone


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "> 99.9 %"), (0.9999, "> 99.9 %"), (0.97, "97 %"), (1e-9, "< 0.1 %"), (0.0, "0 %"), (np.nan, "-")],
)
def test_probability_is_never_rounded_to_certainty(value, text):
    assert percent(value) == text


def test_numbers_and_units_as_html():
    assert number(6.02e6, 3) == "6.02&thinsp;&times;&thinsp;10<sup>6</sup>"
    assert number(-0.5) == "&minus;0.5" and number(np.nan) == "&ndash;"
    assert unit("N s^2/m^2") == '<span class="u">N s<sup>2</sup>/m<sup>2</sup></span>'
    assert table((("a", ""),), []) == ""


@pytest.mark.parametrize(
    ("text", "shown"), [("1/m^n", "1/m<sup>n</sup>"), ("N s^2/m^2", "N s<sup>2</sup>/m<sup>2</sup>")]
)
def test_powers_of_units_are_raised_letters_too(text, shown):
    assert str(unit(text)) == f'<span class="u">{shown}</span>'


def test_the_longest_name_of_a_set_stays_clear_of_its_percentage(studies):
    """Both stand above the bar, and below the bar above, and can be read: measured as they are drawn."""
    study = studies[Verdict.FOUND]
    longest = tuple(sorted(LIBRARY, key=len)[-3:])
    first = dataclasses.replace(study.candidates[0], effects=longest, probability=0.9995)
    figure = plot_candidates(dataclasses.replace(study, candidates=(first, first, *study.candidates[1:])))
    figure.canvas.draw()
    axis = figure.axes[0]
    above = axis.patches[0].get_window_extent()
    for row in range(2):
        name, share = axis.texts[2 * row : 2 * row + 2]
        assert share.get_text() == "> 99.9 %"
        assert name.get_window_extent().x1 < share.get_window_extent().x0
        assert name.get_fontsize() > 6.0
    assert axis.texts[2].get_window_extent().y1 < above.y0


def test_levels_that_were_left_out_have_the_unit_of_the_other_figures(studies):
    study = next(study for study in studies.values() if study.held_out_levels is not None)
    axis = study_figures(study)["held_out_levels"].axes[0]
    shown = [float(label.get_text()) for label in axis.get_yticklabels()]
    levels = study.backbones["level"].values
    assert axis.get_ylabel() == "Amplitude [mm]" and shown == pytest.approx(1e3 * levels, rel=5e-3)
