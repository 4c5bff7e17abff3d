"""What a record holds at multiples of its frequency, against closed forms, and what that says of a law."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.proposals.harmonic_odds import Harmonics
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_waveform

OMEGA, AMPLITUDE, SAMPLING, CYCLES = 20.0, 0.01, 60.0, 24
TIME = np.arange(round(SAMPLING * CYCLES)) * 2.0 * np.pi / OMEGA / SAMPLING


def decay(harmonics, noise, order=0, seed=0):
    """A decaying fundamental with harmonics as shares of it, as a sensor of this order sees the displacement."""
    rng = np.random.default_rng(seed)
    envelope = AMPLITUDE * np.exp(-0.004 * OMEGA * TIME)
    lines = np.cos(OMEGA * TIME) + sum(
        share * n**order * np.cos(n * OMEGA * TIME + n) for n, share in harmonics.items()
    )
    return OMEGA**order * (envelope * lines + noise * AMPLITUDE * rng.standard_normal(TIME.size))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_ratios_are_the_lines_that_the_record_holds(order):
    """Amplitude and phase: cos(n w t + n) is the n-th harmonic of cos(w t), delayed by -1 for the second and so on."""
    found = Harmonics(SAMPLING, decay({2: 0.03, 3: 0.004}, 1e-4, order), order, AMPLITUDE)
    expected = [0.03 * 2**order * np.exp(2j), 0.004 * 3**order * np.exp(3j)]
    assert found.ratios[:2] == pytest.approx(expected, abs=5.0 * found.errors[0], rel=0.02)
    assert np.all(np.abs(found.ratios[2:]) < 1e-3)  # no more than noise is there
    # a shift of time changes no ratio
    later = Harmonics(SAMPLING, decay({2: 0.03, 3: 0.004}, 1e-4, order)[17:-43], order, AMPLITUDE)
    assert later.ratios[:2] == pytest.approx(expected, abs=5.0 * later.errors[0], rel=0.02)


def test_errors_are_those_of_noise():
    """Two parts of each ratio, over many records of noise: their scatter is the error within a sixth."""
    found = [Harmonics(SAMPLING, decay({}, 3e-3, seed=seed), 0, AMPLITUDE) for seed in range(150)]
    scatter = np.std([[*item.ratios.real, *item.ratios.imag] for item in found])
    assert scatter == pytest.approx(np.mean([item.errors for item in found]), rel=1.0 / 6.0)


def duffing(share):
    oscillator = Oscillator(1.0, ["cubic_stiffness"])
    parameters = {
        "linear_stiffness": OMEGA**2, "viscous_damping": 0.002, "cubic_stiffness": share * OMEGA**2 / AMPLITUDE**2,
    }  # fmt: skip
    vector = np.array([parameters[name] for name in oscillator.parameter_names])
    noise = 1e-4 * AMPLITUDE * np.random.default_rng(1).standard_normal(TIME.size)
    motion = simulate_waveform(oscillator, parameters, TIME, AMPLITUDE).displacement
    return make_layout(oscillator, AMPLITUDE, OMEGA), vector, motion + noise


def test_a_duffing_oscillator_shows_its_third_harmonic():
    """To first order it is k3 A^2 / (32 k); where the record holds it, the law is likelier, else it is less likely."""
    share = 0.2
    layout, vector, motion = duffing(share)
    third = share / 32.0 / (1.0 + 0.75 * share)
    bent, straight = (Harmonics(SAMPLING, x, 0, AMPLITUDE) for x in (motion, decay({}, 1e-4)))
    shown = straight._shown(layout, vector)
    assert shown[1] == pytest.approx(third, rel=0.1)
    assert abs(shown[0]) < 1e-4
    error = np.hypot(straight.errors[1], 0.05 * third)
    assert bent.log_odds(layout, vector) == pytest.approx(np.log((third / error) ** 2), abs=1.0)
    assert straight.log_odds(layout, vector) == pytest.approx(-np.log((third / straight.errors[1]) ** 2), abs=1.0)


def test_a_line_from_elsewhere_says_next_to_nothing():
    """Negative control: a mode near twice the frequency is no harmonic of a law that shows one as large."""
    layout, vector, _ = duffing(0.0)
    rng = np.random.default_rng(3)
    quadratic = make_layout(Oscillator(1.0, ["quadratic_stiffness"]), AMPLITUDE, OMEGA)
    bent = np.array([OMEGA**2, 0.002, 0.12 * OMEGA**2 / AMPLITUDE])  # second harmonic: a sixth of it, 2 %
    odds = []
    for _ in range(20):
        line = 0.02 * AMPLITUDE * np.cos(2.03 * OMEGA * TIME + rng.uniform(0.0, 2.0 * np.pi))
        record = Harmonics(SAMPLING, decay({}, 1e-4) + line, 0, AMPLITUDE)
        odds.append(record.log_odds(quadratic, bent) - record.log_odds(layout, vector))
    true = simulate_waveform(quadratic.oscillator, bent, TIME, AMPLITUDE).displacement
    held = Harmonics(SAMPLING, true + 1e-6 * rng.standard_normal(TIME.size), 0, AMPLITUDE)
    assert held.log_odds(quadratic, bent) > 5.0
    other_side = np.where(np.arange(bent.size) == 2, -bent, bent)
    assert held.log_odds(quadratic, other_side) < held.log_odds(quadratic, bent) - 4.0
    either = [held.log_odds(quadratic, vector, has_side=False) for vector in (bent, other_side)]
    # begun from the other side the motion is a few per cent larger
    assert either[0] == pytest.approx(held.log_odds(quadratic, bent) - np.log(2.0), abs=0.1)
    assert either[1] > held.log_odds(quadratic, other_side) + 2.0
    assert np.median(odds) < 1.0 and np.max(odds) < 4.0


def test_springs_whose_frequencies_compensate_each_other_are_given_away_by_their_harmonics():
    """A strong spring on one side and a quadratic one against it: a bent motion that the record does not hold."""
    oscillator = Oscillator(1.0, ["bilinear_stiffness", "quadratic_stiffness"])
    layout = make_layout(oscillator, AMPLITUDE, OMEGA)
    values = {"linear_stiffness": 0.5, "bilinear_stiffness": 2.0, "quadratic_stiffness": -5.0}
    vector = np.array([values.get(name, 0.1 / OMEGA**2) * OMEGA**2 for name in oscillator.parameter_names])
    linear = make_layout(Oscillator(1.0, []), AMPLITUDE, OMEGA)
    record = Harmonics(SAMPLING, decay({}, 1e-4), 0, AMPLITUDE)
    assert record.log_odds(layout, vector) < -10.0
    assert record.log_odds(linear, np.array([OMEGA**2, 0.1])) == pytest.approx(0.0, abs=0.5)


def test_a_harmonic_that_a_filter_took_away_says_nothing():
    """Negative control: the same record, its upper part removed, must not speak against a law that shows harmonics."""
    whole = decay({}, 1e-4)
    spectrum = np.fft.rfft(whole)
    spectrum[round(1.5 * CYCLES) :] *= 1e-4
    passed = np.fft.irfft(spectrum, whole.size)
    layout, vector, _ = duffing(0.2)
    assert Harmonics(SAMPLING, whole, 0, AMPLITUDE).log_odds(layout, vector) < -3.0
    assert Harmonics(SAMPLING, passed, 0, AMPLITUDE).log_odds(layout, vector) == 0.0


def test_a_sensor_that_is_too_slow_says_nothing_of_what_it_cannot_see():
    coarse = slice(None, None, 8)  # seven samples a cycle and a half
    errors = Harmonics(SAMPLING / 8.0, decay({}, 1e-4)[coarse], 0, AMPLITUDE).errors
    assert np.isfinite(errors[0]) and np.isnan(errors[1:]).all()
