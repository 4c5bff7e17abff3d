"""Harmonics of a decay, and its acceleration over displacement and speed, from fits of a few cycles at a time.

Over some cycles a decay is its mid-line, a fundamental and harmonics of one phase, all falling with the amplitude. That
is linear in its coefficients once the phase is known, which the peaks tell; so every number has a standard error, and
the second derivative of the fit is a smooth acceleration that no difference of samples would be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._common.checks import FloatArray
from .._common.threads import with_one_thread

ORDERS = (2, 3, 4, 5)
"""Harmonics that are looked at."""
LEAST_PER_CYCLE = 16.0
"""Samples of a cycle below which the fifth harmonic is not safely below half the sampling rate."""
_CYCLES = 3  # of one fit
_MOST = 40  # fits of a decay
_MID_LINE = 2  # last columns of a fit
_POINTS = 256  # of the cycle in the middle of a fit
_CHANCE = 2.448  # 95 % of the modulus of two independent standard normal numbers


@dataclass(frozen=True, eq=False)
class HarmonicDecay:
    """Harmonics and accelerations of a decay at w amplitudes, in falling order.

    Attributes
    ----------
    amplitude : (w,) array
        Of the fundamental [m or rad].
    ratios : (w, 4) array
        Amplitude of harmonics 2 to 5 over that of the fundamental.
    floor : (w, 4) array
        What noise alone makes of them, exceeded in 5 % of the cases.
    turning : (w, 2, 2) array
        Displacement and acceleration where the speed is zero: at the trough and at the peak.
    crossing : (w, 2, 2) array
        Speed and acceleration where the displacement is zero, falling and rising.
    acceleration_error : (w,) array
        Standard error of the accelerations.
    """

    amplitude: FloatArray
    ratios: FloatArray
    floor: FloatArray
    turning: FloatArray
    crossing: FloatArray
    acceleration_error: FloatArray


@with_one_thread
def harmonic_decay(
    time: FloatArray, displacement: FloatArray, peaks: FloatArray, *, has_mid_line: bool = True
) -> HarmonicDecay | None:
    """Return the harmonics of a decay.

    Parameters
    ----------
    time, displacement : (n,) arrays
        Seconds, uniform; metres or radians from equilibrium.
    peaks : (p,) array
        Instants of its positive peaks [s].
    has_mid_line : bool
        Whether the mid-line is the structure's. Integration of a velocity or an acceleration loses it: displacements
        are then counted from it, wherever it is.

    Returns
    -------
    HarmonicDecay or None
        None where a cycle has fewer than 16 samples, or there are fewer than four cycles.
    """
    if peaks.size < _CYCLES + 2:
        return None
    period = float(np.median(np.diff(peaks)))
    step = float(time[-1] - time[0]) / (time.size - 1)
    if period / step < LEAST_PER_CYCLE:
        return None
    starts = np.unique(np.linspace(0, peaks.size - _CYCLES - 1, _MOST).round().astype(int))
    found = [one for s in starts if (one := _fit(time, displacement, peaks, int(s), has_mid_line)) is not None]
    if len(found) < 3:
        return None
    return HarmonicDecay(*(np.array(part) for part in zip(*found, strict=True)))


def peaks_of(time: FloatArray, displacement: FloatArray) -> FloatArray:
    """Return the instants of the positive peaks of a simulated decay, by the parabola through three samples."""
    x = displacement
    at = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:]) & (x[1:-1] > 0.0)) + 1
    bend = x[at - 1] - 2.0 * x[at] + x[at + 1]
    shift = np.where(bend < 0.0, 0.5 * (x[at - 1] - x[at + 1]) / np.where(bend < 0.0, bend, -1.0), 0.0)
    return np.asarray(time[at] + shift * (time[1] - time[0]))


def _fit(
    time: FloatArray, x: FloatArray, peaks: FloatArray, first: int, has_mid_line: bool
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray, float] | None:
    """Return what `HarmonicDecay` holds of the cycles from one peak on."""
    last = first + _CYCLES
    near = slice(max(first - 2, 0), min(last + 3, peaks.size))
    number = np.arange(peaks.size, dtype=np.float64)[near]
    middle, half = 0.5 * (peaks[first] + peaks[last]), 0.5 * (peaks[last] - peaks[first])
    turns: FloatArray = np.polyfit((peaks[near] - middle) / half, number, min(3, number.size - 1))
    held = (time >= peaks[first]) & (time <= peaks[last])
    if np.count_nonzero(held) < 3 * (2 * ORDERS[-1] + 6):
        return None
    u = (time[held] - middle) / half
    angle = 2.0 * np.pi * np.polyval(turns, u)
    rough = np.interp(np.array([-1.0, 1.0]), u, np.abs(x[held]))
    fall = np.log(max(rough[0], 1e-300) / max(rough[1], 1e-300))  # over two units of u
    design = _design(u, angle, fall)
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ x[held]
    residual = x[held] - design @ coefficients
    variance = float(residual @ residual) / (residual.size - coefficients.size)
    covariance = variance * (inverse @ inverse.T)
    if not has_mid_line:
        coefficients[-_MID_LINE:] = 0.0

    pairs = coefficients[: 2 * ORDERS[-1]].reshape(-1, 2)
    sizes = np.hypot(pairs[:, 0], pairs[:, 1])
    errors = np.sqrt(0.5 * np.diag(covariance)[: 2 * ORDERS[-1]].reshape(-1, 2).sum(axis=1))
    if not sizes[0] > 0.0:
        return None

    # the cycle in the middle, a little more than one, on a fine grid
    reach = 0.6 * (peaks[last] - peaks[first]) / _CYCLES / half
    fine = np.linspace(-reach, reach, _POINTS)
    rows = _design(fine, np.asarray(2.0 * np.pi * np.polyval(turns, fine), dtype=np.float64), fall)
    step = (fine[1] - fine[0]) * half
    # sixth-order differences of a smooth fit at more than 200 points a cycle
    shown = rows[3:-3]
    speed = _combined(rows, (-1, 9, -45, 0, 45, -9, 1)) / (60.0 * step)
    bending = _combined(rows, (2, -27, 270, -490, 270, -27, 2)) / (180.0 * step**2)
    place, velocity, acceleration = shown @ coefficients, speed @ coefficients, bending @ coefficients
    error = float(np.sqrt(np.median(np.einsum("ij,jk,ik->i", bending, covariance, bending))))
    turning = _where_zero(velocity, place, acceleration)
    crossing = _where_zero(place, velocity, acceleration)
    if turning is None or crossing is None:
        return None
    return float(sizes[0]), sizes[1:] / sizes[0], _CHANCE * errors[1:] / sizes[0], turning, crossing, error


def _design(u: FloatArray, angle: FloatArray, fall: float) -> FloatArray:
    """Return the columns: cosine and sine of each order, falling; the fundamental's change; the mid-line."""
    decay = np.exp(-0.5 * fall * u)
    columns = [decay * part(k * angle) for k in range(1, ORDERS[-1] + 1) for part in (np.cos, np.sin)]
    columns += [u * columns[0], u * columns[1], u**2 * columns[0], u**2 * columns[1], np.ones_like(u), u]
    return np.stack(columns, axis=1)


def _combined(rows: FloatArray, weights: tuple[int, ...]) -> FloatArray:
    n = rows.shape[0] - len(weights) + 1
    return np.asarray(sum(w * rows[k : k + n] for k, w in enumerate(weights)))


def _where_zero(values: FloatArray, place: FloatArray, acceleration: FloatArray) -> FloatArray | None:
    """Return place and acceleration where ``values`` are zero: the innermost with each sign of ``place``."""
    at = np.flatnonzero(np.diff(np.signbit(values)))
    share = values[at] / (values[at] - values[at + 1])
    pairs = np.stack([one[at] + share * (one[at + 1] - one[at]) for one in (place, acceleration)], axis=1)
    sides = [pairs[pairs[:, 0] < 0.0], pairs[pairs[:, 0] >= 0.0]]
    if not all(len(side) for side in sides):
        return None
    return np.array([side[len(side) // 2] for side in sides])
