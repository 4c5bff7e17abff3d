"""Cycles of a free decay: exact cases, errors that mean what they say, ends of records."""

from __future__ import annotations

import tracemalloc
import zlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pymc_backbone._common.checks import InputError
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.cycle_data import QUANTITIES
from pymc_backbone.measurement.cycles import extract_cycles, extract_cycles_from_arrays
from pymc_backbone.measurement.levels import backbones_at_levels
from pymc_backbone.measurement.reading.record import Record

FREQUENCY, RATIO = 2.0, 0.01


def generator(request: pytest.FixtureRequest) -> np.random.Generator:
    """Return a generator seeded by the test's name."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


def linear_decay(t: np.ndarray, ratio: float = RATIO) -> np.ndarray:
    """Return the decay of a linear oscillator released at rest from 1, damped frequency `FREQUENCY`."""
    w = 2.0 * np.pi * FREQUENCY
    decay = ratio / np.sqrt(1.0 - ratio**2) * w
    return np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))


def friction_decay(t: np.ndarray, loss: float) -> np.ndarray:
    """Return the decay under dry friction alone: every half cycle a cosine about +-loss, until it sticks."""
    w = 2.0 * np.pi * FREQUENCY
    half = np.floor(2.0 * FREQUENCY * t).astype(int)
    stuck = int(np.ceil((1.0 - loss) / (2.0 * loss)))
    half = np.minimum(half, stuck)
    sign = np.where(half % 2 == 0, 1.0, -1.0)
    swing = 1.0 - loss * (2.0 * half + 1.0)
    moving = sign * loss + swing * np.cos(w * t)
    final = (-1.0) ** stuck * (1.0 - 2.0 * loss * stuck)
    return np.where(half < stuck, moving, final)


@pytest.mark.parametrize("samples", [10, 37, 200])
def test_linear_decay_without_noise_is_exact(samples: int) -> None:
    t = np.arange(0.0, 15.0, 1.0 / (FREQUENCY * samples) * 1.013)
    cycles = extract_cycles_from_arrays(t, linear_decay(t))
    # the template holds the decay to second order in the damping ratio; (0.01 * 2.4)^3 / 6 = 2e-6 rad, at both peaks
    np.testing.assert_allclose(cycles.frequency, FREQUENCY, rtol=5e-6)
    np.testing.assert_allclose(cycles.damping, 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2), rtol=5e-4)
    assert len(cycles) >= 29
    assert np.all(np.diff(cycles.amplitude) < 0.0)


def scores(rng: np.random.Generator, noise: float, draws: int = 30) -> dict[str, np.ndarray]:
    """Return normalised errors of the cycle quantities of a linear decay over many draws."""
    t = np.arange(0.0, 12.0, 1.0 / (FREQUENCY * 25) * 1.013)
    clean = linear_decay(t)
    damping = 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2)
    found: dict[str, list[np.ndarray]] = {"frequency": [], "damping": []}
    for _ in range(draws):
        cycles = extract_cycles_from_arrays(t, clean + noise * rng.standard_normal(t.size), noise=noise)
        found["frequency"].append((cycles.frequency - FREQUENCY) / cycles.frequency_error)
        found["damping"].append((cycles.damping - damping) / cycles.damping_error)
    return {name: np.concatenate(values) for name, values in found.items()}


@pytest.mark.parametrize("noise", [1e-3, 1e-2, 5e-2])
def test_cycle_errors_are_honest(noise: float, request: pytest.FixtureRequest) -> None:
    for name, z in scores(generator(request), noise).items():
        # 700 correlated values, about 300 independent ones: three standard deviations of the variance are 0.25
        assert 0.75 < np.mean(z**2) < 1.25, name
        # neighbours share peaks with opposite signs, so the mean is tighter than 1/sqrt(700)
        assert abs(np.mean(z)) < 0.12, name


def test_noise_below_what_the_fits_leave_is_noticed(request: pytest.FixtureRequest) -> None:
    t = np.arange(0.0, 12.0, 0.02)
    noisy = linear_decay(t) + 0.01 * generator(request).standard_normal(t.size)
    right, wrong = (extract_cycles_from_arrays(t, noisy, noise=noise) for noise in (0.01, 0.003))
    assert any("times the given noise" in note for note in wrong.notes)
    np.testing.assert_allclose(np.median(wrong.frequency_error / right.frequency_error), 1.0, atol=0.25)


def test_noise_is_estimated_when_not_given(request: pytest.FixtureRequest) -> None:
    t = np.arange(0.0, 12.0, 0.02)
    cycles = extract_cycles_from_arrays(t, linear_decay(t) + 0.01 * generator(request).standard_normal(t.size))
    assert cycles.noise == pytest.approx(0.01, rel=0.12)  # 600 samples: 3 %, four standard deviations


def test_coloured_noise_by_its_autocovariance(request: pytest.FixtureRequest) -> None:
    rng = generator(request)
    t = np.arange(0.0, 12.0, 0.02)
    clean = linear_decay(t)
    kernel = np.array([1.0, 0.8, 0.5]) * 0.006
    autocovariance = np.correlate(kernel, kernel, mode="full")[2:]
    z: dict[str, list[np.ndarray]] = {"told": [], "not told": []}
    for _ in range(25):
        noisy = clean + np.convolve(rng.standard_normal(t.size + 2), kernel, mode="valid")
        for name, noise in (("told", autocovariance), ("not told", np.sqrt(autocovariance[0]))):
            cycles = extract_cycles_from_arrays(t, noisy, noise=noise)
            z[name].append((cycles.frequency - FREQUENCY) / cycles.frequency_error)
    assert 0.75 < np.mean(np.concatenate(z["told"]) ** 2) < 1.3
    assert np.mean(np.concatenate(z["not told"]) ** 2) > 1.5  # the negative control: white noise is a wrong model


def test_friction_stop_leaves_no_cycle_at_rest(request: pytest.FixtureRequest) -> None:
    t = np.arange(0.0, 30.0, 1.0 / 80.0)
    loss, noise = 0.011, 1e-3
    noisy = friction_decay(t, loss) + noise * generator(request).standard_normal(t.size)
    cycles = extract_cycles_from_arrays(t, noisy, noise=noise)
    exact = 1.0 - 2.0 * loss * (2.0 * np.arange(len(cycles)) + 1.0)
    assert 18 <= len(cycles) <= 22  # 45 swings fit into 1 / 0.022
    assert np.all(np.abs(cycles.amplitude - exact) < 5.0 * cycles.amplitude_error)
    truth = 2.0 * np.log((exact + loss * 1.0) / (exact - loss * 1.0))
    assert np.all(np.abs(cycles.damping - truth) < 5.0 * cycles.damping_error)
    np.testing.assert_allclose(cycles.frequency, FREQUENCY, atol=5.0 * cycles.frequency_error.max())


def test_asymmetry_and_static_offset_are_kept(request: pytest.FixtureRequest) -> None:
    t = np.arange(0.0, 12.0, 0.01)
    x = linear_decay(t)
    bent = x + 0.1 * x**2 + 0.03
    noisy = bent + 1e-3 * generator(request).standard_normal(t.size)
    cycles = extract_cycles_from_arrays(t, noisy, noise=1e-3)
    clean = extract_cycles_from_arrays(t, bent)
    np.testing.assert_allclose(cycles.offset, clean.offset, atol=5.0 * cycles.offset_error.max())
    # at small amplitude only the static offset is left of the mid-line
    assert cycles.offset[0] == pytest.approx((0.03 + 0.1 * cycles.amplitude[0] ** 2) / cycles.amplitude[0], rel=0.05)


def test_a_record_that_begins_in_mid_swing_starts_at_its_first_peak() -> None:
    t = np.arange(0.18, 12.0, 0.01)
    cycles = extract_cycles_from_arrays(t, linear_decay(t))
    assert cycles.turning_times[0] == pytest.approx(0.25, abs=2e-3)
    assert cycles.turning_signs[0] == -1.0
    assert cycles.time[0] == pytest.approx(0.75, abs=2e-3)


def test_cycles_below_the_noise_are_dropped(request: pytest.FixtureRequest) -> None:
    t = np.arange(0.0, 40.0, 0.02)
    noisy = linear_decay(t, 0.02) + 0.02 * generator(request).standard_normal(t.size)
    cycles = extract_cycles_from_arrays(t, noisy, noise=0.02)
    assert 12 < len(cycles) < 30
    assert np.all(cycles.smoothed_amplitude > 6.0 * cycles.amplitude_error)


def test_rescaled_time_and_amplitude_change_nothing_else(request: pytest.FixtureRequest) -> None:
    t = np.arange(0.0, 12.0, 0.02)
    noisy = linear_decay(t) + 0.01 * generator(request).standard_normal(t.size)
    one = extract_cycles_from_arrays(t, noisy, noise=0.01)
    other = extract_cycles_from_arrays(t * 1e-3 + 5.0, noisy * 1e-6, noise=0.01e-6)
    scale = {"amplitude": 1e-6, "frequency": 1e3, "damping": 1.0, "offset": 1.0}
    for name in QUANTITIES:
        for suffix in ("", "_error"):
            # the smoothing's eigenvalues see rounding: 1e-6
            np.testing.assert_allclose(
                getattr(other, name + suffix),
                getattr(one, name + suffix) * scale[name],
                rtol=1e-5,
                atol=1e-7 * scale[name],
            )


def test_record_objects_and_their_noise() -> None:
    t = np.arange(0.0, 12.0, 0.02)
    record = SimpleNamespace(
        specimen="a", time=t, displacement=linear_decay(t), noise=1e-3, notes=("cut at the release",)
    )
    cycles = extract_cycles(record)
    assert (cycles.specimen, cycles.noise, cycles.notes) == ("a", 1e-3, ("cut at the release",))


@pytest.mark.parametrize(
    ("time", "displacement", "words"),
    [
        (np.arange(100.0) ** 1.1, np.cos(np.arange(100.0)), "uniform"),
        (np.arange(100.0), np.ones(100), "must move"),
        (np.arange(100.0), np.cos(np.arange(99.0)), "as long as"),
        (np.arange(100.0), np.cos(np.arange(100.0) * 0.1), "at least four cycles"),
        (np.arange(100.0), np.where(np.arange(100) == 3, np.nan, 1.0), "finite"),
    ],
)
def test_unusable_records_say_why(time: np.ndarray, displacement: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        extract_cycles_from_arrays(time, displacement)


@pytest.mark.parametrize("cycles", [5, 6, 7])
def test_records_of_a_few_cycles_are_extracted(cycles: int, request: pytest.FixtureRequest) -> None:
    # fewer turning points than the running mean that widens standard errors is long
    t = np.arange(0.0, (cycles + 0.4) / FREQUENCY, 1.0 / (FREQUENCY * 40))
    noise = 1e-3 * generator(request).standard_normal(t.size)
    found = extract_cycles_from_arrays(t, linear_decay(t) + noise, noise=1e-3)
    assert len(found) >= cycles - 1
    assert found.turning_times.size <= 15
    np.testing.assert_array_less(np.abs(found.frequency - FREQUENCY), 5.0 * found.frequency_error)


def test_very_short_records_give_a_backbone_or_a_reason(rng: np.random.Generator) -> None:
    reasons: list[str] = []
    backbones = 0
    for length in np.arange(2.5, 6.5, 0.1):
        t = np.arange(0.0, length / FREQUENCY, 1.0 / (FREQUENCY * 20))
        try:
            angle = 2.0 * np.pi * FREQUENCY * t
            motion = np.exp(-0.04 * angle) * np.cos(angle) + 1e-3 * rng.standard_normal(t.size)
            found = extract_cycles_from_arrays(t, motion, noise=1e-3)
            values = backbones_at_levels([found])["value"].values
        except InputError as error:
            reasons.append(str(error))
            continue
        assert len(found) >= 4 and np.isfinite(values).all()
        backbones += 1
    assert any("at least four cycles" in reason for reason in reasons)
    assert len(reasons) >= 8 and backbones >= 10


def test_four_cycles_of_a_quantised_acceleration_are_enough():
    """Fewer cycles than bands of their covariance."""
    time = 0.01 * np.arange(1, 101)
    noise = 1e-6 * np.random.default_rng(100).normal(size=time.size)
    values = np.round(1e3 * (np.exp(-time) * np.cos(10.0 * np.pi * time) + noise)) * 1e-9
    cycles = extract_cycles(condition(Record("short", time, values, "acceleration")))
    assert cycles.frequency.size == 4
    # the damped frequency of cos(10 pi t) exp(-t), and its decrement over a fifth of a second
    np.testing.assert_allclose(cycles.frequency, 5.0, rtol=5e-3)
    np.testing.assert_allclose(cycles.damping, 0.2, rtol=0.15)


def test_one_wrong_time_stamp_does_not_ask_for_all_memory():
    time = 0.01 * np.arange(200)
    time[150:] += 1e12
    record = Record("beam", time, np.cos(0.3 * np.arange(200)))
    with pytest.raises(InputError, match=r"beam: 1e\+12 s lie between the time stamps 1.49 and .* cut the record"):
        condition(record)


def test_memory_grows_with_the_record_not_with_its_square(rng: np.random.Generator) -> None:
    """A lightly damped structure rings for thousands of cycles; a covariance of all of them would fill the memory."""
    count, frequency = 6000, 100.0
    t = np.arange(0.0, count / frequency, 1.0 / (16 * frequency) * 1.013)
    rate = np.log(20.0) / t[-1]
    decay = np.exp(-rate * t) * np.cos(2.0 * np.pi * frequency * t) + 1e-3 * rng.standard_normal(t.size)
    tracemalloc.start()
    try:
        cycles = extract_cycles_from_arrays(t, decay)
        backbone = backbones_at_levels([cycles])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(cycles) > 5900
    assert peak < 0.5 * 8 * len(cycles) ** 2
    error = np.asarray(backbone["standard_error"].sel(observable="frequency"))
    np.testing.assert_array_less(np.abs(backbone["value"].sel(observable="frequency") - frequency), 5.0 * error)
    np.testing.assert_array_less(error, 1e-3)


def test_smoothed_amplitudes_have_the_covariance_of_many_draws() -> None:
    """The factors of the covariance, against amplitudes of records that differ in their noise alone."""
    t = np.arange(0.0, 12.0, 1.0 / (FREQUENCY * 25) * 1.013)
    runs = []
    for seed in range(40):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(t.size)
        runs.append(extract_cycles_from_arrays(t, linear_decay(t) + noise, noise=1e-3))
    n = min(map(len, runs))
    observed = np.std([run.smoothed_amplitude[:n] for run in runs], axis=0)
    factors = [(run.smoothed_amplitude_design[:n], run.smoothed_amplitude_spread) for run in runs]
    stated = np.mean([np.sqrt(np.einsum("ni,ij,nj->n", f, spread, f)) for f, spread in factors], axis=0)
    ratio = stated / observed
    assert np.median(ratio) == pytest.approx(1.0, abs=0.25)
    assert np.all(ratio > 0.7)


def test_a_mid_line_restored_from_a_velocity_is_known_to_what_its_law_may_be():
    """A spring that is bent and hardens: two terms do not follow its mid-line. Oracle: the displacement, by SciPy."""

    def rate(_t: float, y: NDArray[np.float64]) -> list[float]:
        return [y[1], -((2.0 * np.pi) ** 2) * (y[0] + 0.25 * y[0] ** 2 + 0.25 * y[0] ** 3) - 0.06 * y[1]]

    time = np.arange(0.0, 60.0, 1.0 / 64.0)
    x, v = solve_ivp(rate, (0.0, 60.0), [1.0, 0.0], "DOP853", time, rtol=1e-10, atol=1e-12).y
    rng = np.random.default_rng(2)
    noise = 1e-4 * rng.normal(size=time.size)
    truth = extract_cycles(condition(Record("x", time, x + noise)))
    record = condition(Record("v", time, v + 2.0 * np.pi * noise, "velocity", "m/s"))
    assert any("was restored" in note for note in record.notes)
    found = extract_cycles(record)
    late = found.amplitude > 0.3
    expected = np.interp(found.amplitude, truth.amplitude[::-1], truth.offset[::-1])
    off = np.abs(found.offset - expected)[late]
    assert np.all(off < 3.0 * found.offset_error[late])
    # negative control: its statistical error alone does not hold it
    alone = extract_cycles(replace(record, mid_line_shape_error=0.0))
    assert np.any(off > 6.0 * alone.offset_error[late])
    # what the error says is not much more than what is wrong
    assert np.median(found.offset_error[late]) < 0.5 * np.abs(expected).max()
