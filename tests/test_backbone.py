"""Backbones at levels: coverage, a negative control, NaN where nothing was measured, and simulated twins."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone.measurement.cycle_data import Cycles
from pymc_backbone.measurement.cycles import extract_cycles_from_arrays
from pymc_backbone.measurement.levels import backbones_at_levels, default_levels
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.backbones import simulate_population
from pymc_backbone.simulation.decay import simulate_backbone, simulate_waveform

STIFFNESS = (2.0 * np.pi) ** 2
EVERY = ("frequency", "damping", "offset")
CASES = {
    "cubic": (Oscillator(1.0, ["cubic_stiffness"]), {"viscous_damping": 0.063, "cubic_stiffness": 12.0}, 40),
    "friction": (Oscillator(1.0, ["coulomb_friction"]), {"viscous_damping": 0.063, "friction_force": 0.2}, 40),
    "asymmetric": (
        Oscillator(1.0, ["quadratic_stiffness"]),
        {"viscous_damping": 0.063, "quadratic_stiffness": 8.0},
        40,
    ),
    "dozen": (Oscillator(1.0, ["quadratic_damping"]), {"viscous_damping": 0.13, "quadratic_damping": 0.05}, 12),
}


def generator(request: pytest.FixtureRequest) -> np.random.Generator:
    """Return a generator seeded by the test's name."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


def normalised_errors(case: str, decibels: float, samples: int, rng: np.random.Generator, draws: int) -> np.ndarray:
    """Return (draws, observable, level) errors over standard errors."""
    oscillator, parameters, n_cycles = CASES[case]
    parameters = {"linear_stiffness": STIFFNESS} | parameters
    t = np.arange(0.0, float(n_cycles), 1.013 / samples)
    clean = simulate_waveform(oscillator, parameters, t, 1.0).displacement
    noise = 10.0 ** (-decibels / 20.0)
    rows, levels, truth = [], None, None
    for _ in range(draws):
        cycles = extract_cycles_from_arrays(t, clean + noise * rng.standard_normal(t.size), noise=noise)
        if levels is None:
            levels = default_levels([cycles])[1:]
            truth = simulate_backbone(oscillator, parameters, levels).values
        found = backbones_at_levels(cycles, levels, EVERY)
        rows.append((found.value.values[0] - truth) / found.standard_error.values[0])
    return np.array(rows)


def covers(z: np.ndarray) -> bool:
    """Return whether the 95 % intervals cover as often as they say; a dozen effective values a curve and observable."""
    inside = np.abs(z[np.isfinite(z)]) < 1.96
    return bool(np.mean(inside) > 0.90 and np.sqrt(np.nanmean(z**2)) < 1.25)


@pytest.mark.parametrize(
    ("case", "decibels", "samples"),
    [
        ("cubic", 40, 25),
        ("cubic", 20, 60),
        ("friction", 40, 40),
        ("asymmetric", 30, 25),
        ("dozen", 40, 25),
        ("dozen", 50, 12),
    ],
)
def test_level_values_are_covered(case: str, decibels: float, samples: int, request: pytest.FixtureRequest) -> None:
    z = normalised_errors(case, decibels, samples, generator(request), draws=14)
    assert covers(z)
    # sampling error of a mean over 14 draws is 0.27; bias must not show beside it
    assert np.sqrt(np.nanmean(np.nanmean(z, axis=0) ** 2)) < 0.6


def test_standard_errors_half_as_large_fail_the_coverage_check(request: pytest.FixtureRequest) -> None:
    assert not covers(2.0 * normalised_errors("cubic", 40, 25, generator(request), draws=14))


def decay(ratio: float, seconds: float, name: str, rng: np.random.Generator, release: float = 1.0) -> Cycles:
    """Return the cycles of a noisy linear decay of 1 Hz."""
    t = np.arange(0.0, seconds, 0.04)
    x = release * np.exp(-2.0 * np.pi * ratio * t) * np.cos(2.0 * np.pi * t)
    return extract_cycles_from_arrays(t, x + 1e-3 * rng.standard_normal(t.size), noise=1e-3, specimen=name)


def test_dataset_follows_the_contract(request: pytest.FixtureRequest) -> None:
    rng = generator(request)
    found = backbones_at_levels([decay(0.01, 30.0, "a", rng), decay(0.01, 30.0, "b", rng)], observables=EVERY)
    assert found.value.dims == found.standard_error.dims == ("specimen", "observable", "level")
    assert found.covariance.dims == ("specimen", "observable", "level", "level_other")
    assert list(found.observable.values) == list(EVERY)
    assert found.attrs["amplitude_unit"] == "m"
    assert isinstance(found.attrs["notes"], list)
    diagonal = np.diagonal(found.covariance.values, axis1=2, axis2=3)
    np.testing.assert_allclose(np.sqrt(diagonal), found.standard_error.values)
    assert np.linalg.eigvalsh(found.covariance.values).min() > -1e-12 * found.covariance.values.max()


def test_levels_not_reached_are_nan(request: pytest.FixtureRequest) -> None:
    rng = generator(request)
    cycles = [decay(0.01, 30.0, "long", rng), decay(0.01, 12.0, "short", rng), decay(0.01, 30.0, "low", rng, 0.4)]
    found = backbones_at_levels(cycles, [0.1, 0.2, 0.3, 0.6, 0.9, 3.0])
    filled = np.isfinite(found.value.sel(observable="damping").values)
    lowest, highest = ([c.smoothed_amplitude.min() for c in cycles], [c.smoothed_amplitude.max() for c in cycles])
    for i in range(3):
        inside = (found.level.values >= lowest[i]) & (found.level.values <= highest[i])
        np.testing.assert_array_equal(filled[i], inside)
    np.testing.assert_array_equal(np.isfinite(found.standard_error.values), np.isfinite(found.value.values))
    assert not filled[:, -1].any()
    assert any("short: " in note and "not reached" in note for note in found.attrs["notes"])


def test_default_levels_lie_where_all_specimens_were(request: pytest.FixtureRequest) -> None:
    rng = generator(request)
    cycles = [decay(0.01, 30.0, "a", rng), decay(0.01, 20.0, "b", rng, 0.8)]
    levels = default_levels(cycles)
    assert 3 <= levels.size <= 10
    assert levels[0] > max(c.smoothed_amplitude.min() for c in cycles)
    assert levels[-1] < min(c.smoothed_amplitude.max() for c in cycles)
    assert np.isfinite(backbones_at_levels(cycles).value.values).all()


def test_rescaled_amplitude_and_time(request: pytest.FixtureRequest) -> None:
    t = np.arange(0.0, 30.0, 0.04)
    x = np.exp(-0.06 * t) * np.cos(2.0 * np.pi * t) + 1e-2 * generator(request).standard_normal(t.size)
    one = backbones_at_levels(extract_cycles_from_arrays(t, x, noise=1e-2), [0.3, 0.5, 0.8])
    other = backbones_at_levels(
        extract_cycles_from_arrays(t / 50, x * 1e-4, noise=1e-6), np.array([0.3, 0.5, 0.8]) * 1e-4
    )
    scale = np.array([50.0, 1.0])[:, None]
    np.testing.assert_allclose(other.value.values[0], one.value.values[0] * scale, rtol=1e-5)
    np.testing.assert_allclose(other.standard_error.values[0], one.standard_error.values[0] * scale, rtol=1e-3)


def test_simulated_backbones_have_the_same_shape_and_no_error() -> None:
    oscillator, parameters, _ = CASES["cubic"]
    row = oscillator.pack({"linear_stiffness": STIFFNESS} | parameters)
    found = simulate_population(oscillator, np.array([row, row * 1.01]), [0.2, 0.5, 0.9], EVERY)
    assert found.value.shape == (2, 3, 3)
    np.testing.assert_array_equal(found.value.values[0], simulate_backbone(oscillator, row, [0.2, 0.5, 0.9]).values)
    np.testing.assert_array_equal(found.covariance.values, 0.0)


def test_what_cannot_be_used_is_refused(request: pytest.FixtureRequest) -> None:
    rng = generator(request)
    one = decay(0.01, 20.0, "a", rng)
    with pytest.raises(InputError, match="twice"):
        backbones_at_levels([one, one])
    with pytest.raises(InputError, match="inside the measured"):
        backbones_at_levels(one, [5.0, 6.0])
    with pytest.raises(InputError, match="frequency"):
        backbones_at_levels(one, observables=("frequencies",))
    with pytest.raises(InputError, match="at least one"):
        backbones_at_levels([])
    with pytest.raises(InputError, match="share a range"):
        backbones_at_levels([one, decay(0.01, 20.0, "b", rng, 0.05), decay(0.01, 9.0, "c", rng, 8.0)])


DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the measured records of ../shared/data are not here")


def measured(path: Path, band: tuple[float, float] | None = None) -> Cycles:
    """Return the cycles of a measured record."""
    from pymc_backbone.measurement.conditioning.condition import condition
    from pymc_backbone.measurement.cycles import extract_cycles
    from pymc_backbone.measurement.reading.records import read_records

    return extract_cycles(condition(read_records(path)[0], band=band))


@needs_data
@pytest.mark.parametrize(("run", "per_cent"), [("run_21337", 0.488), ("run_21340", 1.33)])
def test_ship_roll_damping_agrees_with_what_was_published(run: str, per_cent: float) -> None:
    found = backbones_at_levels(measured(DATA / "ship_roll_kvlcc2" / f"{run}.csv"), [np.radians(5.0)])
    ratio = found.value.sel(observable="damping").item() / (2.0 * np.pi)
    assert 100.0 * ratio == pytest.approx(per_cent, rel=0.05)  # theirs is a fit of two terms over all amplitudes


@needs_data
def test_beam_records_fall_on_one_backbone() -> None:
    cycles = [measured(path, (90.0, 160.0)) for path in sorted((DATA / "jointed_beam").glob("*.csv"))]
    assert len(cycles) == 9
    speed = 2.0 * np.pi * 122.2
    found = backbones_at_levels(cycles, np.array([0.14, 0.19, 0.25]) / speed)
    frequency, damping = found.value.sel(observable="frequency"), found.value.sel(observable="damping") / (2.0 * np.pi)
    # nine hammer blows at three places: the specimens agree to 0.01 % in frequency and 3 % in damping
    assert np.ptp(frequency.values, axis=0).max() < 0.02
    assert (damping.std("specimen") / damping.mean("specimen")).max() < 0.03
    assert np.all(np.diff(frequency.mean("specimen")) < 0.0)
    assert np.all(np.diff(damping.mean("specimen")) > 0.0)
    assert 122.3 < frequency.values.min() < frequency.values.max() < 122.42
