"""The four marginal densities of `fit_density`, and the bandwidth of a kernel density in any dimension."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import gamma, logsumexp

from .._common.checks import FloatArray
from .density_kernel import FAMILY_CODES, LOG_TWO_PI, PRODUCT, kde_table, log_density_batch

# Range of the GEV shape. At or below -1 the likelihood has no maximum (the end of the support runs into the largest
# value, where the density has no bound); above 1 the density has no mean. Published fits to backbones lie between -0.92
# and 0.29.
GEV_SHAPES = (-0.95, 1.0)

_N_PARAMETERS = {"uniform": 2, "normal": 2, "gev": 3}


def fit_uniform(sample: FloatArray) -> tuple[float, float]:
    """Return the ends of a uniform density: minimum and maximum, each moved outwards by range / (n - 1).

    These are the minimum-variance unbiased estimates of the ends; the sample's own extremes, the maximum-likelihood
    estimate, are too narrow by (n - 1) / (n + 1).
    """
    low, high = float(sample.min()), float(sample.max())
    margin = (high - low) / (sample.size - 1)
    return low - margin, high + margin


def fit_normal(sample: FloatArray) -> tuple[float, float]:
    """Return mean and (unbiased-variance) standard deviation."""
    return float(sample.mean()), float(sample.std(ddof=1))


def fit_kde(sample: FloatArray) -> tuple[float, FloatArray, float]:
    """Return bandwidth, centres and leave-one-out log-likelihood of a kernel density of the sample's variance."""
    mean, spread = fit_normal(sample)
    whitened = (sample[:, None] - mean) / spread
    bandwidth, score = kernel_bandwidth(whitened)
    centres = mean + spread * shrunk_centres(whitened, bandwidth)[:, 0]
    return bandwidth * spread, centres, score - sample.size * float(np.log(spread))


def shrunk_centres(whitened: FloatArray, bandwidth: float) -> FloatArray:
    """Return the centres for which a Gaussian kernel density of ``bandwidth`` has zero mean and unit covariance.

    ``whitened`` (n, r) has zero mean and unit covariance (divisor n - 1). Kernels add bandwidth^2 to the variance, so
    the centres are drawn towards the mean [1]_. At bandwidth 1 they have all arrived there, and one centre stands for
    them: the density is the normal one.

    References
    ----------
    .. [1] M. C. Jones, "On correcting for variance inflation in kernel density estimation", Computational Statistics &
       Data Analysis (1991).
    """
    n, r = whitened.shape
    if bandwidth >= 1.0:
        return np.zeros((1, r))
    centred = whitened - whitened.mean(axis=0)
    return np.asarray(np.sqrt((1.0 - bandwidth**2) * n / (n - 1)) * centred)


def kernel_bandwidth(whitened: FloatArray) -> tuple[float, float]:
    """Choose the bandwidth of a variance-preserving kernel density by leave-one-out likelihood.

    Candidates reach from a third of Silverman's normal-reference bandwidth (narrower ones only win where values are
    tied, as after rounding) to 1, the normal density. Mean and covariance are taken without the specimen left out,
    otherwise the normal density would be favoured.

    Parameters
    ----------
    whitened : array, shape (n, r)
        Sample of zero mean and unit covariance (divisor n - 1); n > r + 2.

    Returns
    -------
    bandwidth : float
        In standard deviations, at most 1; the larger one of equals.
    score : float
        Sum over the specimens of the leave-one-out log density in whitened coordinates (over every k-th specimen,
        scaled up, beyond 400 specimens).
    """
    n, r = whitened.shape
    reference = (4.0 / ((r + 2.0) * n)) ** (1.0 / (r + 4.0))
    bandwidths = np.append(np.geomspace(min(reference, 1.0) / 3.0, 1.0, 24, endpoint=False), 1.0)
    factors = np.sqrt((1.0 - bandwidths**2) * (n - 1) / (n - 2))
    left_out = range(0, n, 1 + n // 400)
    scores = np.zeros(bandwidths.size)
    for index in left_out:
        rest = np.delete(whitened, index, axis=0)
        mean = rest.mean(axis=0)
        rest = rest - mean
        values, vectors = np.linalg.eigh(rest.T @ rest / (n - 2))
        if values[0] <= 1e-12:  # the others do not vary in some direction: this specimen cannot judge a bandwidth
            continue
        root = vectors / np.sqrt(values)
        rest, query = rest @ root, (whitened[index] - mean) @ root
        square = query @ query - 2.0 * np.outer(factors, rest @ query) + np.outer(factors**2, (rest * rest).sum(axis=1))
        scores += logsumexp(-0.5 * square / bandwidths[:, None] ** 2, axis=1)
        scores -= np.log(n - 1) + 0.5 * np.log(values).sum()
    scores -= len(left_out) * r * (np.log(bandwidths) + 0.5 * LOG_TWO_PI)
    best = bandwidths.size - 1 - int(np.argmax(scores[::-1]))
    return float(bandwidths[best]), float(scores[best] * n / len(left_out))


def gev_log_density(y: FloatArray, location: float, scale: float, shape: float) -> FloatArray:
    """Return the log density of the generalised extreme value distribution (``shape`` is xi; SciPy's ``c`` is -xi)."""
    z = (y - location) / scale
    stretch = shape * z
    inside = stretch > -1.0
    stretch = np.where(inside, stretch, 0.0)
    s = np.where(inside, z, 0.0) if abs(shape) < 1e-200 else np.log1p(stretch) / shape
    inside = inside & (s > -700.0)
    s = np.where(inside, s, 0.0)
    return np.asarray(np.where(inside, -np.log(scale) - (1.0 + shape) * s - np.exp(-s), -np.inf))


def fit_gev(sample: FloatArray) -> tuple[float, float, float]:
    """Return location, scale and shape xi of a generalised extreme value density by maximum likelihood.

    The search (Nelder-Mead on the standardised sample, from the L-moment estimate [1]_ and from three shapes with the
    sample's mean and variance) keeps xi within -0.95 ... 1: at or below -1 the likelihood has no maximum [2]_.

    References
    ----------
    .. [1] J. R. M. Hosking, "L-moments: analysis and estimation of distributions using linear combinations of order
       statistics", Journal of the Royal Statistical Society B 52 (1990) 105-124.
    .. [2] R. L. Smith, "Maximum likelihood estimation in a class of nonregular cases", Biometrika 72 (1985) 67-90.
    """
    centre, spread = fit_normal(sample)
    z = (sample - centre) / spread

    def loss(parameters: FloatArray) -> float:
        location, log_scale, shape = (float(p) for p in parameters)
        if not (GEV_SHAPES[0] <= shape <= GEV_SHAPES[1] and abs(log_scale) < 10.0):
            return 1e10
        value = -float(gev_log_density(z, location, float(np.exp(log_scale)), shape).sum())
        return value if np.isfinite(value) else 1e10

    starts = [_gev_by_lmoments(z)] + [_gev_by_moments(shape) for shape in (-0.6, -0.25, 1e-3)]
    # Where a value lies outside the start's support, drawing the shape towards zero lets the support grow over it.
    usable = []
    for location, scale, shape in starts:
        while loss(np.array([location, np.log(scale), shape])) >= 1e10 and abs(shape) > 1e-3:
            shape *= 0.5
        usable.append(np.array([location, np.log(scale), shape]))
    usable.sort(key=loss)
    options: Any = {"xatol": 1e-9, "fatol": 1e-10, "maxiter": 2000}
    fits = [minimize(loss, start, method="Nelder-Mead", options=options) for start in usable[:2]]
    best = min(fits, key=lambda fit: float(fit.fun))
    best = minimize(
        loss, best.x, method="Nelder-Mead", options=options
    )  # a fresh simplex: the first may have collapsed
    location, log_scale, shape = (float(p) for p in best.x)
    return centre + spread * location, spread * float(np.exp(log_scale)), shape


def _gev_by_lmoments(z: FloatArray) -> tuple[float, float, float]:
    """Return the L-moment estimate (location, scale, xi) with Hosking's approximation for the shape."""
    ordered = np.sort(z)
    n = ordered.size
    rank = np.arange(n)
    b0 = ordered.mean()
    b1 = (rank * ordered).sum() / (n * (n - 1))
    b2 = (rank * (rank - 1) * ordered).sum() / (n * (n - 1) * (n - 2))
    l2, l3 = 2.0 * b1 - b0, 6.0 * b2 - 6.0 * b1 + b0
    c = 2.0 / (3.0 + l3 / l2) - np.log(2.0) / np.log(3.0)
    k = float(np.clip(7.8590 * c + 2.9554 * c**2, -0.9, 0.9))
    k = k if abs(k) > 1e-3 else 1e-3
    scale = l2 * k / ((1.0 - 2.0**-k) * gamma(1.0 + k))
    return float(b0 - scale * (1.0 - gamma(1.0 + k)) / k), float(scale), -k


def _gev_by_moments(shape: float) -> tuple[float, float, float]:
    """Return the (location, scale, xi) of zero mean and unit variance for a shape below 1/2."""
    g1, g2 = gamma(1.0 - shape), gamma(1.0 - 2.0 * shape)
    scale = abs(shape) / np.sqrt(g2 - g1**2)
    return float(-scale * (g1 - 1.0) / shape), float(scale), shape


class MarginalFit(NamedTuple):
    """Table entries, parameters in words and criterion (lower is better) of one marginal."""

    table: list[float]
    parameters: dict[str, float]
    score: float


def fit_marginal(family: str, sample: FloatArray, criterion: str) -> MarginalFit:
    """Fit one family; the score is the criterion (bic or aic), for a kernel density -2 x leave-one-out likelihood."""
    if family == "kde":
        bandwidth, centres, likelihood = fit_kde(sample)
        mean, spread = fit_normal(sample)
        parameters = {"mean": mean, "standard_deviation": spread, "bandwidth": bandwidth}
        return MarginalFit(kde_table(bandwidth, centres), parameters, -2.0 * likelihood)
    if family == "uniform":
        low, high = fit_uniform(sample)
        parameters, constant = {"low": low, "high": high}, -np.log(high - low)
    elif family == "normal":
        mean, spread = fit_normal(sample)
        parameters, constant = {"mean": mean, "standard_deviation": spread}, -np.log(spread) - 0.5 * LOG_TWO_PI
    else:
        location, scale, shape = fit_gev(sample)
        parameters, constant = {"location": location, "scale": scale, "shape": shape}, -np.log(scale)
    table = [*parameters.values(), float(constant)]
    codes = np.array([PRODUCT, 1, FAMILY_CODES[family], 0, len(table)])
    likelihoods = np.empty(sample.size)
    log_density_batch(codes, np.array(table), sample[:, None], likelihoods, np.empty((sample.size, 1)))
    penalty = float(np.log(sample.size)) if criterion == "bic" else 2.0
    return MarginalFit(table, parameters, penalty * _N_PARAMETERS[family] - 2.0 * float(likelihoods.sum()))
