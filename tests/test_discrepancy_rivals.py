"""What the records say as much of as of the likeliest set is told beside it, and no law is named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone.discrepancy.deciding import decide
from pymc_backbone.discrepancy.deciding.decision import Decision
from pymc_backbone.discrepancy.deciding.rivals import rivals_of
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.results.entries import LawProbability, MissingMechanism
from pymc_backbone.discrepancy.results.verdict import NamedLevel, Verdict
from pymc_backbone.discrepancy.weighing.evidence import Evidence
from pymc_backbone.discrepancy.wording import verdict_words
from pymc_backbone.effects import LIBRARY

from .discrepancy_cases import AMPLITUDE, MASS, OMEGA

SPRING, INERTIA, POWER = ("cubic_stiffness",), ("nonlinear_inertia",), ("power_stiffness",)
PAIR = ("cubic_stiffness", "quadratic_damping")


def layout_of(names):
    return make_layout(pb.Oscillator(MASS, names), AMPLITUDE, OMEGA)


def decision(verdict, **fields):
    lack = SimpleNamespace(p_value=0.4, share=0.001)
    chances = {SPRING: 0.93, INERTIA: 0.03, ("quintic_stiffness",): 0.01, ("coulomb_friction",): 0.01}
    return Decision(verdict, SPRING, 0.93, 0.0, lack, chances, {}, ranked=(SPRING, INERTIA), **fields)


def search_of(**fields):
    return SimpleNamespace(layout=layout_of, mechanism_of=lambda name: LIBRARY[name].mechanism, **fields)


@pytest.mark.parametrize(
    ("best", "other", "behind", "chance", "is_rival"),
    [
        (SPRING, INERTIA, 0.0, 0.03, True),
        (SPRING, INERTIA, -2.0, 0.03, True),  # the records speak for it more than for what is met more often
        (SPRING, INERTIA, np.log(3.0) - 0.01, 0.03, True),
        (SPRING, INERTIA, np.log(3.0) + 0.01, 0.03, False),
        (SPRING, INERTIA, 0.0, 0.002, False),  # nobody would tell it
        (SPRING, POWER, 0.0, 0.03, False),  # with an exponent of 3 it is the spring
        (POWER, SPRING, 0.0, 0.03, True),
        (SPRING, PAIR, 0.0, 0.03, False),  # holds the spring
        (PAIR, SPRING, 0.0, 0.03, True),
        (PAIR, ("nonlinear_inertia", "quadratic_damping"), 0.0, 0.03, True),
        (SPRING, (), 0.0, 0.03, False),  # nothing missing is a question of its own
        ((), SPRING, 0.0, 0.03, False),
    ],
)
def test_as_likely_by_the_records_is_what_no_bayes_factor_worth_a_mention_speaks_against(
    best, other, behind, chance, is_rival
):
    evidences = {best: Evidence(100.0, 0.0, 0.9), other: Evidence(100.0 - behind, 0.0, chance)}
    found = rivals_of(search_of(), best, evidences, {best: 0.9, other: chance})
    assert found == ((other,) if is_rival else ())


def test_rivals_come_most_probable_first():
    sets = (SPRING, INERTIA, ("quintic_stiffness",))
    evidences = {names: Evidence(10.0, 0.0, 0.0) for names in sets}
    chances = dict(zip(sets, (0.8, 0.02, 0.1), strict=True))
    assert rivals_of(search_of(), SPRING, evidences, chances) == (("quintic_stiffness",), INERTIA)


@pytest.mark.parametrize(("behind", "verdict"), [(0.0, Verdict.AMBIGUOUS), (5.0, Verdict.FOUND)])
def test_a_law_that_is_likelier_for_being_met_more_often_is_not_named(behind, verdict, monkeypatch):
    evidences = {SPRING: Evidence(50.0, 0.0, 0.93), INERTIA: Evidence(50.0 - behind, 0.0, 0.03)}
    chances = {SPRING: 0.93, INERTIA: 0.03}
    open_still = replace(decision(Verdict.AMBIGUOUS), evidences=evidences, probabilities=chances)
    monkeypatch.setattr(decide, "is_unexplained", lambda *_: False)
    told = decide._judged(search_of(), open_still, {}, None)
    assert told.verdict is verdict
    if verdict is Verdict.AMBIGUOUS:
        assert told.rivals == (INERTIA,) and set(told.listed) == {SPRING, INERTIA}
        assert "nonlinear inertia would be as likely as cubic stiffness" in verdict_words.sentence(told)
    else:
        assert told.named_level is NamedLevel.LAW and not told.rivals


@pytest.mark.parametrize(
    ("rivals", "mechanism", "is_held"),
    [
        ((INERTIA,), "changing_frequency", True),
        ((INERTIA,), "spring", False),
        ((("quintic_stiffness",),), "spring", True),
        ((INERTIA, ("coulomb_friction",)), "changing_frequency", False),
        ((), "spring", True),
    ],
)
def test_a_mechanism_is_certain_where_every_rival_has_it(rivals, mechanism, is_held):
    certain = MissingMechanism(mechanism, 0.99, 1.0, (LawProbability("cubic_stiffness", 0.9),))
    likely = MissingMechanism("hysteresis", 0.6, 0.1, (LawProbability("iwan", 0.6),))
    known = decision(Verdict.AMBIGUOUS, rivals=rivals, mechanisms=(certain, likely))
    undecided = decide._undecided(search_of(), known, known.mechanisms)
    assert undecided == (() if is_held else (mechanism,))
    said = verdict_words.sentence(replace(known, undecided=undecided))
    assert ("Certain all the same" in said) is is_held


def test_a_rival_is_told_among_the_laws_however_improbable_it_is():
    laws = (LawProbability("cubic_stiffness", 0.96), LawProbability("nonlinear_inertia", 0.01))
    either = MissingMechanism("changing_frequency", 0.99, 1.0, laws)
    known = decision(
        Verdict.FOUND, listed=(SPRING, INERTIA), rivals=(INERTIA,), mechanisms=(either,),
        named_level=NamedLevel.MECHANISM,
    )  # fmt: skip
    said = verdict_words.sentence(known)
    assert "which law these records do not tell: cubic stiffness 96 %, nonlinear inertia 1 %" in said
    assert said.endswith("which is met more often.")


def test_what_is_less_probable_by_what_the_records_say_is_not_told_to_be_rare():
    known = decision(Verdict.AMBIGUOUS, listed=(SPRING, INERTIA), rivals=(INERTIA,))
    assert "met more often" in verdict_words.sentence(known)
    by_records = replace(known, probabilities={SPRING: 0.5, INERTIA: 0.3}, probability=0.5)
    assert "met more often" not in verdict_words.sentence(by_records)
