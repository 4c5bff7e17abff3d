"""Two modes so close that they beat: their sum is looked for where nothing else explains the samples.

Beside a line as near as that no mode can be passed alone. Two linear modes decay as two damped oscillations whose
frequencies are the same whatever the release; one nonlinear mode does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..._common.checks import FloatArray
from ..fitting.batch import Batch

_POINTS = 240  # of the envelope of a record
_LEFT = 0.1  # of what the best set leaves of the samples, that two modes leave at most
_MOST = 0.6  # of the records in which that must be so
_LEAST_SHARE = 0.03  # of the other mode's amplitude in that of the dominant one, at the begin
_BEAT = (1.5, 3.0)  # difference of the frequencies over the faster decay rate; and where releases are alike
_OTHER = 1.3  # ratio of the largest to the smallest motion from which releases are not alike
_ALIKE = 0.2  # of that difference, by which the frequencies of records may differ
_SHORTEST = 8.0  # cycles
_CLOSE = 0.15  # of the frequency of the mode: what is farther off makes a line of its own, or is outside of a band


@dataclass(frozen=True)
class CloseModes:
    """Two modes that beat.

    Attributes
    ----------
    specimen : str
        In whose record they are seen best.
    frequency, other : float
        Hertz, of the dominant one and of the other.
    share : float
        Amplitude of the other over that of the dominant one, where the record begins.
    """

    specimen: str
    frequency: float
    other: float
    share: float


def close_modes(batch: Batch, left: Sequence[FloatArray]) -> CloseModes | None:
    """Return the two modes whose sum explains most records far better than the best set does, or None.

    Parameters
    ----------
    batch : Batch
        Records as samples.
    left : sequence of (n,) arrays
        What the best set leaves of the samples of each.
    """
    sizes = [float(np.std(term.values[: rest.size])) for term, rest in zip(batch.waveform, left, strict=True)]
    # of one release, or several alike, the frequency of a single mode may change as the sum of two does
    least = _BEAT[0] if max(sizes) > _OTHER * min(sizes) else _BEAT[1]
    seen: list[tuple[float, CloseModes]] = []
    for r, (term, rest) in enumerate(zip(batch.waveform, left, strict=True)):
        time, frequency = term.time[: rest.size], batch.records[r].frequency
        found = _two_modes(time, term.values[: rest.size], frequency, least)
        if found is None:
            continue
        modes, theirs = found
        sizes_left = [float(np.sum(np.abs(envelope_about(time, item, frequency)[0]) ** 2)) for item in (theirs, rest)]
        ratio = sizes_left[0] / max(sizes_left[1], 1e-300)  # about the mode: harmonics and partials are neither's
        if ratio < _LEFT:
            seen.append((ratio, CloseModes(batch.specimens[r], *modes)))
    if not seen or len(seen) < _MOST * len(left):
        return None
    places = np.array([sorted((item.frequency, item.other)) for _, item in seen])
    apart = float(np.median(places[:, 1] - places[:, 0]))
    if (np.ptp(places, axis=0) > _ALIKE * apart).any():
        return None
    return min(seen, key=lambda item: item[0])[1]


def _two_modes(
    time: FloatArray, values: FloatArray, frequency: float, least: float
) -> tuple[tuple[float, float, float], FloatArray] | None:
    """Return frequencies and share of amplitude of two damped oscillations, and what they leave (n,)."""
    if frequency * (time[-1] - time[0]) < _SHORTEST:
        return None
    poles = _poles_of_envelope(time, values, frequency)
    if poles is None:
        return None
    clock = time - time[0]
    scale = 1.0 / clock[-1]

    def rest(x: FloatArray) -> FloatArray:
        return values - _fitted(clock, values, x)[0]

    start = np.array([poles[0].real, poles[0].imag, poles[1].real, poles[1].imag])
    result = least_squares(rest, start, x_scale=np.full(4, scale), max_nfev=20)
    explained, coefficients = _fitted(clock, values, result.x)
    size = np.hypot(coefficients[0::2][:2], coefficients[1::2][:2])
    decay, omega = result.x[0::2], result.x[1::2]
    large, small = (0, 1) if size[0] >= size[1] else (1, 0)
    share = float(size[small] / max(size[large], 1e-300))
    is_beat = abs(omega[0] - omega[1]) > least * float(np.max(-decay))
    is_close = (np.abs(omega / (2.0 * np.pi * frequency) - 1.0) < _CLOSE).all()
    if not is_beat or not is_close or (decay >= 0.0).any() or (omega <= 0.0).any() or share < _LEAST_SHARE:
        return None
    hertz = omega / (2.0 * np.pi)
    return (float(hertz[large]), float(hertz[small]), share), values - explained


def _fitted(clock: FloatArray, values: FloatArray, poles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares sum of two damped oscillations and a constant, and its coefficients (5,)."""
    columns = []
    for decay, omega in (poles[:2], poles[2:]):
        fall = np.exp(np.minimum(decay * clock, 50.0))
        columns += [fall * np.cos(omega * clock), fall * np.sin(omega * clock)]
    basis = np.stack([*columns, np.ones_like(clock)], axis=1)
    coefficients: FloatArray = np.linalg.lstsq(basis, values, rcond=1e-12)[0]
    return basis @ coefficients, coefficients


def _poles_of_envelope(time: FloatArray, values: FloatArray, frequency: float) -> NDArray[np.complex128] | None:
    """Return the poles (2,) [1/s] of two damped oscillations in the complex envelope, by a matrix pencil [1]_.

    References
    ----------
    .. [1] Hua Y., Sarkar T. K. (1990) Matrix pencil method for estimating parameters of exponentially damped/undamped
       sinusoids in noise. IEEE Transactions on Acoustics, Speech, and Signal Processing 38(5), 814-824.
    """
    envelope, omega, step = envelope_about(time, values, frequency)
    every = max(envelope.size // _POINTS, 1)
    z = envelope[::every]
    if z.size < 12:
        return None
    columns = z.size // 3
    hankel = np.lib.stride_tricks.sliding_window_view(z, columns + 1)
    basis = np.linalg.svd(hankel, full_matrices=False)[2][:2].conj().T
    shift = np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0]
    roots = np.linalg.eigvals(shift).conj()
    if not (np.abs(roots) > 1e-6).all():
        return None
    return np.asarray(np.log(roots) / (every * step) + 1j * omega, dtype=np.complex128)


def envelope_about(
    time: FloatArray, values: FloatArray, frequency: float
) -> tuple[NDArray[np.complex128], float, float]:
    """Return the complex amplitude about a frequency, the angular frequency it is of, and the time step.

    The mean over one cycle of whole samples takes the mirror image and the harmonics away.
    """
    step = float(np.median(np.diff(time)))
    cycle = max(round(1.0 / (frequency * step)), 1)
    omega = 2.0 * np.pi / (cycle * step)
    turned = (values - values.mean()) * np.exp(-1j * omega * (time - time[0]))
    return np.convolve(turned, np.full(cycle, 1.0 / cycle), mode="valid"), omega, step


__all__ = ["CloseModes", "close_modes", "envelope_about"]
