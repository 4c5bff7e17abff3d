"""Records compared in the quantity that was measured: what conditioning hands over, filtered noise, the right model."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz

from pymc_backbone.discrepancy.fitting.joint_fit import fit
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import start_state
from pymc_backbone.discrepancy.fitting.passed import passed_values
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.filters import design_band_pass
from pymc_backbone.measurement.conditioning.noise import white_level
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.oscillator import Oscillator

from .discrepancy_cases import AMPLITUDE, FREQUENCY, MASS, OMEGA, RELEASE_TIME, TIME, truth_of

_FOLDER = Path(__file__).resolve().parents[1] / "benchmarks" / "hidden_effects"
if str(_FOLDER) not in sys.path:
    sys.path.insert(0, str(_FOLDER))

from batches import make_batch  # noqa: E402
from quantities import batch_of, fit_from_truth  # noqa: E402

RATE = 1.0 / float(TIME[1] - TIME[0])


@pytest.fixture(scope="module")
def band_pass():
    return design_band_pass((0.65 * FREQUENCY, 1.4 * FREQUENCY), FREQUENCY, RATE, "a test")


@pytest.mark.parametrize("rate", [0.0, 0.4])
def test_gain_of_a_band_pass_is_that_of_its_taps(band_pass, rate):
    """Against the filter applied to an exponentially decaying wave, by NumPy."""
    frequency = FREQUENCY * np.array([0.3, 0.66, 1.0, 1.37, 2.0])
    time = np.arange(-band_pass.half, band_pass.half + 1) / RATE
    for f, gain in zip(frequency, band_pass.gain(frequency, rate), strict=True):
        expected = np.sum(np.exp((-rate + 2j * np.pi * f) * -time) * band_pass.taps)
        assert gain == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("autocovariance", [[2.5, 0.0], [1.0, 0.6, 0.3, 0.1, 0.0]], ids=["white", "coloured"])
def test_passed_noise_has_the_covariance_that_it_is_whitened_with(band_pass, autocovariance):
    """Against the covariance matrix of the samples, multiplied out."""
    size = 2 * band_pass.half + 400
    row = np.zeros(size)
    row[: len(autocovariance)] = autocovariance
    reduce, count, _ = passed_values(band_pass, np.array(autocovariance), size)
    operator = reduce(np.eye(size))
    assert operator.shape == (count, size) and count > 20
    np.testing.assert_allclose(operator @ toeplitz(row) @ operator.T, np.eye(count), atol=1e-4)  # the nugget


def test_passed_values_hold_the_passed_record_and_no_other_mode(band_pass):
    """What the band holds weighs as it would unfiltered; what lies beyond is down by seventy decibels."""
    size = 2 * band_pass.half + 2000
    reduce, _, _ = passed_values(band_pass, np.array([1.0, 0.0]), size)
    time = np.arange(size) / RATE
    inside = np.linalg.norm(reduce(np.cos(OMEGA * time)[:, None]))
    # all that white noise lets be known of a sinusoid: the square root of half the samples that are compared
    assert inside == pytest.approx(np.sqrt(0.5 * 2000), rel=0.02)
    for ratio in (0.2, 2.2, 3.0):
        assert np.linalg.norm(reduce(np.cos(ratio * OMEGA * time)[:, None])) < 1e-3 * inside


def test_the_quadrature_is_a_quarter_of_a_cycle_behind(band_pass):
    time = np.arange(2 * band_pass.half + 1) / RATE - band_pass.half / RATE
    for ratio in (0.8, 1.0, 1.25):
        wave = np.exp(1j * ratio * OMEGA * time)
        gain, turned = band_pass.taps @ wave, band_pass.quadrature @ wave
        assert turned == pytest.approx(1j * gain, abs=1e-3)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("band", [None, (0.65 * FREQUENCY, 1.4 * FREQUENCY)])
def test_conditioning_hands_the_samples_over_as_they_were(quantity, band, rng):
    order = ("displacement", "velocity", "acceleration").index(quantity)
    root = -0.006 * OMEGA + 1j * OMEGA
    since = TIME - RELEASE_TIME
    moving = np.real(AMPLITUDE * root**order * np.exp(root * np.maximum(since, 0.0)))
    held = AMPLITUDE if order == 0 else 0.0
    noise = 1e-3 * AMPLITUDE * OMEGA**order
    values = np.where(since < 0.0, held, moving) + noise * rng.standard_normal(TIME.size)
    unit = "m" + ("", "/s", "/s^2")[order]
    found = condition(Record("a", TIME, values, quantity, unit), band=band)
    measured = found.measured
    at = np.searchsorted(TIME, measured.time - 1e-9)
    np.testing.assert_allclose(TIME[at], measured.time, atol=1e-9)
    difference = values[at] - measured.values
    assert np.ptp(difference) < 1e-12 * np.abs(values).max()  # a constant, nothing else
    assert measured.order == order and (measured.band_pass is not None) == (band is not None)
    # neither the hold nor what a hand may do while it lets go
    assert measured.time[0] > RELEASE_TIME
    # a standard deviation from what 25 cycles leave beside their harmonics
    assert np.sqrt(measured.autocovariance[0]) == pytest.approx(noise, rel=0.2)
    half = 0 if band is None else measured.band_pass.half
    assert measured.time.size - 2 * half <= found.time.size
    # what is passed ends where the displacement does, and begins with it or, behind the hand, a little later
    assert measured.time[-1 - half] == pytest.approx(found.time[-1], abs=1e-9)
    assert 0.0 <= measured.time[half] - found.time[0] + 1e-9 < (0.8 if band else 1e-6) / FREQUENCY


def test_white_level_sees_through_the_lines_of_two_modes(rng):
    time = np.arange(3000) / 200.0
    lines = np.exp(-0.2 * time) * np.cos(OMEGA * time) + 0.2 * np.exp(-0.3 * time) * np.cos(2.9 * OMEGA * time)
    noise = 1e-3 * rng.standard_normal(time.size)
    exact = 1e-6 / 100.0  # variance over half the sampling rate
    assert white_level(lines + noise, 200.0, FREQUENCY) == pytest.approx(exact, rel=0.2)
    coloured = np.cumsum(noise)
    assert white_level(lines + coloured, 200.0, FREQUENCY) is None


@pytest.mark.parametrize("tier", ["velocity", "acceleration", "band_passed", "band_passed_acceleration"])
@pytest.mark.parametrize("index", [0, 5, 8], ids=["cubic_stiffness", "coulomb_friction", "displacement_damping"])
def test_the_truth_leaves_noise_and_a_wrong_effect_does_not(tier, index, tmp_path):
    """Records of the benchmark's generator, which shares no code with the package."""
    from generate import write_batch

    made = make_batch(41, index, tier)
    write_batch(made, tmp_path)
    truth = made.truth
    batch = batch_of(tmp_path, truth)
    layout = make_layout(Oscillator(truth["mass"], truth["hidden"]), batch.amplitude, batch.angular_frequency)
    right = fit_from_truth(layout, batch, truth)
    degrees = sum(term.size - 5 for term in batch.waveform) - layout.free.size
    # four standard deviations of chi-square, and the noise itself known to some three per cent
    assert right.chi_square.sum() / degrees == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / degrees) + 0.06)
    assert evidence.lack_of_fit(batch, right).p_value > 1e-3
    bare = make_layout(Oscillator(truth["mass"]), batch.amplitude, batch.angular_frequency)
    wrong = fit(bare, batch.waveform, start_state(bare, np.empty(0), right.state.own[:, :7]), iterations=60)
    assert wrong.cost > right.cost + 30.0
    assert evidence.lack_of_fit(batch, wrong).p_value < 1e-3


def test_a_filtered_wrong_noise_level_is_seen(band_pass, rng):
    """Noise three times as loud as stated: nine times the chi-square."""
    size = 2 * band_pass.half + 4000
    reduce, count, _ = passed_values(band_pass, np.array([1.0, 0.0]), size)
    passed = reduce(rng.standard_normal((size, 4)))
    assert float((passed**2).mean()) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / passed.size))
    assert float((reduce(3.0 * rng.standard_normal((size, 1))) ** 2).sum()) / count > 5.0


def test_offset_of_the_sensor_is_a_nuisance_of_its_own_quantity(rng):
    from .discrepancy_cases import batch_of as batch_of_made

    oscillator = Oscillator(MASS)
    from pymc_backbone.simulation.decay import simulate_waveform

    exact = simulate_waveform(
        oscillator, truth_of(()), TIME, AMPLITUDE, release_time=RELEASE_TIME, quantity="acceleration"
    ).values
    size = AMPLITUDE * OMEGA**2
    values = exact + 0.3 * size + 2e-3 * size * rng.standard_normal(TIME.size)
    batch = batch_of_made([Record("a", TIME, values, "acceleration", "m/s^2")])
    layout = make_layout(oscillator, AMPLITUDE, OMEGA)
    found = fit(layout, batch.waveform, start_state(layout, np.empty(0), batch.own), has_scatter=False)
    assert found.chi_square[0] / batch.waveform[0].size == pytest.approx(1.0, abs=0.3)
    # what conditioning subtracted already is a median: the rest is small, in units of displacement
    assert abs(found.state.own[0, 4]) < 0.1 * AMPLITUDE
    assert found.state.own[0, 2] == pytest.approx(AMPLITUDE, rel=2e-3)


def falling_noise(rng, size: int) -> np.ndarray:
    """Noise of unit variance, half of its power white, half falling with the frequency from a tenth of the motion's."""
    frequency = np.maximum(np.fft.rfftfreq(size, 1.0 / RATE), 0.1 * FREQUENCY)
    slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(size)) / np.sqrt(frequency), size)
    return np.sqrt(0.5) * (slow / slow.std() + rng.standard_normal(size))


def lack_of(rng, quantity: str, candidate: tuple[str, ...] = ()) -> evidence.LackOfFit:
    """What a set leaves of records of a damper that rises with the speed, with noise that falls with the frequency."""
    from pymc_backbone.simulation.decay import simulate_waveform

    from .discrepancy_cases import batch_of as batch_of_made

    effects = ("quadratic_damping",)
    records = []
    for k in range(3):
        exact = simulate_waveform(
            Oscillator(MASS, effects), truth_of(effects), TIME, AMPLITUDE, release_time=RELEASE_TIME, quantity=quantity
        ).values
        values = exact + 3e-3 * np.abs(exact).max() * falling_noise(rng, TIME.size)
        records.append(Record(f"record {k}", TIME, values, quantity, "m/s^2" if quantity == "acceleration" else "m"))
    batch = batch_of_made(records)
    layout = make_layout(Oscillator(MASS, candidate), AMPLITUDE, OMEGA)
    eta = layout.coordinates(np.array([truth_of(candidate)[name] for name in layout.names]))
    found = fit(layout, batch.waveform, start_state(layout, eta, batch.own), iterations=60, nuisances=batch.nuisances)
    return evidence.lack_of_fit(batch, found)


def test_noise_of_an_accelerometer_that_falls_with_the_frequency_is_noise_to_the_right_set():
    seeds = range(6)
    right = [lack_of(np.random.default_rng(seed), "acceleration", ("quadratic_damping",)).p_value for seed in seeds]
    assert min(right) > evidence.UNEXPLAINED and np.median(right) > 0.05
    # negative control: what lacks the damper is no noise
    assert max(lack_of(np.random.default_rng(seed), "acceleration").p_value for seed in (0, 1)) < 1e-20


def test_a_line_midway_between_the_harmonics_or_an_error_that_fades_is_not_the_level_of_the_noise(rng):
    windows, lines = [slice(60 * k, 60 * (k + 1)) for k in range(9)], 16
    bases = [np.linalg.qr(rng.standard_normal((60, lines)))[0] for _ in windows]
    white = rng.standard_normal(540)
    fading, line = white.copy(), white.copy()
    for k, (window, basis) in enumerate(zip(windows, bases, strict=True)):
        fading[window] += basis @ np.full(lines, 10.0 if k < 3 else 0.0)
        line[window] += basis[:, :2] @ np.full(2, 20.0)
    beside = list(zip(windows, bases, strict=True))
    for residuals, expected in ((white, 1.0), (fading, 1.0), (line, 1.0), (3.0 * white, 9.0)):
        most, count = evidence._between(residuals, beside, in_most=True)
        # the median of nine estimates from twelve squares each: a fifth, and as much again by what was added
        assert count == 9 * lines and most == pytest.approx(expected, rel=0.6)
    assert min(evidence._between(item, beside, in_most=False)[0] for item in (fading, line)) > 20.0
    assert evidence._between(white, [], in_most=True) == (0.0, 0.0)


def test_the_variance_from_most_squares_is_that_of_all(rng):
    for size in (8, 16, 40):
        found = [evidence._of_most(4.0 * rng.standard_normal(size) ** 2) for _ in range(8000)]
        assert np.mean(found) == pytest.approx(4.0, rel=0.03), size  # five standard errors, and what bias is left
    assert evidence._of_most(np.array([2.0])) == pytest.approx(2.0)
