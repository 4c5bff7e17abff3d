"""Penalised splines whose smoothness is averaged over, not chosen: a curve with an honest covariance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cholesky_banded, eigh, solve_banded

from .._common.checks import FloatArray

KNOTS = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, 42), np.ones(3)])
"""Cubic knots; more change no level value of the library's effects by a tenth of its standard error."""
_SIZE = KNOTS.size - 4  # spline functions

SMOOTHNESS_GRID = np.logspace(-1.0, 9.0, 31)
"""Prior variance of the curve's bending over the noise variance, in the direction the record determines best."""


_CERTAIN = 1e12
"""Weight, in observations, of a belief that no scatter shakes."""
KINKS: tuple[float, ...] = tuple(np.linspace(0.0, 1.0, 9))
"""Places (in the range of the abscissa) where the curve may bend much more than elsewhere."""
KINK_WIDTH, KINK_EASE = 0.07, 1e4
UNDERSMOOTHING = 4.0
"""Freedom to bend beyond what the likelihood asks for: a fifth more standard error, a third less bias at corners."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A smoothed curve of m points, as r spline coefficients that hold for all of them.

    Attributes
    ----------
    design : (m, r) array
        Value of each spline function at each point; those of all abscissas side by side.
    coefficients : (r,) array
        The curve's.
    spread : (r, r) array
        Their covariance: noise, and doubt about how smooth the curve is.
    noise_spread : (r, r) array
        What noise alone would make of them, the smoothness as it was weighted.
    scatter : float
        Mean squared normalised residual (at least 1).
    """

    design: FloatArray
    coefficients: FloatArray
    spread: FloatArray
    noise_spread: FloatArray
    scatter: float

    @property
    def value(self) -> FloatArray:
        """The curve (m,)."""
        return self.design @ self.coefficients

    @property
    def covariance(self) -> FloatArray:
        """Its covariance (m, m), which a record of many cycles has no memory for."""
        return self.design @ self.spread @ self.design.T

    @property
    def noise_covariance(self) -> FloatArray:
        """What noise alone would make of it (m, m)."""
        return self.design @ self.noise_spread @ self.design.T


@dataclass(frozen=True, eq=False)
class _Family:
    """Curves of one prior on one abscissa, one for each of s smoothnesses; k directions of bending are seen.

    ``logs`` (s,) are logarithms of weights, ``means`` (s, basis) coefficients. ``free`` (basis, n) makes coefficients
    of white values where nothing bends, ``seen`` (k, n) what they say of each direction of bending in units of its
    noise, ``shrunk`` (s, k) is the share of that which is taken, ``basis`` (basis, k) its coefficients. ``blind``
    (basis, basis) is the spread of what is not seen, ``scatters`` (s,) the factor on the noise variance.
    """

    logs: FloatArray
    means: FloatArray
    free: FloatArray
    seen: FloatArray
    shrunk: FloatArray
    basis: FloatArray
    blind: FloatArray
    scatters: FloatArray

    def spread(self, weights: FloatArray) -> FloatArray:
        """Return the covariance (basis, basis) of curves of their own noise, averaged with ``weights`` (s,)."""
        bent = (self.basis * ((weights * self.scatters) @ self.shrunk**2)) @ self.basis.T
        return bent + float(weights @ self.scatters) * (self.free @ self.free.T + self.blind)

    def influence(self, weights: FloatArray) -> FloatArray:
        """Return what noise of unit variance in each white value does to the averaged coefficients (basis, n)."""
        return float(weights.sum()) * self.free + (self.basis * (weights @ self.shrunk)) @ self.seen


@lru_cache(maxsize=64)
def _bending_roots(order: int, kink: float | None) -> FloatArray:
    """Return spline coefficients of the prior: ``order`` columns that cost nothing, then some of unit variance.

    With a ``kink`` (in [0, 1]) bending costs less there by `KINK_EASE`.
    """
    nodes, weights = np.polynomial.legendre.leggauss(3)
    breaks = np.unique(KNOTS)
    half = np.diff(breaks) / 2.0
    points = ((breaks[:-1] + half)[:, None] + half[:, None] * nodes).ravel()
    scale = np.sqrt((half[:, None] * weights).ravel())
    if kink is not None:
        scale = scale / np.sqrt(1.0 + KINK_EASE * np.exp(-0.5 * ((points - kink) / KINK_WIDTH) ** 2))
    bending = BSpline(KNOTS, np.eye(_SIZE), 3).derivative(order)(points) * scale[:, None]
    values, vectors = eigh(bending.T @ bending)
    return np.hstack([vectors[:, :order], vectors[:, order:] / np.sqrt(np.maximum(values[order:], 1e-14 * values[-1]))])


def _whiten(bands: FloatArray, columns: FloatArray) -> FloatArray:
    """Return ``L^-1 columns`` with ``L L^T`` the covariance given by its lower diagonals, row b the b-th."""
    lower = cholesky_banded(bands, lower=True)
    return solve_banded((bands.shape[0] - 1, 0), lower, columns)


def regularised_bands(bands: FloatArray) -> FloatArray:
    """Return covariance diagonals that are safely positive definite: off-diagonals shrunk as little as it takes."""
    for shrink in (1.0, 0.999, 0.99, 0.97, 0.9, 0.7, 0.4):
        trial = bands.copy()
        trial[1:] *= shrink
        try:
            cholesky_banded(trial, lower=True)
        except np.linalg.LinAlgError:
            continue
        return trial
    trial = bands.copy()
    trial[1:] = 0.0
    return trial


def smooth(
    places: list[FloatArray],
    values: FloatArray,
    bands: FloatArray,
    targets: list[FloatArray],
    *,
    orders: tuple[int, ...] = (2,),
    scatter_prior: float = 12.0,
    kinks: bool = False,
    undersmoothing: float = UNDERSMOOTHING,
) -> Curve:
    """Smooth ``values`` with noise covariance ``bands``, averaging over smoothness and over abscissas.

    The curve has a Gaussian prior: a polynomial of degree ``order - 1`` that costs nothing plus a part whose
    ``order``-th derivative is
    white with unknown strength. The strength (and the abscissa, and the order) is integrated over with the restricted
    likelihood as weight, so
    that the covariance holds the doubt about smoothness too.

    Parameters
    ----------
    places : list of (n,) arrays
        The same n cycles on each candidate abscissa, for example log amplitude and amplitude; monotone.
    values : (n,) array
        What is smoothed.
    bands : (b, n) array
        Lower diagonals of the noise covariance of ``values``.
    targets : list of (m,) arrays
        Where the curve is wanted, on each abscissa; inside the range of ``places``.
    orders : tuple of int, default (2,)
        Orders of the penalised derivative to average over, 2 or 3.
    scatter_prior : float, default 12
        Weight, in observations, of the belief that ``bands`` is right; scatter beyond it inflates the covariance.
    kinks : bool, default False
        Average over curves with one place of strong bending, too.
    undersmoothing : float, default `UNDERSMOOTHING`
        Factor on the prior variance of bending after it has been weighted.

    Returns
    -------
    Curve
        Value, covariance, and scatter.
    """
    n = values.size
    families: list[tuple[slice, _Family]] = []
    for number, white in enumerate(_whiten_all(places, values, bands)):
        models: list[tuple[int, float | None]] = [(order, None) for order in orders if n > order + 1]
        if kinks and number == 0 and n > 5:
            models += [(2, kink) for kink in KINKS]
        here = slice(_SIZE * number, _SIZE * (number + 1))
        families += [(here, _smooth_as(white, n, *model, scatter_prior, undersmoothing)) for model in models]
    if not families:
        raise ValueError("smoothing needs at least four values")
    logs = np.concatenate([family.logs for _, family in families])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    size = _SIZE * len(places)
    spread, scatter = np.zeros((size, size)), 0.0
    influence = np.zeros((size, families[0][1].free.shape[1]))
    every = np.zeros((weights.size, size))
    start = 0
    for here, family in families:
        taken = slice(start, start + family.logs.size)
        own = weights[taken]
        spread[here, here] += family.spread(own)
        influence[here] += family.influence(own)
        every[taken, here] = family.means
        scatter += float(own @ family.scatters)
        start = taken.stop
    coefficients = weights @ every
    apart = every - coefficients
    spread += (apart * weights[:, None]).T @ apart
    design = np.hstack([_design(place, target) for place, target in zip(places, targets, strict=True)])
    return Curve(design, coefficients, spread, scatter * (influence @ influence.T), scatter)


def _whiten_all(places: list[FloatArray], values: FloatArray, bands: FloatArray) -> list[FloatArray]:
    """Return ``values`` and spline functions (n, 1 + basis) of each abscissa, of white noise that all have in common.

    Of more values than functions only the triangle is kept, which carries every inner product that the models need.
    The values stand last in it, so that their noise stays white.
    """
    columns = [*(_design(place, place) for place in places), values]
    white = _whiten(regularised_bands(bands), np.column_stack(columns))
    if white.shape[0] > white.shape[1]:
        white = np.linalg.qr(white, mode="r")
    return [white[:, [-1, *range(_SIZE * k, _SIZE * (k + 1))]] for k in range(len(places))]


def log_evidence(places: list[FloatArray], values: FloatArray, bands: FloatArray, *, kinks: bool = False) -> float:
    """Return the logarithm of the probability of ``values`` under the curves that `smooth` averages over.

    Parameters
    ----------
    places, values, bands, kinks
        As in `smooth`; orders 2 and 3 count.

    Returns
    -------
    float
        Up to a constant that does not depend on ``bands``, which are taken at their word: no scatter beyond them.
    """
    n = values.size
    determinant = float(np.log(cholesky_banded(regularised_bands(bands), lower=True)[0]).sum())
    found = []
    for number, white in enumerate(_whiten_all(places, values, bands)):
        models: list[tuple[int, float | None]] = [(2, None), (3, None)]
        if kinks and number == 0:
            models += [(2, kink) for kink in KINKS]
        for order, kink in models:
            logs = _smooth_as(white, n, order, kink, _CERTAIN, 1.0).logs
            free = white[:, 1:] @ _bending_roots(order, kink)[:, :order]
            cost = float(np.log(np.abs(np.diag(np.linalg.qr(free, mode="r")))).sum())
            found.append(float(np.log(np.mean(np.exp(logs - logs.max()))) + logs.max()) - cost)
    top = max(found)
    return float(np.log(np.mean(np.exp(np.array(found) - top)))) + top - determinant


def _design(place: FloatArray, at: FloatArray) -> FloatArray:
    """Return the spline basis (m, basis) over the range of ``place``, evaluated ``at`` (m,), dense."""
    low, high = float(place.min()), float(place.max())
    return BSpline.design_matrix(np.clip((at - low) / (high - low), 0.0, 1.0), KNOTS, 3).toarray()


def _smooth_as(
    white: FloatArray,
    n: int,
    order: int,
    kink: float | None,
    scatter_prior: float,
    undersmoothing: float,
) -> _Family:
    """Return the curves of one prior for every smoothness."""
    roots = _bending_roots(order, kink)
    y, design = white[:, 0], white[:, 1:] @ roots
    free, rough = design[:, :order], design[:, order:]
    q_free, r_free = np.linalg.qr(free)
    rough_part = q_free.T @ rough
    rough = rough - q_free @ rough_part
    y_part = q_free.T @ y
    y = y - q_free @ y_part
    if rough.shape[0] >= rough.shape[1]:
        d2, v = eigh(rough.T @ rough)
        keep = d2 > 1e-13 * d2[-1]
        d2, v = d2[keep], v[:, keep]
    else:
        d2_full, u = eigh(rough @ rough.T)
        keep = d2_full > 1e-13 * d2_full[-1]
        d2 = d2_full[keep]
        v = (rough.T @ u[:, keep]) / np.sqrt(d2)
    d = np.sqrt(d2)
    seen = (v.T @ rough.T) / d[:, None]
    gamma = seen @ y
    rest = max(float(y @ y - gamma @ gamma), 0.0)
    solve_free = np.linalg.solve(r_free.T, roots[:, :order].T).T
    bend_at = roots[:, order:] - solve_free @ rough_part
    basis = bend_at @ v
    tau = SMOOTHNESS_GRID / d2[-1]
    ratio = 1.0 + tau[:, None] * d2
    # noise scale: never below what was handed in, pulled towards it with the weight of scatter_prior observations
    chi2 = (gamma**2 / ratio).sum(axis=1) + rest
    dof = n - order
    scatters = np.maximum((scatter_prior + chi2) / (scatter_prior + dof), 1.0)
    logs = -0.5 * np.log(ratio).sum(axis=1) - 0.5 * chi2 / scatters - 0.5 * dof * np.log(scatters)
    tau = tau * undersmoothing
    ratio = 1.0 + tau[:, None] * d2
    shrunk = tau[:, None] * d / ratio
    means = solve_free @ y_part + (shrunk * gamma) @ basis.T
    # directions of bending the record says nothing about keep their prior variance
    unseen = bend_at - basis @ v.T
    weights = np.exp(logs - logs.max())
    blind = float(weights @ tau / weights.sum()) * (unseen @ unseen.T)
    return _Family(logs, means, solve_free @ q_free.T, seen, shrunk, basis, blind, scatters)
