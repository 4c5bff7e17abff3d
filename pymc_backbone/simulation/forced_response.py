"""Steady forced response of the softening oscillator m x'' + c x' + k x - k_n x^3 = F cos(w t), with all its branches.

The first harmonic A cos(w t - phase) balances where, with s = A^2 and g = 3 k_n / 4,

    ((k - m w^2 - g s)^2 + (c w)^2) s = F(w)^2,

a cubic in s: one steady motion, or three, of which the middle one is unstable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import root

from .._common.checks import FloatArray, InputError, check_finite_array, check_positive

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class ForcedOscillator:
    """Oscillator with a cubic spring under a harmonic force.

    Attributes
    ----------
    mass : float
        m [kg].
    damping : float
        c [N s/m]; positive.
    stiffness : float
        k [N/m], k_m - k_o for the beam.
    softening : float
        k_n [N/m^3]; the spring's force is k x - k_n x^3. Negative hardens.
    force : float, default 0
        Amplitude of the force, the same at all frequencies [N].
    base_moment : float, default 0
        Base participation times amplitude of the base's displacement [kg m]: the amplitude of the force is this times
        w^2. One of the two is given.

    Raises
    ------
    InputError
        If a number is out of its range, or not exactly one of the two excitations is positive.

    See Also
    --------
    frequency_response : its steady motions.
    Oscillator : a mass whose free decay is simulated.
    """

    mass: float
    damping: float
    stiffness: float
    softening: float
    force: float = 0.0
    base_moment: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mass", "damping", "stiffness"):
            check_positive(name, getattr(self, name))
        if not np.isfinite(self.softening):
            raise InputError(f"`softening` must be finite, got {self.softening}.")
        if (self.force == 0.0) == (self.base_moment == 0.0):
            raise InputError(
                f"exactly one of `force` and `base_moment` must be given, got {self.force:g} and {self.base_moment:g}."
            )
        check_positive("force or base_moment", self.force + self.base_moment)

    @property
    def natural_frequency(self) -> float:
        """Undamped, at vanishing amplitude [Hz]."""
        return float(np.sqrt(self.stiffness / self.mass) / (2.0 * np.pi))

    @property
    def escape_amplitude(self) -> float:
        """Displacement without restoring force, sqrt(k / k_n) [m]; infinite where the spring does not soften."""
        return float(np.sqrt(self.stiffness / self.softening)) if self.softening > 0.0 else np.inf

    def force_amplitude(self, frequency: ArrayLike) -> FloatArray:
        """Return the amplitude of the force [N] at frequencies [Hz]."""
        omega = 2.0 * np.pi * np.asarray(frequency, dtype=float)
        return np.asarray(self.force + self.base_moment * omega**2)

    def backbone(self, amplitude: ArrayLike) -> FloatArray:
        """Return the undamped frequency [Hz] of the first harmonic at amplitudes [m]; NaN where there is no motion."""
        a = np.asarray(amplitude, dtype=float)
        square = (self.stiffness - 0.75 * self.softening * a**2) / self.mass
        return np.asarray(np.sqrt(np.where(square > 0.0, square, np.nan)) / (2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Every steady motion at each frequency; ``plt.plot(frequency, amplitude)`` draws all branches.

    Attributes
    ----------
    frequency : ndarray, shape (n,)
        Forcing frequencies [Hz].
    amplitude : ndarray, shape (n, 3)
        Amplitudes of the first harmonic [m] in the columns lower, middle and upper branch; NaN where a branch is not.
        The upper branch is the one at resonance: with softening it goes on to the right of the bend, the lower one to
        the left. A response without folds is in the first column.
    phase : ndarray, shape (n, 3)
        By which the motion lags behind the force [rad], 0 to pi.
    stable : ndarray of bool, shape (n, 3)
        Whether small disturbances die out.
    fold_frequencies : ndarray, shape (f,)
        All frequencies [Hz] at which two motions merge: where the amplitude jumps in a sweep.
    fold_amplitudes : ndarray, shape (f,)
        Amplitudes [m] there.

    See Also
    --------
    frequency_response : returns it.
    PeriodicMotion : with higher harmonics.
    """

    frequency: FloatArray
    amplitude: FloatArray
    phase: FloatArray
    stable: NDArray[np.bool_]
    fold_frequencies: FloatArray
    fold_amplitudes: FloatArray


def frequency_response(oscillator: ForcedOscillator, frequency: ArrayLike) -> FrequencyResponse:
    """Return all steady motions of a forced oscillator at given frequencies, with their stability.

    Parameters
    ----------
    oscillator : ForcedOscillator
        The oscillator and its excitation.
    frequency : array-like, shape (n,)
        Forcing frequencies [Hz]; positive.

    Returns
    -------
    FrequencyResponse
        Amplitude, phase and stability of each branch, and the folds.

    Raises
    ------
    InputError
        If a frequency is not positive.

    See Also
    --------
    periodic_motion : with higher harmonics.
    fit_frequency_response : fitted to a measured one.

    Notes
    -----
    The roots of the cubic are eigenvalues of its companion matrix, polished by Newton. A motion is stable where
    (k - m w^2 - g s)(k - m w^2 - 3 g s) + (c w)^2 > 0: averaging's condition, exact to the order of the first harmonic.
    For a softening spring the cubic has roots beyond the escape amplitude sqrt(k / k_n) too, where the spring pushes
    outwards: no motion goes there and comes back, so they are left out. Folds are the real roots of the cubic's
    discriminant, a polynomial in w^2.

    References
    ----------
    Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations, section 4.1. Wiley. doi:10.1002/9783527617586

    Examples
    --------
    >>> from pymc_backbone.simulation.forced_response import ForcedOscillator, frequency_response
    >>> beam = ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, force=1.2e-4)
    >>> response = frequency_response(beam, [6.95, 7.2])
    >>> (1e6 * response.amplitude).round(2).tolist()
    [[14.02, 32.77, 38.01], [nan, nan, 30.26]]
    >>> response.fold_frequencies.round(3).tolist()
    [6.883, 7.022]
    """
    f = check_finite_array("frequency", frequency)
    if f.min() <= 0.0:
        raise InputError(f"`frequency` must be positive, got {f.min():g} Hz.")
    roots = branch_roots(oscillator, f)
    folds, heights = _folds(oscillator)
    motion = (roots.imag == 0.0) & (roots.real < oscillator.escape_amplitude**2)
    square = np.where(motion, roots.real, np.nan)
    if not folds.size:
        # One curve: not to be torn where it passes from the side of one branch to that of the other.
        square = np.sort(square, axis=1)
    stiff, g = _dynamic_stiffness(oscillator, f)[:, None], 0.75 * oscillator.softening
    loss = (2.0 * np.pi * f * oscillator.damping)[:, None]
    phase = np.arctan2(np.broadcast_to(loss, square.shape), stiff - g * square)
    stable = (stiff - g * square) * (stiff - 3.0 * g * square) + loss**2 > 0.0
    return FrequencyResponse(f, np.sqrt(square), phase, stable, folds, heights)


def branch_roots(oscillator: ForcedOscillator, frequency: FloatArray) -> ComplexArray:
    """Return the roots s = A^2 [m^2] of the cubic at each frequency [Hz], shape (n, 3): lower, middle, upper branch.

    Where only one root is real, the other two are there as a complex pair (infinite for a linear spring): it is the
    continuation of two motions beyond the fold at which they merged, and takes their columns.
    """
    stiff, g = _dynamic_stiffness(oscillator, frequency), 0.75 * oscillator.softening
    loss = 2.0 * np.pi * frequency * oscillator.damping
    force = oscillator.force_amplitude(frequency) ** 2
    # In t = 1 / (s / scale) the leading coefficient is never zero, not even without a cubic term.
    scale = np.median(force / (stiff**2 + loss**2))
    lead = force / scale
    companion = np.zeros((len(frequency), 3, 3))
    companion[:, 0, 0] = (stiff**2 + loss**2) / lead
    companion[:, 0, 1] = -2.0 * g * scale * stiff / lead
    companion[:, 0, 2] = (g * scale) ** 2 / lead
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    t = np.linalg.eigvals(companion).astype(complex)
    s = np.full(t.shape, np.inf, dtype=complex)
    np.divide(scale, t, out=s, where=t != 0.0)
    s = _settle_pairs(s, stiff, loss, force, g)
    for _ in range(2):
        # Near a fold Newton's step is a small number over a small one: only steps that shrink the residual are taken.
        value, slope = _cubic(s, stiff, loss, force, g)
        trial = s - np.divide(value, slope, out=np.zeros_like(s), where=np.isfinite(s) & (slope != 0.0))
        s = np.where(np.abs(_cubic(trial, stiff, loss, force, g)[0]) < np.abs(value), trial, s)
    order = np.argsort(s.real, axis=1, kind="stable")
    s = np.take_along_axis(s, order, axis=1)
    # A lone real root stands at either end of the sorted real parts, save where it ties with its pair's.
    alone = (s.imag[:, 1] == 0.0) & (s.imag[:, 0] != 0.0)
    s[alone] = s[alone][:, [1, 0, 2]]
    return s


def _settle_pairs(s: ComplexArray, stiff: FloatArray, loss: FloatArray, force: FloatArray, g: float) -> ComplexArray:
    """Decide where two roots are nearly equal whether they are real: rounding makes eigenvalues take either side.

    The cubic's values at its extremes tell; there the pair follows from the parabola through the extreme.
    """
    if g == 0.0:
        return s
    inner = 4.0 * stiff**2 - 3.0 * (stiff**2 + loss**2)
    spread = np.sqrt(np.maximum(inner, 0.0))
    extremes = np.stack([2.0 * stiff - spread, 2.0 * stiff + spread], axis=1) / (3.0 * g)
    values = _cubic(extremes.astype(complex), stiff, loss, force, g)[0].real
    three = (inner > 0.0) & (values[:, 0] * values[:, 1] < 0.0)
    for i in np.flatnonzero(three != (np.count_nonzero(s.imag == 0.0, axis=1) == 3)):
        j = int(np.argmin(np.abs(values[i])))
        centre, curvature = extremes[i, j], 6.0 * g * g * extremes[i, j] - 4.0 * stiff[i] * g
        half = np.sqrt(complex(-2.0 * values[i, j] / curvature))
        far = int(np.argmax(np.abs(s[i] - centre)))
        s[i] = [s[i, far].real, centre - half, centre + half]
    return s


def _cubic(
    s: ComplexArray, stiff: FloatArray, loss: FloatArray, force: FloatArray, g: float
) -> tuple[ComplexArray, ComplexArray]:
    """Value and slope of the first harmonic's cubic; not finite where the root is not."""
    finite: ComplexArray = np.where(np.isfinite(s), s, 0.0).astype(complex)
    rest = stiff[:, None] - g * finite
    value = (rest**2 + loss[:, None] ** 2) * finite - force[:, None]
    slope = rest * (rest - 2.0 * g * finite) + loss[:, None] ** 2
    return np.where(np.isfinite(s), value, np.inf).astype(complex), slope


def _dynamic_stiffness(oscillator: ForcedOscillator, frequency: FloatArray) -> FloatArray:
    return oscillator.stiffness - oscillator.mass * (2.0 * np.pi * frequency) ** 2


def _folds(oscillator: ForcedOscillator) -> tuple[FloatArray, FloatArray]:
    """Frequencies [Hz] and amplitudes [m] of the folds, by frequency, below the escape amplitude."""
    o, g = oscillator, 0.75 * oscillator.softening
    if g == 0.0:
        return np.empty(0), np.empty(0)
    # Everything over k, and w^2 as 1 - y: the folds of a lightly damped oscillator crowd around y = 0.
    y = Polynomial([0.0, 1.0])
    loss = (o.damping**2 / (o.mass * o.stiffness)) * (1.0 - y)
    scale = o.stiffness / abs(g)
    force = (o.force / o.stiffness) ** 2 / scale + (o.base_moment / o.mass) ** 2 / scale * (1.0 - y) ** 2
    sign = np.sign(g)
    square = y**2 + loss
    # Discriminant of s^3 - 2 sign y s^2 + (y^2 + loss) s - force.
    discriminant = (
        -4.0 * square**2 * loss
        + 36.0 * sign * y * square * force
        - 32.0 * sign * y**3 * force
        - 27.0 * force**2
    )  # fmt: skip
    candidates = discriminant.roots()
    real = candidates.real[np.abs(candidates.imag) <= 1e-7 * np.abs(candidates)]
    pairs = []
    for start in real[real < 1.0]:
        value = float(start)
        # The double root of the cubic at a fold, from the two equations cubic = 0 and slope = 0.
        for sigma in np.roots([3.0, -4.0 * sign * value, square(value)]):
            point = _polish_fold(value, float(sigma.real), sign, loss, force)
            if point is not None:
                pairs.append(point)
    found: list[tuple[float, float]] = []
    for value, sigma in sorted(pairs, reverse=True):
        frequency = o.natural_frequency * np.sqrt(1.0 - value)
        height = np.sqrt(sigma * scale)
        if height < o.escape_amplitude and not any(abs(frequency - f) <= 1e-9 * frequency for f, _ in found):
            found.append((frequency, height))
    frequencies, heights = zip(*found, strict=True) if found else ((), ())
    return np.array(frequencies), np.array(heights)


def _polish_fold(
    y: float, sigma: float, sign: float, loss: Polynomial, force: Polynomial
) -> tuple[float, float] | None:
    """Solve cubic = slope = 0 from a start, or return None where the start was no fold."""
    start, unit, slope_unit = np.array([y, sigma]), float(force(y)), float(loss(y))
    if min(unit, slope_unit) <= 0.0:
        return None

    def equations(point: FloatArray) -> FloatArray:
        v, s = point
        rest = v - sign * s
        # Divided so that both equations are of the order of one.
        return np.array(
            [
                ((rest**2 + loss(v)) * s - force(v)) / unit,
                (rest * (rest - 2.0 * sign * s) + loss(v)) / slope_unit,
            ]
        )

    solution = root(equations, start, tol=1e-13)
    y, sigma = (float(value) for value in solution.x)
    close = np.max(np.abs(solution.fun)) < 1e-7 and np.all(np.abs(solution.x - start) < 0.02 * np.abs(start).max())
    return (y, sigma) if close and sigma > 0.0 and y < 1.0 else None


__all__ = ["ForcedOscillator", "FrequencyResponse", "branch_roots", "frequency_response"]
