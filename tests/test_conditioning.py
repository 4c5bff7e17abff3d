"""Conditioning: sampling, release, zero, integration, band-pass, second mode, noise, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, lfilter

from pymc_backbone._common.checks import InputError
from pymc_backbone.discrepancy.fitting.record_term import release_of
from pymc_backbone.measurement.conditioning.asymmetry import beyond_stop
from pymc_backbone.measurement.conditioning.condition import ConditionedRecord, condition
from pymc_backbone.measurement.conditioning.convolution import convolve_inside
from pymc_backbone.measurement.conditioning.noise import _pooled
from pymc_backbone.measurement.conditioning.plausibility import check_per_cycle
from pymc_backbone.measurement.cycles import extract_cycles, extract_cycles_from_arrays
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.records import read_records

Array = NDArray[np.float64]
FREQUENCY = 10.0
OMEGA = 2.0 * np.pi * FREQUENCY
FORCES: dict[str, Callable[[Array, Array], Array]] = {
    "linear": lambda x, v: 0.0 * x,
    "hardening": lambda x, v: 0.3 * OMEGA**2 * x**3,
    "strongly hardening": lambda x, v: 2.0 * OMEGA**2 * x**3,
    "softening": lambda x, v: -0.4 * OMEGA**2 * x**3,
    "quadratic stiffness": lambda x, v: 0.25 * OMEGA**2 * x**2,
    "bilinear": lambda x, v: 0.3 * OMEGA**2 * x * (x > 0.0),
    "stop": lambda x, v: 0.8 * OMEGA**2 * np.maximum(x - 0.35, 0.0),
    "late stop": lambda x, v: 0.8 * OMEGA**2 * np.maximum(x - 0.6, 0.0),
    "freeplay": lambda x, v: -0.9 * OMEGA**2 * np.clip(x, -0.05, 0.05),
    "quadratic damping": lambda x, v: 0.03 * v * np.abs(v),
    "van der Pol": lambda x, v: 0.05 * OMEGA * x**2 * v,
}


@cache
def _simulated(force: str, damping: float, cycles: float, per_cycle: int, impact: bool) -> tuple[Array, Array]:
    """Time, and displacement, velocity, acceleration of m = 1, released from x = 1 (or struck at rest) at time 0."""
    law = FORCES[force]

    def rate(t: float, y: Array) -> list[Array]:
        return [y[1], -2.0 * damping * OMEGA * y[1] - OMEGA**2 * y[0] - law(y[0], y[1])]

    time = np.arange(int(cycles * per_cycle)) / (FREQUENCY * per_cycle)
    y0 = [0.0, OMEGA] if impact else [1.0, 0.0]
    x, v = solve_ivp(rate, (0.0, time[-1]), y0, "DOP853", time, rtol=1e-10, atol=1e-11).y
    motion = np.array([x, v, rate(0.0, np.array([x, v]))[1]])
    return time, motion


def simulated(
    force: str = "linear", damping: float = 0.01, cycles: float = 40, per_cycle: int = 50, *, impact: bool = False
) -> tuple[Array, Array]:
    time, motion = _simulated(force, damping, cycles, per_cycle, impact)
    return time.copy(), motion.copy()


def friction(stick: float, cycles: float, per_cycle: int, start: float = 1.0) -> tuple[Array, Array]:
    """Exact displacement under dry friction alone: half cycles of cosines about +-stick, then rest."""
    time = np.arange(int(cycles * per_cycle)) / (FREQUENCY * per_cycle)
    x = np.empty(time.size)
    half = np.floor(time * 2.0 * FREQUENCY).astype(int)
    level = start
    for k in range(half.max() + 1):
        inside = half == k
        sign = np.sign(level)
        if abs(level) <= stick:
            x[half >= k] = level
            break
        centre = sign * stick
        x[inside] = centre + (level - centre) * np.cos(OMEGA * (time[inside] - 0.5 * k / FREQUENCY))
        level = 2.0 * centre - level
    return time, x


def record(time: Array, values: Array, quantity: str = "displacement", name: str = "s") -> Record:
    return Record(name, time, values, quantity)


def cycle_quantities(time: Array, x: Array, begin: float = 0.0, end: float = np.inf) -> dict[str, Array]:
    """Cycle quantities by the package's definition from the extremes of a quintic spline (clean records)."""
    spline = make_interp_spline(time, x, k=5)
    slope, bend = spline.derivative(), spline.derivative(2)
    v = slope(time)
    at = np.flatnonzero(v[:-1] * v[1:] < 0.0)
    t = time[at] + (time[at + 1] - time[at]) * v[at] / (v[at] - v[at + 1])
    for _ in range(5):
        t = t - slope(t) / bend(t)
    t = t[(t > begin) & (t < end)]
    values = spline(t)
    first = int(values[0] < values[1])
    p0, q, p1 = values[first:-2:2], values[first + 1 : -1 : 2], values[first + 2 :: 2]
    n = p1.size
    p0, q, t0, t1 = p0[:n], q[:n], t[first:-2:2][:n], t[first + 2 :: 2]
    amplitude = (p0 + p1 - 2.0 * q) / 4.0
    return {
        "time": 0.5 * (t0 + t1),
        "amplitude": amplitude,
        "frequency": 1.0 / (t1 - t0),
        "damping": 2.0 * np.log((p0 - q) / (p1 - q)),
        "offset": ((p0 + p1) / 2.0 + q) / 2.0 / amplitude,
    }


def warnings_of(decay: ConditionedRecord) -> list[str]:
    return [note for note in decay.notes if note.startswith("warning")]


def is_uniform(time: Array) -> bool:
    return bool(np.ptp(np.diff(time)) < 1e-6 * np.diff(time).mean())


# ---- what comes out -----------------------------------------------------------------------------


def test_clean_displacement_passes_unchanged() -> None:
    time, (x, _, _) = simulated()
    decay = condition(record(time + 3.0, x))
    assert (decay.specimen, decay.unit, decay.quantity, decay.source) == ("s", "m", "displacement", "s")
    assert decay.offset_is_measured and np.isnan(decay.rest_offset) and np.isnan(decay.second_mode_share)
    np.testing.assert_allclose(decay.time, time[: decay.time.size] + 3.0, atol=1e-9)
    np.testing.assert_allclose(decay.displacement, x[: decay.time.size], atol=2e-6)
    assert decay.frequency == pytest.approx(FREQUENCY * np.sqrt(1 - 0.01**2), rel=1e-4)
    assert decay.sampling_rate == pytest.approx(500.0)
    assert decay.amplitude == pytest.approx(1.0, rel=0.01)
    assert decay.noise_autocovariance.size >= 2
    assert not decay.displacement.flags.writeable and not decay.time.flags.writeable
    assert all(isinstance(note, str) and note.isprintable() for note in decay.notes)


def test_rotation_keeps_its_unit() -> None:
    time, (_, v, _) = simulated()
    decay = condition(Record("s", time, v, "velocity", "rad/s"))
    assert decay.unit == "rad" and decay.quantity == "velocity"


def test_scaling_units_changes_nothing_else(rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated("hardening")
    x = x + 1e-3 * rng.normal(size=x.size) + 0.2
    one, small = condition(record(time, x)), condition(record(1e3 * time, 1e-5 * x))
    np.testing.assert_allclose(small.displacement, 1e-5 * one.displacement, atol=1e-12)
    # the last bit of the sampling rate decides in which bin a spectral line falls
    assert small.noise == pytest.approx(1e-5 * one.noise, rel=0.01)
    assert small.frequency == pytest.approx(1e-3 * one.frequency, rel=1e-6)
    assert len(small.notes) == len(one.notes)


# ---- sampling -----------------------------------------------------------------------------------


def test_rounded_stamps_go_to_the_grid() -> None:
    time, (x, _, _) = simulated(per_cycle=30)  # 300 Hz, stamps in ms: 3, 7, 10, ...
    decay = condition(record(np.round(time, 3), x))
    assert is_uniform(decay.time)
    assert decay.sampling_rate == pytest.approx(300.0, rel=1e-5)
    np.testing.assert_allclose(decay.displacement, x[: decay.time.size], atol=1e-5)
    assert any("of a sample" in note and "put there" in note for note in decay.notes)


@pytest.mark.parametrize("jitter", [0.1, 0.2, 0.35])
def test_true_jitter_is_resampled(jitter: float, rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated(per_cycle=40)
    jittered = time + rng.uniform(-jitter, jitter, time.size) / 400.0
    jittered[0] = 0.0
    values = make_interp_spline(time, x, k=5)(np.clip(jittered, 0.0, time[-1]))
    decay = condition(record(jittered, values))
    assert is_uniform(decay.time) and decay.sampling_rate == pytest.approx(400.0, rel=1e-3)
    assert any("jitter" in note and "cubic spline" in note for note in decay.notes)
    # two stamps that jitter apart (by up to 1.7 samples) are no gap
    assert not any("missing" in note for note in decay.notes)
    truth = make_interp_spline(time, x, k=5)(np.clip(decay.time, 0.0, time[-1]))
    # ignoring a jitter of 0.35 would cost 0.2 samples (rms) of slope, 0.03; the spline leaves h^4 errors
    assert np.max(np.abs(decay.displacement - truth)[5:-5]) < 5e-4


def test_missing_samples_are_found_among_jitter(rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated(per_cycle=60)
    jittered = time + rng.uniform(-0.25, 0.25, time.size) / 600.0
    keep = np.ones(time.size, bool)
    keep[[300, 700, 701, 1500]] = False
    values = make_interp_spline(time, x, k=5)(np.clip(jittered, 0.0, time[-1]))
    decay = condition(record(jittered[keep], values[keep]))
    assert any("4 missing samples in 3 gaps" in note for note in decay.notes)
    assert decay.sampling_rate == pytest.approx(600.0, rel=1e-3)


def test_samples_missing_for_cycles_are_told_although_no_oscillation_stands_out_of_what_fills_them() -> None:
    time, (x, _, _) = simulated(per_cycle=60)
    keep = np.ones(time.size, bool)
    keep[400:800] = False
    begin, end = re.escape(f"{time[399]:.6g}"), re.escape(f"{time[800]:.6g}")
    with pytest.raises(InputError, match=rf"samples are missing between {begin} and {end} s, 6\.\d cycles of"):
        condition(record(time[keep], x[keep]))


def test_a_few_missing_samples_are_interpolated_and_many_are_refused() -> None:
    time, (x, _, _) = simulated(per_cycle=60)
    keep = np.ones(time.size, bool)
    keep[[100, 101, 200, 333]] = False
    decay = condition(record(time[keep], x[keep]))
    assert is_uniform(decay.time)
    np.testing.assert_allclose(decay.displacement, x[: decay.time.size], atol=1e-4)
    assert any("4 missing samples in 3 gaps" in note for note in decay.notes)
    keep[500:530] = False
    with pytest.raises(
        InputError, match=r"s: samples are missing between 0\.83166\d* and 0\.88333\d* s.*stop=.*start="
    ):
        condition(record(time[keep], x[keep]))


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (1.3, r"a mode at 1[23]\.\d+ Hz, \d+% .* keep one, for example with `band=\("),
        (1.2, "a mode at 1[12].* too close for a `band`"),
    ],
)
def test_modes_that_beat_at_once_are_refused_with_what_to_do(ratio: float, said: str, rng: np.random.Generator) -> None:
    """All modes of a struck structure in one record: the amplitude grows again after a few cycles."""
    time = np.arange(0.0, 60.0 / FREQUENCY, 1.0 / (66.0 * FREQUENCY))
    both = np.exp(-0.6 * time) * (np.cos(OMEGA * time) + 0.8 * np.cos(ratio * OMEGA * time))
    with pytest.raises(InputError, match="before the amplitude grows again, expected at least 5; " + said):
        condition(record(time, both + 1e-3 * rng.normal(size=time.size)))


# ---- release ------------------------------------------------------------------------------------


def before(kind: str, quantity: int, per_cycle: int, cycles: float) -> Array:
    """What the sensor shows before time 0."""
    n = int(cycles * per_cycle)
    if kind == "held":
        return np.full(n, 1.0 if quantity == 0 else 0.0)
    if kind == "impact":
        return np.zeros(n)
    time = np.arange(-n, 0) / (per_cycle * FREQUENCY)
    drive = [np.cos(OMEGA * time), -OMEGA * np.sin(OMEGA * time), -(OMEGA**2) * np.cos(OMEGA * time)][quantity]
    return drive * (np.linspace(0.0, 1.0, n) if kind == "growing" else 1.0)


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("per_cycle", [12, 100])
@pytest.mark.parametrize("quantity", [0, 1, 2])
@pytest.mark.parametrize("kind", ["held", "impact", "growing", "plateau"])
def test_release_is_found(kind: str, quantity: int, per_cycle: int, noise: float, rng: np.random.Generator) -> None:
    # a drive at the frequency and amplitude of the first free cycle
    force = "hardening" if kind in ("held", "impact") else "linear"
    _time, motion = simulated(force, 0.01, 30, per_cycle, impact=kind == "impact")
    lead = before(kind, quantity, per_cycle, 20.3)
    values = np.concatenate([lead, motion[quantity]])
    values = values + (noise * rng.normal(size=values.size) + 0.4) * np.abs(motion[quantity]).max()
    stamps = np.arange(values.size) / (per_cycle * FREQUENCY) + 7.0
    released = stamps[lead.size]
    decay = condition(record(stamps, values, ["displacement", "velocity", "acceleration"][quantity]))
    late = (decay.time[0] - released) * FREQUENCY
    # held or struck: before the first (second) turning point; driven: one to three cycles after the bend
    low, high = (0.0, 0.8) if kind in ("held", "impact") else (0.0, 3.5)
    assert low <= late <= high, late
    word = "at rest" if kind in ("held", "impact") else "driven"
    assert any("were dropped" in note and word in note for note in decay.notes)
    assert not warnings_of(decay)


@pytest.mark.parametrize("loud", [1.5, 2.5])
def test_cycles_on_a_stop_are_not_taken_for_a_drive(loud: float, rng: np.random.Generator) -> None:
    """On the stop the swing takes another time, and the fundamental of the free swing is less than the motion.

    Against a stiff spring behind a gap, on one side, released from some times the gap; integrated by SciPy.
    """
    gap, stop, decrement = 0.003, 30.0, 0.02

    def rate(_time: float, state: Array) -> list[float]:
        x, v = state
        return [v, -(OMEGA**2) * (x + stop * max(x - gap, 0.0)) - decrement / np.pi * OMEGA * v]

    time = np.arange(0.0, 60.0 / FREQUENCY, 1.0 / (66.0 * FREQUENCY))
    motion = solve_ivp(rate, (0.0, time[-1]), [-loud * gap, 0.0], t_eval=time, rtol=1e-8, atol=1e-11).y[0]
    decay = condition(record(time, motion + 1e-3 * gap * rng.normal(size=time.size)))
    assert decay.time[0] < 1.0 / FREQUENCY
    assert not any("driven" in note for note in decay.notes)


@pytest.mark.parametrize("pulse", [0.02, 0.08, 0.15, 0.3])
@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("stiffness", [-0.25, 0.0, 1.0])
def test_what_a_hammer_still_drives_is_dropped_and_a_held_start_is_not(
    pulse: float, quantity: str, stiffness: float, rng: np.random.Generator
) -> None:
    """Oracle: the equation of motion with the force of the hammer, at a tight tolerance."""
    rest, per_cycle = 1.7, 48
    time = np.arange(0.0, 20.0, 1.0 / per_cycle)  # in cycles

    def force(t: float) -> float:
        return np.pi**2 / pulse * np.sin(np.pi * (t - rest) / pulse) if rest < t < rest + pulse else 0.0

    def acceleration(t: float, x: float, v: float, is_struck: bool) -> float:
        free = -((2.0 * np.pi) ** 2) * (x + stiffness * x**3) - 0.12 * v
        return (free + force(t)) if is_struck else free * (t >= rest)

    for is_struck in (True, False):

        def rate(t: float, y: Array, is_struck: bool = is_struck) -> list[float]:
            return [y[1], acceleration(t, y[0], y[1], is_struck)] if is_struck or t >= rest else [0.0, 0.0]

        begun = [0.0 if is_struck else 1.0, 0.0]
        solved = solve_ivp(rate, (0.0, 20.0), begun, t_eval=time, rtol=1e-8, atol=1e-9, max_step=0.01)
        x, v = solved.y
        values = {"displacement": x, "velocity": v}.get(quantity)
        if values is None:
            values = np.array([acceleration(*state, is_struck) for state in zip(time, x, v, strict=True)])
        values = values + 0.003 * np.abs(values[-960:]).max() * rng.normal(size=values.size)
        decay = condition(record(time / FREQUENCY, values, quantity))
        late = decay.time[0] * FREQUENCY - rest
        at = decay.measured.time[0] * FREQUENCY - rest
        low, high = (pulse, 0.9) if is_struck else (-1e-9, 0.6)
        assert low <= late <= high and low <= at <= high, (is_struck, late, at)


@pytest.mark.parametrize(
    ("loudness", "typical"),
    [
        ((900.0, 1.0, 1.2, 0.8), 1.0),
        ((900.0, 1.0), 1.0),
        ((3.0, 1.0), 2.0),
        ((2.0, 0.0), 1.0),  # quieter than the converter's step for a while: the noise is what it shows
        ((9.0,), 9.0),
    ],
)
def test_of_few_segments_one_that_is_far_louder_holds_no_noise(loudness, typical) -> None:
    estimates = np.outer(loudness, np.ones(7))
    np.testing.assert_allclose(_pooled(estimates, np.full(estimates.shape, 4.0)), typical)


def test_held_position_is_dropped_and_first_turning_point_kept() -> None:
    _time, (x, _, _) = simulated(damping=0.02, per_cycle=80)
    values = np.concatenate([np.full(800, 1.0), x])
    decay = condition(record(np.arange(values.size) / 800.0, values))
    first = decay.time[np.argmin(decay.displacement)]
    assert first == pytest.approx(1.0 + 0.5 / FREQUENCY, abs=2.0 / 800.0)  # half a cycle after the release at 1 s
    assert first - decay.time[0] == pytest.approx(0.25 / FREQUENCY, abs=0.05 / FREQUENCY)


@pytest.mark.parametrize("per_cycle", [8.2, 10.2, 24.0])
@pytest.mark.parametrize("between", np.linspace(0.0, 0.9, 10))
def test_the_first_turning_point_after_a_hold_is_kept_however_few_samples_show_it(per_cycle, between) -> None:
    """Half a cycle after the release, wherever that lies between two samples: what remembers tells a later one."""
    stamps = np.arange(40 * per_cycle) / (per_cycle * FREQUENCY)
    release = (2.0 * per_cycle + between) / (per_cycle * FREQUENCY)
    after = np.maximum(stamps - release, 0.0) * 2.0 * np.pi * FREQUENCY
    decay = condition(record(stamps, np.exp(-0.005 * after) * np.cos(after)))
    cycles = extract_cycles(decay)
    assert cycles.turning_times[0] == pytest.approx(release + 0.5 / FREQUENCY, abs=0.05 / FREQUENCY)
    assert release_of(decay, cycles)[1] == pytest.approx(release, abs=0.05 / FREQUENCY)


@pytest.mark.parametrize("hold", [0.25, 0.4, 0.6])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_short_hold_is_dropped(hold: float, noise: float, rng: np.random.Generator) -> None:
    per_cycle = 40
    _, (x, _, _) = simulated(damping=0.02, per_cycle=per_cycle)
    values = np.concatenate([np.full(int(hold * per_cycle), x[0]), x])
    values = values + noise * np.abs(x).max() * rng.normal(size=values.size)
    stamps = np.arange(values.size) / (per_cycle * FREQUENCY)
    decay = condition(record(stamps, values))
    late = decay.time[0] * FREQUENCY - hold
    assert -0.06 <= late <= 0.3, late
    assert any("at rest" in note for note in decay.notes)
    assert extract_cycles(decay).frequency[0] == pytest.approx(FREQUENCY, rel=0.02)


@pytest.mark.parametrize("phase", np.linspace(0.0, 0.9, 10))
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_free_motion_is_not_taken_for_a_short_hold(phase: float, noise: float, rng: np.random.Generator) -> None:
    per_cycle = 40
    _, (x, _, _) = simulated(damping=0.01, per_cycle=per_cycle)
    values = x[int(phase * per_cycle) :]
    values = values + noise * np.abs(x).max() * rng.normal(size=values.size)
    decay = condition(record(np.arange(values.size) / (per_cycle * FREQUENCY), values))
    assert not any("at rest" in note for note in decay.notes)


def test_record_that_begins_in_free_motion_keeps_its_first_sample() -> None:
    for offset in (0, 17, 33):
        time, (x, _, _) = simulated("hardening")
        decay = condition(record(time[offset:], x[offset:] + 5.0))
        assert decay.time[0] == pytest.approx(time[offset], abs=1e-9)
        assert not any("were dropped" in note and "before" in note for note in decay.notes)


def test_start_and_stop_are_obeyed() -> None:
    time, (x, _, _) = simulated()
    decay = condition(record(time, x), start=0.5, stop=2.0)
    assert decay.time[0] == pytest.approx(0.5) and decay.time[-1] == pytest.approx(2.0, abs=0.01)
    held = np.concatenate([np.full(500, 1.0), x])
    stamps = np.arange(held.size) / 500.0
    assert condition(record(stamps, held), start=1.1).time[0] == pytest.approx(1.1)
    with pytest.raises(InputError, match="3 samples lie between"):
        condition(record(time, x), start=1.0, stop=1.005)
    with pytest.raises(InputError, match="start"):
        condition(record(time, x), start=np.nan)


@pytest.mark.parametrize("impact", [True, False])
def test_softening_acceleration_that_stays_level_is_not_taken_for_forcing(impact: bool) -> None:
    """The displacement decays while the acceleration, omega^2 A, does not fall yet."""
    _time, motion = simulated("softening", 0.004, 60, 40, impact=impact)
    lead = np.zeros(400) if impact else np.zeros(0)
    values = np.concatenate([lead, motion[2]])
    decay = condition(record(np.arange(values.size) / 400.0, values, "acceleration"))
    assert (
        decay.time[0] < (lead.size / 40.0 + 3.5) / FREQUENCY
        if impact
        else decay.time[0] == pytest.approx(0.0, abs=1e-9)
    )
    assert not warnings_of(decay)


def test_second_impact_ends_the_record_with_a_warning() -> None:
    _time, (x, _, _) = simulated(cycles=25, impact=True)
    values = np.concatenate([np.zeros(100), x, 0.8 * x])
    decay = condition(record(np.arange(values.size) / 500.0, values))
    assert decay.time[-1] < (100 + x.size) / 500.0 + 0.15
    assert decay.grows_again and any("grows again" in note for note in warnings_of(decay))


# ---- zero ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("cycles", [15, 120])
@pytest.mark.parametrize(
    "force", ["linear", "hardening", "quadratic stiffness", "bilinear", "quadratic damping", "stop", "late stop"]
)
def test_sensor_offset_is_not_physics(force: str, cycles: int, rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated(force, 0.01, cycles)
    noise = 2e-3
    decay = condition(record(time, x + 0.7 + noise * rng.normal(size=x.size)))
    assert np.isnan(decay.rest_offset)
    # with a tail the zero is as good as its mean; without (15 cycles fall to 0.4) as good as the extrapolation says
    assert abs(decay.baseline - 0.7) < 4.0 * decay.baseline_error
    assert decay.baseline_error < (5e-4 if cycles == 120 else 0.03)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_a_reading_of_many_amplitudes_is_no_obstacle(quantity: str) -> None:
    """An absolute gauge shows 10 mm and moves by a micrometre."""
    time, motion = simulated("hardening", 0.01, 60)
    values = motion[["displacement", "velocity", "acceleration"].index(quantity)]
    plain = condition(record(time, values, quantity))
    far = condition(record(time, values + 1e4 * np.abs(values).max(), quantity))
    np.testing.assert_allclose(far.displacement, plain.displacement, atol=1e-6)
    if quantity == "displacement":
        assert far.baseline == pytest.approx(1e4, abs=1e-4)


@pytest.mark.parametrize("damping", [0.0005, 0.004])
def test_a_record_that_hardly_decays_takes_its_zero_from_the_second_harmonic(
    damping: float, rng: np.random.Generator
) -> None:
    """The mid-line alone, at 0.13 amplitudes, cannot tell where it would end."""
    time, (x, _, _) = simulated("quadratic stiffness", damping, 20)
    decay = condition(record(time, x + 0.7 + 0.01 * rng.normal(size=x.size)))
    assert abs(decay.baseline - 0.7) < min(0.06, 3.0 * decay.baseline_error)
    assert decay.baseline_error > 0.003


def test_quadratic_stiffness_keeps_its_mid_line() -> None:
    time, (x, _, _) = simulated("quadratic stiffness", 0.01, 100)
    decay = condition(record(time, x - 2.0))
    assert decay.baseline == pytest.approx(-2.0, abs=1e-4)
    measured = cycle_quantities(decay.time, decay.displacement)["offset"]
    truth = cycle_quantities(time, x)["offset"]
    assert truth[0] < -0.05
    np.testing.assert_allclose(measured[:20], truth[:20], atol=3e-4)


@pytest.mark.parametrize("sensor", [0.0, 0.3])
def test_friction_stop_off_centre_is_reported_not_subtracted(sensor: float, rng: np.random.Generator) -> None:
    time, x = friction(0.03, 30, 60, start=0.98)
    stopped_at = x[-1]
    assert abs(stopped_at) > 0.01
    decay = condition(record(time, x + sensor + 1e-3 * rng.normal(size=x.size)))
    assert decay.baseline == pytest.approx(sensor, abs=1e-3)
    assert decay.rest_offset == pytest.approx(stopped_at, abs=1.5e-3)
    assert any("came to rest" in note for note in decay.notes)
    # what follows the stop is no motion
    assert decay.time[-1] < time[np.flatnonzero(x != stopped_at)[-1]] + 3.0 / FREQUENCY


# ---- velocity and acceleration ------------------------------------------------------------------


@pytest.mark.parametrize("force", ["linear", "hardening"])
def test_a_symmetric_structure_whose_amplitude_halves_each_cycle_shows_neither_second_harmonic_nor_wander(
    force: str, rng: np.random.Generator
) -> None:
    """Means over cycles would leave more than a per cent of such a fundamental beside it."""
    time, motion = simulated(force, 0.12, 7)
    for quantity in (0, 1):
        noisy = motion[quantity] + 1e-3 * np.abs(motion[quantity]).max() * rng.normal(size=time.size)
        decay = condition(record(time, noisy, ("displacement", "velocity")[quantity]))
        assert not any("second harmonic" in note or "wanders" in note for note in decay.notes), decay.notes
        if quantity == 0:
            assert abs(decay.baseline) < 3.0 * decay.baseline_error < 5e-3


@pytest.mark.parametrize("per_cycle", [20, 100])
@pytest.mark.parametrize("quantity", [1, 2])
@pytest.mark.parametrize(
    ("force", "damping"),
    [
        ("linear", 0.001),
        ("linear", 0.05),
        ("hardening", 0.01),
        ("strongly hardening", 0.01),
        ("softening", 0.01),
        ("quadratic damping", 0.002),
    ],
)
def test_integration_recovers_every_cycle(force: str, damping: float, quantity: int, per_cycle: int) -> None:
    cycles = 8 if damping > 0.02 else 30
    time, motion = simulated(force, damping, cycles, per_cycle)
    time, motion = time[3:], motion[:, 3:]
    offset = 0.1 * np.abs(motion[quantity]).max()
    decay = condition(record(time, motion[quantity] + offset, ["", "velocity", "acceleration"][quantity]))
    assert not decay.offset_is_measured and decay.baseline == 0.0
    end = decay.time[-1] - 0.3 / FREQUENCY
    found = cycle_quantities(decay.time, decay.displacement, end=end)
    truth = cycle_quantities(time, motion[0], end=end)
    assert found["time"].size == truth["time"].size  # not a cycle is lost
    np.testing.assert_allclose(found["amplitude"], truth["amplitude"], rtol=1e-3)
    np.testing.assert_allclose(found["frequency"], truth["frequency"], rtol=3e-4)
    np.testing.assert_allclose(found["damping"], truth["damping"], atol=2e-3)
    inner = slice(2, -3)
    np.testing.assert_allclose(found["amplitude"][inner], truth["amplitude"][inner], rtol=4e-4)
    np.testing.assert_allclose(found["damping"][inner], truth["damping"][inner], atol=5e-4)


@pytest.mark.parametrize(("force", "offset"), [("quadratic stiffness", -0.085), ("bilinear", -0.06)])
def test_mid_line_of_an_asymmetric_structure_is_restored_from_velocity(
    force: str, offset: float, rng: np.random.Generator
) -> None:
    """Without its mid-line a quadratic stiffness of 0.25 shows a decrement of 0.072 where it is 0.055."""
    time, (x, v, _) = simulated(force, 0.01, 40, 50)
    decay = condition(record(time, v + 0.1 * OMEGA, "velocity"))
    assert decay.offset_is_measured and any("restored from the mean velocity" in note for note in decay.notes)
    assert not warnings_of(decay)
    end = decay.time[-1] - 0.3 / FREQUENCY
    found = cycle_quantities(decay.time, decay.displacement, 0.01, end)
    truth = cycle_quantities(time, x, 0.01, end)
    assert truth["offset"][0] == pytest.approx(offset, abs=0.01)
    np.testing.assert_allclose(found["offset"][:20], truth["offset"][:20], atol=5e-3)
    np.testing.assert_allclose(found["damping"][:20], truth["damping"][:20], rtol=0.02)


@pytest.mark.parametrize("gap", [0.0, 0.35, 0.9])
def test_the_mid_line_beyond_a_stop_is_the_mean_of_its_force(gap: float) -> None:
    angle = (np.arange(20000) + 0.5) * (2.0 * np.pi / 20000)
    for amplitude in (0.2, 0.5, 1.0):
        mean = np.pi * np.maximum(amplitude * np.cos(angle) - gap, 0.0).mean()
        assert beyond_stop(np.array([amplitude]), gap)[0] == pytest.approx(mean, abs=1e-8)


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_what_is_not_known_of_the_mid_line_of_a_stop_is_in_the_error_of_the_damping(
    noise: float, rng: np.random.Generator
) -> None:
    """Taken for that of a bilinear spring, the decrement below the gap was off far beyond its errors."""
    time, (x, v, _) = simulated("stop", 0.01, 60, 50)
    cycles = extract_cycles(condition(record(time, v + noise * OMEGA * rng.normal(size=v.size), "velocity")))
    truth = cycle_quantities(time, x, 0.01, time[-1] - 0.5 / FREQUENCY)
    below = (cycles.amplitude < 0.3) & (cycles.amplitude > 0.1)
    true = np.interp(cycles.time[below], truth["time"], truth["damping"])
    off = np.abs(cycles.damping[below] - true)
    assert true == pytest.approx(2.0 * np.pi * 0.01, rel=0.01)
    if noise == 0.0:
        assert off.max() < 0.02 * true[0]
    assert np.median(off / cycles.damping_error[below]) < 1.5
    assert "damping" in cycles.observables and "offset" in cycles.observables


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("quantity", ["velocity", "acceleration", "filtered"])
def test_a_lost_mid_line_is_warned_of_and_taken_from_the_second_harmonic(
    quantity: str, noise: float, rng: np.random.Generator
) -> None:
    """Without it the decrement would be off by 30 %, and errors of 1 % would refute the right model."""
    time, motion = simulated("quadratic stiffness", 0.01, 40, 50)
    values = motion[{"velocity": 1, "acceleration": 2, "filtered": 0}[quantity]]
    values = values + noise * np.abs(values).max() * rng.normal(size=values.size)
    band = (6.0, 15.0) if quantity == "filtered" else None
    decay = condition(record(time, values, "displacement" if band else quantity), band=band)
    if quantity == "velocity" and noise == 0.0:
        assert decay.offset_is_measured
    else:
        assert not decay.offset_is_measured
        (warning,) = warnings_of(decay)
        assert "asymmetric" in warning and "measure displacement" in warning
        cycles = extract_cycles(decay)
        truth = extract_cycles_from_arrays(time, motion[0])
        true = np.interp(-cycles.amplitude, -truth.amplitude, truth.damping)
        first = slice(0, 8)
        off = np.abs(cycles.damping - true)[first]
        assert 0.05 < 2.0 * decay.mid_line_error < 0.15
        assert noise > 0.0 or off.max() < 0.12 * true[0]
        assert (off < 3.5 * cycles.damping_error[first]).all()
        assert cycles.damping_error[0] > 1.8 * decay.mid_line_error * cycles.damping[0]


@pytest.mark.parametrize("quantity", ["velocity", "acceleration"])
def test_noise_after_integration_is_what_is_stated(quantity: str, rng: np.random.Generator) -> None:
    time, motion = simulated("hardening", 0.005, 60, 40)
    values = motion[1 if quantity == "velocity" else 2]
    sigma = 0.01 * np.abs(values).max()
    clean = condition(record(time, values, quantity), start=0.0).displacement
    lags, found, stated = 21, [], []
    for _ in range(6):
        decay = condition(record(time, values + sigma * rng.normal(size=time.size), quantity), start=0.0)
        n = min(clean.size, decay.displacement.size)
        noise = (decay.displacement[:n] - clean[:n])[80:-80]
        found.append([np.mean(noise[: noise.size - lag] * noise[lag:]) for lag in range(lags)])
        padded = np.pad(decay.noise_autocovariance, (0, lags))[:lags]
        stated.append(padded)
    found_mean, stated_mean = np.mean(found, axis=0), np.mean(stated, axis=0)
    # six records of some 120 independent stretches each determine a variance to 5 %; the spectrum is known to 10 %
    np.testing.assert_allclose(stated_mean, found_mean, atol=0.3 * found_mean[0])
    assert stated_mean[0] == pytest.approx(found_mean[0], rel=0.3)


# ---- band-pass ----------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0005, 0.005, 0.03])
def test_band_pass_leaves_a_linear_decay_alone(damping: float) -> None:
    time, (x, _, _) = simulated("linear", damping, 14 if damping > 0.02 else 60)
    decay = condition(record(time, x + 0.5), band=(6.0, 15.0))
    truth = cycle_quantities(time, x, decay.time[0], decay.time[-1])
    found = cycle_quantities(decay.time, decay.displacement)
    n = min(found["time"].size, truth["time"].size)
    assert n >= truth["time"].size - 1 and n >= 4
    np.testing.assert_allclose(found["amplitude"][:n], truth["amplitude"][:n], rtol=1e-3)
    np.testing.assert_allclose(found["damping"][:n], truth["damping"][:n], atol=1e-5)
    np.testing.assert_allclose(found["frequency"][:n], truth["frequency"][:n], rtol=1e-5)
    assert 0.0 < decay.lost_cycles < 6.0
    assert decay.time[0] == pytest.approx(decay.lost_cycles / decay.frequency, rel=0.01)
    assert any("cycles were lost at each end" in note and "biased" in note for note in decay.notes)
    assert decay.band == (6.0, 15.0) and not decay.offset_is_measured


def test_band_pass_bias_on_a_nonlinear_decay_is_small() -> None:
    time, (_, v, _) = simulated("hardening", 0.005, 80)
    decay = condition(record(time, v, "velocity"), band=(6.0, 16.0))
    truth = cycle_quantities(time, simulated("hardening", 0.005, 80)[1][0])
    found = cycle_quantities(decay.time, decay.displacement, end=decay.time[-1] - 0.3 / FREQUENCY)
    at = found["time"]
    np.testing.assert_allclose(found["frequency"], np.interp(at, truth["time"], truth["frequency"]), rtol=2e-4)
    # the third harmonic, 0.9 % of the fundamental at full amplitude, is gone with its share of the peaks
    np.testing.assert_allclose(found["amplitude"], np.interp(at, truth["time"], truth["amplitude"]), rtol=0.01)
    np.testing.assert_allclose(found["damping"], np.interp(at, truth["time"], truth["damping"]), rtol=0.02)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_band_pass_separates_two_modes(quantity: str) -> None:
    time = np.arange(4000) / 500.0
    s1, s2 = -0.6 + 2j * np.pi * 10.0, -1.0 + 2j * np.pi * 23.0
    power = ["displacement", "velocity", "acceleration"].index(quantity)
    values = np.real(s1**power * np.exp(s1 * time) + 0.4 * 1j * s2**power * np.exp(s2 * time))
    decay = condition(record(time, values, quantity), band=(6.0, 15.0))
    np.testing.assert_allclose(
        decay.displacement, np.real(np.exp(s1 * decay.time)), atol=2e-3 * np.exp(-0.6 * decay.time[0])
    )
    assert not warnings_of(decay)
    other = condition(record(time, values, quantity), band=(17.0, 29.0))
    assert other.frequency == pytest.approx(23.0, rel=1e-3)
    np.testing.assert_allclose(other.displacement, np.real(0.4j * np.exp(s2 * other.time)), atol=2e-3)


@pytest.mark.parametrize(
    ("band", "words"),
    [
        ((15.0, 6.0), ("0 < low < high", "half the sampling rate")),
        ((0.0, 15.0), ("0 < low",)),
        ((6.0, 300.0), ("250 Hz",)),
        ((40.0, 60.0), ("between 40 and 60", "10 Hz", "choose the band")),
        ((9.8, 10.2), ("beside the mode", "widen it")),
        ((6.0,), ("two frequencies",)),
        ("wide", ("two frequencies",)),
        (7.0, ("two frequencies",)),
        ((6.0, np.nan), ("0 < low",)),
    ],
)
def test_bad_bands_are_refused(band: object, words: tuple[str, ...]) -> None:
    time, (x, _, _) = simulated()
    with pytest.raises(InputError) as caught:
        condition(record(time, x), band=band)  # type: ignore[arg-type]
    for word in words:
        assert word in str(caught.value), str(caught.value)


def test_band_pass_longer_than_the_record_is_refused() -> None:
    time, (x, _, _) = simulated(cycles=10)
    with pytest.raises(InputError, match=r"widen the band|cycles left by the band-pass"):
        condition(record(time, x), band=(8.8, 11.5))


# ---- second mode --------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.85, 1.4, 1.99, 2.5, 6.3])
def test_second_mode_is_named(ratio: float, rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated("hardening", 0.005, 60)
    other = ratio * FREQUENCY
    values = x + 0.15 * np.exp(-0.002 * 2 * np.pi * other * time) * np.cos(2 * np.pi * other * time + 1.0)
    decay = condition(record(time, values + 3e-3 * rng.normal(size=time.size)))
    assert decay.second_mode_frequency == pytest.approx(other, rel=0.02)
    assert 0.05 < decay.second_mode_share < 0.5
    (warning,) = [note for note in warnings_of(decay) if "second mode" in note]
    assert f"{decay.second_mode_frequency:.4g} Hz" in warning and "`band=(" in warning
    low, high = (float(edge) for edge in warning.rpartition("`band=(")[2].rstrip(")`").split(","))
    assert low < decay.frequency < high and not low < other < high


@pytest.mark.parametrize("quantity", [0, 1, 2])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("force", sorted(FORCES))
def test_harmonics_raise_no_false_alarm(force: str, noise: float, quantity: int, rng: np.random.Generator) -> None:
    time, motion = simulated(force, 0.01, 40, 40)
    values = motion[quantity] + noise * np.abs(motion[quantity]).max() * rng.normal(size=time.size)
    decay = condition(record(time, values, ["displacement", "velocity", "acceleration"][quantity]))
    # an asymmetric structure's lost mid-line is a true alarm
    assert not [note for note in warnings_of(decay) if "asymmetric" not in note], decay.notes
    assert force in ("quadratic stiffness", "bilinear", "stop", "late stop") or not warnings_of(decay), decay.notes


@pytest.mark.parametrize("stick", [0.01, 0.05])
def test_friction_raises_no_false_alarm(stick: float, rng: np.random.Generator) -> None:
    time, x = friction(stick, 40, 40)
    decay = condition(record(time, x + 1e-3 * rng.normal(size=x.size)))
    assert not warnings_of(decay), decay.notes


# ---- noise --------------------------------------------------------------------------------------


@pytest.mark.parametrize("decibel", [20, 40, 60])
@pytest.mark.parametrize("per_cycle", [10, 30, 200])
@pytest.mark.parametrize("force", ["linear", "hardening", "quadratic damping"])
def test_noise_level_is_honest(force: str, per_cycle: int, decibel: int, rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated(force, 0.01, 40, per_cycle)
    sigma = np.sqrt(0.5) * 10.0 ** (-decibel / 20.0)
    decay = condition(record(time, x + sigma * rng.normal(size=time.size)))
    # 40 cycles of 10 samples, half of them used up by the harmonics: 7 %
    assert decay.noise == pytest.approx(sigma, rel=0.2)
    assert np.sqrt(decay.noise_autocovariance[0]) == pytest.approx(sigma, rel=0.2)
    assert np.all(np.abs(decay.noise_autocovariance[1:]) < 0.15 * sigma**2)


@pytest.mark.parametrize("per_cycle", [25, 150])
def test_noise_beside_a_friction_stop_is_that_of_the_tail(per_cycle: int, rng: np.random.Generator) -> None:
    time, x = friction(0.03, 40, per_cycle)
    decay = condition(record(time, x + 3e-4 * rng.normal(size=x.size)))
    assert decay.noise == pytest.approx(3e-4, rel=0.15)


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_quantisation_counts_as_noise(bits: int) -> None:
    time, (x, _, _) = simulated("hardening", 0.01, 40, 37)
    step = 2.2 / 2.0**bits
    decay = condition(record(time, step * np.round(x / step)))
    assert step / np.sqrt(12.0) * 0.9 < decay.noise < 2.0 * step / np.sqrt(12.0)


def test_a_stuck_sensor_does_not_hide_the_noise(rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated("linear", 0.03, 40, 50)
    noisy = x + 1e-3 * rng.standard_normal(x.size)
    noisy[time > 2.0] = noisy[time <= 2.0][-1]
    # the corner where it sticks is taken for noise, too: a third more; before, the stuck tail made it zero
    assert 0.8e-3 < condition(record(time, noisy)).noise < 1.6e-3


def test_coloured_noise_is_seen_as_such(rng: np.random.Generator) -> None:
    """A first-order low-pass at twice the mode: neighbours correlate, and the level counts where the mode is."""
    time, (x, _, _) = simulated("linear", 0.004, 150, 50)
    a = np.exp(-2.0 * np.pi * 20.0 / 500.0)
    noise = np.zeros(time.size)
    drive = rng.normal(size=time.size) * 1e-2
    for i in range(1, time.size):
        noise[i] = a * noise[i - 1] + drive[i]
    decay = condition(record(time, x + noise))
    stated = np.pad(decay.noise_autocovariance, (0, 40))
    truth = 1e-4 / (1 - a**2) * a ** np.arange(40)
    assert stated[0] == pytest.approx(truth[0], rel=0.35)  # low orders are bridged, not seen
    assert stated[5] == pytest.approx(truth[5], abs=0.25 * truth[0])
    assert decay.noise > 1.5 * np.sqrt(truth[0])  # white noise as strong around the mode would be larger in all


# ---- what is refused ----------------------------------------------------------------------------


def test_only_records_are_conditioned() -> None:
    with pytest.raises(InputError, match="must be a Record, got list"):
        condition([1.0, 2.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("scale", [1e200, 1e-200])
def test_values_that_are_no_measurement(scale: float) -> None:
    time, (x, _, _) = simulated()
    refuses(time, scale * x, "check the unit")


def refuses(time: Array, values: Array, *words: str, quantity: str = "displacement") -> None:
    with pytest.raises(InputError) as caught:
        condition(Record("s", time, values, quantity, source="run 7.csv"))
    message = str(caught.value)
    assert message.startswith("run 7.csv: ") and message.endswith((".", ")"))
    for word in words:
        assert word in message, message


def test_constant_record() -> None:
    time = np.arange(200) / 100.0
    refuses(time, np.full(200, 3.3), "all samples are 3.3")


def test_too_few_samples_per_cycle() -> None:
    time = np.arange(200) / 60.0
    refuses(time, np.exp(-0.3 * time) * np.cos(2 * np.pi * 10 * time), "6 samples per cycle", "sample faster than 80")
    with pytest.raises(InputError, match=r"s: 7\.996 samples per cycle of the 13 Hz motion, expected at least 8"):
        check_per_cycle(104.0, 104.0 / 7.996, "s")  # rounded it would be as many as are expected


@pytest.mark.parametrize("per_cycle", [12, 100])
@pytest.mark.parametrize("side", ["upper", "lower", "both"])
def test_clipping(side: str, per_cycle: int, rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated("linear", 0.005, 40, per_cycle)
    low, high = {"upper": (-2.0, 0.8), "lower": (-0.8, 2.0), "both": (-0.8, 0.8)}[side]
    noisy = x + 1e-3 * rng.normal(size=x.size)
    found = condition(record(time, np.clip(noisy, low, high)))
    note = next(note for note in found.notes if "peaks are clipped at" in note)
    limit = "-0.8 (lower" if side == "lower" else "0.8 (upper"
    assert note.startswith("warning: ") and f"clipped at {limit} limit" in note
    again = float(note.partition("used from ")[2].partition(" s on")[0])
    assert found.amplitude < 0.82 and found.time[0] > again - 1e-9
    left = noisy[time >= again]
    assert low < left.min() and left.max() < high  # no sample that was cut is the first of what is used
    assert left.max() > 0.7  # and no more was left out than that


def test_clipping_that_leaves_few_cycles_is_refused(rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated("linear", 0.005, 40, 40)
    noisy = np.clip(x + 1e-3 * rng.normal(size=x.size), -0.8, 0.8)[:560]  # of which seven or so are cut off
    refuses(time[:560], noisy, "peaks are clipped at", "widen the range: only 6.", "expected at least 8")


@pytest.mark.parametrize("side", ["upper", "lower", "both"])
def test_clipping_in_front_of_the_noise(side: str, rng: np.random.Generator) -> None:
    """A sensor saturates, and what follows it adds noise: no two tops are equal."""
    time, (x, _, _) = simulated("linear", 0.005, 40, 40)
    low, high = {"upper": (-2.0, 0.8), "lower": (-0.8, 2.0), "both": (-0.8, 0.8)}[side]
    found = condition(record(time, np.clip(x, low, high) + 3e-3 * rng.normal(size=x.size)))
    assert any("peaks are clipped at" in note for note in found.notes)
    assert 0.7 < found.amplitude < 0.82


@pytest.mark.parametrize("decrement", [1e-3, 0.03])
def test_flat_tops_that_decay_are_not_clipping(decrement: float, rng: np.random.Generator) -> None:
    """An acceleration on a spring that softens is as flat at its top: its third harmonic is a ninth, against it."""
    turns = np.arange(40 * 60) / 60.0
    shape = np.cos(2.0 * np.pi * turns) - np.cos(6.0 * np.pi * turns) / 9.0
    values = np.exp(-decrement * turns) * shape
    condition(record(turns / FREQUENCY, values + 1e-3 * rng.normal(size=turns.size)))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_model_that_is_held_beside_a_step_of_the_converter_is_not_clipping(
    side: float, rng: np.random.Generator
) -> None:
    time, (x, _, _) = simulated("linear", 0.005, 40, 40)
    held = np.concatenate([np.full(50, x[0]), x]) + 1.5e-3 * rng.normal(size=x.size + 50)
    step = 2.0 / 2**9
    values = side * np.minimum(np.floor((held - 0.25 * step) / step) * step, np.floor(x[0] / step) * step)
    runs = np.count_nonzero(np.diff((values == values[0]).astype(int)) == 1)
    assert runs > 5, "the last digit should come and go"
    conditioned = condition(record(np.arange(values.size) * (time[1] - time[0]), values))
    assert conditioned.amplitude == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("bits", [8, 10])
def test_a_coarse_converter_is_not_clipping(bits: int) -> None:
    time, (x, _, _) = simulated("linear", 0.0005, 60, 200)
    step = 2.0 / 2.0**bits
    condition(record(time, step * np.round(x / step)))


@pytest.mark.parametrize("rate", [0.0, 0.2])
def test_no_decay(rate: float, rng: np.random.Generator) -> None:
    time = np.arange(3000) / 500.0
    refuses(time, np.exp(rate * (time - 6.0)) * np.cos(OMEGA * time) + 1e-3 * rng.normal(size=3000), "cycles")


def test_too_few_cycles() -> None:
    time, (x, _, _) = simulated("linear", 0.01, 3.2, 60)
    refuses(time, x, "cycles", "expected at least 4")


def test_drowned_in_noise(rng: np.random.Generator) -> None:
    time = np.arange(2000) / 500.0
    with pytest.raises(InputError):
        condition(record(time, rng.normal(size=2000)))
    refuses(time, np.exp(-8.0 * time) * np.cos(OMEGA * time) + 0.5 * rng.normal(size=2000))


@pytest.mark.parametrize("order", [0, 4])
def test_the_jump_of_an_acceleration_at_the_release_is_no_spike(order: int, rng: np.random.Generator) -> None:
    time = np.arange(2400) / 800.0
    moving = time >= 0.1
    elapsed = time[moving] - 0.1
    values = np.zeros(time.size)
    values[moving] = -100.0 * np.exp(-0.6 * elapsed) * np.cos(2.0 * np.pi * 20.0 * elapsed)
    if order:
        values = lfilter(*butter(order, 100.0, fs=800.0), values)
    values += 0.1 * rng.standard_normal(time.size)
    decay = condition(record(time, values, "acceleration"))
    assert 0.09 < decay.time[0] < 0.125 and not [note for note in decay.notes if "spike" in note]
    values[1200] += 30.0
    assert [note for note in condition(record(time, values, "acceleration")).notes if "a spike of 3" in note]


def test_what_rings_after_a_release_is_no_spike(rng: np.random.Generator) -> None:
    """Behind a filter against aliases that is close to half the sampling rate the jump rings for some samples."""
    time = np.arange(2400) / 800.0
    elapsed = np.maximum(time - 0.3004, 0.0)
    values = -100.0 * (time >= 0.3004) * np.exp(-0.6 * elapsed) * np.cos(2.0 * np.pi * 8.0 * elapsed)
    values = lfilter(*butter(4, 320.0, fs=800.0), values) + 0.03 * rng.standard_normal(time.size)
    assert not [note for note in condition(record(time, values, "acceleration")).notes if "spike" in note]
    values[260] += 20.0  # later than what rings
    assert [note for note in condition(record(time, values, "acceleration")).notes if "a spike of" in note]


@pytest.mark.parametrize(("bend", "power"), [(2.0, 3), (3.0, 5)])
def test_a_strong_spring_that_decays_in_few_cycles_is_no_mode_of_its_harmonics(
    bend: float, power: int, rng: np.random.Generator
) -> None:
    """Its frequency falls by an octave meanwhile: the line of the acceleration is as broad as what is beside it."""
    stiffness, damping = (2.0 * np.pi * 6.0) ** 2, 2.0 * 0.08 * 2.0 * np.pi * 6.0
    time = np.arange(1500) / 440.0
    elapsed = np.maximum(time - 0.28, 0.0)

    def rate(_: float, y: Array) -> Array:
        return np.array([y[1], -damping * y[1] - stiffness * (y[0] + bend * y[0] ** power)])

    x, v = solve_ivp(rate, (0.0, elapsed[-1]), [1.0, 0.0], "DOP853", rtol=1e-10, atol=1e-12, dense_output=True).sol(
        elapsed
    )
    values = np.where(time > 0.28, -damping * v - stiffness * (x + bend * x**power), 0.0)
    values += 3e-3 * np.abs(values).max() * rng.standard_normal(time.size)
    decay = condition(record(time, values, "acceleration"))
    assert 6.0 < decay.frequency < 9.0 and not decay.grows_again
    cycles = extract_cycles(decay)
    assert len(cycles) >= 5 and cycles.frequency[0] > 1.05 * cycles.frequency[-1]


def test_hopeless_records_end_in_an_input_error(rng: np.random.Generator) -> None:
    time = np.arange(400) / 100.0
    shapes = {
        "ramp": time,
        "step": (time > 2.0).astype(float),
        "exponential": np.exp(-time),
        "spike": np.where(np.arange(400) == 200, 1.0, 0.0),
        "random walk": np.cumsum(rng.normal(size=400)),
        "alternating": (-1.0) ** np.arange(400),
        "huge": 1e300 * np.cos(time),
        "tiny": 1e-300 * np.cos(time),
    }
    for values in shapes.values():
        for quantity in ("displacement", "velocity", "acceleration"):
            with pytest.raises(InputError):
                condition(record(time, values, quantity))


# ---- real records -------------------------------------------------------------------------------


def test_ship_roll_decays(shared_data: Path) -> None:
    # damping ratio at 5 degrees as published (EFD, doi 10.17632/2stvkyngj9.1)
    for run, ratio in zip(read_records(shared_data / "ship_roll_kvlcc2", unit="rad"), (0.00488, 0.0133), strict=True):
        decay = condition(run)
        assert decay.time[0] == pytest.approx(run.time[0], abs=1e-3)  # the stored files begin at the release
        assert decay.frequency == pytest.approx(0.393, abs=0.001) and decay.unit == "rad"
        assert not warnings_of(decay) and abs(decay.baseline) < 2e-3
        cycles = cycle_quantities(decay.time[::8], decay.displacement[::8])
        near = np.abs(cycles["amplitude"] - np.deg2rad(5.0)) < np.deg2rad(1.2)
        assert cycles["damping"][near].mean() / (2 * np.pi) == pytest.approx(ratio, rel=0.15)


@pytest.mark.parametrize("hold", [8.0, 24.0])
def test_ship_held_before_its_release(shared_data: Path, hold: float, rng: np.random.Generator) -> None:
    run = read_records(shared_data / "ship_roll_kvlcc2", unit="rad")[0]
    n = int(hold * 100)
    values = np.concatenate([run.values[0] + 1e-4 * rng.normal(size=n), run.values])
    decay = condition(Record("held", np.arange(values.size) / 100.0, values, unit="rad"))
    plain = condition(run)
    # released in a trough: the first turning point is the peak half a cycle later, the record begins a quarter before
    assert decay.time[0] == pytest.approx(hold + 0.6, abs=0.15)
    assert decay.frequency == pytest.approx(plain.frequency, rel=1e-3)
    assert decay.baseline == pytest.approx(plain.baseline, abs=3e-4)


def test_jointed_beam_warns_of_its_second_mode(shared_data: Path) -> None:
    for run in read_records(shared_data / "jointed_beam"):
        decay = condition(run)
        assert decay.frequency == pytest.approx(122.3, abs=0.2)
        assert decay.second_mode_frequency == pytest.approx(243.5, abs=0.4)  # the second harmonic is at 244.6 Hz
        assert decay.second_mode_share > 0.05
        assert len(warnings_of(decay)) == 1
        assert decay.time[0] == pytest.approx(0.0, abs=1e-6)


def test_jointed_beam_falls_on_one_backbone_after_the_band_pass(shared_data: Path) -> None:
    frequencies, dampings = [], []
    for run in read_records(shared_data / "jointed_beam"):
        decay = condition(run, band=(90.0, 160.0))
        assert not warnings_of(decay) and decay.lost_cycles < 5.0
        cycles = cycle_quantities(decay.time, decay.displacement, end=decay.time[-1] - 0.004)
        speed = cycles["amplitude"] * 2 * np.pi * cycles["frequency"]
        near = np.abs(speed - 0.2) < 0.03
        frequencies.append(np.median(cycles["frequency"][near]))
        dampings.append(np.log(cycles["amplitude"][near][0] / cycles["amplitude"][near][-1]) / (near.sum() - 1))
    assert np.ptp(frequencies) < 0.05 and 122.2 < np.mean(frequencies) < 122.45
    assert np.ptp(dampings) < 0.15 * np.mean(dampings) and 0.0004 < np.mean(dampings) / (2 * np.pi) < 0.0010


@pytest.mark.parametrize("turned", [(False, False), (True, False), (False, True)], ids=str)
@pytest.mark.parametrize("size", [7, 64, 1001])
def test_convolution_by_transform_is_the_sum_of_products(turned, size, rng):
    values, kernel = (
        rng.standard_normal(count) + 1j * is_complex * rng.standard_normal(count)
        for count, is_complex in zip((1001, size), turned, strict=True)
    )
    if not turned[0]:
        values = values.real
    if not turned[1]:
        kernel = kernel.real
    found = convolve_inside(values, kernel)
    assert np.iscomplexobj(found) == any(turned) and found.size == 1001 - size + 1
    # rounding of sums of up to a thousand products
    np.testing.assert_allclose(found, np.convolve(values, kernel, mode="valid"), atol=1e-11)
