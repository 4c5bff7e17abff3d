"""Calibration of set probabilities: right probabilities pass, wrong priors are rejected, sets follow the prior."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks" / "hidden_effects"
sys.path.insert(0, str(FOLDER))

import prior_batches  # noqa: E402
import sbc  # noqa: E402
from meanings import Meaning, meaning_of  # noqa: E402
from systems import PARAMETERS  # noqa: E402

from pymc_backbone.discrepancy.weighing.evidence import PRIOR_OF_SIZE, VARIANT  # noqa: E402
from pymc_backbone.effects import LIBRARY  # noqa: E402

SETS = [frozenset(), *(frozenset((a,)) for a in "abcd"), frozenset("ab"), frozenset("cd"), frozenset("abc")]


def _batches(rng: np.random.Generator, count: int, temper: float = 1.0) -> list[sbc.Sets]:
    """Return batches whose truth is drawn from probabilities; those that are told are these to a power."""
    rows = []
    for number in range(count):
        true = rng.dirichlet(np.full(len(SETS) + 1, 0.35))  # the last is none of the sets
        told = true**temper / np.sum(true**temper)
        drawn = int(rng.choice(true.size, p=true))
        is_none = drawn == len(SETS)
        hidden = frozenset() if is_none else SETS[drawn]
        meaning = Meaning(hidden, not is_none, set() if is_none else {hidden}, set(), set())
        rows.append(sbc.sets_of(str(number), list(zip(SETS, told[:-1], strict=True)), meaning))
    return rows


def _rejects(p_values: dict[str, float]) -> bool:
    return min(p_values.values()) < sbc.LEVEL / 2.0


def test_right_probabilities_are_calibrated(rng: np.random.Generator) -> None:
    rows = _batches(rng, 2000)
    assert not _rejects(sbc.uniformity(rows))
    found = sbc.reliability(rows)
    # Ten bins of sums of independent truths: the expected sum of their absolute deviations is some 0.01 per batch.
    assert found["expected_calibration_error"] < 0.1
    assert abs(found["top"]["standard_errors"]) < 4.0
    assert sum(row["hits"] for row in found["bins"]) == 2000 and found["unlisted"] == 0


@pytest.mark.parametrize("factor", sorted(sbc.WRONG_PRIORS.values()))
def test_a_wrong_prior_is_rejected(factor: float, rng: np.random.Generator) -> None:
    rows = _batches(rng, 300)
    right, wrong = sbc.reliability(rows), sbc.reliability([sbc.reweighted(row, factor) for row in rows])
    assert not _rejects(sbc.uniformity(rows))
    assert _rejects(sbc.uniformity([sbc.reweighted(row, factor) for row in rows]))
    assert wrong["log_score"] < right["log_score"]
    assert wrong["expected_calibration_error"] > right["expected_calibration_error"]


def test_too_sure_and_too_unsure_are_rejected(rng: np.random.Generator) -> None:
    for temper in (3.0, 0.3):
        rows = _batches(rng, 300, temper)
        assert _rejects(sbc.uniformity(rows))


def test_the_level_of_the_test_is_kept(rng: np.random.Generator) -> None:
    rejected = sum(_rejects(sbc.uniformity(_batches(rng, 60))) for _ in range(60))
    assert rejected <= 4  # 0.6 expected at a level of 1 %; five or more once in 2000


def test_the_transform_of_known_probabilities() -> None:
    rows = [(frozenset("a"), 0.2), (frozenset(), 0.5), (frozenset("b"), 0.1)]

    def told(hidden: frozenset[str] | None, *also: frozenset[str]) -> sbc.Sets:
        accepted = set() if hidden is None else {hidden, *also}
        return sbc.sets_of("one", rows, Meaning(hidden or frozenset(), hidden is not None, accepted, set(), set()))

    assert sbc.pit(told(frozenset("a")), 0.5) == pytest.approx(0.6)
    assert sbc.pit(told(frozenset()), 1.0) == pytest.approx(0.5)
    assert sbc.pit(told(None), 0.0) == pytest.approx(0.8)  # none of them stands last
    assert sbc.pit(told(frozenset("c")), 0.3) == pytest.approx(0.8)  # no probability of its own
    assert told(frozenset("c")).truth is None
    together = told(frozenset("a"), frozenset("b"))  # either name is right: they count as one
    np.testing.assert_allclose(together.probability, (0.5, 0.3, 0.2))
    assert sbc.pit(together, 1.0) == pytest.approx(0.8)
    doubled = sbc.reweighted(told(frozenset("a")), 10.0)
    np.testing.assert_allclose(doubled.probability, np.array((2.0, 1.0, 0.5, 0.2)) / 3.7)
    assert doubled.truth == 0


def test_parts_of_a_run_are_read_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = {"hidden": ["iwan"], "base": [], "tier": "prior"}
    entries = [{"effects": ["iwan"], "probability": 0.7}, {"effects": [], "probability": None}]
    answers = [{"verdict": "found", "candidates": entries}, {"verdict": "refused", "sentence": "no"}, None]
    for part in ("first", "second"):
        for number, result in enumerate(answers):
            folder = tmp_path / part / f"batch_{number:04d}"
            folder.mkdir(parents=True)
            (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
            if result:
                (folder / "result.json").write_text(json.dumps(result), encoding="utf-8")
    rows, left = sbc.read_sets([tmp_path / "first", tmp_path / "second"])
    assert len(rows) == 2 and left == {"without a result": 2, "refused or failed": 2}
    np.testing.assert_allclose(rows[0].probability, (0.7, 0.3))
    target = tmp_path / "figures.json"
    assert sbc.main([str(tmp_path / "first"), str(tmp_path / "second"), "--json", str(target)]) == 0
    assert "2 batches (2 without a result, 2 refused or failed)" in capsys.readouterr().out
    assert json.loads(target.read_text(encoding="utf-8"))["reliability"]["top"]["right"] == 1.0


def test_sets_are_drawn_from_the_packages_prior() -> None:
    weights = prior_batches.sets_and_weights()
    assert sum(weights.values()) == pytest.approx(1.0)
    # Variants add some 2 % to sets of one, which the normalisation takes from all.
    assert weights[()] == pytest.approx(PRIOR_OF_SIZE[0], rel=0.03)
    assert weights[("power_damping",)] == pytest.approx(VARIANT * weights[("quadratic_damping",)])
    pair = weights[("iwan", "quadratic_damping")] / weights[("iwan",)]
    singles = len(prior_batches.looked_for("m"))
    expected = PRIOR_OF_SIZE[2] / (0.5 * singles * (singles - 1)) / (PRIOR_OF_SIZE[1] / singles)
    assert pair == pytest.approx(expected)
    assert ("power_damping", "quadratic_damping") not in weights  # one stands in the place of the other


def test_parameters_lie_within_the_default_bounds(rng: np.random.Generator) -> None:
    mass, omega, amplitude = 2.0, 20.0, 0.01
    names = {name for names in prior_batches.sets_and_weights() for name in names}
    for name in sorted(names):
        for _ in range(20):
            values = prior_batches.draw_values(name, rng, amplitude, {"mass": mass, "omega": omega}, 0.5)
            assert set(values) == set(LIBRARY[name].parameter_names) <= set(PARAMETERS)
            for parameter in LIBRARY[name].parameters:
                low, high = parameter.bounds(mass, amplitude, omega)
                slack = 1e-12 * max(abs(low), abs(high))
                if parameter.role == "strength" and LIBRARY[name].with_role("slip_force"):
                    continue  # follows from the slip
                if parameter.role == "power_coefficient":
                    exponent = values[LIBRARY[name].with_role("exponent")[0]]
                    low, high = (bound * amplitude ** (1.0 - exponent) for bound in (low, high))
                    slack *= amplitude ** (1.0 - exponent)
                assert low - slack <= values[parameter.name] <= high + slack


def test_a_batch_of_the_prior_can_be_judged() -> None:
    batch = prior_batches.make_prior_batch(5, 7)
    assert batch.truth["tier"] == "prior" and len(batch.records) in (3, 4, 5)
    again = prior_batches.make_prior_batch(5, 7)
    assert np.array_equal(batch.records[0].measured, again.records[0].measured)
    meaning = meaning_of(batch.truth)
    assert meaning.accepted == {frozenset(batch.truth["hidden"])}
