"""The mid-line that integration loses: restored from the mean velocity where possible, else a word of warning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from ..._common.checks import FloatArray
from .convolution import convolve_inside
from .tracking import Track

_EVIDENCE = 12.0
SIGNIFICANT = 5.0
_MINIMUM_POINTS = 8
_RATIOS = (1.5, 7.0)
"""Mid-line over second harmonic, sign reversed: 3 for a quadratic stiffness, 4.5 for a bilinear one, 1.5 to 4.5 for a
stop on one side, the less the later it is touched."""
GAPS = (0.12, 0.2, 0.28, 0.36, 0.44, 0.52, 0.6, 0.7, 0.8)
"""Of a stop on one side, over the first amplitude."""
_RATIO, _RATIO_ERROR = 3.3, 1.0
"""The same where the stiffness is not known: 2.3 for x^4."""
_SHAPE = 0.3
"""How far between that of one law and that of another a mid-line lies, as a standard deviation."""
_TOLERATED = 0.008
"""Second harmonic up to which damping is off by 5 % without a mid-line: it changes what falls from peak to peak."""


@dataclass(frozen=True)
class MidLine:
    """Mid-line ``linear A + square A^2`` of a displacement of amplitude A, and what stops on one side add to it.

    Attributes
    ----------
    linear, square : float
        Coefficients.
    stops : tuple of (float, float)
        Coefficient of `beyond_stop`, and displacement at which the stop is touched.
    error : float
        Standard error of the mid-line over amplitude at the first cycle.
    is_measured : bool
        Whether it was measured, and not taken from the second harmonic.
    shape_error : float
        Standard error, over amplitude at the first cycle, of what laws of force make of it below: two terms are the
        least that tell a spring of two sides from a curved one, and several springs at once are neither.
    """

    linear: float
    square: float
    error: float
    is_measured: bool = True
    shape_error: float = 0.0
    stops: tuple[tuple[float, float], ...] = ()

    def at(self, amplitude: FloatArray) -> FloatArray:
        """Return the mid-line at amplitudes of the displacement."""
        found = self.linear * amplitude + self.square * amplitude**2
        for size, gap in self.stops:
            found = found + size * beyond_stop(amplitude, gap)
        return found

    def sized(self, factor: float) -> MidLine:
        """Return the mid-line so many times as large; its errors are left out."""
        stops = tuple((factor * size, gap) for size, gap in self.stops)
        return MidLine(factor * self.linear, factor * self.square, 0.0, stops=stops)


def beyond_stop(amplitude: FloatArray, gap: float) -> FloatArray:
    """Return the mean over a cycle of ``pi max(A cos - gap, 0)``, which moves the mid-line; zero up to the gap."""
    reached = np.maximum(amplitude, gap)
    touched = np.arccos(gap / reached)  # of half a turn
    found: FloatArray = np.sqrt(np.maximum(reached**2 - gap**2, 0.0)) - gap * touched
    return found


def displacement_amplitude(path: Track, integrations: int) -> Track:
    """Return the track with the smoothed amplitude of the displacement in place of that of what was measured."""
    u = np.linspace(-1.0, 1.0, path.time.size)
    degree = int(np.clip(path.cycles / 4.0, 2, 8))
    weights = np.maximum(path.amplitude / path.amplitude.max(), 1e-3)
    rate = np.gradient(path.phase, path.time)
    values = np.log(np.maximum(path.amplitude, 1e-12 * path.amplitude.max())) - integrations * np.log(rate)
    curve = np.polynomial.chebyshev.chebfit(u, values, degree, w=weights)
    smooth = np.polynomial.chebyshev.chebval(u, curve)
    return replace(path, amplitude=np.exp(np.clip(smooth, values.min() - 1.0, values.max() + 1.0)))


def restore_mid_line(path: Track, harmonic: float) -> MidLine | None:
    """Return the mid-line that the mean of a velocity over each cycle implies, where it is significant.

    Parameters
    ----------
    path : Track
        Track of a velocity.
    harmonic : float
        Second harmonic of the displacement over its fundamental at the first cycle, from `second_harmonic`; 0 where
        it is insignificant.

    Returns
    -------
    MidLine or None
        None where it is insignificant or does not fit the second harmonic.

    Notes
    -----
    The mean of the velocity over a cycle is the rate of change of the mid-line plus the sensor's offset. An
    autonomous structure's mid-line is a function of amplitude, here ``a A`` (bilinear), ``b A^2`` (quadratic), both,
    or that of a stop on one side after a gap: the means are regressed on the rates of change of each, and what comes
    out is averaged with the evidence for each. Each coefficient must stand out five standard errors. The same force
    that shifts the mid-line makes the second harmonic, a third of the shift for a quadratic stiffness and 1 / 4.5 of it
    for a bilinear one: a mid-line far from that is drift of the sensor. (An acceleration shows the second derivative
    only, which drowns: its mid-line is not restored.)
    """
    stop = max(path.time.size - path.per_cycle, 1)
    picked = slice(None, stop, path.per_cycle)
    amplitude = displacement_amplitude(path, 1).amplitude
    mean, first = path.mean[picked], float(amplitude[0])
    if mean.size < _MINIMUM_POINTS or harmonic == 0.0:
        return None
    possible: list[tuple[float, MidLine]] = []
    least = mean.size * np.log(max(float(np.var(mean)), np.finfo(float).tiny)) - _EVIDENCE
    for parts in _shapes(first):
        rates = [np.gradient(part.at(amplitude), path.time)[picked] for part in parts]
        basis = np.column_stack([np.ones(mean.size), *rates])
        scale = np.linalg.norm(basis, axis=0)
        solution = np.linalg.lstsq(basis / scale, mean, rcond=None)[0] / scale
        residual = mean - basis @ solution
        variance = max(float(residual @ residual) / (mean.size - basis.shape[1]), np.finfo(float).tiny)
        covariance = np.linalg.pinv((basis / scale).T @ (basis / scale)) / np.outer(scale, scale) * variance
        unknowns = len(parts) + len(parts[0].stops)
        score = mean.size * np.log(variance) + unknowns * np.log(mean.size)
        strength = np.abs(solution[1:]) / np.sqrt(np.diag(covariance)[1:])
        gradient = np.array([float(part.at(amplitude[:1])[0]) / first for part in parts])
        ratio = -float(gradient @ solution[1:]) / harmonic
        if score < least and strength.min() > SIGNIFICANT and _RATIOS[0] < ratio < _RATIOS[1]:
            error = float(np.sqrt(gradient @ covariance[1:, 1:] @ gradient))
            sized = [part.sized(float(size)) for part, size in zip(parts, solution[1:], strict=True)]
            possible.append((score, replace(_sum(sized), error=error)))
    return _mean(possible, amplitude) if possible else None


def _shapes(first: float) -> list[tuple[MidLine, ...]]:
    """Return what a mid-line may be the sum of; ``first`` is the largest amplitude."""
    linear, square = MidLine(1.0, 0.0, 0.0), MidLine(0.0, 1.0, 0.0)
    stops = [(MidLine(0.0, 0.0, 0.0, stops=((1.0, gap * first),)),) for gap in GAPS]
    return [(square,), (linear,), (linear, square), *stops]


def _sum(parts: Sequence[MidLine]) -> MidLine:
    """Return the sum of mid-lines, without their errors."""
    stops = tuple(stop for part in parts for stop in part.stops)
    return MidLine(sum(part.linear for part in parts), sum(part.square for part in parts), 0.0, stops=stops)


def _mean(possible: Sequence[tuple[float, MidLine]], amplitude: FloatArray) -> MidLine:
    """Return the mean of mid-lines weighted with their evidence, given minus two times its logarithm.

    Means of few cycles often do not tell the shapes apart: what these differ by is an error of the shape.
    """
    scores = np.array([score for score, _ in possible])
    weights = np.exp(-0.5 * (scores - scores.min()))
    weights /= weights.sum()
    whole = _sum([line.sized(float(weight)) for weight, (_, line) in zip(weights, possible, strict=True)])
    apart = np.array([line.at(amplitude) - whole.at(amplitude) for _, line in possible]) / amplitude
    spread = float(np.sqrt(weights @ apart**2).max())
    error = float(np.sqrt(weights @ np.array([line.error**2 for _, line in possible])))
    usual = _SHAPE * abs(float(whole.at(amplitude[:1])[0])) / float(amplitude[0])
    return replace(whole, error=error, shape_error=float(np.hypot(usual, spread)))


def implied_shift(harmonic: float, error: float) -> tuple[float, float]:
    """Return the mid-line, over amplitude, that a second harmonic and its error imply, and its standard error.

    The force that shifts the mid-line makes the second harmonic as well, several times smaller.
    """
    return -_RATIO * harmonic, float(np.hypot(_RATIO_ERROR * harmonic, _RATIO * error))


def implied_mid_line(path: Track, integrations: int, harmonic: float, error: float, *, is_filtered: bool) -> MidLine:
    """Return the mid-line at turning points that the second harmonic and its error imply.

    From one peak to the next falls the amplitude and, with it, the mid-line: damping holds the rate of change of the
    mid-line over amplitude. Of a filtered motion (``is_filtered``) turning points lack the harmonic as well.
    """
    first = float(displacement_amplitude(path, integrations).amplitude[0])
    shift, error = implied_shift(harmonic, error)
    return MidLine(0.0, (shift + is_filtered * harmonic) / first, error, is_measured=False)


def find_mid_line(
    values: FloatArray, sampling_rate: float, path: Track, integrations: int, *, is_filtered: bool, is_mode: bool
) -> tuple[MidLine | None, str]:
    """Return the mid-line that integration or a filter took, where it is known, and a sentence on it.

    Parameters
    ----------
    values : (n,) array
        What was measured, unfiltered.
    sampling_rate : float
        Samples per second.
    path : Track
        Its track.
    integrations : int
        From it to a displacement.
    is_filtered : bool
        Whether a band was passed.
    is_mode : bool
        Whether another mode stands at twice the frequency, so that the second harmonic says nothing.

    Returns
    -------
    MidLine or None, str
        Restored from the mean velocity; else as the second harmonic implies it; None where that is next to nothing.
    """
    share, error = (0.0, 1.0) if is_mode else second_harmonic(values, sampling_rate, path, integrations)
    share = share if abs(share) > SIGNIFICANT * error else 0.0
    found = restore_mid_line(path, share) if integrations == 1 and not is_filtered else None
    if found is not None:
        amplitude = displacement_amplitude(path, integrations).amplitude[:1]
        offset = float(found.at(amplitude)[0] / amplitude[0])
        return found, (
            f"the mid-line, {offset:+.3f} +- {found.error:.3f} of the first amplitude, was restored from the mean "
            "velocity of each cycle"
        )
    if abs(share) < _TOLERATED:
        return None, "the mid-line was removed by filtering: the offset of this specimen is not measured"
    found = implied_mid_line(path, integrations, share, error, is_filtered=is_filtered)
    return found, (
        f"warning: a second harmonic of {abs(share):.1%} shows an asymmetric structure, but filtering removed its "
        "mid-line: offset is not measured, and damping, with a mid-line as that harmonic implies it, is known to "
        f"{2.0 * found.error:.0%} only at the first cycle; measure displacement, unfiltered"
    )


def second_harmonic(values: FloatArray, sampling_rate: float, path: Track, integrations: int) -> tuple[float, float]:
    """Return the second harmonic of the displacement over its fundamental at the first cycle, and its standard error.

    Positive where it adds to the positive peaks. Only what keeps its phase to the fundamental and grows with the
    square of amplitude counts.
    """
    per_cycle = path.per_cycle
    step = 2.0 * np.pi / per_cycle
    first, last = np.ceil(path.phase[0] / step), np.floor(path.phase[-1] / step)
    grid = step * np.arange(first, last + 1.0)
    if grid.size < 4 * per_cycle:
        return 0.0, 1.0
    stamps = np.arange(values.size) / sampling_rate
    samples = make_interp_spline(stamps, values, k=5)(np.clip(path.time_at(grid), 0.0, stamps[-1]))
    box = np.ones(per_cycle) / per_cycle
    samples = path.without_fundamental(samples, grid)
    z = 2.0 * convolve_inside(samples * np.exp(-2j * grid), np.convolve(box, box))
    amplitude = np.interp(grid[per_cycle - 1 : per_cycle - 1 + z.size], path.phase, path.amplitude)
    z, amplitude = z[::per_cycle], amplitude[::per_cycle]
    if z.size < 3:
        return 0.0, 1.0
    # a velocity's phase is a quarter of a turn ahead: x = A cos(phi) has v ~ -sin(phi) = cos(phi + 90 degrees)
    turned = z / (2j) ** integrations * 1j ** (2 * integrations)
    weight = amplitude**2
    coefficient = complex(turned @ weight) / float(weight @ weight)
    residual = np.abs(turned - coefficient * weight) ** 2
    error = np.sqrt(float(residual @ weight**2) / (z.size - 1.0) * z.size) / float(weight @ weight)
    return coefficient.real * float(path.amplitude[0]), float(error) * float(path.amplitude[0])
