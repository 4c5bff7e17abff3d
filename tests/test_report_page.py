"""What a reader of the report meets: what to do, signs and units as typeset, what is folded and what is left out."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from pymc_backbone.discrepancy.results.entries import Candidate, Check, HeldOut, Remainder
from pymc_backbone.discrepancy.results.verdict import Status, Verdict
from pymc_backbone.effects import LIBRARY
from pymc_backbone.reporting.candidate_plots import plot_parameters
from pymc_backbone.reporting.gap_plots import plot_before_after, plot_held_out
from pymc_backbone.reporting.html import prose, table
from pymc_backbone.reporting.report import report_html
from pymc_backbone.reporting.words import next_steps, verdict_means

from .study_cases import make_study
from .test_report import Page


@pytest.fixture(scope="module")
def studies():
    return {verdict: make_study(verdict) for verdict in Verdict}


def shown(study):
    return Page(report_html(study, {}, version="1")).text.replace("\N{NO-BREAK SPACE}", " ")


def test_what_to_do_comes_before_why_and_what_speaks_against_the_data_first(studies):
    study = dataclasses.replace(
        studies[Verdict.AMBIGUOUS], checks=(Check("no second mode", False, "a line at 3 Hz: keep one mode"),)
    )
    assert next_steps(study)[0] == "A line at 3 Hz: keep one mode." and len(next_steps(study)) > 1
    text = shown(study)
    assert text.index("What to do next") < text.index("A line at 3 Hz") < text.index("Why")


def test_a_warning_on_all_records_is_something_to_do_and_a_record_keeps_its_name(studies):
    study = studies[Verdict.AMBIGUOUS]
    first = str(study.backbones["specimen"].values[0])
    assert first != first.capitalize()
    study = dataclasses.replace(
        study,
        checks=(Check("specimens alike", False, f"{first} differs; look at it"),),
        notes=("warning: the sensor bends", f"{first}: warning: a second mode", "all is well"),
    )
    assert next_steps(study)[:2] == [f"{first} differs; look at it.", "The sensor bends."]
    assert not any("second mode" in step or "well" in step for step in next_steps(study))


def test_where_no_set_is_told_the_page_does_not_speak_of_one(studies):
    study = dataclasses.replace(studies[Verdict.UNEXPLAINED], extended=None, missing_effects=())
    assert "the best set explains a part" in verdict_means(studies[Verdict.UNEXPLAINED])
    assert "the best set" not in verdict_means(study) and "leaves something of the records" in verdict_means(study)


def test_an_unexplained_gap_has_no_probability_of_a_set_on_top(studies):
    pages = [report_html(studies[verdict], {}, version="1") for verdict in (Verdict.FOUND, Verdict.UNEXPLAINED)]
    assert np.isfinite(studies[Verdict.UNEXPLAINED].probability)
    assert ["<span>probability" in page for page in pages] == [True, False]


@pytest.mark.parametrize("verdict", [Verdict.FOUND, Verdict.UNEXPLAINED])
def test_a_verdict_without_a_test_that_decides_says_what_to_do_all_the_same(studies, verdict):
    study = dataclasses.replace(studies[verdict], advice=(), checks=())
    assert len(next_steps(study)) == 1 and "What to do next" in shown(study)


@pytest.mark.parametrize(
    ("said", "typeset"),
    [
        ("as A^(-0.92 +- 0.01)", "as A<sup>&minus;0.92 &plusmn; 0.01</sup>"),
        ("44% (p = 4e-34).", "44&nbsp;% (p = 4&thinsp;&times;&thinsp;10<sup>&minus;34</sup>)."),
        ("keep one with `band`", "keep one with <code>band</code>"),
        ("up to 3 micrometres", "up to 3 &micro;m"),
        ("run_2e3, 3e5.csv, a-5, --band 1:2, 2024-01-02", "run_2e3, 3e5.csv, a-5, --band 1:2, 2024-01-02"),
        ("1e5 <b>", "1&thinsp;&times;&thinsp;10<sup>5</sup> &lt;b&gt;"),
    ],
)
def test_sentences_in_ascii_are_typeset_and_names_are_not(said, typeset):
    assert prose(said) == typeset


def test_a_name_in_a_table_stays_as_it_is_typed():
    text = table((("record", "head"), ("finding", "text")), [("A^(2) 5%", "A^(2) 5%")])
    assert "<span>A^(2) 5%</span>" in text and "<span>A<sup>2</sup> 5&nbsp;%</span>" in text


def test_no_markup_is_shown_as_text(studies):
    """A number that is HTML, with a unit behind it, once lost what said so."""
    left = Remainder("frequency", -7.7e-5, "Hz", 0.5, 1.1, 0.1, 0.5, (0.1,), (-7.7e-5,), (1e-4,))
    text = shown(dataclasses.replace(studies[Verdict.FOUND], remainder=(left,)))
    assert "\N{MINUS SIGN}7.7\N{THIN SPACE}\N{MULTIPLICATION SIGN}\N{THIN SPACE}10\N{MINUS SIGN}5 Hz" in text
    assert "&" not in text and "<sup>" not in text


def test_a_number_without_a_unit_has_no_dash_behind_it(studies):
    item = Candidate(
        ("iwan",), 0.5, 1.0, 1.0, 1.0, Status.POSSIBLE, "fits", parameters={"joint_exponent": (-0.7, 0.03)}
    )
    assert LIBRARY["iwan"].parameters[-1].unit == "-"
    text = shown(dataclasses.replace(studies[Verdict.AMBIGUOUS], candidates=(item,)))
    assert "\N{MINUS SIGN}0.7 \N{PLUS-MINUS SIGN} 0.03\n" in text.replace("</span>", "\n")


def test_a_parameter_that_was_held_has_no_interval_and_no_panel(studies):
    study = studies[Verdict.FOUND]
    effect, group = next((name, group) for name, group in study.parameters.items() if name == "coulomb_friction")
    (name, estimate), *_ = group.items()
    held = dataclasses.replace(estimate, mean=1.0, sd=0.0, hdi_low=1.0, hdi_high=1.0)
    changed = dataclasses.replace(study, parameters={**study.parameters, effect: {**group, name: held}})
    rows = [report_html(each, {}, version="1").count("<span>held</span>") for each in (study, changed)]
    assert rows == [0, 1]
    assert len(plot_parameters(changed).axes) == len(plot_parameters(study).axes) - 1
    labels = [text.get_text() for legend in plot_parameters(changed).legends for text in legend.get_texts()]
    assert "95 % of the fit" in labels and "95 % HDI" not in labels


def test_more_groups_than_a_screen_holds_are_folded(studies):
    """Of alternatives never more than a screen: the less probable ones open as one row."""
    names = [name for name in LIBRARY if LIBRARY[name].mechanism][:14]
    pairs = list(itertools.pairwise(names))
    kinds = {tuple(sorted({LIBRARY[name].mechanism for name in pair})) for pair in pairs}
    assert len(kinds) > 6
    rows = tuple(Candidate(pair, 0.05, 1.0, 1.0, 1.0, Status.POSSIBLE, "fits") for pair in pairs)
    study = dataclasses.replace(studies[Verdict.AMBIGUOUS], ambiguous_sets=tuple(pairs), candidates=rows)
    assert f"{len(kinds) - 5} more, less probable" in shown(study)


def test_only_what_was_left_out_has_a_row_and_names_keep_what_tells_them_apart():
    names = tuple(f"pendulum_free_swing_data_0{i}" for i in range(4))
    one = np.array([3.0, np.nan, 2.0, 4.0])
    axis = plot_held_out(HeldOut(3.0, 1.0, names, one, one / 3.0), "specimen").axes[0]
    labels = [label.get_text() for label in axis.get_yticklabels()]
    assert len(labels) == 3 and [label[-2:] for label in labels] == ["00", "02", "03"]
    assert all(len(label) <= 22 for label in labels)


def test_the_longest_title_of_a_figure_is_whole_and_inside(studies):
    study = studies[Verdict.FOUND]
    longest = ["cubic_stiffness", "displacement_dependent_damping", "quintic_stiffness"]
    study = dataclasses.replace(study, extended=study.base + longest[0] + longest[1] + longest[2])
    figure = plot_before_after(study, "frequency")
    figure.canvas.draw()
    title = figure.axes[1]._left_title
    assert "quintic stiffness" in title.get_text()
    assert title.get_window_extent().x1 <= figure.bbox.x1
