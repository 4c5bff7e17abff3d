"""Two modes that beat, told from one nonlinear mode whose decay two damped oscillations imitate as well."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pymc_backbone.discrepancy.checks import second_mode
from pymc_backbone.discrepancy.disturbances.close_modes import close_lines, close_modes, lines_that_beat

FREQUENCY, OTHER, RATE = 40.0, 40.5, 1600.0
TIME = np.arange(0.0, 4.0, 1.0 / RATE)


def beating(size: float, share: float, phase: float, frequency: float = FREQUENCY) -> np.ndarray:
    """The sum of two linear modes of nearly one frequency."""
    first = np.exp(-0.8 * TIME) * np.cos(2.0 * np.pi * frequency * TIME)
    return size * (first + share * np.exp(-1.2 * TIME) * np.cos(2.0 * np.pi * OTHER * TIME + phase))


def nonlinear(size: float) -> np.ndarray:
    """A softening spring with drag, by SciPy: frequency and damping change with the amplitude."""
    omega = 2.0 * np.pi * FREQUENCY

    def rate(_time: float, y: np.ndarray) -> list[float]:
        return [y[1], -(omega**2) * (y[0] - 0.05 * y[0] ** 3) - 1.6 * y[1] - 0.02 * y[1] * abs(y[1])]

    run = solve_ivp(rate, (0.0, TIME[-1]), [size, 0.0], "DOP853", t_eval=TIME, rtol=1e-9, atol=1e-12)
    return run.y[0]


def batch_of(records: list[np.ndarray], rng: np.random.Generator) -> SimpleNamespace:
    noisy = [item + 1e-3 * np.abs(item).max() * rng.normal(size=item.size) for item in records]
    return SimpleNamespace(
        waveform=[SimpleNamespace(time=TIME, values=item, size=item.size) for item in noisy],
        records=[SimpleNamespace(frequency=FREQUENCY, band=(30.0, 50.0), time=TIME) for _ in noisy],
        specimens=[f"hit {r}" for r in range(len(noisy))],
    )


def test_two_modes_that_beat_are_found(rng):
    records = [
        beating(size, share, phase) for size, share, phase in [(1.0, 0.5, 0.3), (0.5, 0.3, 2.0), (2.0, 0.6, 1.0)]
    ]
    batch = batch_of(records, rng)
    found = close_modes(batch, [0.2 * item for item in records])
    assert found is not None and found.specimen in batch.specimens
    assert (found.frequency, found.other) == pytest.approx((FREQUENCY, OTHER), abs=0.005)
    assert found.share == pytest.approx({"hit 0": 0.5, "hit 1": 0.3, "hit 2": 0.6}[found.specimen], abs=0.02)


@pytest.mark.parametrize("sizes", [(1.0,), (1.0, 0.6, 0.3)])
def test_one_nonlinear_mode_is_no_beat(sizes, rng):
    """Although the sum of two damped oscillations leaves a thousandth of it, and a set that is wrong leaves a fifth."""
    records = [nonlinear(size) for size in sizes]
    assert close_modes(batch_of(records, rng), [0.2 * item for item in records]) is None


def test_partials_beside_the_two_speak_against_neither(rng):
    """A string has a partial at twice the frequency, which neither the best set nor the two modes explain."""
    partial = 0.08 * np.exp(-2.0 * TIME) * np.cos(2.0 * np.pi * 2.03 * FREQUENCY * TIME)
    records = [size * (beating(1.0, 0.5, 0.3) + partial) for size in (1.0, 0.5)]
    left = [0.2 * beating(size, 0.5, 0.3) + size * partial for size in (1.0, 0.5)]
    assert close_modes(batch_of(records, rng), left) is not None


def test_what_a_set_explains_as_well_is_no_beat(rng):
    records = [beating(size, 0.5, 0.3) for size in (1.0, 0.5)]
    assert close_modes(batch_of(records, rng), [2e-3 * item for item in records]) is None


def test_modes_whose_frequencies_change_from_record_to_record_are_none(rng):
    """As where one mode of a structure meets another that the release moves."""
    records = [beating(1.0, 0.5, 0.3), 0.5 * nonlinear(1.0) + 0.3 * np.exp(-TIME) * np.cos(2.0 * np.pi * 41.5 * TIME)]
    assert close_modes(batch_of(records, rng), [0.2 * item for item in records]) is None


def test_a_beat_is_told_behind_a_band_pass_too(rng, monkeypatch):
    batch = batch_of([beating(1.0, 0.5, 0.3), beating(0.5, 0.5, 1.0)], rng)
    monkeypatch.setattr(second_mode.evidence, "residuals_as_measured", lambda term, best, r: 0.2 * term.values)
    check = second_mode.second_mode_check(batch, SimpleNamespace(chi_square=[1e3 * TIME.size] * 2))
    assert not check.passed and "two modes at 40 and 40.5 Hz" in check.message and "no band keeps one" in check.message
    explained = second_mode.second_mode_check(batch, SimpleNamespace(chi_square=[1.0 * TIME.size] * 2))
    assert explained.passed


def test_the_smaller_of_two_modes_is_a_line_of_each_record(rng):
    """Also of one that does not show it, at its usual order of the frequency there, and of no height."""
    shares = [(1.0, 0.2, 0.3), (0.5, 0.1, 2.0), (2.0, 0.3, 1.0)]
    records = [*(beating(*of) for of in shares), beating(1.0, 0.0, 0.0)]
    lines = close_lines(batch_of(records, rng))
    assert lines is not None
    for line, (size, share, phase) in zip(lines[:3], shares, strict=True):
        assert line.frequency == pytest.approx(OTHER, abs=0.01) and line.decay == pytest.approx(1.2, rel=0.05)
        assert line.cosine == pytest.approx(size * share * np.cos(phase), abs=0.02 * size * share)
        assert line.sine == pytest.approx(-size * share * np.sin(phase), abs=0.02 * size * share)
        assert (line.begin, line.end, line.release) == (TIME[0], TIME[-1], TIME[0])
    assert lines[3].frequency == pytest.approx(OTHER, abs=0.01) and lines[3].cosine == lines[3].sine == 0.0


@pytest.mark.parametrize(("last", "is_one"), [(40.15, True), (40.9, False)])
def test_the_smaller_mode_is_the_same_in_specimens_whose_larger_one_is_not(last, is_one, rng):
    """Specimens differ in the mode that is looked at; so that it passes the other one they do not."""
    records = [beating(1.0, 0.2, 0.3, frequency) for frequency in (39.85, 40.0, last)]
    batch = batch_of(records, rng)
    assert close_modes(batch, [0.2 * item for item in records]) is None
    lines = close_lines(batch)
    assert (lines is not None) == is_one
    if lines is not None:
        assert [line.frequency for line in lines] == pytest.approx([OTHER] * 3, abs=0.01)


@pytest.mark.parametrize(
    "records",
    [
        [nonlinear(size) for size in (1.0, 0.6, 0.3)],
        [beating(size, 0.6, 0.3) for size in (1.0, 0.5)],  # neither mode is the smaller one
        [beating(1.0, 0.2, 0.3), beating(1.0, 0.0, 0.0)],  # hardly half of the records hold it
    ],
)
def test_no_line_is_begun_where_records_do_not_hold_the_same_small_mode(records, rng):
    assert close_lines(batch_of(records, rng)) is None


@pytest.mark.parametrize(
    ("grow", "blow", "is_told"), [((True, True, False), False, True), ((False, True, False), False, False),
                                  ((True, True, True), True, False)],
)  # fmt: skip
def test_modes_that_beat_are_found_beyond_the_first_beat(grow, blow, is_told, rng):
    """Where the amplitude grows again records are cut, most often for another blow; whole, they are two modes."""
    whole = [beating(size, 0.3, 0.3) for size in (1.0, 0.5, 2.0)]
    if blow:
        whole = [one + np.where(TIME > 1.0, np.roll(one, round(RATE)), 0.0) for one in whole]
    batch = batch_of(whole, rng)
    records = [SimpleNamespace(specimen=f"hit {r}", time=TIME, values=one) for r, one in enumerate(whole)]
    for term in batch.waveform:  # what is left of them, much less than a beat
        term.time, term.values = TIME[: round(0.4 * RATE)], term.values[: round(0.4 * RATE)]
    batch.has_open_records = True
    for record, grows in zip(batch.records, grow, strict=True):
        record.grows_again = grows
    assert close_lines(batch) is None
    lines = lines_that_beat(batch, records)
    assert (lines is not None) == is_told
    if lines is not None:
        assert [line.frequency for line in lines] == pytest.approx([OTHER] * 3, abs=0.01)
        assert [line.end for line in lines] == [TIME[-1]] * 3
    batch.has_open_records = False
    assert lines_that_beat(batch, records) is None
