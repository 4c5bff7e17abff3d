"""Branches, folds and stability of the forced oscillator, against independent roots and direct integration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pymc_backbone._common.checks import InputError
from pymc_backbone.simulation.forced_response import ForcedOscillator, branch_roots, frequency_response
from pymc_backbone.simulation.harmonic_balance import periodic_motion

SAMPLE = ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, force=1.2e-4)
SYSTEMS = {
    "softening": SAMPLE,
    "softening, shaken base": ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, base_moment=6.5e-8),
    "hardening": ForcedOscillator(0.03842, 0.07098, 82.59, -9.16e9, force=3e-4),
    "lightly damped": ForcedOscillator(1.0, 1e-4, 1.0, -0.01, force=2e-4),
}


def cubic_roots(oscillator: ForcedOscillator, frequency: float) -> np.ndarray:
    """Squared amplitudes below the escape amplitude, from the cubic in another scaling, ascending."""
    omega, g = 2 * np.pi * frequency, 0.75 * oscillator.softening
    stiff = oscillator.stiffness - oscillator.mass * omega**2
    unit = oscillator.stiffness / abs(g)
    force = oscillator.force + oscillator.base_moment * omega**2
    a = np.array([g * g, -2 * stiff * g, stiff**2 + (oscillator.damping * omega) ** 2, -(force**2)])
    roots = np.roots(a * unit ** np.array([3, 2, 1, 0]) / oscillator.stiffness**2 / unit) * unit
    roots = np.sort(roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)])
    return roots[roots < oscillator.escape_amplitude**2]


@pytest.mark.parametrize("oscillator", SYSTEMS.values(), ids=SYSTEMS)
def test_branches_are_all_roots_and_folds_are_where_their_number_changes(oscillator):
    f = np.linspace(0.55, 1.6, 1500) * oscillator.natural_frequency
    response = frequency_response(oscillator, f)
    counts = np.empty(len(f), dtype=int)
    for i, frequency in enumerate(f):
        expected = cubic_roots(oscillator, frequency)
        amplitude = response.amplitude[i]
        counts[i] = np.isfinite(amplitude).sum()
        near = np.abs(response.fold_frequencies / frequency - 1).min() < 2e-4
        if not near:
            np.testing.assert_allclose(np.sort(amplitude[np.isfinite(amplitude)]), np.sqrt(expected), rtol=1e-6)
    changes = np.flatnonzero(np.diff(counts))
    assert len(changes) == len(response.fold_frequencies) == 2
    for index, fold in zip(changes, response.fold_frequencies, strict=True):
        low, high = f[index], f[index + 1]
        assert low <= fold <= high
        for _ in range(20):
            middle = 0.5 * (low + high)
            same = len(cubic_roots(oscillator, middle)) == counts[index]
            low, high = (middle, high) if same else (low, middle)
        assert fold == pytest.approx(low, rel=1e-7)


@pytest.mark.parametrize("oscillator", SYSTEMS.values(), ids=SYSTEMS)
def test_columns_are_continuous_curves(oscillator):
    """Each column is one stretch without holes, ordered, stable outside and unstable between."""
    f = np.linspace(0.8, 1.3, 3000) * oscillator.natural_frequency
    response = frequency_response(oscillator, f)
    for column in range(3):
        there = np.flatnonzero(np.isfinite(response.amplitude[:, column]))
        assert there.size and np.all(np.diff(there) == 1)
        assert np.all(response.stable[there, column] == (column != 1))
    folded = np.isfinite(response.amplitude).all(axis=1)
    assert np.all(np.diff(response.amplitude[folded], axis=1) > 0.0)
    assert np.all((response.phase[folded] > 0.0) & (response.phase[folded] < np.pi))
    side = -1 if oscillator.softening > 0 else 1
    assert np.all(side * (response.fold_frequencies - oscillator.natural_frequency) > 0.0)
    for fold, height in zip(response.fold_frequencies, response.fold_amplitudes, strict=True):
        roots = branch_roots(oscillator, np.array([fold]))[0]
        nearest = np.sort(np.abs(np.sqrt(roots) - height))[:2]
        assert np.all(nearest < 1e-5 * height)


def least_folding_force(damping: float) -> float:
    low, high = 1e-9, 1e-2
    for _ in range(60):
        middle = np.sqrt(low * high)
        sample = ForcedOscillator(0.03842, damping, 82.59, 9.16e9, force=middle)
        folds = frequency_response(sample, [7.0]).fold_frequencies.size
        low, high = (low, middle) if folds else (middle, high)
    return high


def test_folds_begin_at_the_cusp():
    """Where the cubic has a triple root: F^2 = 8 sqrt(3) (c w)^3 / (9 g), exact as damping goes to zero."""
    damping = 0.07098e-3
    loss = damping * 2 * np.pi * SAMPLE.natural_frequency
    cusp = np.sqrt(8 * np.sqrt(3) * loss**3 / (9 * 0.75 * SAMPLE.softening))
    assert least_folding_force(damping) == pytest.approx(cusp, rel=2e-4)
    assert least_folding_force(0.07098) == pytest.approx(84.87e-6, rel=1e-3)


def test_linear_and_unfolded_responses_are_one_curve():
    linear = ForcedOscillator(2.0, 0.3, 50.0, 0.0, base_moment=0.01)
    f = np.linspace(0.1, 3.0, 200)
    omega = 2 * np.pi * f
    expected = 0.01 * omega**2 / (50.0 - 2.0 * omega**2 + 0.3j * omega)
    response = frequency_response(linear, f)
    np.testing.assert_allclose(response.amplitude[:, 0], np.abs(expected), rtol=1e-12)
    np.testing.assert_allclose(response.phase[:, 0], -np.angle(expected), rtol=1e-9)
    assert response.fold_frequencies.size == 0 and np.all(np.isnan(response.amplitude[:, 1:]))
    weak = frequency_response(ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, force=4e-5), np.linspace(4, 9, 500))
    assert weak.fold_frequencies.size == 0 and np.all(np.isfinite(weak.amplitude[:, 0])) and weak.stable[:, 0].all()
    almost = frequency_response(ForcedOscillator(2.0, 0.3, 50.0, 1e-9, base_moment=0.01), f)
    np.testing.assert_allclose(almost.amplitude[:, 0], response.amplitude[:, 0], rtol=1e-9)


def test_resonance_peak_lies_on_the_backbone():
    """Where the lag is a quarter, force balances damping, c w A = F, and the frequency is the free one."""
    f = np.linspace(6.8, 7.4, 4001)
    response = frequency_response(SAMPLE, f)
    upper, phase = response.amplitude[:, 2], response.phase[:, 2]
    there = np.isfinite(upper)
    quarter = np.interp(np.pi / 2, phase[there], f[there])
    height = np.interp(quarter, f[there], upper[there])
    assert quarter == pytest.approx(SAMPLE.backbone(height), rel=1e-6)
    assert SAMPLE.damping * 2 * np.pi * quarter * height == pytest.approx(SAMPLE.force, rel=1e-6)


def steady(oscillator: ForcedOscillator, frequency: float, state: list[float], cycles: int) -> complex:
    """First harmonic of the last cycle by direct integration; cos(w t - lag) has the angle -lag."""
    omega = 2 * np.pi * frequency
    force = float(oscillator.force_amplitude(frequency))

    def rate(t, y):
        x, v = y
        spring = oscillator.stiffness * x - oscillator.softening * x**3
        return [v, (force * np.cos(omega * t) - oscillator.damping * v - spring) / oscillator.mass]

    period = 1.0 / frequency
    times = (cycles + np.arange(64) / 64) * period
    run = solve_ivp(rate, (0.0, times[-1]), state, method="DOP853", rtol=1e-9, atol=1e-14, t_eval=times)
    assert run.success
    return complex(2.0 * np.mean(run.y[0] * np.exp(-1j * omega * times)))


@pytest.mark.parametrize("name", ["softening", "softening, shaken base"])
def test_direct_integration_settles_on_the_stable_branches(name):
    """Within the size of the neglected third harmonic; with it, to the accuracy of the settling."""
    oscillator = SYSTEMS[name]
    frequency = float(frequency_response(oscillator, [7.0]).fold_frequencies @ [0.6, 0.4])
    response = frequency_response(oscillator, [frequency])
    omega = 2 * np.pi * frequency
    for column in (0, 2):
        amplitude, lag = response.amplitude[0, column], response.phase[0, column]
        # Started 2 % off: the transient is smaller than 1e-6 of the motion after 100 cycles.
        state = [1.02 * amplitude * np.cos(lag), 0.98 * amplitude * omega * np.sin(lag)]
        motion = steady(oscillator, frequency, state, cycles=100)
        full = periodic_motion(oscillator, frequency, amplitude)
        third = full.harmonic_amplitudes[1]
        assert third == pytest.approx(oscillator.softening * amplitude**3 / (32 * oscillator.mass * omega**2), rel=0.2)
        assert abs(motion - amplitude * np.exp(-1j * lag)) < 3.0 * third
        assert abs(motion - full.harmonic_amplitudes[0] * np.exp(-1j * full.phase)) < 2e-5 * amplitude


def test_direct_integration_leaves_the_unstable_branch():
    frequency = 6.95
    response = frequency_response(SAMPLE, [frequency])
    full = periodic_motion(SAMPLE, frequency, response.amplitude[0, 1])
    step = 1e-6 / frequency
    x = full.displacement(np.array([-step, 0.0, step]))
    ends = []
    for factor in (0.98, 1.02):
        state = [factor * x[1], factor * (x[2] - x[0]) / (2 * step)]
        ends.append(abs(steady(SAMPLE, frequency, state, cycles=110)))
    np.testing.assert_allclose(sorted(ends), response.amplitude[0, [0, 2]], rtol=5e-3)


def test_higher_harmonics_converge():
    motions = [periodic_motion(SAMPLE, 6.95, 38.01e-6, harmonics=n).harmonic_amplitudes[0] for n in (1, 2, 3, 8)]
    errors = np.abs(np.array(motions[:3]) / motions[3] - 1.0)
    assert motions[0] == pytest.approx(frequency_response(SAMPLE, [6.95]).amplitude[0, 2], rel=1e-9)
    assert errors[0] > 1e-4 and np.all(errors[1:] < 0.02 * errors[:-1])


def test_changing_the_units_changes_nothing():
    f = np.linspace(6.5, 8.0, 50)
    length, mass = 1e5, 1e-3
    other = ForcedOscillator(
        0.03842 * mass, 0.07098 * mass, 82.59 * mass, 9.16e9 * mass / length**2, force=1.2e-4 * mass * length
    )
    a, b = frequency_response(SAMPLE, f), frequency_response(other, f)
    np.testing.assert_allclose(b.amplitude, a.amplitude * length, rtol=1e-9)
    np.testing.assert_allclose(b.fold_frequencies, a.fold_frequencies, rtol=1e-9)
    np.testing.assert_array_equal(a.stable, b.stable)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ForcedOscillator(1.0, 0.1, 1.0, 0.0), "exactly one of"),
        (lambda: ForcedOscillator(1.0, 0.1, 1.0, 0.0, force=1.0, base_moment=1.0), "exactly one of"),
        (lambda: ForcedOscillator(1.0, 0.0, 1.0, 0.0, force=1.0), "`damping` must be positive"),
        (lambda: frequency_response(SAMPLE, [7.0, 0.0]), "`frequency` must be positive"),
        (lambda: periodic_motion(SAMPLE, 6.8, 38e-6), "no steady motion was found near"),
    ],
)
def test_what_cannot_be_used_is_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()
