"""A sensor's zero that wanders: its spectrum against the one drawn from, and what it must not be taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances.drifting_zero import SENTENCE, drifting_zero
from pymc_backbone.discrepancy.fitting.batch import Batch
from pymc_backbone.discrepancy.fitting.joint_fit import Fit, fit
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import start_state
from pymc_backbone.discrepancy.fitting.whitening import whitener, with_slow_noise
from pymc_backbone.discrepancy.sets.question import ask
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.one_sensor import mid_lines_differ, records_of_one_sensor
from pymc_backbone.measurement.conditioning.wander import MidLine, Wander, of_one_sensor
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.levels import backbones_at_levels
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.oscillator import Oscillator
from tests.discrepancy_cases import MASS, batch_of, batch_of_conditioned, drifting_records

FREQUENCY, RATE, RATIO, CYCLES = 5.0, 150.0, 0.006, 60
TIME = np.arange(int(CYCLES / FREQUENCY * RATE)) / RATE
OMEGA = 2.0 * np.pi * FREQUENCY
NOISE = 10.0 ** (-50.0 / 20.0) / np.sqrt(2.0)
WALK = 0.2 * NOISE  # standard deviation of a step from one sample to the next


def motion(amplitude: float = 1.0) -> np.ndarray:
    """A linear decay from rest, in closed form."""
    damped = OMEGA * np.sqrt(1.0 - RATIO**2)
    angle = damped * TIME
    return amplitude * np.exp(-RATIO * OMEGA * TIME) * (np.cos(angle) + RATIO * OMEGA / damped * np.sin(angle))


def record(rng: np.random.Generator, walk: float, amplitude: float = 1.0, name: str = "one") -> Record:
    """The decay with white noise, and with a random walk whose steps have this standard deviation."""
    added = NOISE * rng.standard_normal(TIME.size) + np.cumsum(walk * rng.standard_normal(TIME.size))
    return Record(name, TIME, motion(amplitude) + added, "displacement", "m", "made in a test", ())


def test_density_is_that_of_the_random_walk_that_was_added():
    """Sampled at the rate r, a walk of steps s has the one-sided density 2 s^2 / r / (2 sin(pi f / r))^2."""
    at = FREQUENCY * np.array([0.02, 0.05, 0.1, 0.2])
    truth = 2.0 * WALK**2 / RATE / (2.0 * np.sin(np.pi * at / RATE)) ** 2
    found = [condition(record(np.random.default_rng(seed), WALK)).measured.wander for seed in range(16)]
    assert all(one is not None and one.probability > 0.95 for one in found)
    ratio = np.array([one.at(at) / truth for one in found if one is not None])
    # up to 48 squares of normal numbers tell a level to some 20 to 60 %, the lowest frequencies least; a part is in the
    # noise that the spectrum between the harmonics tells already
    assert np.all(np.exp(np.mean(np.log(ratio), axis=0)) > 0.5)
    assert np.all(np.exp(np.mean(np.log(ratio), axis=0)) < 1.3)
    assert np.std(np.log(ratio), axis=0).max() < 0.8


def test_white_noise_is_not_taken_for_a_wandering_zero():
    found = [condition(record(np.random.default_rng(100 + seed), 0.0)).measured.wander for seed in range(24)]
    sure = sum(one is not None and one.probability > 0.95 for one in found)
    assert sure <= 1
    assert sum(one is not None and one.is_possible for one in found) <= 8
    assert not any("wanders" in note for note in condition(record(np.random.default_rng(100), 0.0)).notes)


def test_a_large_release_is_not_taken_for_a_wandering_zero():
    """A pendulum from 160 degrees (SciPy): where its frequency changes fast, means over a cycle are off at the edge."""
    omega, time = 2.0 * np.pi * 0.9, np.arange(0.0, 60.0, 1.0 / 90.0)
    solved = solve_ivp(
        lambda _, y: [y[1], -0.03 * omega * y[1] - omega**2 * np.sin(y[0])], (0.0, time[-1]), [np.radians(160.0), 0.0],
        t_eval=time, rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    probabilities = []
    for seed in range(8):
        begun = int(90 * np.random.default_rng(seed).uniform(0.0, 2.0))
        noise = 0.005 * np.random.default_rng(seed).standard_normal(time.size - begun)
        made = Record("one", time[: time.size - begun], solved.y[0][begun:] + noise, "displacement", "rad", "test", ())
        slow = condition(made).measured.wander
        probabilities.append(0.0 if slow is None else slow.probability)
    assert np.mean(np.array(probabilities) > 0.5) < 0.2, probabilities


@pytest.mark.parametrize("power", [2, 1])
def test_mid_line_of_a_structure_is_not_taken_for_a_wandering_zero(power):
    """SciPy's decay from a spring with a quadratic force, and from one that is harder on one side."""

    def rate(t: float, y: np.ndarray) -> list[float]:
        pull = y[0] + 0.2 * (y[0] ** 2 if power == 2 else max(y[0], 0.0))
        return [y[1], -(OMEGA**2) * pull - 2.0 * RATIO * OMEGA * y[1]]

    exact = solve_ivp(rate, (0.0, TIME[-1]), [1.0, 0.0], "DOP853", TIME, rtol=1e-10, atol=1e-12).y[0]
    assert abs(exact[: int(4 * RATE / FREQUENCY)].mean()) > 0.02  # the mid-line is far off
    for seed in range(5):
        noisy = exact + 0.1 * NOISE * np.random.default_rng(seed).standard_normal(TIME.size)
        measured = condition(Record("one", TIME, noisy, "displacement", "m", "made in a test", ())).measured
        if measured.slow_noise is not None:
            assert measured.slow_noise.size(1.0 / RATE, TIME.size, 0.0) < 0.1 * NOISE


def test_records_of_one_sensor_are_judged_together():
    """A record of few cycles in which slow noise hides is not taken for quiet where that of the others does not."""
    found = [condition(record(np.random.default_rng(seed), 0.1 * WALK)).measured.wander for seed in range(16)]
    alone = [one for one in found if one is not None]
    doubtful = [k for k, one in enumerate(alone) if not one.is_sure]
    together = of_one_sensor(alone)
    assert len(doubtful) >= 4, "the walk is too plain for this test"
    assert sum(one is None or not one.is_sure for one in together) <= len(doubtful) - 2
    assert all(one is not None and one.is_possible for one in together)
    quiet = [condition(record(np.random.default_rng(400 + seed), 0.0)).measured.wander for seed in range(6)]
    assert not any(one is not None and one.is_sure for one in of_one_sensor(quiet))
    # six records in which it hardly shows tell of it together, and quiet ones of its absence
    faint = [condition(record(np.random.default_rng(60 + seed), 0.04 * WALK)).measured.wander for seed in range(6)]
    assert sum(one is None or not one.is_possible for one in faint) >= 3, "the walk is too plain for this test"
    assert all(one is not None and one.is_possible for one in of_one_sensor(faint))
    among = of_one_sensor(quiet)
    assert all(one.probability < alone.probability for one, alone in zip(among, quiet, strict=True))
    # one that is loud among quiet ones stays so
    mixed = of_one_sensor([*quiet, condition(record(np.random.default_rng(1), WALK)).measured.wander])
    assert mixed[-1] is not None and mixed[-1].is_sure


def line(change: float, side: float = 1.0, low: float = 0.1, high: float = 1.0, error: float = 1e-4) -> Wander:
    """A mid-line that moves with the square of the amplitude, by so much up to 1."""
    amplitude = np.linspace(low, high, 20)
    own = MidLine(amplitude, change * amplitude**2, error, side)
    return Wander(np.zeros(1), np.ones(1), 1.0, 0.1, np.zeros(1), np.zeros((0, 2)), own)


@pytest.mark.parametrize(
    ("lines", "differ"),
    [
        ([line(0.02), line(0.03, high=0.7), line(0.025, low=0.2)], False),  # a third of scatter
        ([line(0.02), line(-0.03), line(0.025)], True),
        ([line(0.02, 1.0), line(-0.02, -1.0)], False),  # to the side of the release
        ([line(0.02, 1.0), line(-0.02, 1.0)], True),
        ([line(2e-4), line(-2e-4), line(-1e-4)], False),  # within the errors
        ([line(0.02, low=0.8), line(-0.02, high=0.9)], False),  # hardly an amplitude in common
        ([line(0.02), None], False),
    ],
)
def test_mid_lines_of_one_structure_are_one_function_of_the_amplitude(lines, differ):
    assert mid_lines_differ(lines) == differ


def test_a_zero_that_drifts_otherwise_in_each_record_is_not_taken_for_physics():
    """A drift is smooth, and so a function of the amplitude in one decay; only beside others it is seen to be none."""
    records = drifting(300, (0.03, -0.02, 0.01))
    together = records_of_one_sensor([condition(one) for one in records])
    for one, alone in zip(together, (condition(one) for one in records), strict=True):
        assert not alone.measured.wander.is_sure and one.measured.wander.is_sure
        assert sum("zero drifts" in note for note in one.notes) == 1
    batch = batch_of_conditioned(together)
    found = _linear_fit(batch)
    assert evidence.lack_of_fit(batch, found).p_value > 1e-3
    assert found.cost / sum(term.size for term in batch.deciding) == pytest.approx(1.0, abs=0.06)
    without = _linear_fit(batch_of(records))
    assert without.cost > 5.0 * found.cost


def drifting(seed: int, sizes: tuple[float, ...]) -> list[Record]:
    """Records whose zero creeps by so much, smoothly and so as a function of the amplitude."""
    records = [record(np.random.default_rng(seed + r), 0.0, 1.0 - 0.1 * r, f"s{r}") for r in range(len(sizes))]
    creep = 1.0 - np.exp(-2.0 * TIME / TIME[-1])
    return [replace(one, values=one.values + size * creep) for one, size in zip(records, sizes, strict=True)]


def test_damping_is_not_that_of_a_zero_that_creeps():
    """Its slope takes as much from each decrement as it adds to a cycle, over the amplitude: 50 of its errors here."""
    together = records_of_one_sensor([condition(one) for one in drifting(300, (0.03, -0.02, 0.01))])
    truth = 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2)
    levels = np.geomspace(0.15, 0.75, 5)
    for one in together:
        cycles = extract_cycles(one)
        off = (cycles.damping - truth) / cycles.damping_error
        assert 0.4 < float(np.mean(off**2)) < 1.6
        values = backbones_at_levels([cycles], levels, ("damping",), amplitude_unit="m")
        far = (values["value"].values - truth) / values["standard_error"].values
        assert np.abs(far).max() < 3.5
    blind = extract_cycles(replace(together[0], measured=replace(together[0].measured, wander=None)))
    values = backbones_at_levels([blind], levels, ("damping",), amplitude_unit="m")
    far = (values["value"].values - truth) / values["standard_error"].values
    assert np.abs(far).max() > 20.0


def test_a_zero_that_drifts_alike_in_all_records_is_no_missing_effect():
    """No record differs from the others; but no effect moves the mid-line so and leaves the harmonics as they are."""
    study = pb.find_missing_effect(
        pb.Oscillator(MASS), drifting(310, (0.02, 0.021)), candidates=["quadratic_stiffness", "coulomb_friction"],
        quick=True, tolerance=0, random_seed=1,
    )  # fmt: skip
    assert study.verdict == "adequate"
    assert sum(note == SENTENCE for note in study.notes) == 1


def test_the_mid_line_of_a_structure_is_not_taken_away(rng):
    """An asymmetric spring makes its harmonics: with all of the mid-line as noise it is still there."""
    question = ask(
        pb.Oscillator(MASS), drifting(310, (0.0, 0.0)), candidates=["coulomb_friction"], max_effects=1, tolerance=0,
        measuring=Measuring(),
    )  # fmt: skip
    search = Search(question.batch, question.base, question.candidates, 1)
    search.run()
    assert drifting_zero(question, search, Measuring()) is None  # nothing stands out of the noise
    bent = drifting_records(rng, 0.0, one_side=0.1)
    question = ask(
        pb.Oscillator(MASS), bent, candidates=["coulomb_friction"], max_effects=1, tolerance=0, measuring=Measuring()
    )
    search = Search(question.batch, question.base, question.candidates, 1)
    search.run()
    assert any(one.measured.wander.of_all.is_sure for one in question.batch.records)
    assert drifting_zero(question, search, Measuring()) is None


def test_whitening_makes_slow_noise_white():
    """The covariance of the noise, given in closed form, becomes the unit matrix."""
    wander = Wander(np.array([3e-6, 2e-7]), np.array([1.0, 2.0]), 3.0, 1.0, np.zeros(0), np.zeros((0, 2)))
    time = np.arange(200) / 40.0
    autocovariance = np.array([1e-5, 4e-6, 1e-6])
    modes = wander.modes(time, 1e-9)
    k = np.arange(1, modes.shape[1] + 1)
    density = sum(
        level * ((k / 10.0) ** -power - 3.0**-power) for level, power in zip((3e-6, 2e-7), (1, 2), strict=True)
    )
    # a cosine of length n at the rate r takes half the one-sided density times r
    assert (modes**2).sum(axis=0) == pytest.approx(20.0 * density, rel=1e-12)
    assert wander.size(1.0 / 40.0, 200, 1e-9) == pytest.approx(np.sqrt((modes**2).sum(axis=1).mean()), rel=1e-12)
    assert wander.modes(time, 1e-9, time[50:60]) == pytest.approx(modes[50:60], rel=1e-9, abs=1e-12)
    lag = np.abs(np.subtract.outer(np.arange(200), np.arange(200)))
    covariance = np.where(lag < 3, autocovariance[np.minimum(lag, 2)], 0.0) + modes @ modes.T
    white = with_slow_noise(whitener(autocovariance), modes)(np.eye(200))
    assert white @ covariance @ white.T == pytest.approx(np.eye(200), abs=0.05)
    plain = whitener(autocovariance)(np.eye(200))
    assert np.linalg.eigvalsh(plain @ covariance @ plain.T).max() > 40.0


def _linear_fit(batch: Batch) -> Fit:
    layout = make_layout(Oscillator(MASS), batch.amplitude, batch.angular_frequency)
    found = fit(layout, batch.deciding, start_state(layout, np.zeros(0), batch.own), nuisances=batch.nuisances)
    assert found is not None
    return found


def test_a_wandering_zero_is_not_taken_for_physics():
    p_values, ratios = [], []
    for seed in range(4):
        rng = np.random.default_rng(200 + seed)
        batch = batch_of([record(rng, WALK, 1.0 - 0.2 * r, f"specimen {r}") for r in range(3)])
        found = _linear_fit(batch)
        p_values.append(evidence.lack_of_fit(batch, found).p_value)
        ratios.append(found.cost / sum(term.size for term in batch.deciding))
    assert min(p_values) > 1e-3
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_without_slow_noise_in_the_whitening_it_would_be(monkeypatch):
    """The negative control of the test above."""
    monkeypatch.setattr("pymc_backbone.measurement.conditioning.condition.find_wander", lambda *_: None)
    batch = batch_of([record(np.random.default_rng(200), WALK, 1.0 - 0.2 * r, f"specimen {r}") for r in range(3)])
    assert evidence.lack_of_fit(batch, _linear_fit(batch)).p_value < 1e-10


def test_offsets_at_levels_hold_the_wandering_zero():
    """Over many records the mid-line, in its standard errors, has the variance of standard normal numbers."""
    z = []
    for seed in range(8):
        batch = batch_of([record(np.random.default_rng(300 + seed), WALK)])
        term = batch.levels[0]
        rows = term.rows[:, 0] == 2
        z.append(float(np.mean((term.whitening[np.ix_(rows, rows)] @ term.values[rows]) ** 2)))
    assert 0.3 < np.mean(z) < 2.0  # fifty without
