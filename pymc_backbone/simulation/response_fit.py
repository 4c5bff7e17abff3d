"""Stiffness and softening from a measured frequency response, by least squares that knows of the fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import chi2

from .._common.checks import FloatArray, InputError, check_choice, check_finite_array
from .forced_response import ComplexArray, ForcedOscillator, branch_roots

FREE = ("stiffness", "softening", "damping", "force")
_BRANCHES = ("nearest", "lower", "upper")
# Natural frequencies over the measured range, and k_n A^2 / k at the largest amplitude: 1 is where the force vanishes.
_GRID_RANGE, _GRID_SIZE = (0.95, 1.1), 16
_GRID_BEND = (-0.5, -0.1, 0.0, 0.05, 0.15, 0.35, 0.7)
_NEAR_FOLD = 8.0  # standard errors from a motion to the unstable one, below which no straight line describes it
_COARSE = 0.05  # of the largest amplitude: what the first fits take for the error, so that they see beyond a fold
_CLOSE: dict[str, Any] = {"xtol": 1e-10, "ftol": 1e-10, "gtol": 1e-10, "max_nfev": 80}


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A fitted frequency response.

    Attributes
    ----------
    oscillator : ForcedOscillator
        With the fitted values.
    values, standard_errors : dict of str to float
        Of the fitted quantities, in SI units; ``force`` stands for the oscillator's ``base_moment`` if that is given.
    covariance : ndarray, shape (p, p)
        Of the values, in the order of ``values``.
    residuals : ndarray, shape (n,)
        Measured minus fitted amplitude, in standard errors; past a fold, the distance to where the branches met.
    branches : ndarray of str, shape (n,)
        ``lower`` or ``upper``: the branch that each point was compared with.
    past_fold : int
        How many points were compared with a branch that ends before their frequency.
    chi_square : float
        Sum of the squared residuals.
    degrees_of_freedom : int
        Points minus fitted quantities.
    p_value : float
        Probability of a larger chi-square if the model is right; NaN where no standard error was given.

    See Also
    --------
    fit_frequency_response : returns it.
    """

    oscillator: ForcedOscillator
    values: dict[str, float]
    standard_errors: dict[str, float]
    covariance: FloatArray
    residuals: FloatArray
    branches: NDArray[np.str_]
    past_fold: int
    chi_square: float
    degrees_of_freedom: int
    p_value: float


@dataclass(frozen=True, eq=False)
class _Problem:
    oscillator: ForcedOscillator
    frequency: FloatArray
    amplitude: FloatArray
    error: FloatArray
    branch: NDArray[np.str_]
    free: tuple[str, ...]

    @property
    def force_name(self) -> str:
        return "force" if self.oscillator.force else "base_moment"

    def at(self, z: FloatArray) -> ForcedOscillator:
        """Return the oscillator at scaled quantities: k / k0, k_n A^2 / k, log c / c0, log F / F0."""
        point = dict(zip(self.free, z.tolist(), strict=True))
        o, top = self.oscillator, float(self.amplitude.max())
        k = o.stiffness * point.get("stiffness", 1.0)
        return replace(
            o,
            stiffness=k,
            softening=point["softening"] * k / top**2 if "softening" in point else o.softening,
            damping=o.damping * np.exp(point.get("damping", 0.0)),
            **{self.force_name: getattr(o, self.force_name) * np.exp(point.get("force", 0.0))},
        )

    def value(self, oscillator: ForcedOscillator, name: str) -> float:
        return float(getattr(oscillator, self.force_name if name == "force" else name))

    def compare(self, z: FloatArray) -> tuple[ComplexArray, NDArray[np.str_], FloatArray]:
        """Complex amplitude, real unless past a fold, of the branch that each point is compared with.

        Also that branch's name, and how far away the unstable motion is.
        """
        roots = branch_roots(self.at(z), self.frequency)
        outer = np.sqrt(roots[:, [0, 2]])
        distance = np.abs(self.amplitude[:, None] - outer)
        distance[~np.isfinite(outer)] = np.inf
        column = np.argmin(distance, axis=1)
        column = np.where(self.branch == "lower", 0, np.where(self.branch == "upper", 1, column))
        chosen = np.take_along_axis(outer, column[:, None], axis=1)[:, 0]
        # A linear spring has one branch only, whatever the point was said to be on.
        chosen = np.where(np.isfinite(chosen), chosen, outer[:, 0])
        middle = np.sqrt(roots[:, 1])
        gap = np.abs(np.where(np.isfinite(middle), middle, np.inf) - chosen)
        return chosen, np.where(column == 0, "lower", "upper"), gap

    def residuals(self, z: FloatArray, error: FloatArray) -> FloatArray:
        """Misfits, then how far past the fold: both go continuously through a fold, so that a step may cross it."""
        chosen = self.compare(z)[0]
        return np.concatenate([(self.amplitude - chosen.real) / error, np.abs(chosen.imag) / error])


def fit_frequency_response(
    start: ForcedOscillator,
    frequency: ArrayLike,
    amplitude: ArrayLike,
    *,
    standard_error: ArrayLike | None = None,
    branch: str | Sequence[str] = "nearest",
    free: Sequence[str] = ("stiffness", "softening"),
) -> ResponseFit:
    """Fit the softening oscillator to a measured frequency response.

    Parameters
    ----------
    start : ForcedOscillator
        Mass, and the values of what is not fitted. ``stiffness`` and ``softening`` are searched for on a grid as well;
        a fitted ``damping`` or ``force`` should be right within a factor of two.
    frequency : array-like, shape (n,)
        Forcing frequencies [Hz]; in any order, repeats allowed (one from each branch, say).
    amplitude : array-like, shape (n,)
        Measured amplitudes of the first harmonic [m].
    standard_error : float or array-like, shape (n,), optional
        Of the amplitudes [m]. Without it, equal errors are assumed and estimated from the residuals; then chi-square
        cannot tell whether the model is right.
    branch : str or sequence of str, default "nearest"
        Of each point: ``lower``, ``upper`` or ``nearest``, the branch whose amplitude is nearest at the trial values.
        With softening, a sweep downwards stays on the upper branch until it jumps, one upwards on the lower.
    free : sequence of str, default ("stiffness", "softening")
        What is fitted, of these two, ``damping`` and ``force``.

    Returns
    -------
    ResponseFit
        Values, standard errors, residuals and chi-square.

    Raises
    ------
    InputError
        If the data do not match in size, are not positive, are fewer than needed, or do not determine what is fitted.

    See Also
    --------
    frequency_response : the model that is fitted.
    ForcedOscillator : where the fit begins.

    Notes
    -----
    Never compared with the unstable branch. Where a trial value has a fold before the frequency of a point, the branch
    goes on as a pair of complex roots; their imaginary part counts as misfit. So the sum of squares stays continuous as
    folds move over points, and the fit finds its way without knowing on which side of the jump a point was. Coarse,
    robust fits from the best points of a grid come first, then least squares. Standard errors are those of the
    linearised fit; points within eight of their errors of the unstable motion take no part in them, because the
    amplitude runs vertically into a fold. Amplitudes above the escape amplitude sqrt(k / k_n) are no motions: k_n is
    bounded by that. The model is the first harmonic's; the third is about k_n A^2 / (32 m w^2) of it.

    Examples
    --------
    >>> import numpy as np
    >>> from pymc_backbone.simulation.forced_response import ForcedOscillator, frequency_response
    >>> from pymc_backbone.simulation.response_fit import fit_frequency_response
    >>> truth = ForcedOscillator(0.03842, 0.07098, 82.59, 9.16e9, force=1.2e-4)
    >>> frequency = np.linspace(6.2, 8.0, 30)
    >>> measured = np.nanmax(frequency_response(truth, frequency).amplitude, axis=1)
    >>> start = ForcedOscillator(0.03842, 0.07098, 100.0, 0.0, force=1.2e-4)
    >>> fit = fit_frequency_response(start, frequency, measured, standard_error=1e-7)
    >>> {name: float(f"{value:.4g}") for name, value in fit.values.items()}
    {'stiffness': 82.59, 'softening': 9160000000.0}
    """
    problem = _check(start, frequency, amplitude, standard_error, branch, free)
    best = _search(problem)
    n, p = len(problem.frequency), len(problem.free)
    fitted, error = problem.at(best.x), problem.error
    chosen, branches, gap = problem.compare(best.x)
    residuals = (
        np.where(chosen.imag == 0.0, problem.amplitude - chosen.real, np.abs(problem.amplitude - chosen)) / error
    )
    chi_square = float(residuals @ residuals)
    scale = 1.0 if standard_error is not None else chi_square / (n - p)
    slopes = best.jac[:n][gap > _NEAR_FOLD * error]
    curvature = slopes.T @ slopes
    size = np.sqrt(np.diag(curvature))
    if not np.all(size > 0.0) or np.linalg.cond(curvature / np.outer(size, size)) > 1e12:
        raise InputError(
            f"the response does not determine {', '.join(problem.free)} together; fix one of them in `start`, or "
            "measure closer to the peak."
        )
    jacobian = _jacobian(problem, best.x)
    covariance = scale * jacobian @ np.linalg.inv(curvature) @ jacobian.T
    return ResponseFit(
        oscillator=fitted,
        values={name: problem.value(fitted, name) for name in problem.free},
        standard_errors=dict(zip(problem.free, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        residuals=residuals / np.sqrt(scale),
        branches=branches,
        past_fold=int(np.count_nonzero(chosen.imag)),
        chi_square=chi_square / scale,
        degrees_of_freedom=n - p,
        p_value=float(chi2.sf(chi_square, n - p)) if standard_error is not None else float("nan"),
    )


def _check(
    start: ForcedOscillator,
    frequency: ArrayLike,
    amplitude: ArrayLike,
    standard_error: ArrayLike | None,
    branch: str | Sequence[str],
    free: Sequence[str],
) -> _Problem:
    """Check all arguments and return the problem."""
    chosen = [free] if isinstance(free, str) else list(free)
    for name in chosen:
        check_choice("free", name, FREE)
    names = tuple(name for name in FREE if name in chosen)
    f = check_finite_array("frequency", frequency)
    a = check_finite_array("amplitude", amplitude)
    if len(a) != len(f):
        raise InputError(f"`amplitude` must have a value for each of {len(f)} frequencies, got {len(a)}.")
    if len(f) <= len(names) or not names:
        raise InputError(
            f"`free` must name at least one quantity and fewer than there are points, got {len(names)} for {len(f)}."
        )
    for label, values in (("frequency", f), ("amplitude", a)):
        if values.min() <= 0.0:
            index = int(np.argmin(values))
            raise InputError(f"`{label}` must be positive, got {label}[{index}] = {values[index]:g}. Drop that point.")
    given = 1e-2 * a.max() if standard_error is None else standard_error
    error = check_finite_array("standard_error", np.atleast_1d(np.asarray(given)))
    if error.size not in (1, len(f)) or error.min() <= 0.0:
        raise InputError("`standard_error` must be one positive number or one for each point, in metres.")
    labels = [branch] * len(f) if isinstance(branch, str) else list(branch)
    if len(labels) != len(f):
        raise InputError(f"`branch` must be one name or one for each of {len(f)} points, got {len(labels)}.")
    for label in set(labels):
        check_choice("branch", label, _BRANCHES)
    return _Problem(start, f, a, np.broadcast_to(error, f.shape), np.array(labels), names)


def _search(problem: _Problem) -> OptimizeResult[Any]:
    """Grid, coarse robust fits, least squares; return the best, in scaled quantities."""
    o, names = problem.oscillator, problem.free
    wide = np.full(len(problem.frequency), _COARSE * problem.amplitude.max())
    low, high = problem.frequency.min() * _GRID_RANGE[0], problem.frequency.max() * _GRID_RANGE[1]
    stiffness = o.mass * (2.0 * np.pi * np.linspace(low, high, _GRID_SIZE)) ** 2 / o.stiffness
    axes = {"stiffness": [*stiffness, 1.0], "softening": _GRID_BEND, "damping": (0.0,), "force": (0.0,)}
    grid = np.stack(np.meshgrid(*(axes[name] for name in names), indexing="ij"), axis=-1).reshape(-1, len(names))
    costs = np.array([np.sum(np.log1p(problem.residuals(z, wide) ** 2)) for z in grid])
    limits = {"stiffness": (1e-12, np.inf), "softening": (-50.0, 0.999), "damping": (-5.0, 5.0), "force": (-5.0, 5.0)}
    bounds = ([limits[name][0] for name in names], [limits[name][1] for name in names])

    def coarse(z: Any) -> Any:
        return problem.residuals(z, wide)

    def fine(z: Any) -> Any:
        return problem.residuals(z, problem.error)

    fits = []
    for z in grid[np.argsort(costs, kind="stable")[:3]]:
        near: Any = least_squares(coarse, z, bounds=bounds, loss="soft_l1", x_scale="jac", max_nfev=40).x
        fits.append(least_squares(fine, near, jac="3-point", bounds=bounds, x_scale="jac", **_CLOSE))
    return min(fits, key=lambda fit: float(fit.cost))


def _jacobian(problem: _Problem, z: FloatArray) -> FloatArray:
    """Return the derivatives of the quantities to the scaled ones."""
    fitted, top = problem.at(z), float(problem.amplitude.max())
    jacobian = np.diag([problem.value(fitted, name) for name in problem.free])
    names = problem.free
    if "stiffness" in names:
        jacobian[names.index("stiffness"), names.index("stiffness")] = problem.oscillator.stiffness
    if "softening" in names:
        row = names.index("softening")
        jacobian[row, row] = fitted.stiffness / top**2
        if "stiffness" in names:
            bend = z[row] / top**2
            jacobian[row, names.index("stiffness")] = bend * problem.oscillator.stiffness
    return jacobian


__all__ = ["FREE", "ResponseFit", "fit_frequency_response"]
