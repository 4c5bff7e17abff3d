"""Compiled evaluation of every kind of density, and the layout of the plain data it reads.

Layout of ``codes`` and ``table`` (offsets count from 0; ``d`` = observables x levels):

- product: ``codes = [PRODUCT, d, family, start, size, family, start, size, ...]``, one triple per value; ``table[start
  : start + size]`` holds

  - uniform: low, high, log density
  - normal: mean, standard deviation, log constant
  - kde: bandwidth, log constant, centres in ascending order
  - gev: location, scale, shape (xi), log constant

- joint: ``codes = [JOINT, d, r, n]``; ``table = [log constant, bandwidth, mean (d), whitening (d x d), centres (n x
  r)]``. With z = whitening (y - mean) the density is a Gaussian mixture over the n centres in the first r coordinates
  times a standard normal in the others.

- data-consistent: ``codes = [DATA_CONSISTENT, d, q, r, n, m, ...]``; ``table = [log constant, bandwidth, is log (d),
  centre (d), projection (q x d), inner reach (q), polynomials (r x f), centres (n x r), predicted centres (m x r),
  reach (r), linear (r), quadratic (r x r), ...]``. With t = y, or its logarithm, u = projection (t - centre) and z
  the r polynomials of second degree in u (f = 1 + q + q (q + 1) / 2), the log density is that of a Gaussian mixture
  over the centres, less that over the predicted centres, plus ``linear . z + z . quadratic z``. Beyond a reach (the
  boxes |u| <= inner reach, |z| <= reach) the polynomials keep their values at the edge and the density falls like the
  kernel. The dots stand for codes and table of the joint density of the same population.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from .._common.checks import FloatArray, IntArray

PRODUCT, JOINT, DATA_CONSISTENT = 0, 1, 2
UNIFORM, NORMAL, KDE, GEV = 0, 1, 2, 3
FAMILY_CODES: dict[str, int] = {"uniform": UNIFORM, "normal": NORMAL, "kde": KDE, "gev": GEV}
LOG_TWO_PI = math.log(2.0 * math.pi)

# A kernel whose weight relative to the largest one is below exp(-40) = 4e-18 does not change the last bit of the sum,
# so leaving it out keeps the density smooth.
_NEGLIGIBLE = -40.0


@numba.njit(cache=True, error_model="numpy")
def _kde(table: FloatArray, start: int, size: int, y: float) -> tuple[float, float]:
    """Return log density and derivative of a one-dimensional Gaussian kernel density at ``y``."""
    bandwidth = table[start]
    first = start + 2
    last = start + size
    low, high = first, last
    while low < high:
        middle = (low + high) // 2
        if table[middle] < y:
            low = middle + 1
        else:
            high = middle
    # The nearest centre has the largest exponent: taken out of the sum, the density never underflows.
    nearest = low
    if low == last or (low > first and y - table[low - 1] < table[low] - y):
        nearest = low - 1
    u = (table[nearest] - y) / bandwidth
    largest = -0.5 * u * u
    total, slope = 1.0, u
    index = nearest + 1
    while index < last:
        u = (table[index] - y) / bandwidth
        exponent = -0.5 * u * u - largest
        if not exponent > _NEGLIGIBLE:
            break
        weight = math.exp(exponent)
        total += weight
        slope += weight * u
        index += 1
    index = nearest - 1
    while index >= first:
        u = (table[index] - y) / bandwidth
        exponent = -0.5 * u * u - largest
        if not exponent > _NEGLIGIBLE:
            break
        weight = math.exp(exponent)
        total += weight
        slope += weight * u
        index -= 1
    return table[start + 1] + largest + math.log(total), slope / total / bandwidth


@numba.njit(cache=True, error_model="numpy")
def _gev(table: FloatArray, start: int, y: float) -> tuple[float, float]:
    """Return log density and derivative of a generalised extreme value density at ``y``."""
    scale = table[start + 1]
    shape = table[start + 2]
    z = (y - table[start]) / scale
    stretch = 1.0 + shape * z
    if not stretch > 0.0:
        return -np.inf, 0.0
    # log1p(shape z) / shape is exact to rounding down to the smallest normal shapes; at shape = 0 its limit is z.
    s = z if abs(shape) < 1e-200 else math.log1p(shape * z) / shape
    if s < -700.0:
        return -np.inf, 0.0
    t = math.exp(-s)
    return table[start + 3] - (1.0 + shape) * s - t, (t - 1.0 - shape) / (stretch * scale)


@numba.njit(cache=True, error_model="numpy")
def _product(codes: IntArray, table: FloatArray, y: FloatArray, gradient: FloatArray) -> float:
    """Return the sum of the marginal log densities; fill ``gradient``."""
    total = 0.0
    for index in range(codes[1]):
        family = codes[2 + 3 * index]
        start = codes[3 + 3 * index]
        value = y[index]
        if family == NORMAL:
            u = (value - table[start]) / table[start + 1]
            total += table[start + 2] - 0.5 * u * u
            gradient[index] = -u / table[start + 1]
        elif family == UNIFORM:
            if value < table[start] or value > table[start + 1]:
                return -np.inf
            total += table[start + 2]
            gradient[index] = 0.0
        else:
            if family == GEV:
                log_value, slope = _gev(table, start, value)
            else:
                log_value, slope = _kde(table, start, codes[4 + 3 * index], value)
            total += log_value
            gradient[index] = slope
    return total


@numba.njit(cache=True, error_model="numpy")
def _joint(codes: IntArray, table: FloatArray, y: FloatArray, gradient: FloatArray) -> float:
    """Return the joint log density; fill ``gradient``."""
    d, r, n = codes[1], codes[2], codes[3]
    whitening = 2 + d
    centres = whitening + d * d
    inverse_square = 1.0 / (table[1] * table[1])
    scratch = np.empty(2 * r)
    total = table[0]
    for j in range(d):
        gradient[j] = 0.0
    for k in range(d):
        row = whitening + k * d
        even, odd = 0.0, 0.0  # two sums halve the wait of each addition for the one before
        for j in range(0, d - 1, 2):
            even += table[row + j] * (y[j] - table[2 + j])
            odd += table[row + j + 1] * (y[j + 1] - table[3 + j])
        if d % 2 == 1:
            even += table[row + d - 1] * (y[d - 1] - table[1 + d])
        z = even + odd
        if k < r:
            scratch[k] = z
        else:
            total -= 0.5 * z * z
            for j in range(d):
                gradient[j] -= z * table[row + j]
    log_sum = _mixture(table, centres, n, r, inverse_square, scratch)
    for k in range(r):
        row = whitening + k * d
        for j in range(d):
            gradient[j] += scratch[r + k] * table[row + j]
    return total + log_sum


@numba.njit(cache=True, error_model="numpy")
def _mixture(table: FloatArray, start: int, n: int, r: int, inverse_square: float, scratch: FloatArray) -> float:
    """Return the log of a sum of Gaussian kernels at ``scratch[:r]``; fill its slopes into ``scratch[r:]``."""
    for k in range(r):
        scratch[r + k] = 0.0
    largest, weights = -np.inf, 0.0
    for i in range(n):
        square = 0.0
        for k in range(r):
            u = table[start + i * r + k] - scratch[k]
            square += u * u
        exponent = -0.5 * square * inverse_square
        if exponent > largest:
            weight = 1.0
            rescale = math.exp(largest - exponent)
            largest = exponent
            weights *= rescale
            for k in range(r):
                scratch[r + k] *= rescale
        elif exponent - largest > _NEGLIGIBLE:
            weight = math.exp(exponent - largest)
        else:
            continue
        weights += weight
        for k in range(r):
            scratch[r + k] += weight * (table[start + i * r + k] - scratch[k])
    for k in range(r):
        scratch[r + k] *= inverse_square / weights
    return largest + math.log(weights)


@numba.njit(cache=True, error_model="numpy")
def _polynomial(table: FloatArray, start: int, u: FloatArray, slopes: FloatArray) -> float:
    """Return a polynomial of second degree; fill ``slopes``."""
    q = u.size
    value = table[start]
    for a in range(q):
        slopes[a] = table[start + 1 + a]
        value += slopes[a] * u[a]
    place = start + 1 + q
    for a in range(q):
        for b in range(a, q):
            factor = table[place]
            value += factor * u[a] * u[b]
            slopes[a] += factor * u[b]
            slopes[b] += factor * u[a]
            place += 1
    return value


@numba.njit(cache=True, error_model="numpy")
def _data_consistent(codes: IntArray, table: FloatArray, y: FloatArray, gradient: FloatArray) -> float:
    """Return the log ratio of observed to predicted density; fill ``gradient``."""
    d, q, r, n, m = codes[1], codes[2], codes[3], codes[4], codes[5]
    f = 1 + q + q * (q + 1) // 2
    centre = 2 + d
    projection = centre + d
    inner_reach = projection + q * d
    polynomials = inner_reach + q
    observed = polynomials + r * f
    predicted = observed + n * r
    reach = predicted + m * r
    linear = reach + r
    quadratic = linear + r
    inverse_square = 1.0 / (table[1] * table[1])
    total = table[0]
    u, inner_slopes = np.zeros(q), np.zeros(q)
    for j in range(d):
        gradient[j] = 1.0  # of t with respect to y, for now
        t = y[j]
        if table[2 + j] != 0.0:
            if not t > 0.0:
                return -np.inf
            gradient[j] = 1.0 / t
            t = math.log(t)
        t -= table[centre + j]
        for a in range(q):
            u[a] += table[projection + a * d + j] * t
    is_inside = np.empty(q)
    for a in range(q):
        edge = table[inner_reach + a]
        inside_u = min(max(u[a], -edge), edge)
        beyond = u[a] - inside_u
        total -= 0.5 * beyond * beyond * inverse_square
        inner_slopes[a] = -beyond * inverse_square
        is_inside[a] = 1.0 if beyond == 0.0 else 0.0
        u[a] = inside_u
    scratch, steepness = np.empty(2 * r), np.empty((r, q))
    for k in range(r):
        scratch[k] = _polynomial(table, polynomials + k * f, u, steepness[k])
    total += _mixture(table, observed, n, r, inverse_square, scratch)
    slopes = scratch[r:].copy()
    total -= _mixture(table, predicted, m, r, inverse_square, scratch)
    inside = np.empty(r)
    for k in range(r):
        slopes[k] -= scratch[r + k]
        edge = table[reach + k]
        inside[k] = min(max(scratch[k], -edge), edge)
    for k in range(r):
        beyond = scratch[k] - inside[k]
        total -= 0.5 * beyond * beyond * inverse_square
        slopes[k] -= beyond * inverse_square
        slope = table[linear + k]
        for j in range(r):
            slope += table[quadratic + k * r + j] * inside[j]
        total += slope * inside[k]
        if beyond == 0.0:
            for j in range(r):
                slope += table[quadratic + j * r + k] * inside[j]
            slopes[k] += slope
    for a in range(q):
        for k in range(r):
            inner_slopes[a] += is_inside[a] * slopes[k] * steepness[k, a]
    for j in range(d):
        slope = 0.0
        for a in range(q):
            slope += inner_slopes[a] * table[projection + a * d + j]
        gradient[j] *= slope
    return total


@numba.njit(cache=True, error_model="numpy")
def log_density(codes: IntArray, table: FloatArray, y: FloatArray, gradient: FloatArray) -> float:
    """Evaluate a fitted density and its gradient.

    Compiled (``numba.njit``, cached on disk, without fast-math because NaN matters) and usable inside other compiled
    functions.

    Parameters
    ----------
    codes : array of int64, shape (c,)
        Kind and layout, `Density.codes`.
    table : array of float64, shape (t,)
        Numbers of the density, `Density.table`.
    y : array of float64, shape (d,)
        Values flattened in C order over (observable, level), each in the unit of its observable.
    gradient : array of float64, shape (d,)
        Overwritten with the derivative of the log density with respect to ``y``; zeros where the density is zero.

    Returns
    -------
    float
        The log density; -inf outside the support and where any value is not finite; never NaN.
    """
    d = codes[1]
    finite = True
    for index in range(d):
        if not math.isfinite(y[index]):
            finite = False
    total = -np.inf
    if finite:
        if codes[0] == PRODUCT:
            total = _product(codes, table, y, gradient)
        elif codes[0] == JOINT:
            total = _joint(codes, table, y, gradient)
        else:
            total = _data_consistent(codes, table, y, gradient)
    if not math.isfinite(total):  # also an overflow far away, which can end in inf - inf
        total = -np.inf
        for index in range(d):
            gradient[index] = 0.0
    return total


@numba.njit(cache=True, error_model="numpy")
def log_density_batch(
    codes: IntArray, table: FloatArray, values: FloatArray, result: FloatArray, gradients: FloatArray
) -> None:
    """Evaluate `log_density` for every row of ``values`` (n, d) into ``result`` (n,) and ``gradients`` (n, d)."""
    for index in range(values.shape[0]):
        result[index] = log_density(codes, table, values[index], gradients[index])


def kde_table(bandwidth: float, centres: FloatArray) -> list[float]:
    """Return the table entries of a one-dimensional kernel density."""
    return [bandwidth, -float(np.log(bandwidth * centres.size)) - 0.5 * LOG_TWO_PI, *np.sort(centres).tolist()]


def mixture_marginal(
    bandwidth: float, mean: FloatArray, whitening: FloatArray, centres: FloatArray, index: int
) -> tuple[IntArray, FloatArray]:
    """Return codes and table of the marginal of one value of a joint density, a one-dimensional kernel density."""
    along = np.linalg.inv(whitening)[index]
    r = centres.shape[1]
    width = float(np.sqrt(bandwidth**2 * (along[:r] ** 2).sum() + (along[r:] ** 2).sum()))
    table = np.array(kde_table(width, mean[index] + centres @ along[:r]))
    return np.array([PRODUCT, 1, KDE, 0, table.size]), table


def data_consistent_size(codes: IntArray) -> int:
    """Return how many numbers of the table are the ratio's own; those of the joint density follow."""
    _, d, q, r, n, m = (int(code) for code in codes[:6])
    return 2 + d * (2 + q) + q + r * (1 + q + q * (q + 1) // 2 + n + m + 2 + r)


def is_layout(codes: IntArray, table_size: int, kind: int, size: int) -> bool:
    """Whether codes and table are of a density of ``kind`` over ``size`` values: the compiled code does not check."""
    if codes.ndim != 1 or codes.size < 2 or codes[0] != kind or codes[1] != size:
        return False
    if kind == JOINT:
        return (
            codes.size == 4
            and 0 <= codes[2] <= size
            and codes[3] >= 1
            and table_size == 2 + size + size**2 + codes[2] * codes[3]
        )
    if kind == DATA_CONSISTENT:
        if codes.size != 10 or not (1 <= codes[2] <= size and np.all(codes[3:6] >= 1)):
            return False
        own = data_consistent_size(codes)
        return table_size > own and is_layout(codes[6:], table_size - own, JOINT, size)
    if codes.size != 2 + 3 * size:
        return False
    family, start, length = codes[2:].reshape(size, 3).T
    expected = np.select(
        [family == UNIFORM, family == NORMAL, family == GEV, family == KDE],
        [3, 3, 4, np.maximum(length, 3)],
        default=-1,
    )
    return bool(np.all((length == expected) & (start >= 0) & (start + length <= table_size)))
