"""What single records show: harmonics, forces, spectra over time; the numbers that are drawn, against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone._common.checks import InputError
from pymc_backbone.discrepancy.disturbances.sensor_filter import SensorFilter
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.results.portraits import Portraits, _simulated, beyond_spring
from pymc_backbone.discrepancy.results.portraits import portraits as pictures
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.harmonics import harmonic_decay, peaks_of
from pymc_backbone.measurement.time_frequency import time_frequency
from pymc_backbone.reporting.portrait_plots import plot_distortion, plot_force_sections, plot_time_frequency
from pymc_backbone.reporting.report_portraits import portraits
from pymc_backbone.reporting.study_plots import study_figures

from .discrepancy_cases import FREQUENCY, MASS, batch_of, make_records

STIFFNESS, DAMPING, TOP = 1000.0, 0.3, 0.1
OMEGA = np.sqrt(STIFFNESS)
CUBIC = 0.05 * STIFFNESS / TOP**2  # a twentieth of the linear force at the top
TIME = np.arange(0.0, 25.0, 2.0 * np.pi / OMEGA / 40.0)


def decay(effect: str, value: float, **more: float) -> np.ndarray:
    values = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING, effect: value, **more}
    names = [name for name in values if name not in ("linear_stiffness", "viscous_damping")]
    return pb.simulate_waveform(pb.Oscillator(1.0, names), values, TIME, TOP).values


# ---- harmonics ---------------------------------------------------------------------------------


def test_third_harmonic_of_a_duffing_oscillator():
    """First order in the cubic force over the linear: 1/32 of it; the second order takes 21/32 of that off."""
    x = decay("cubic_stiffness", CUBIC)
    found = harmonic_decay(TIME, x, peaks_of(TIME, x))
    assert found is not None
    share = CUBIC * found.amplitude**2 / STIFFNESS
    expected = share / 32.0 * (1.0 - 21.0 / 32.0 * share)
    held = share > 0.01
    assert held.sum() > 5
    # third order: the square of a twentieth
    np.testing.assert_allclose(found.ratios[held, 1], expected[held], rtol=0.005)
    # a force alike on both sides makes no even ones; a hundredth of the third at the top is what three cycles fall by
    assert (found.ratios[held][:, [0, 2]] < 0.01 * found.ratios[:, 1].max()).all()
    assert np.all(np.diff(found.amplitude) < 0.0)


def test_second_harmonic_of_a_spring_stiffer_to_one_side():
    """First order: a quadratic force a2 x^2 makes a2 A / (6 k) of the second harmonic."""
    quadratic = 0.05 * STIFFNESS / TOP
    x = decay("quadratic_stiffness", quadratic)
    found = harmonic_decay(TIME, x, peaks_of(TIME, x))
    share = quadratic * found.amplitude / STIFFNESS
    held = share > 0.01
    np.testing.assert_allclose(found.ratios[held, 0], share[held] / 6.0, rtol=0.01)


def test_a_mid_line_that_integration_lost_is_in_neither_force():
    """First order, a quadratic force moves the mid-line by -a2 A^2 / (2 k); without it both sections stay."""
    quadratic = 0.05 * STIFFNESS / TOP
    x = decay("quadratic_stiffness", quadratic)
    peaks = peaks_of(TIME, x)
    envelope = np.interp(TIME, peaks, np.interp(peaks, TIME, x))
    lost = x + quadratic * envelope**2 / (2.0 * STIFFNESS)
    sections = [
        beyond_spring(harmonic_decay(TIME, values, peaks, has_mid_line=False), 1.0, STIFFNESS) for values in (x, lost)
    ]
    top = quadratic * TOP**2
    for exact, integrated in zip(*sections, strict=True):
        np.testing.assert_allclose(integrated[1], exact[1], atol=0.03 * top)
    plain = beyond_spring(harmonic_decay(TIME, x, peaks), 1.0, STIFFNESS)
    moved = beyond_spring(harmonic_decay(TIME, lost, peaks), 1.0, STIFFNESS)
    assert np.abs(moved[0][1] - plain[0][1]).max() > 0.3 * top  # negative control: counted from equilibrium they differ


def test_noise_lies_below_its_floor_in_nineteen_of_twenty(rng):
    """A linear decay has no harmonics: what is found is noise, and 5 % of it exceed the floor."""
    exact = decay("cubic_stiffness", 0.0)
    exceeded = []
    for _ in range(20):
        found = harmonic_decay(TIME, exact + 1e-5 * rng.standard_normal(TIME.size), peaks_of(TIME, exact))
        exceeded.append(found.ratios > found.floor)
    # 3200 numbers, a third of them in overlapping cycles: a deviation of half a per cent
    assert np.mean(exceeded) == pytest.approx(0.05, abs=0.02)


def test_few_samples_or_cycles_tell_nothing():
    x = decay("cubic_stiffness", CUBIC)
    assert harmonic_decay(TIME[::3], x[::3], peaks_of(TIME, x)) is None
    assert harmonic_decay(TIME[:120], x[:120], peaks_of(TIME[:120], x[:120])) is None


# ---- forces ------------------------------------------------------------------------------------


def test_sections_of_the_force_are_the_true_law(rng):
    """At rest the spring is left, in passing zero the damper: both as they were put in."""
    drag = 1.0
    x = decay("cubic_stiffness", CUBIC, quadratic_damping=drag)
    for noise in (0.0, 1e-6):
        found = harmonic_decay(TIME, x + noise * rng.standard_normal(TIME.size), peaks_of(TIME, x))
        rest, passing = beyond_spring(found, 1.0, STIFFNESS)
        error = 4.0 * np.median(found.acceleration_error)
        # drag has harmonics beyond the fifth: a hundredth of its force at the top, 0.04 N
        np.testing.assert_allclose(rest[1], CUBIC * rest[0] ** 3, atol=0.04 * CUBIC * TOP**3 + error)
        true = DAMPING * passing[0] + drag * passing[0] * np.abs(passing[0])
        np.testing.assert_allclose(passing[1], true, atol=0.02 * np.abs(true).max() + error)
    # negative control: the wrong spring leaves a line
    rest, _ = beyond_spring(found, 1.0, 0.9 * STIFFNESS)
    assert np.abs(rest[1] - CUBIC * rest[0] ** 3).max() > 0.05 * STIFFNESS * TOP


# ---- over time and frequency -------------------------------------------------------------------


def test_a_model_is_released_from_where_it_comes_back():
    """Of a softening spring the force turns at sqrt(k / -k3): from beyond it, nothing comes back."""
    barrier = 1.1 * TOP
    oscillator = pb.Oscillator(1.0, "cubic_stiffness")
    vector = oscillator.pack(
        {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING, "cubic_stiffness": -STIFFNESS / barrier**2}
    )
    found = SimpleNamespace(layout=make_layout(oscillator, TOP, OMEGA), parameters=lambda _: vector)
    x = decay("cubic_stiffness", -STIFFNESS / barrier**2)
    measured = harmonic_decay(TIME, x, peaks_of(TIME, x))
    simulated = _simulated(found, measured, (1.3 * barrier, TOP), True)
    np.testing.assert_allclose(
        np.interp(measured.amplitude[::-1], simulated.amplitude[::-1], simulated.ratios[::-1, 1]),
        measured.ratios[::-1, 1],
        atol=0.05 * measured.ratios[:, 1].max(),  # between points the line through two is off by 4 %
    )
    assert _simulated(found, measured, (1.3 * barrier,), True) is None


def test_ridge_of_a_chirp_and_a_second_mode(rng):
    """A decay whose frequency falls from 12 to 10 Hz, and a mode at 31 Hz: both where they were put."""
    time = np.arange(0.0, 12.0, 1.0 / 400.0)
    frequency = 12.0 - 2.0 * time / 12.0
    phase = 2.0 * np.pi * (12.0 * time - time**2 / 12.0)
    x = np.exp(-0.15 * time) * (np.cos(phase) + 0.1 * np.cos(2.0 * np.pi * 31.0 * time))
    record = condition(pb.Record("chirp", time, 1e-3 * x + 1e-7 * rng.standard_normal(time.size)))
    picture = time_frequency(record, extract_cycles(record))
    assert picture.second_mode == pytest.approx(31.0, abs=0.2)
    # the second mode moves single cycles by a few per cent; a median of nine does not follow it
    ridge = np.median(np.lib.stride_tricks.sliding_window_view(picture.ridge_frequency, 9), axis=1)
    np.testing.assert_allclose(ridge, np.interp(picture.ridge_time[4:-4], time, frequency), rtol=0.02)
    # the picture itself: its highest line is the ridge, and above 20 Hz the second mode
    step = picture.frequency[1]
    low = picture.frequency < 20.0
    highest = picture.frequency[low][np.argmax(picture.level[low], axis=0)]
    np.testing.assert_allclose(highest, np.interp(picture.time, time, frequency), atol=1.5 * step)
    above = (picture.frequency > 26.0) & (picture.frequency < 34.0)
    early = picture.time < 6.0
    assert np.all(
        np.abs(picture.frequency[above][np.argmax(picture.level[above][:, early], axis=0)] - 31.0) < 1.5 * step
    )
    assert picture.level.max() == pytest.approx(0.0, abs=1e-9)
    figure = plot_time_frequency(picture)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["frequency followed", "second mode"]


# ---- in a study --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def study():
    rng = np.random.default_rng(11)
    x = decay("cubic_stiffness", 4.0 * CUBIC)
    records = [pb.Record(f"s{i}", TIME, x + 1e-5 * rng.standard_normal(TIME.size)) for i in range(2)]
    return pb.find_missing_effect(
        pb.Oscillator(1.0), records, candidates=["cubic_stiffness", "coulomb_friction"], max_effects=1, quick=True,
        held_out=0, random_seed=1,
    )  # fmt: skip


def test_the_extended_model_meets_the_points_and_the_base_does_not(study):
    shown = study.portraits
    assert shown.measured is not None and shown.has_forces and shown.specimen == "s0"
    assert study.missing_effects == ("cubic_stiffness",)
    top = shown.measured.amplitude > 0.5 * shown.measured.amplitude[0]
    at = np.log(shown.measured.amplitude[top])
    for model, is_near in ((shown.named, True), (shown.base, False)):
        order = np.argsort(model.amplitude)
        third = np.interp(at, np.log(model.amplitude[order]), model.ratios[order, 1])
        assert bool(np.all(np.abs(third / shown.measured.ratios[top, 1] - 1.0) < 0.1)) is is_near
    rest, _ = beyond_spring(shown.measured, shown.mass, shown.stiffness)
    of_named, _ = beyond_spring(shown.named, shown.mass, shown.stiffness)
    of_base, _ = beyond_spring(shown.base, shown.mass, shown.stiffness)
    ends = [np.interp(rest[0, [0, -1]], *one) for one in (of_named, of_base)]
    span = float(np.ptp(rest[1]))
    np.testing.assert_allclose(ends[0], rest[1, [0, -1]], atol=0.05 * span)
    assert np.abs(ends[1] - rest[1, [0, -1]]).max() > 0.3 * span


def test_report_and_figures_hold_them(study, tmp_path):
    figures = study_figures(study)
    assert {"force_sections", "distortion"} <= set(figures) and "time_frequency_1" not in figures  # quick, one mode
    pb.write_study(study, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "What single records show" in page and page.count("<figcaption>") >= 2
    assert "beyond the linear spring over displacement" in page  # what a reader who sees no picture is told
    drawn = figures["distortion"].axes[1].get_lines()
    measured = next(line for line in drawn if line.get_label() == "measured")
    above = study.portraits.measured.ratios[:, 1] > study.portraits.measured.floor[:, 1]
    np.testing.assert_allclose(measured.get_ydata(), study.portraits.measured.ratios[above, 1])


def test_without_forces_the_figures_say_what_they_need():
    bare = Portraits((), "a", 1.0, 1.0, None, None, None, has_forces=False)
    for draw in (plot_force_sections, plot_distortion):
        with pytest.raises(InputError, match="16 samples per cycle"):
            draw(bare)


def test_of_a_velocity_the_right_model_meets_the_points_although_its_mid_line_is_lost():
    rng = np.random.default_rng(12)
    names = ["quadratic_stiffness"]
    values = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING, names[0]: 0.15 * STIFFNESS / TOP}
    records = []
    for k in range(2):
        v = pb.simulate_waveform(
            pb.Oscillator(1.0, names), values, TIME, TOP * (1.0 - 0.1 * k), quantity="velocity"
        ).values
        noise = 1e-4 * TOP * OMEGA * rng.standard_normal(TIME.size)
        records.append(pb.Record(f"s{k}", TIME, v + noise, quantity="velocity", unit="m/s"))
    study = pb.find_missing_effect(
        pb.Oscillator(1.0), records, candidates=names, max_effects=1, quick=True, held_out=0, random_seed=1
    )
    shown = study.portraits
    assert study.missing_effects == ("quadratic_stiffness",) and not shown.has_mid_line
    for measured, named, base in zip(
        *(beyond_spring(one, shown.mass, shown.stiffness) for one in (shown.measured, shown.named, shown.base)),
        strict=True,
    ):
        span = float(np.ptp(measured[1]))
        ends = measured[0, [0, -1]]
        np.testing.assert_allclose(np.interp(ends, *named), measured[1, [0, -1]], atol=0.1 * span)
        assert np.abs(np.interp(ends, *base) - measured[1, [0, -1]]).max() > 0.3 * span
    page = portraits(study, {"force_sections": plot_force_sections(shown)})
    assert "Integration of the record lost its mid-line" in page


def test_behind_a_filter_no_forces_are_told(rng):
    """It turns the harmonics: beside a spring alone the sections had shown a drag that is not there."""
    records = make_records(rng, ("cubic_stiffness",), share=4.0)
    batch = batch_of(records)
    search = Search(batch, pb.Oscillator(MASS), ("cubic_stiffness",), 1)
    search.fit_set(())
    assert pictures(batch, search.fits[()], None).measured is not None
    behind = SensorFilter(1, FREQUENCY / 3.0, "high-pass").passed(batch)
    assert pictures(behind, search.fits[()], None).measured is None
