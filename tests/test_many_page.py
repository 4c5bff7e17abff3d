"""The page over all structures, what stands out, the table: from hand-made records."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from urllib.parse import unquote

import numpy as np
import pytest

from pymc_backbone.survey.figures import plot_damping_against_frequency, plot_quantity
from pymc_backbone.survey.files import survey_table
from pymc_backbone.survey.outliers import LEAST, Quantity, far, majority, quantities, stand_out
from pymc_backbone.survey.page import survey_html
from pymc_backbone.survey.structure import Structure
from pymc_backbone.survey.survey import SURVEY_KEYS, Survey

from .test_plots import drawn_without_overlap
from .test_report import HOSTILE, Page


def structure(name: str, rng: np.random.Generator, verdict: str = "found", effect: str = "coulomb_friction", **more):
    values = {"mean": 10.0 * (1.0 + 0.02 * rng.standard_normal()), "sd": 0.1, "hdi_low": 9.0, "hdi_high": 11.0}
    stiffness = {"mean": 1e4, "sd": 10.0, "hdi_low": 9e3, "hdi_high": 1.1e4, "unit": "N/m"}
    sets = ((effect,), ("jenkins",)) if verdict == "ambiguous" else ()
    made = Structure(
        name, "somewhere", verdict, "A sentence.", (effect,) if verdict == "found" else (), (effect,), 0.97, sets, 1.2,
        3, 12.0 * (1.0 + 0.003 * rng.standard_normal()), 0.004 * (1.0 + 0.03 * rng.standard_normal()),
        {"linear_stiffness": stiffness, "friction_force": {**values, "unit": "N"}}, 12.0, 1.1, (), 1, 2.0, None, None,
        f"structures/{name}/report.html",
    )  # fmt: skip
    return dataclasses.replace(made, **more)


def survey_of(structures) -> Survey:
    return Survey(tuple(structures), 1, "0.0", {"mass": 1.2}, workers="2 processes", seconds=3.0, total=len(structures))


@pytest.fixture
def usual(rng) -> list[Structure]:
    return [structure(f"beam_{i:02d}", rng) for i in range(12)]


def test_nothing_stands_out_among_equals(usual):
    """Negative control."""
    assert stand_out(usual) == {} and majority(usual) == (("coulomb_friction",), 12, 12)
    assert survey_of(usual).sentence == "12 of 12 decided structures lack Coulomb friction."


def test_a_structure_whose_law_is_open_does_not_stand_out_for_it(rng):
    law, other = ("cubic_stiffness",), ("quintic_stiffness",)
    known = [structure(f"beam_{k}", rng, effect=law[0]) for k in range(4)]
    open_law = structure("open", rng, missing_effects=(), mechanisms=("spring",), ambiguous_sets=(law, other))
    assert majority([*known, open_law]) == (law, 4, 4)
    assert stand_out([*known, open_law]) == {}
    # negative control: of another mechanism, the usual law not among its sets
    strange = dataclasses.replace(open_law, mechanisms=("hysteresis",), ambiguous_sets=(("iwan",), ("jenkins",)))
    assert "none of its possible sets is the usual one" in stand_out([*known, strange])["open"][0]
    # where no law is known anywhere, mechanisms are what structures have in common
    assert majority([open_law] * 3) == (("spring",), 3, 3)
    assert stand_out([open_law] * 3) == {}


def test_what_stands_out_is_ranked_and_said(usual, rng):
    usual[3] = dataclasses.replace(usual[3], frequency=13.0)
    usual[5] = dataclasses.replace(usual[5], verdict="unexplained", missing_effects=())
    usual[7] = structure("other", rng, effect="freeplay")
    usual[8] = structure("bare", rng, verdict="adequate")
    usual[9] = structure("torn", rng, verdict="ambiguous")
    usual[10] = structure("elsewhere", rng, verdict="ambiguous", effect="iwan")
    found = stand_out(usual)
    assert next(iter(found)) == "beam_05" and list(found)[-1] == "beam_03"
    assert set(found) == {"beam_03", "beam_05", "other", "bare", "elsewhere"}
    assert "frequency is +8." in found["beam_03"][0] and "lacks freeplay; 7 of 9" in found["other"][0]
    assert "lacks nothing" in found["bare"][0]


def test_structures_that_lack_more_than_the_usual_lack_the_usual_too(rng):
    """Two lack friction, one friction and a spring: three lack friction."""
    both = structure("both", rng, missing_effects=("coulomb_friction", "cubic_stiffness"))
    survey = survey_of([structure("a", rng), structure("b", rng), both])
    assert survey.sentence == (
        "3 of 3 decided structures lack Coulomb friction, 1 of them other effects too; 1 stand out."
    )
    assert survey.standing_out["both"] == (
        "lacks Coulomb friction + cubic stiffness; 2 of 3 lack Coulomb friction alone",
    )
    other = structure("other", rng, effect="freeplay")
    survey = survey_of([structure("a", rng), structure("b", rng), other])
    assert survey.sentence.startswith("2 of 3 decided structures lack Coulomb friction; ")
    assert survey.standing_out["other"] == ("lacks freeplay; 2 of 3 lack Coulomb friction",)


def test_few_structures_have_a_range_and_no_spread(rng, usual):
    """9, 12 and 12.02 Hz: a median absolute deviation would say 12 Hz within 0.2 %."""
    few = [structure(name, rng, frequency=value) for name, value in (("a", 9.0), ("b", 12.0), ("c", 12.02))]
    page = survey_html(survey_of(few))
    assert "median frequency; 9 to 12.02 Hz over the structures" in page and "\N{PLUS-MINUS SIGN}" not in page
    row = re.search(r"<tr[^>]*><td[^>]*><span>frequency</span></td>.*?</tr>", page, re.DOTALL)
    assert row is not None and "&ndash;" in row[0]
    row = re.search(r"<tr[^>]*><td[^>]*><span>frequency</span></td>.*?</tr>", survey_html(survey_of(usual)), re.DOTALL)
    assert row is not None and "&ndash;" not in row[0]


def test_a_value_that_is_badly_known_does_not_stand_out():
    values = np.array([1.0, 1.01, 0.99, 1.0, 1.02, 2.0])
    known = Quantity("x", "N", tuple("abcdef"), values, np.full(6, 0.01))
    guessed = dataclasses.replace(known, errors=np.array([0.01] * 5 + [1.5]))
    assert known.scores()[-1] > 10.0 and guessed.scores()[-1] < 1.5
    few = Quantity("x", "N", tuple("abcde"), values[1:], np.zeros(5))
    assert LEAST > 5 and np.isnan(few.scores()).all()
    equal = Quantity("x", "N", tuple("abcdef"), np.ones(6), np.zeros(6))
    assert (equal.scores() == 0.0).all()
    signed = Quantity("x", "N", tuple("abcdef"), np.array([-1.0, 1.0, 0.5, -0.5, 0.2, 90.0]), np.zeros(6))
    assert signed.scores()[-1] > far(6)
    pairs = zip("abcdef", values, strict=True)
    half = stand_out([Structure(name, verdict="found", frequency=value) for name, value in pairs])
    assert list(half) == ["f"] and "1.99 times the median" in half["f"][0]


@pytest.mark.parametrize("count", [6, 12, 40, 150])
def test_equals_are_rarely_far(rng, count):
    """One or two quantities in a hundred; the bound is four standard errors above 2.5 %."""
    x = rng.standard_normal((1000, count))
    names = tuple(map(str, range(count)))
    false = [np.any(np.abs(Quantity("x", "1", names, row, np.zeros(count)).scores()) > far(count)) for row in x]
    assert np.mean(false) < 0.045


def test_scores_are_those_of_a_normal_distribution(rng):
    """The robust standard deviation is consistent: of many normal values, as many exceed 2 as should (4.55 %)."""
    values = rng.standard_normal(20000)
    quantity = Quantity("x", "1", tuple(map(str, range(20000))), values, np.zeros(20000))
    share = float(np.mean(np.abs(quantity.scores()) > 2.0))
    assert share == pytest.approx(0.0455, abs=0.006)  # four standard errors of a share, and the spread's own


def test_page_holds_hostile_names_without_running_them(rng):
    items = [
        structure(name, rng, report=f"structures/{name}/report.html", warnings=(name,), sentence=name)
        for name in HOSTILE
    ]
    items += [Structure(name + "!", name, error=f"{name}: cannot be read", traceback=name) for name in HOSTILE]
    items[0] = dataclasses.replace(items[0], verdict="unexplained", missing_effects=())
    survey = dataclasses.replace(survey_of(items), command=" ".join(HOSTILE), settings={HOSTILE[0]: HOSTILE[1]})
    text = survey_html(survey)
    page = Page(text)
    assert "script" not in page.tags and "\x1b" not in text and HOSTILE[0] in page.text
    links = [link for link in page.links if not link.startswith("data:")]
    assert {unquote(link) for link in links} == {f"./structures/{name}/report.html" for name in HOSTILE}
    assert not any(set(link) & set("<>\"' \n\\") for link in links)


def test_page_of_one_of_none_and_of_many(usual, rng):
    for items in ([usual[0]], [Structure("a", error="It failed.")], [], [structure(f"s{i}", rng) for i in range(120)]):
        page = Page(survey_html(survey_of(items)))
        assert "NaN" not in page.text and "nan" not in page.text.lower().split()


def test_names_are_in_the_figures_where_values_stand_out(usual):
    usual[3] = dataclasses.replace(usual[3], damping_ratio=0.009)
    order = [item.name for item in usual]
    found = {item.name: item for item in quantities(usual)}
    figure = plot_quantity(found["damping_ratio"], order)
    assert [text.get_text() for text in figure.axes[0].texts] == [r"beam_03"]
    drawn_without_overlap(figure)
    drawn = plot_damping_against_frequency(usual, ["beam_03"])
    assert drawn is not None and len(drawn.axes[0].texts) == 1
    drawn_without_overlap(drawn)


def test_structures_stand_below_the_axis_by_name(usual):
    """Up to a dozen by name, of a long one the end where it differs; more by number, and the axis says so."""
    long = "footbridge_over_the_river_span_07"
    usual[3] = dataclasses.replace(usual[3], name=long)
    order = [item.name for item in usual]
    for name in ("frequency", "damping_ratio"):
        axis = plot_quantity({item.name: item for item in quantities(usual)}[name], order).axes[0]
        labels = [label.get_text() for label in axis.get_xticklabels()]
        assert axis.get_xticks().tolist() == list(range(1, 13)) and axis.get_xlabel() == ""
        assert labels[:3] == ["beam_00", "beam_01", "beam_02"] and labels[4:] == order[4:]
        assert labels[3].endswith("river_span_07") and len(labels[3]) < len(long)
    more = [*usual, dataclasses.replace(usual[0], name="one more")]
    axis = plot_quantity(
        {item.name: item for item in quantities(more)}["frequency"], [item.name for item in more]
    ).axes[0]
    assert axis.get_xlabel() == "Structure, in the order given"
    assert not any(name in label.get_text() for label in axis.get_xticklabels() for name in order)


def test_names_of_points_that_lie_together_are_above_each_other(usual):
    """Five of twelve within a thousandth of each other, at the bottom and at the top of the panel."""
    for others in (0.009, 0.002):
        close = {f"beam_{i:02d}": 0.004 + 1e-7 * i for i in range(5)}
        items = [
            dataclasses.replace(item, frequency=12.0, damping_ratio=close.get(item.name, others)) for item in usual
        ]
        drawn = plot_damping_against_frequency(items, list(close))
        assert drawn is not None
        drawn.canvas.draw()
        boxes = [text.get_window_extent() for text in drawn.axes[0].texts]
        assert len(boxes) == 5
        assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
        inside = drawn.bbox
        assert all(inside.x0 <= box.x0 and box.x1 <= inside.x1 for box in boxes)
        assert all(inside.y0 <= box.y0 and box.y1 <= inside.y1 for box in boxes)


def test_table_has_a_row_for_each_and_no_formula(usual):
    items = [*usual, Structure("=1+1", error="@cmd: it failed")]
    rows = list(csv.DictReader(io.StringIO(survey_table(survey_of(items)))))
    assert [row["name"] for row in rows] == [*(item.name for item in usual), "'=1+1"]
    assert (
        rows[-1]["verdict"] == "failed" and rows[-1]["error"] == "'@cmd: it failed" and rows[-1]["frequency [Hz]"] == ""
    )
    assert float(rows[0]["friction_force [N]"]) == pytest.approx(usual[0].parameters["friction_force"]["mean"])


def test_public_equals_documented(usual):
    assert {"program", *survey_of(usual).entries()} == set(SURVEY_KEYS)
    documented = str(Structure.__doc__)
    assert all(field.name in documented for field in dataclasses.fields(Structure))
