r"""How smooth hysteresis saturates, or grows, in numbers without a unit: ``dW/dt = 1 -+ W^n``, ``W(0) = 0``.

It depends on the exponent alone: close to zero it is a power series in ``t^n``, beyond it Taylor polynomials on pieces
that are made as they are needed. Both are exact to some 1e-11, and so are the derivatives to the exponent. All of that
is kept in an array, from `FIRST` on to `BEHIND`.
"""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray

compiled = numba.njit(error_model="numpy", fastmath={"contract"})

FIRST = 6  # behind the parameters of the effect
ORDER = 12  # of the Taylor polynomials
TERMS = 14  # of the power series, which is used up to t = 1 / n
_LENGTH = 0.4  # pieces, in t n
_SMALL = 0.5  # W up to which that holds where it grows beyond bounds
_ERROR = 1e-12  # of a piece where W grows beyond bounds, which is as long as that lets it be ...
_LONGEST = 4.0  # ... and not longer, in t
_MOST = 128  # pieces: enough for exponents up to 19; beyond, they are longer and less exact
_SATURATED = 1e-14
_LEAST = 1e-300

# The exponent; the end of the series in t, W there where it saturates and where it grows, the length of a piece; the
# series, its derivatives with respect to the exponent, room for powers, logarithms and quotients ...
OF_EXPONENT, END, W_END, _STEP, SERIES = FIRST, FIRST + 1, FIRST + 2, FIRST + 4, FIRST + 5
SERIES_SLOPES = SERIES + TERMS + 1
_P = SERIES_SLOPES + TERMS + 1
_L = _P + TERMS + 1
_Q = _L + TERMS + 1
# ... and of W that saturates and W that grows how many pieces there are, how many of equal length, where they begin,
# where they are expanded, and their polynomials.
TABLES = _Q + TERMS + 1
_COUNT, _EQUAL, BEGIN = range(3)
CENTRES = BEGIN + _MOST + 1
PIECES = CENTRES + _MOST
WIDTH = 2 * (ORDER + 1)
N_TABLE = PIECES + _MOST * WIDTH
BEHIND = TABLES + 2 * N_TABLE


@compiled
def power_of(size: float, exponent: float) -> float:
    """Return the power of a size: most exponents are 1, and a logarithm is cheaper than a power of any kind."""
    if exponent == 1.0:
        return size
    return math.exp(exponent * math.log(size)) if size > 0.0 else 0.0


@compiled
def _write_series(p: FloatArray, n: float) -> None:
    """Write the coefficients of g, where W = t g(+-t^n), and their derivatives with respect to the exponent.

    ``W' = 1 - y P`` with ``P = g^n`` gives them one by one, as a logarithmic derivative gives those of P.
    """
    p[SERIES], p[SERIES_SLOPES] = 1.0, 0.0
    p[_P], p[_L] = 1.0, 0.0  # powers, and their derivatives
    for k in range(1, TERMS + 1):
        way = 1.0 + n * k
        p[SERIES + k] = -p[_P + k - 1] / way
        p[SERIES_SLOPES + k] = (p[_P + k - 1] * k / way - p[_L + k - 1]) / way
        power, slope = 0.0, 0.0
        for j in range(1, k + 1):
            weight = n * j - (k - j)
            power += weight * p[SERIES + j] * p[_P + k - j]
            slope += j * p[SERIES + j] * p[_P + k - j]
            slope += weight * (p[SERIES_SLOPES + j] * p[_P + k - j] + p[SERIES + j] * p[_L + k - j])
        p[_P + k], p[_L + k] = power / k, slope / k


@compiled
def series_at(p: FloatArray, first: int, y: float) -> tuple[float, float]:
    """Return a polynomial of `TERMS` and its derivative."""
    value, slope = p[first + TERMS], 0.0
    for k in range(TERMS - 1, -1, -1):
        slope = slope * y + value
        value = value * y + p[first + k]
    return value, slope


@compiled
def set_exponent(p: FloatArray, n: float) -> None:
    """Begin anew with another exponent."""
    _write_series(p, n)
    p[OF_EXPONENT], p[END] = n, 1.0 / n
    # the last ones begin where W has saturated: 1 - W falls as exp(-n t), from t = 1 on at the latest
    p[_STEP] = max(_LENGTH / n, (1.0 - math.log(_SATURATED) / n) / (_MOST - 2))
    for table in range(2):
        p[W_END + table] = p[END] * series_at(p, SERIES, power_of(p[END], n) * (1.0 - 2.0 * table))[0]
        p[TABLES + table * N_TABLE + _COUNT] = 0.0
        p[TABLES + table * N_TABLE + _EQUAL] = float(_MOST)


@compiled
def _expand(p: FloatArray, a: int, sign: float, w: float, by_n: float) -> None:
    """Write Taylor polynomials of W and of its derivative with respect to the exponent from their values at a place.

    The coefficients of powers, logarithm and quotient follow one by one from those of W, as in any Taylor integrator.
    """
    n = p[OF_EXPONENT]
    d = a + ORDER + 1
    p[a], p[d] = w, by_n
    p[_P], p[_L] = power_of(w, n), math.log(w)
    p[_Q] = p[_P] / w
    for k in range(ORDER):
        p[a + k + 1] = ((1.0 if k == 0 else 0.0) - sign * p[_P + k]) / (k + 1)
        forcing = 0.0
        for j in range(k + 1):
            forcing += n * p[_Q + j] * p[d + k - j] + p[_P + j] * p[_L + k - j]
        p[d + k + 1] = -sign * forcing / (k + 1)
        m = k + 1
        power, logarithm, quotient = 0.0, m * p[a + m], 0.0
        for j in range(m):
            power += (n * (m - j) - j) * p[a + m - j] * p[_P + j]
            if j > 0:
                logarithm -= j * p[_L + j] * p[a + m - j]
            quotient -= p[_Q + j] * p[a + m - j]
        p[_P + m] = power / (m * w)
        p[_L + m] = logarithm / (m * w)
        p[_Q + m] = (p[_P + m] + quotient) / w


@compiled
def polynomial(p: FloatArray, first: int, step: float) -> float:
    """Return a Taylor polynomial."""
    value = p[first + ORDER]
    for j in range(ORDER - 1, -1, -1):
        value = value * step + p[first + j]
    return value


@compiled
def _add_piece(p: FloatArray, table: int, sign: float) -> None:
    """Write the next piece.

    They are of equal length, expanded at their centres, as long as W is small or saturates; where it grows beyond one,
    towards infinity, they are expanded where they begin.
    """
    k = int(p[table + _COUNT])
    a = table + PIECES + k * WIDTH
    d = a + ORDER + 1
    if k == 0:
        begin = p[END]
        y = sign * power_of(begin, p[OF_EXPONENT])
        g, slope = series_at(p, SERIES, y)
        w, by_n = begin * g, begin * (series_at(p, SERIES_SLOPES, y)[0] + slope * y * math.log(begin))
        p[table + BEGIN] = begin
    else:
        begin = p[table + BEGIN + k]
        step = begin - p[table + CENTRES + k - 1]
        w, by_n = polynomial(p, a - WIDTH, step), polynomial(p, a - ORDER - 1, step)
    p[table + _COUNT] = k + 1.0
    p[table + CENTRES + k] = begin
    if sign > 0.0 and not 1.0 - w > _SATURATED:
        p[a] = 1.0
        p[a + ORDER] = 0.0
        p[table + BEGIN + k + 1] = math.inf
        return
    _expand(p, a, sign, w, by_n)
    if sign > 0.0 or w < _SMALL:
        step = 0.5 * p[_STEP]
        p[table + CENTRES + k] = begin + step
        p[table + BEGIN + k + 1] = p[END] + (k + 1) * p[_STEP]
        _expand(p, a, sign, polynomial(p, a, step), polynomial(p, d, step))
        return
    p[table + _EQUAL] = min(p[table + _EQUAL], float(k))
    step = _LONGEST
    for first in (a, d):
        size = max(abs(p[first]), 1.0)
        for j in (ORDER - 1, ORDER):
            if p[first + j] != 0.0:
                step = min(step, (_ERROR * size / abs(p[first + j])) ** (1.0 / j))
    p[table + BEGIN + k + 1] = begin + step


@compiled
def is_there(p: FloatArray, table: int, sign: float, k: int) -> bool:
    """Return whether there is a piece with this number, made if it is the next one; not where W is infinite."""
    if k < int(p[table + _COUNT]):
        return True
    if k >= _MOST:
        return False
    _add_piece(p, table, sign)
    if math.isfinite(p[table + PIECES + k * WIDTH + ORDER]):
        return True
    p[table + _COUNT] = float(k)
    return False


@compiled
def piece(p: FloatArray, table: int, sign: float, t: float) -> int:
    """Return the piece that holds a place behind the series, made if need be; -1 where W is beyond all bounds."""
    k = max(int(min((t - p[END]) / p[_STEP], _MOST - 1.0)), 0)
    if k < int(min(p[table + _COUNT] - 1.0, p[table + _EQUAL])):
        return k
    k = min(k, int(p[table + _EQUAL]), max(int(p[table + _COUNT]) - 1, 0))
    while is_there(p, table, sign, k):
        if t < p[table + BEGIN + k + 1]:
            return k
        k += 1
    return -1


@compiled
def tail(p: FloatArray, beyond: float) -> float:
    """Return dW/dt where W is one to rounding: never zero, as no past is ever forgotten altogether."""
    n = p[OF_EXPONENT]
    return max(n * _SATURATED * math.exp(-n * beyond), _LEAST)


__all__ = [
    *("BEGIN", "BEHIND", "CENTRES", "END", "FIRST", "N_TABLE", "OF_EXPONENT", "ORDER", "PIECES"),
    *("SERIES", "SERIES_SLOPES", "TABLES", "TERMS", "WIDTH", "W_END"),
    *("compiled", "is_there", "piece", "polynomial", "power_of", "series_at", "set_exponent", "tail"),
]
