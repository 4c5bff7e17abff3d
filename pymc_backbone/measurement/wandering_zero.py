"""What a zero that wanders does to the cycles of a displacement: damping sees its slope, to first order.

The decrement of a cycle is that of two swings, from peak to trough and on to the next peak. A zero that rises by ``s``
over the cycle shortens the first and lengthens the second, and takes ``s`` over the amplitude from the decrement. The
mid-lines of the cycles tell how the zero went; what they leave open is an error that all cycles share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .._common.checks import FloatArray
from .conditioning.conditioned import MeasuredSamples
from .conditioning.wander import Wander
from .cycle_data import Cycles, with_shared_errors

_OFFSET = 3  # row of `Cycles.bands`
_OWN = (0, 1, 2, 3)  # powers of the amplitude that a structure's own mid-line is made of


def mind_wandering_zero(cycles: Cycles, measured: MeasuredSamples) -> Cycles:
    """Return the cycles of a displacement without what the slow noise of its zero does to damping and turning points.

    The offsets stay as they are: they hold the slow noise as errors, for it may hide a mid-line of the structure's own.
    What is only possible adds to the errors of the offsets alone. Cycles without slow noise, or of a velocity or an
    acceleration, come back as they were.
    """
    slow = measured.slow_noise
    if slow is None or measured.order:
        return cycles
    time, noise = measured.time, float(measured.autocovariance[0])
    # the zero was taken from where it happened to be
    size = slow.size(float(time[-1] - time[0]) / (time.size - 1), time.size, noise)
    modes = slow.modes(time, noise, cycles.time)
    zero = np.column_stack([modes, np.full(len(cycles), size)])
    if slow.is_sure and modes.shape[1]:
        cycles = _without_slope(cycles, slow, measured, modes)
    return with_shared_errors(cycles, "offset", -zero / cycles.smoothed_amplitude[:, None])


def _without_slope(cycles: Cycles, slow: Wander, measured: MeasuredSamples, modes: FloatArray) -> Cycles:
    """Return the cycles without what the zero does to damping and turning points; ``modes`` (n, k) are those there."""
    time, noise = measured.time, float(measured.autocovariance[0])
    half = 0.5 / cycles.frequency
    before, after = (slow.modes(time, noise, cycles.time + side * half) for side in (-1.0, 1.0))
    share = np.exp(0.25 * cycles.damping)[:, None]
    amplitude = cycles.amplitude[:, None]
    of_damping = ((before - modes) / share - (after - modes) * share) / amplitude
    amounts, root = _amounts(cycles, 0.25 * (before + 2.0 * modes + after), slow)
    turning = slow.modes(time, noise, cycles.turning_times)
    cycles = replace(
        cycles,
        damping=cycles.damping - of_damping @ amounts,
        turning_values=cycles.turning_values - turning @ amounts,
        turning_value_errors=np.sqrt(cycles.turning_value_errors**2 + ((turning @ root) ** 2).sum(axis=1)),
    )
    return with_shared_errors(cycles, "damping", of_damping @ root)


def _amounts(cycles: Cycles, modes: FloatArray, slow: Wander) -> tuple[FloatArray, FloatArray]:
    """Return the amounts (k,) of the modes (n, k) in the mid-lines, and a root (k, k) of their covariance.

    Beside a constant, and what a structure's own mid-line may be where the slow noise does not hold all of it.
    """
    size = cycles.amplitude / cycles.amplitude.max()
    powers = _OWN[:1] if slow.mid_line is None else _OWN[: max(len(cycles) // 2, 1)]
    shapes = np.column_stack([size**power for power in powers])
    noise = np.diag(cycles.bands[_OFFSET, 0])
    for lag in range(1, min(cycles.bands.shape[1], len(cycles))):
        beside = np.diag(cycles.bands[_OFFSET, lag, :-lag], lag)
        noise = noise + beside + beside.T
    whole = np.column_stack([shapes, modes])
    whitened = np.linalg.solve(
        np.linalg.cholesky(noise * np.outer(cycles.amplitude, cycles.amplitude)),
        np.column_stack([whole, cycles.offset * cycles.amplitude]),
    )
    count = len(powers)
    own = np.linalg.qr(whitened[:, :count])[0]
    left = whitened[:, count:] - own @ (own.T @ whitened[:, count:])
    seen, middle = left[:, :-1], left[:, -1]
    values, vectors = np.linalg.eigh(seen.T @ seen + np.eye(seen.shape[1]))
    root = vectors / np.sqrt(values)
    amounts: FloatArray = root @ (root.T @ (seen.T @ middle))
    return amounts, root


__all__ = ["mind_wandering_zero"]
