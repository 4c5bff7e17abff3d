"""Fit of a measured frequency response: recovery, honest errors, folds, and a wrong law that is noticed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from pymc_backbone._common.checks import InputError
from pymc_backbone.simulation import response_fit
from pymc_backbone.simulation.forced_response import ForcedOscillator, frequency_response
from pymc_backbone.simulation.harmonic_balance import periodic_motion
from pymc_backbone.simulation.response_fit import fit_frequency_response

TRUTH = ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, force=1.2e-4)
START = ForcedOscillator(0.03842, 0.07098, 100.0, 0.0, force=1.2e-4)
GRID = np.linspace(6.2, 8.0, 40)
ERROR = 3e-7


def sweeps(oscillator: ForcedOscillator, grid: np.ndarray = GRID) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, amplitudes and branches of a sweep downwards followed by one upwards."""
    amplitude = frequency_response(oscillator, grid).amplitude
    lone = np.where(np.isfinite(amplitude[:, 0]), "lower", "upper")
    lower = np.where(np.isfinite(amplitude[:, 0]), amplitude[:, 0], amplitude[:, 2])
    upper = np.where(np.isfinite(amplitude[:, 2]), amplitude[:, 2], amplitude[:, 0])
    down = np.where(np.isfinite(amplitude[:, 2]), "upper", lone)
    return np.concatenate([grid, grid]), np.concatenate([upper, lower]), np.concatenate([down, lone])


def noisy(amplitude: np.ndarray, seed: int) -> np.ndarray:
    return amplitude + ERROR * np.random.default_rng(seed).normal(size=len(amplitude))


def test_standard_errors_are_honest_and_chi_square_is_one():
    """Twelve seeds, two quantities each; errors four times too small or too large would not pass."""
    frequency, amplitude, _ = sweeps(TRUTH)
    misses, p_values = [], []
    for seed in range(12):
        fit = fit_frequency_response(START, frequency, noisy(amplitude, seed + 100), standard_error=ERROR)
        names = ("stiffness", "softening")
        misses += [(fit.values[name] - getattr(TRUTH, name)) / fit.standard_errors[name] for name in names]
        p_values.append(fit.p_value)
        assert fit.degrees_of_freedom == 78
    within = np.count_nonzero(np.abs(misses) < 1.0)
    low, high = binom.ppf([0.005, 0.995], len(misses), 0.683)
    assert low <= within <= high
    assert np.count_nonzero(np.abs(misses) < 0.25) < low and np.count_nonzero(np.abs(misses) < 4.0) > high
    assert min(p_values) > 1e-3 and 0.1 < np.median(p_values) < 0.95


@pytest.mark.slow
def test_points_in_the_fold_would_make_errors_too_small(monkeypatch):
    """The figures of docs/beam.md; kept, the points next to the unstable motion are the negative control."""
    frequency, amplitude, _ = sweeps(TRUTH)
    scatter = {}
    for limit in (response_fit._NEAR_FOLD, 0.0):
        monkeypatch.setattr(response_fit, "_NEAR_FOLD", limit)
        fits = [
            fit_frequency_response(START, frequency, noisy(amplitude, seed), standard_error=ERROR) for seed in range(40)
        ]
        for name in ("stiffness", "softening"):
            misses = [(fit.values[name] - getattr(TRUTH, name)) / fit.standard_errors[name] for fit in fits]
            scatter[name, limit > 0.0] = np.std(misses)
    assert (scatter["stiffness", True], scatter["softening", True]) == pytest.approx((0.99, 1.04), abs=0.02)
    assert scatter["softening", False] == pytest.approx(1.6, abs=0.1)


@pytest.mark.parametrize("sweep", ["down", "up"])
def test_one_sweep_is_enough(sweep):
    frequency, amplitude, branch = sweeps(TRUTH)
    half = slice(None, len(GRID)) if sweep == "down" else slice(len(GRID), None)
    data = noisy(amplitude, 5)[half]
    nearest = fit_frequency_response(START, frequency[half], data, standard_error=ERROR)
    labelled = fit_frequency_response(START, frequency[half], data, standard_error=ERROR, branch=list(branch[half]))
    for fit in (nearest, labelled):
        for name in ("stiffness", "softening"):
            assert abs(fit.values[name] - getattr(TRUTH, name)) < 4.0 * fit.standard_errors[name]
        np.testing.assert_array_equal(fit.branches, branch[half])
        assert fit.p_value > 1e-3 and fit.past_fold == 0


def test_order_of_points_does_not_matter_and_scales_come_from_the_residuals():
    frequency, amplitude, _ = sweeps(TRUTH)
    data, order = noisy(amplitude, 8), np.random.default_rng(1).permutation(len(frequency))
    known = fit_frequency_response(START, frequency, data, standard_error=ERROR)
    unknown = fit_frequency_response(START, frequency[order], data[order])
    assert np.isnan(unknown.p_value) and unknown.chi_square == pytest.approx(unknown.degrees_of_freedom)
    scatter = np.sqrt(known.chi_square / known.degrees_of_freedom)
    for name in ("stiffness", "softening"):
        assert abs(unknown.values[name] - known.values[name]) < 1e-3 * known.standard_errors[name]
        assert unknown.standard_errors[name] == pytest.approx(scatter * known.standard_errors[name], rel=0.02)


def test_damping_and_force_can_be_fitted_too():
    frequency, amplitude, _ = sweeps(TRUTH)
    free = ("force", "damping", "softening", "stiffness")
    start = ForcedOscillator(0.03842, 0.05, 100.0, 0.0, force=1.7e-4)
    fit = fit_frequency_response(start, frequency, noisy(amplitude, 3), standard_error=ERROR, free=free)
    assert tuple(fit.values) == ("stiffness", "softening", "damping", "force")
    for name in free:
        assert abs(fit.values[name] - getattr(TRUTH, name)) < 3.5 * fit.standard_errors[name]
        assert fit.standard_errors[name] < 0.03 * getattr(TRUTH, name)
    assert fit.standard_errors["softening"] == pytest.approx(np.sqrt(fit.covariance[1, 1]))


@pytest.mark.parametrize(
    ("truth", "name"),
    [
        (ForcedOscillator(0.03842, 0.07098, 97.87, 0.05e9, force=1.2e-4), "nearly linear"),
        (ForcedOscillator(0.03842, 0.07098, 62.91, 49.3e9, force=4.0e-5), "softest, folded"),
        (ForcedOscillator(0.03842, 0.07098, 82.59, -9.16e9, force=1.6e-4), "hardening"),
        (ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, base_moment=6.5e-8), "shaken base"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_other_systems_are_recovered(truth, name):
    grid = np.linspace(0.8, 1.15, 40) * truth.natural_frequency
    frequency, amplitude, _ = sweeps(truth, grid)
    error = 0.01 * amplitude.max()
    data = np.abs(amplitude + error * np.random.default_rng(11).normal(size=len(amplitude)))
    start = ForcedOscillator(0.03842, 0.07098, 60.0, 0.0, force=truth.force, base_moment=truth.base_moment)
    fit = fit_frequency_response(start, frequency, data, standard_error=error)
    assert fit.p_value > 1e-3
    for quantity in ("stiffness", "softening"):
        assert abs(fit.values[quantity] - getattr(truth, quantity)) < 3.5 * fit.standard_errors[quantity]


def test_another_law_is_flagged():
    """Negative control: a quintic spring bends the resonance too, but not as the square of the amplitude."""
    omega = 2 * np.pi * GRID
    quintic = 6.0e18
    amplitude = np.empty(len(GRID))
    for i, w in enumerate(omega):
        stiff, g = 82.59 - 0.03842 * w**2, 0.625 * quintic
        # First harmonic of a quintic spring, (stiff - g s^2)^2 + (c w)^2 = F^2 / s; the upper of its branches.
        roots = np.roots([g * g, 0.0, -2 * stiff * g, 0.0, stiff**2 + (0.07098 * w) ** 2, -(1.2e-4**2)])
        real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
        amplitude[i] = np.sqrt(real[real < np.sqrt(82.59 / quintic)].max())
    assert np.ptp(amplitude) > 2e-5
    fit = fit_frequency_response(START, GRID, noisy(amplitude, 2), standard_error=ERROR)
    assert fit.p_value < 1e-6
    same = fit_frequency_response(START, *sweeps(TRUTH)[:2], standard_error=ERROR)
    assert same.chi_square < 1e-6


def test_neglected_harmonics_bias_little():
    """Amplitudes of the full motion: the fit is off by less than the share of the third harmonic."""
    frequency, amplitude, _ = sweeps(TRUTH, np.linspace(6.3, 8.0, 18))
    motions = [periodic_motion(TRUTH, f, a) for f, a in zip(frequency, amplitude, strict=True)]
    full = np.array([motion.harmonic_amplitudes[0] for motion in motions])
    share = max(motion.harmonic_amplitudes[1] / motion.harmonic_amplitudes[0] for motion in motions)
    fit = fit_frequency_response(START, frequency, full, standard_error=ERROR)
    assert share < 0.01
    assert fit.values["stiffness"] == pytest.approx(TRUTH.stiffness, rel=1e-3)
    assert fit.values["softening"] == pytest.approx(TRUTH.softening, rel=2 * share)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"amplitude": [1e-6] * 3}, "`amplitude` must have a value for each of 4"),
        ({"amplitude": [1e-6, 2e-6, -1e-6, 1e-6]}, r"amplitude\[2\]"),
        ({"free": ("stiffnes",)}, "Did you mean 'stiffness'"),
        ({"free": ("stiffness", "softening", "damping", "force")}, "fewer than there are points"),
        ({"branch": "middle"}, "`branch` must be one of"),
        ({"branch": ["upper"]}, "`branch` must be one name or one for each"),
        ({"standard_error": 0.0}, "`standard_error` must be"),
        ({"frequency": [0.01, 0.011, 0.012, 0.013], "free": ("stiffness", "force")}, "does not determine"),
    ],
)
def test_what_cannot_be_used_is_refused(change, words):
    arguments = {"frequency": [6.5, 7.0, 7.5, 8.0], "amplitude": [1e-6] * 4, "standard_error": 1e-7, **change}
    with pytest.raises(InputError, match=words):
        fit_frequency_response(START, arguments.pop("frequency"), arguments.pop("amplitude"), **arguments)
