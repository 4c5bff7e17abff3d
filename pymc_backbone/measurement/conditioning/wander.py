"""A sensor's zero that wanders: noise slower than the motion, told from the mid-line that a structure itself has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct
from scipy.interpolate import make_interp_spline
from scipy.ndimage import uniform_filter1d
from scipy.special import logsumexp

from ..._common.checks import FloatArray
from .convolution import convolve_inside
from .noise import NoiseSpectrum
from .tracking import Track

TOP = 0.6
"""Order (frequency over that of the motion) up to which noise is slow; above, it shows between the harmonics."""
_CLEAR = 0.4  # order up to which the motion's own line does not reach
_POWERS = (0.5, 1.0, 1.5, 2.0)
_RATIOS = np.geomspace(1.0, 1e7, 43)  # of slow noise to the other at the lowest frequency
_LEVERAGE = 0.5  # share of a frequency that shapes of the mid-line take, beyond which it says nothing
_FEWEST = 2
_MANY = 12.0  # cycles
_SLOW = 0.025  # damping ratio
_POSSIBLE = 0.2  # probability below which it is left out
_SURE = 0.95
_MOST_MODES = 200
_QUIET = 0.1  # share of the records of a sensor with slow noise that hold none nevertheless
_SPREAD = 1.2  # standard deviation of the logarithm of slow noise over the other, in records of one sensor
_SEEN = 0.1  # share of the other noise from which slow noise counts
_PLACES = 40  # at which a mid-line is kept
_EDGE = 6  # cycles of a record, from which one at an edge is left out where the motion changes fast
_CHANGES = (0.01, 0.2)  # of the period from one cycle to the next, and of the logarithm of the amplitude: fast


@dataclass(frozen=True)
class MidLine:
    """Mid-line of a record as a function of its amplitude.

    Attributes
    ----------
    amplitude, value : (g,) arrays
        Amplitudes, rising, and the mid-line there, smooth [unit].
    error : float
        Root mean square of what it leaves of the tracked one [unit].
    side : float
        1 where the first turning point is on the positive side, else -1.
    """

    amplitude: FloatArray
    value: FloatArray
    error: float
    side: float

    def change(self, low: float, high: float) -> float:
        """Return by how much the mid-line moves between two amplitudes."""
        return float(np.diff(np.interp([low, high], self.amplitude, self.value))[0])


@dataclass(frozen=True)
class Wander:
    """Power spectral density of the slow noise, beyond the one that the spectrum between the harmonics tells.

    ``sum_j level_j (f^-power_j - top^-power_j)`` below ``top``.

    Attributes
    ----------
    levels, powers : (j,) arrays
        Mixture of power laws, each weighed by its probability [unit^2/Hz at 1 Hz; -].
    top : float
        Frequency above which there is none [Hz].
    probability : float
        That there is slow noise at all.
    likelihood : (1 + g,) array
        Logarithm of the likelihood of none, and of each power law that was asked.
    asked : (g, 2) array
        Level and power of these.
    mid_line : MidLine or None
        Mid-line of the record; None where the structure has as good as none.
    of_all : Wander or None
        The slow noise where nothing of the mid-line is the structure's.
    """

    levels: FloatArray
    powers: FloatArray
    top: float
    probability: float
    likelihood: FloatArray
    asked: FloatArray
    mid_line: MidLine | None = None
    of_all: Wander | None = None

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the one-sided density [unit^2/Hz] at positive frequencies [Hz]."""
        clipped = np.minimum(frequency, self.top)[..., None]
        return np.asarray(np.sum(self.levels * (clipped**-self.powers - self.top**-self.powers), axis=-1))

    @property
    def is_possible(self) -> bool:
        """Whether it is worth being counted."""
        return self.probability > _POSSIBLE

    @property
    def is_sure(self) -> bool:
        """Whether there is no doubt that the zero wanders."""
        return self.probability > _SURE

    def note(self, path: Track, sampling_rate: float, spectrum: NoiseSpectrum, unit: str) -> str:
        """Return a sentence that says by how much."""
        size = self.size(1.0 / sampling_rate, int(float(path.time[-1]) * sampling_rate), spectrum.total**2)
        return (
            f"the sensor's zero wanders slower than the motion, by some {size:.2g} {unit}: that is counted as "
            "noise, not as the structure's mid-line"
        )

    def size(self, step: float, count: int, noise: float) -> float:
        """Return the root mean square of the slow noise in so many samples, ``step`` [s] apart."""
        return float(np.sqrt(self._variances(step, count, noise)[1].sum() / count))

    def modes(self, time: FloatArray, noise: float, at: FloatArray | None = None) -> FloatArray:
        """Return the slow noise as columns (m, k): a record of it is these times independent standard normal numbers.

        Parameters
        ----------
        time : (n,) array
            Instants [s], uniform, rising.
        noise : float
            Variance of the other noise of a sample at these instants [unit^2]; what is far below it is left out.
        at : (m,) array, optional
            Instants [s] at which the columns are wanted; by default ``time``.
        """
        step = float(time[-1] - time[0]) / (time.size - 1)
        k, variance = self._variances(step, time.size, noise)
        place = ((time if at is None else at) - time[0]) / step + 0.5
        return np.cos(np.outer(np.pi / time.size * place, k)) * np.sqrt(2.0 / time.size * variance)

    def _variances(self, step: float, count: int, noise: float) -> tuple[FloatArray, FloatArray]:
        """Return numbers (k,) of half waves in so many samples, and the variance of each that counts."""
        k = np.arange(1.0, min(_MOST_MODES, count // 2) + 1.0)
        variance = 0.5 * self.at(k / (2.0 * step * count)) / step
        return k[variance > _SEEN * noise], variance[variance > _SEEN * noise]


def find_wander(
    values: FloatArray, sampling_rate: float, path: Track, spectrum: NoiseSpectrum, order: int = 0
) -> Wander | None:
    """Return the slow noise of a record, or None where it is too short to tell.

    Parameters
    ----------
    values : (n,) array
        What was measured; time counts from its first sample.
    sampling_rate : float
        Samples per second.
    path : Track
        Its track up to the end of motion.
    spectrum : NoiseSpectrum
        Noise between the harmonics.
    order : int
        How often the displacement was differentiated in ``values``.

    Notes
    -----
    The mid-line of an autonomous structure is a function of its amplitude, and what shifts it makes a second
    harmonic that changes alike. What remains of the tracked mid-line beside constant, A, A^2, A^3 (A^2 alone in few
    cycles) and that harmonic is taken to cosines, whose squares follow the density of the noise (Whittle's
    likelihood): the known one alone, or with a power law of the frequency added, whose power (0.5 to 2: from drifting
    electronics to a random walk) and size are averaged over what the record supports. An acceleration that decays
    slowly has as good as no mid-line of its own.
    """
    middle, shapes, line = _mid_line(values, sampling_rate, path, order)
    found = _slow_noise(middle, shapes, path, spectrum)
    if found is None or line is None:
        return found
    return replace(found, mid_line=line, of_all=_slow_noise(middle, shapes[:, :1], path, spectrum))


def _slow_noise(middle: FloatArray, shapes: FloatArray, path: Track, spectrum: NoiseSpectrum) -> Wander | None:
    """Return the slow noise of a mid-line (n,) beside shapes (n, s) that it may have; None where it is too short.

    Where the frequency changes fast, at a large release or before friction stops the motion, a cycle at the edge of the
    record is none of the track's: its mean is off by what the phase is.
    """
    n, per_cycle = middle.size, path.per_cycle
    if n > _EDGE * per_cycle:
        inside = slice(per_cycle * _is_fast(path, 1), n - per_cycle * _is_fast(path, -1))
        middle, shapes = middle[inside], shapes[inside]
        n = middle.size
    if n < 3 * per_cycle:
        return None
    basis = np.linalg.qr(shapes / np.maximum(np.abs(shapes).max(axis=0), 1e-300))[0]
    left = middle - basis @ (basis.T @ middle)
    k = np.arange(1, int(2.0 * _CLEAR * n / per_cycle) + 1)
    leverage = (dct(basis, axis=0, norm="ortho") ** 2).sum(axis=1)[k]
    orders = 0.5 * k * per_cycle / n
    # two running means over a cycle, and the density of samples at a uniform rate
    passed = np.sinc(orders) ** 4
    density = 2.0 * dct(left, norm="ortho")[k] ** 2 * path.frequency**-1 / per_cycle
    used = leverage < _LEVERAGE
    if used.sum() < _FEWEST:
        return None
    density = (density / passed / (1.0 - leverage))[used]
    frequency = orders[used] * path.frequency
    known = np.maximum(spectrum.at(frequency), 1e-300)
    top = TOP * path.frequency
    lowest = 0.5 * path.frequency * per_cycle / n
    scale = float(spectrum.at(np.array([lowest]))[0])
    asked, logs = [], [_log_likelihood(density, known)]
    for power in _POWERS:
        shape = frequency**-power - top**-power
        for ratio in _RATIOS:
            level = ratio * scale / (lowest**-power - top**-power)
            asked.append((level, power))
            logs.append(_log_likelihood(density, known + level * shape))
    return _averaged(np.array(logs), np.array(asked), top, _alone(len(asked)))


def _is_fast(path: Track, way: int) -> bool:
    """Return whether the motion changes fast at the beginning (``way`` 1) or the end (-1) of a track."""
    places = slice(None, None, way * path.per_cycle)
    time, amplitude = path.time[places][:3], np.maximum(path.amplitude[places][:2], 1e-300)
    periods = np.abs(np.diff(time))
    changes = np.abs(np.diff(np.log(periods))), np.abs(np.diff(np.log(amplitude)))
    return any(change.size > 0 and change[0] > most for change, most in zip(changes, _CHANGES, strict=True))


def of_one_sensor(wanders: Sequence[Wander | None]) -> list[Wander | None]:
    """Return the slow noise of records of one batch, each judged with half an eye on the others.

    Records of one batch mostly come from one sensor. With even odds each stands for itself; or all are as quiet, or
    as loud, as that sensor is: over the other noise alike up to a spread, for hands and cables differ, and a few of
    them quiet nevertheless. So many records in which slow noise does not stand out tell of it together, and many that
    hold none make one that seems to hold some less likely to.
    """
    found = [item for item in wanders if item is not None]
    if len(found) < 2:
        return list(wanders)
    sensors, odds = _sensors(len(found[0].asked))
    of_sensor = np.array([logsumexp(item.likelihood + sensors, axis=1) for item in found])
    result: list[Wander | None] = []
    for item in wanders:
        if item is None:
            result.append(None)
            continue
        others = odds + of_sensor[[other is not item for other in found]].sum(axis=0)
        beforehand = logsumexp(sensors + (others - logsumexp(others))[:, None], axis=0)
        judged = _averaged(item.likelihood, item.asked, item.top, beforehand)
        result.append(replace(judged, mid_line=item.mid_line, of_all=item.of_all))
    return result


def _sensors(count: int) -> tuple[FloatArray, FloatArray]:
    """Return what sensors there are, as logarithms of probabilities: of what a record of each holds (h, 1 + g); each's.

    The first says nothing of its records, the second is quiet, and the others hold one of the ``count`` power laws.
    """
    steps = np.arange(_RATIOS.size)
    apart = (steps[:, None] - steps) * float(np.log(_RATIOS[1] / _RATIOS[0])) / _SPREAD
    alike = -0.5 * apart**2
    alike -= logsumexp(alike, axis=1, keepdims=True)
    quiet = np.full((1, 1 + count), -np.inf)
    quiet[0, 0] = 0.0
    loud = np.full((count, 1 + count), -np.inf)
    loud[:, 0] = np.log(_QUIET)
    for power in range(len(_POWERS)):
        block = slice(power * steps.size, (power + 1) * steps.size)
        loud[block, 1:][:, block] = np.log1p(-_QUIET) + alike
    return np.vstack([_alone(count), quiet, loud]), np.log(np.r_[0.5, 0.25, np.full(count, 0.25 / count)])


def _alone(count: int) -> FloatArray:
    """Return the logarithm of the prior of none and of so many power laws: even, and even among these."""
    return np.append(np.log(0.5), np.full(count, np.log(0.5 / count)))


def _averaged(likelihood: FloatArray, asked: FloatArray, top: float, beforehand: FloatArray) -> Wander:
    """Return the mean of the power laws over their posterior."""
    posterior = likelihood + beforehand
    weight = np.exp(posterior - logsumexp(posterior))
    levels = [float(weight[1:][asked[:, 1] == power] @ asked[asked[:, 1] == power, 0]) for power in _POWERS]
    return Wander(np.array(levels), np.array(_POWERS), top, float(1.0 - weight[0]), likelihood, asked)


def _log_likelihood(density: FloatArray, expected: FloatArray) -> float:
    """Return Whittle's log-likelihood of squares of single normal numbers."""
    return -0.5 * float(np.sum(density / expected + np.log(expected)))


def _mid_line(
    values: FloatArray, sampling_rate: float, path: Track, order: int
) -> tuple[FloatArray, FloatArray, MidLine | None]:
    """Return the mid-line (n,) on a grid of uniform phase, what a structure's own is made of (n, s), and that one."""
    per_cycle = path.per_cycle
    stamps = np.arange(values.size) / sampling_rate
    step = 2.0 * np.pi / per_cycle
    end = min(float(stamps[-1]), float(path.time[-1]) + 1.0 / path.frequency)
    bounds = path.phase_at(np.array([0.0, end]))
    grid = step * np.arange(np.ceil(bounds[0] / step), np.floor(bounds[1] / step) + 1.0)
    dense = round(sampling_rate / (path.frequency * per_cycle))
    if dense > 1:  # the noise of single samples would pass for that of all
        values = uniform_filter1d(values, dense)
    samples = make_interp_spline(stamps, values, k=3)(np.clip(path.time_at(grid), 0.0, stamps[-1]))
    first = samples[:per_cycle]
    samples = path.without_fundamental(samples, grid)
    box = np.ones(per_cycle) / per_cycle
    kernel = np.convolve(box, box)
    middle = convolve_inside(samples, kernel)
    second = 2.0 * convolve_inside(samples * np.exp(-2j * grid), kernel)
    inner = grid[per_cycle - 1 : per_cycle - 1 + middle.size]
    amplitude = path.amplitude_at(path.time_at(inner)) / float(path.amplitude.max())
    ratio = float(np.log(path.amplitude[0] / path.amplitude[-1])) / (2.0 * np.pi * path.cycles)
    if order == 2 and ratio < _SLOW:  # twice the rate of decay, over the angular frequency, squared: next to nothing
        return middle, np.ones((middle.size, 1)), None
    # few cycles hold few frequencies: not all are given away to shapes
    powers = (0, 1, 2, 3) if middle.size > _MANY * per_cycle else (0, 2)
    own = np.column_stack([amplitude**power for power in powers])
    smooth = own @ np.linalg.lstsq(own, middle, rcond=None)[0]
    places = np.argsort(amplitude)[np.linspace(0, middle.size - 1, min(_PLACES, middle.size)).astype(int)]
    size = amplitude * float(path.amplitude.max())
    line = None
    if middle.size:
        side = 1.0 if np.argmax(first) < np.argmin(first) else -1.0
        line = MidLine(size[places], smooth[places], float(np.sqrt(np.mean((middle - smooth) ** 2))), side)
    return middle, np.column_stack([own, second.real]), line
