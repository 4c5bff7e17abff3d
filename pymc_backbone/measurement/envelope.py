"""Cycles of a free decay of which only the envelope was measured: amplitude or power over time.

A lock-in amplifier, or a spectrum analyser in zero span, delivers an amplitude each so many cycles, disturbed by the
noise in its band. The samples are taken together in stretches over which the amplitude falls by the same share; the
logarithm of the mean power of each, less that of the noise, gives

    damping = -d ln A / dt / frequency,

which is the decrement per cycle of the package's definition. Neighbouring dampings share a stretch, and their
covariance says so.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._common.checks import FloatArray, InputError, check_motion
from .._common.threads import with_one_thread
from .cycle_data import MINIMUM_CYCLES, Cycles
from .envelope_noise import Scatter, excess, memory_of, scatter_of
from .envelope_part import FreeEnvelope, free_envelope
from .smoothed_amplitude import amplitude_from_damping
from .smoothing import smooth

MOST_STRETCHES = 160
"""More tell no more, and cost."""
_SAMPLES = 4  # of a stretch at least, where there are as many
_MEMORIES = 2  # of the noise, in samples, that a stretch holds at least
_CURVED = 3  # neighbours to either side over which a frequency bends alike
_OF_CORRECTION = 0.2  # how much of the correction of a bent curve is in doubt
_FEWEST = 12
_MOTION = ("m", "rad")


@with_one_thread
def envelope_cycles(
    record: Any, *, start: float | None = None, stop: float | None = None, floor: float | None = None
) -> Cycles:
    """Return what an envelope says of amplitude, damping and, where it was measured, frequency.

    Parameters
    ----------
    record : Record
        With the quantity ``envelope`` and a frequency.
    start, stop : float, optional
        Part of the record to use [s]; ``start`` replaces the search for the release.
    floor : float, optional
        Amplitude [unit of the record] at which the part to use ends.

    Returns
    -------
    Cycles
        One for each pair of neighbouring stretches, not for each cycle; without turning points.

    Raises
    ------
    InputError
        Where the frequency is not known, the envelope does not decay, or too little of it stands above the noise.

    See Also
    --------
    extract_cycles : the same of a waveform.
    backbones_at_levels : what follows.
    """
    name = record.specimen
    if record.frequency is None:
        raise InputError(
            f"{record.source}: the frequency of the motion must be known, because damping is per cycle, and the file "
            "has no column 'frequency'; give `frequency`, in Hz."
        )
    frequency = np.broadcast_to(np.asarray(record.frequency, dtype=np.float64), record.time.shape)
    if record.unit in _MOTION:
        check_motion(float(record.values.max()), float(np.median(frequency)), record.unit, record.source)
    free = free_envelope(
        record.time, record.values, start=start, stop=stop, least=floor, unit=_shown(record.unit), name=name
    )
    is_measured = np.ndim(record.frequency) > 0
    return _cycles(record, free, frequency[free.part], is_measured)


def _shown(unit: str) -> str:
    return "(relative)" if unit == "1" else unit


def _cycles(record: Any, free: FreeEnvelope, frequency: FloatArray, is_measured: bool) -> Cycles:
    """Return the cycles of the free part."""
    time, values = record.time[free.part], record.values[free.part]
    relative = free.scatter.variance(free.amplitude) / free.amplitude**2
    memory = memory_of(time, np.log(np.maximum(values, 0.1 * free.amplitude)), relative)
    edges = _edges(time, free.amplitude, max(_SAMPLES, _MEMORIES * memory if memory > 1 else 1))
    first, count = edges[:-1], np.diff(edges)
    if count.size < MINIMUM_CYCLES + 1:
        raise InputError(
            f"the envelope of {record.specimen!r} must hold at least {MINIMUM_CYCLES + 1} stretches of decay, got "
            f"{count.size}; record faster or longer."
        )

    def mean(samples: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(samples, first) / count)

    at, power, motion = mean(time), mean(values**2), mean(frequency)
    variance = _log_variance(free.scatter, power, free.floor.power, count)
    # the mean of m powers that fall by exp(-2 d) each is that in their middle times sinh(m d) / (m sinh(d))
    slope = np.abs(np.gradient(np.log(mean(free.amplitude)), first + 0.5 * (count - 1.0)))
    fall = count * slope + 1e-9
    bent = np.sinh(fall) / (count * np.sinh(fall / count))
    log = 0.5 * np.log(power - free.floor.power) - 0.5 * np.log(bent) + variance
    variance = variance * excess(at, log, variance)
    beside = -0.5 * free.floor.doubt * free.floor.power / (power - free.floor.power)

    cycles = 0.5 * (motion[1:] + motion[:-1]) * np.diff(at)
    n = cycles.size
    damping = (log[:-1] - log[1:]) / cycles
    bands = np.zeros((4, 2, n))
    bands[2, 0] = (variance[:-1] + variance[1:]) / cycles**2
    bands[2, 1, :-1] = -variance[1:-1] / (cycles[:-1] * cycles[1:])
    middle = 0.5 * (log[1:] + log[:-1])
    log_bands = np.zeros((2, n))
    log_bands[0], log_bands[1, :-1] = (variance[:-1] + variance[1:]) / 4.0, variance[1:-1] / 4.0
    amplitude = np.exp(middle)
    bands[0, 0] = log_bands[0] * amplitude**2
    bands[0, 1, :-1] = log_bands[1, :-1] * amplitude[:-1] * amplitude[1:]
    middle_motion = 0.5 * (motion[1:] + motion[:-1])
    bent_by = np.zeros(n)
    if is_measured:
        bent_by = _bent_by(motion)
        bands[1] = _frequency_bands(time, frequency, free.amplitude, at, motion, count, first)
    index = np.arange(n, dtype=np.float64)
    curve = smooth([index], middle, log_bands, [index], orders=(2, 3), kinks=True)
    smoothed, design, spread = amplitude_from_damping(
        amplitude, bands[0], damping, bands[2], np.exp(curve.value), n, 0.5 * (cycles[1:] + cycles[:-1])
    )
    shared = np.zeros((4, n, 2))
    shared[2, :, 1] = damping * (log[:-1] - log[1:]) ** 2 / 12.0  # a curved decay, taken as straight over a stretch
    shared[2, :, 0] = (beside[:-1] - beside[1:]) / cycles
    shared[1, :, 1] = _OF_CORRECTION * bent_by
    shared[0, :, 0] = 0.5 * (beside[:-1] + beside[1:]) * amplitude
    errors = np.sqrt(bands[:, 0] + (shared**2).sum(axis=2))
    notes = [*record.notes, *(f"{record.specimen}: {note}" for note in free.notes)]
    return Cycles(
        specimen=record.specimen,
        time=0.5 * (at[1:] + at[:-1]),
        amplitude=amplitude,
        frequency=middle_motion - bent_by,
        damping=damping,
        offset=np.zeros(n),
        amplitude_error=errors[0],
        frequency_error=errors[1],
        damping_error=errors[2],
        offset_error=errors[3],
        bands=bands,
        shared=shared,
        smoothed_amplitude=smoothed,
        smoothed_amplitude_design=design,
        smoothed_amplitude_spread=spread,
        **{f"turning_{what}": np.zeros(0) for what in ("times", "values", "time_errors", "value_errors", "signs")},
        noise=float(np.sqrt(free.scatter.constant)),
        notes=tuple(notes),
        observables=("frequency", "damping") if is_measured else ("damping",),
    )


def _bent_by(means: FloatArray) -> FloatArray:
    """Return by how much the mean of two neighbouring means exceeds a curve half way between them.

    Of a parabola each mean exceeds its middle by a twenty-fourth of the second difference, the mean of two what lies
    between them by an eighth. Differences are averaged over neighbours, so that they bring no noise along.
    """
    second = np.pad(np.diff(means, 2), 1, mode="edge")
    reach = min(_CURVED, (means.size - 1) // 2)
    kernel = np.ones(2 * reach + 1) / (2 * reach + 1)
    smooth_second = np.convolve(np.pad(second, reach, mode="edge"), kernel, mode="valid")
    return np.asarray((smooth_second[1:] + smooth_second[:-1]) / 12.0)


def _edges(time: FloatArray, amplitude: FloatArray, samples: int) -> Any:
    """Return the first sample of each stretch, and the end: equal falls of the amplitude, enough samples in each."""
    n = time.size
    most = int(np.clip(n // samples, min(_FEWEST, n // 2), MOST_STRETCHES))
    least = max(n // (8 * most), samples // (2 * _SAMPLES), 1)
    # the fall as a smooth function of time: its own noise must not choose the edges
    knots = np.unique(np.linspace(0, n - 1, min(40, max(n // 8, 4))).round().astype(int))
    halves = np.maximum(np.diff(knots).min() // 2, 1)
    log = np.array([np.log(amplitude[max(k - halves, 0) : k + halves + 1]).mean() for k in knots])
    fall = np.interp(np.arange(n), knots, np.maximum.accumulate(log[0] - log) + 1e-9 * np.arange(knots.size))
    wanted = np.linspace(fall[0], fall[-1], most + 1)[1:-1]
    inner = np.searchsorted(fall, wanted)
    edges = [0]
    for edge in inner:
        if edge - edges[-1] >= least and n - edge >= least:
            edges.append(int(edge))
    return np.array([*edges, n])


def _log_variance(scatter: Scatter, power: FloatArray, floor: float, count: Any) -> FloatArray:
    """Return the variance of half the logarithm of mean powers, the samples independent."""
    signal = np.maximum(power - floor, 1e-300)
    each = scatter.variance(np.sqrt(signal)) / signal * (1.0 + scatter.constant / signal)
    return np.asarray(each / count)


def _frequency_bands(
    time: FloatArray, frequency: FloatArray, amplitude: FloatArray, at: FloatArray, mean: FloatArray, count: Any,
    first: Any,
) -> FloatArray:  # fmt: skip
    """Return the covariance of the mean frequency of neighbouring stretches, as `Cycles.bands` has it."""
    scatter = scatter_of(time, frequency, amplitude, -2.0)
    each = scatter.constant + scatter.relative * np.maximum(amplitude, 1e-300) ** -2.0
    variance = np.add.reduceat(each, first) / count**2
    variance = variance * excess(at, mean, variance)
    bands = np.zeros((2, mean.size - 1))
    bands[0] = (variance[1:] + variance[:-1]) / 4.0
    bands[1, :-1] = variance[1:-1] / 4.0
    return bands
