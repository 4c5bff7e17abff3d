"""Steady forced motion with its higher harmonics: what the first harmonic alone leaves out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import root

from .._common.checks import FloatArray, InputError, check_positive
from .forced_response import ForcedOscillator


@dataclass(frozen=True, eq=False)
class PeriodicMotion:
    """A steady motion with its odd harmonics.

    Attributes
    ----------
    frequency : float
        Forcing frequency [Hz].
    cosine, sine : ndarray, shape (h,)
        Of the harmonics 1, 3, 5, ... [m], with the force F cos(w t).

    See Also
    --------
    periodic_motion : returns it.
    FrequencyResponse : the first harmonic, with all branches.
    """

    frequency: float
    cosine: FloatArray
    sine: FloatArray

    @property
    def harmonic_amplitudes(self) -> FloatArray:
        """Amplitudes of the harmonics 1, 3, 5, ... [m]."""
        return np.hypot(self.cosine, self.sine)

    @property
    def phase(self) -> float:
        """By which the first harmonic lags behind the force [rad]."""
        return float(np.arctan2(self.sine[0], self.cosine[0]))

    def displacement(self, time: ArrayLike) -> FloatArray:
        """Return the displacement [m] at times [s]."""
        order = 2 * np.arange(len(self.cosine)) + 1
        angle = 2.0 * np.pi * self.frequency * np.asarray(time, dtype=float)[..., None] * order
        return np.asarray(np.cos(angle) @ self.cosine + np.sin(angle) @ self.sine)


def periodic_motion(
    oscillator: ForcedOscillator, frequency: float, amplitude: float, *, harmonics: int = 5
) -> PeriodicMotion:
    """Return the steady motion near an amplitude of the first harmonic, with higher harmonics balanced too.

    Parameters
    ----------
    oscillator : ForcedOscillator
        The oscillator and its excitation.
    frequency : float
        Forcing frequency [Hz].
    amplitude : float
        One of `frequency_response` at this frequency [m]: it chooses the branch.
    harmonics : int, default 5
        How many odd harmonics.

    Returns
    -------
    PeriodicMotion
        The motion.

    Raises
    ------
    InputError
        If no steady motion is found near the start, as beyond a fold or the escape amplitude.

    See Also
    --------
    frequency_response : the first harmonic, with all branches.

    Notes
    -----
    Harmonic balance with the spring's force evaluated over time at 8 samples per harmonic, enough for the cube to be
    free of aliasing; the error falls geometrically with the number of harmonics.

    Examples
    --------
    >>> from pymc_backbone.simulation.forced_response import ForcedOscillator
    >>> from pymc_backbone.simulation.harmonic_balance import periodic_motion
    >>> beam = ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, force=1.2e-4)
    >>> (1e6 * periodic_motion(beam, 6.95, 38.01e-6).harmonic_amplitudes[:2]).round(2).tolist()
    [38.06, 0.21]
    """
    o, f, start = oscillator, check_positive("frequency", frequency), check_positive("amplitude", amplitude)
    order = 2 * np.arange(int(harmonics)) + 1
    omega = 2.0 * np.pi * f
    force = float(o.force_amplitude(f))
    samples = 8 * int(order[-1])
    angle = 2.0 * np.pi * np.arange(samples) / samples
    cosines, sines = np.cos(np.outer(angle, order)), np.sin(np.outer(angle, order))
    dynamic = o.stiffness - o.mass * (order * omega) ** 2
    # In units of the start, equations over the first harmonic's share of the spring's force.
    unit = o.stiffness * start

    def residual(z: FloatArray) -> FloatArray:
        a, b = start * z[: len(order)], start * z[len(order) :]
        cube = -o.softening * (cosines @ a + sines @ b) ** 3
        loss = o.damping * order * omega
        in_phase = dynamic * a + loss * b + 2.0 / samples * (cosines.T @ cube)
        quadrature = dynamic * b - loss * a + 2.0 / samples * (sines.T @ cube)
        in_phase[0] -= force
        return np.concatenate([in_phase, quadrature]) / unit

    lag = np.arctan2(o.damping * omega, dynamic[0] - 0.75 * o.softening * start**2)
    guess = np.zeros(2 * len(order))
    guess[0], guess[len(order)] = np.cos(lag), np.sin(lag)
    solution = root(residual, guess, tol=1e-12)
    cosine, sine = start * solution.x[: len(order)], start * solution.x[len(order) :]
    first = float(np.hypot(cosine[0], sine[0]))
    if np.max(np.abs(solution.fun)) > 1e-9 or abs(first - start) > 0.2 * start:
        raise InputError(
            f"no steady motion was found near `amplitude` = {start:g} m at {f:g} Hz; take an amplitude of "
            "`frequency_response` that is away from a fold and well below the escape amplitude."
        )
    return PeriodicMotion(f, cosine, sine)


__all__ = ["PeriodicMotion", "periodic_motion"]
