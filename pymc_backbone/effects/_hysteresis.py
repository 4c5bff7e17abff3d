r"""The loading curve of smooth hysteresis: every half cycle of a Bouc-Wen displacement lies on one curve.

While the velocity keeps its sign, the law :math:`\dot z = A \dot x - \beta |\dot x| |z|^{n-1} z - \gamma \dot x |z|^n`
does not hold time: along the way :math:`s` in the direction of motion

.. math:: \frac{dz}{ds} = A - b |z|^n, \qquad b = \gamma + \beta\ (z \ge 0),\ \gamma - \beta\ (z < 0),

so each half cycle follows the one solution through zero, from where the last turning point lies on it. Either side is
:math:`z = z_s W(s A / z_s)` with :math:`z_s = (A / |b|)^{1/n}` and :math:`dW/dt = 1 \mp W^n, W(0) = 0` (`_saturation`).

Everything is kept in room behind the parameters of the effect (`N_ROOM` numbers), all zero in the beginning. What is
asked for is worked out again when a parameter or the turning point is another one.
"""

from __future__ import annotations

import math

from .._common.checks import FloatArray
from ._saturation import (
    BEGIN,
    BEHIND,
    CENTRES,
    END,
    FIRST,
    N_TABLE,
    OF_EXPONENT,
    ORDER,
    PIECES,
    SERIES,
    SERIES_SLOPES,
    TABLES,
    TERMS,
    W_END,
    WIDTH,
    compiled,
    is_there,
    piece,
    polynomial,
    power_of,
    series_at,
    set_exponent,
    tail,
)

_A, _BETA, _GAMMA, _EXPONENT = 1, 3, 4, 5  # where the parameters stand; the others are a factor of the force
_NEWTON_STEPS = 60

# The room behind that of W: what it was worked out for, ...
_OF_A, _OF_BETA, _OF_GAMMA = range(BEHIND, BEHIND + 3)
# ... where the last turning point is on the curve, of which z there, whether its slopes are there, and these (slope
# along the way, derivatives with respect to A, beta, gamma, n), ...
_IS_STARTED, _OF_START, _START, _HAS_SLOPES, _START_SLOPES = range(BEHIND + 3, BEHIND + 8)
# ... the derivatives asked for last, with respect to A, beta, gamma, n, the place for which, and z there, ...
_OUT = _START_SLOPES + 5
_IS_KNOWN, _OF_PLACE, _KNOWN = range(_OUT + 4, _OUT + 7)
# ... and each side's b, whose sign, A / z_s, z_s, the way to the end of the series, and d ln t / dn.
_SIDES = _KNOWN + 1
_B, _SIGN, _RATE, _SIZE, _WAY, _TILT, _N_SIDE = range(7)
_END = _SIDES + 2 * _N_SIDE
N_ROOM = _END - FIRST


@compiled
def _prepare(p: FloatArray) -> None:
    """Work out what depends on the parameters alone, if they are others than last time."""
    n, a = max(p[_EXPONENT], 1.0), p[_A]
    if p[OF_EXPONENT] == n and p[_OF_A] == a and p[_OF_BETA] == p[_BETA] and p[_OF_GAMMA] == p[_GAMMA]:
        return
    if p[OF_EXPONENT] != n:
        set_exponent(p, n)
    p[_OF_A], p[_OF_BETA], p[_OF_GAMMA] = a, p[_BETA], p[_GAMMA]
    p[_IS_STARTED], p[_IS_KNOWN] = 0.0, 0.0
    for side in range(2):
        at = _SIDES + side * _N_SIDE
        b = p[_GAMMA] + p[_BETA] if side == 0 else p[_GAMMA] - p[_BETA]
        p[at + _B], p[at + _SIGN] = b, 1.0 if b > 0.0 else -1.0
        p[at + _RATE], p[at + _SIZE], p[at + _WAY], p[at + _TILT] = 0.0, math.inf, math.inf, 0.0
        if b != 0.0 and a > 0.0:
            size = math.exp(math.log(a / abs(b)) / n)
            if 0.0 < size < math.inf:
                p[at + _RATE], p[at + _SIZE] = a / size, size
                p[at + _WAY] = p[END] * size / a
                p[at + _TILT] = math.log(a / abs(b)) / (n * n)


@compiled
def _along(p: FloatArray, side: int, s: float) -> tuple[float, float]:
    """Return the size of z and dz/ds a way ``s`` from zero on one side."""
    at = _SIDES + side * _N_SIDE
    a = p[_OF_A]
    if s <= p[at + _WAY]:
        way = a * s
        y = p[at + _B] * power_of(way, p[OF_EXPONENT]) / a if a > 0.0 else 0.0
        g, slope = series_at(p, SERIES, y)
        return way * g, a * (g + p[OF_EXPONENT] * y * slope)
    sign, t = p[at + _SIGN], s * p[at + _RATE]
    table = TABLES + (0 if sign > 0.0 else N_TABLE)
    k = piece(p, table, sign, t)
    if k < 0:
        return math.inf, math.inf
    if math.isinf(p[table + BEGIN + k + 1]):
        return p[at + _SIZE], a * tail(p, t - p[table + BEGIN + k])
    first = table + PIECES + k * WIDTH
    step = t - p[table + CENTRES + k]
    w, dw = p[first + ORDER], 0.0
    for j in range(ORDER - 1, -1, -1):
        dw = dw * step + w
        w = w * step + p[first + j]
    return p[at + _SIZE] * w, a * dw


@compiled
def _along_with_slopes(p: FloatArray, side: int, s: float) -> tuple[float, float, float, float, float]:
    """Return the same, and the derivatives of the size of z with respect to A, b, n.

    Scaling the way and scaling z leave two relations between these three: that to n is all that is kept.
    """
    at = _SIDES + side * _N_SIDE
    n, a, b = p[OF_EXPONENT], p[_OF_A], p[at + _B]
    if s <= p[at + _WAY]:
        way = a * s
        if not way > 0.0:
            return 0.0, a, s, 0.0, 0.0
        logarithm = math.log(way)
        power = way if n == 1.0 else math.exp(n * logarithm)
        y = b * power / a
        g, by_y, by_n = p[SERIES + TERMS], 0.0, p[SERIES_SLOPES + TERMS]
        for k in range(TERMS - 1, -1, -1):
            by_y = by_y * y + g
            g = g * y + p[SERIES + k]
            by_n = by_n * y + p[SERIES_SLOPES + k]
        slope, by_b = a * (g + n * y * by_y), s * by_y * power
        return way * g, slope, (s * slope - b * by_b) / a, by_b, way * (by_n + by_y * y * logarithm)
    t = s * p[at + _RATE]
    table = TABLES + (0 if p[at + _SIGN] > 0.0 else N_TABLE)
    k = piece(p, table, p[at + _SIGN], t)
    if k < 0:
        return math.inf, math.inf, math.inf, math.inf, math.inf
    if math.isinf(p[table + BEGIN + k + 1]):
        z, slope = p[at + _SIZE], a * tail(p, t - p[table + BEGIN + k])
        return z, slope, z / (n * a), -z / (n * b), -p[at + _TILT] * z
    first = table + PIECES + k * WIDTH
    step = t - p[table + CENTRES + k]
    w, dw, by_n = p[first + ORDER], 0.0, p[first + 2 * ORDER + 1]
    for j in range(ORDER - 1, -1, -1):
        dw = dw * step + w
        w = w * step + p[first + j]
        by_n = by_n * step + p[first + ORDER + 1 + j]
    z, slope = p[at + _SIZE] * w, a * dw
    by_b = (s * slope - z) / (n * b)
    return z, slope, (s * slope - b * by_b) / a, by_b, p[at + _SIZE] * by_n + p[at + _TILT] * (s * slope - z)


@compiled
def _way_to(p: FloatArray, side: int, z: float) -> float:
    """Return the way from zero to a size of z on one side, by Newton's method from where it cannot go astray.

    The curve bends one way only; where z is beyond what it reaches, it is saturated: the place where it gets so.
    """
    at = _SIDES + side * _N_SIDE
    a, sign = p[_OF_A], p[at + _SIGN]
    if not (z > 0.0 and a > 0.0):
        return 0.0
    low, high = 0.0, p[at + _WAY]
    s = min(z / a, high)
    if z > p[W_END + (0 if sign > 0.0 else 1)] * p[at + _SIZE]:
        w = z / p[at + _SIZE]
        table = TABLES + (0 if sign > 0.0 else N_TABLE)
        k, reached = 0, high
        while is_there(p, table, sign, k):
            end, reached = p[table + BEGIN + k + 1], p[table + BEGIN + k] / p[at + _RATE]
            if math.isinf(end):
                return reached
            if w <= polynomial(p, table + PIECES + k * WIDTH, end - p[table + CENTRES + k]):
                break
            k += 1
        else:
            return reached
        low, high, s = reached, end / p[at + _RATE], reached
    for _ in range(_NEWTON_STEPS):
        found, slope = _along(p, side, s)
        change = (z - found) / slope if slope > 0.0 else 0.0
        s = min(max(s + change, low), high)
        if not abs(change) > 4e-16 * s:
            break
    return s


@compiled
def _write_slopes(p: FloatArray, place: float) -> tuple[float, float]:
    """Write the derivatives of z with respect to A, beta, gamma, n at a place on the curve; return z and dz/ds."""
    if place >= 0.0:
        z, slope, by_a, by_b, by_n = _along_with_slopes(p, 0, place)
        p[_OUT], p[_OUT + 1], p[_OUT + 2], p[_OUT + 3] = by_a, by_b, by_b, by_n
        return z, slope
    z, slope, by_a, by_b, by_n = _along_with_slopes(p, 1, -place)
    p[_OUT], p[_OUT + 1], p[_OUT + 2], p[_OUT + 3] = -by_a, by_b, -by_b, -by_n
    return -z, slope


@compiled
def place(x: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return where on its curve the state is: negative before z has changed its sign since the last turning point.

    Not a number where there is no room behind the parameters.
    """
    if p.size < _END:
        return math.nan
    _prepare(p)
    start = direction * z[1]
    if p[_IS_STARTED] == 0.0 or p[_OF_START] != start:
        p[_START] = _way_to(p, 0, start) if start >= 0.0 else -_way_to(p, 1, -start)
        p[_IS_STARTED], p[_OF_START], p[_HAS_SLOPES] = 1.0, start, 0.0
    result: float = p[_START] + direction * (x - z[0])
    return result


@compiled
def lagging(x: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the hysteretic displacement [m]; nan where there is no room behind the parameters."""
    if p.size < _END:
        return math.nan
    now = place(x, direction, z, p)
    if p[_IS_KNOWN] == 1.0 and p[_OF_PLACE] == now:
        return direction * p[_KNOWN]
    return direction * _along(p, 0, now)[0] if now >= 0.0 else -direction * _along(p, 1, -now)[0]


@compiled
def lagging_slopes(x: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> float:
    """Write its derivatives to x, v, the six parameters and z = [x_r, z_r, branch]; return it."""
    out[:] = 0.0
    if p.size < _END:
        out[:] = math.nan
        return math.nan
    now = place(x, direction, z, p)
    if p[_HAS_SLOPES] == 0.0:
        _, p[_START_SLOPES] = _write_slopes(p, p[_START])
        p[_HAS_SLOPES] = 1.0
        for j in range(4):
            p[_START_SLOPES + 1 + j] = p[_OUT + j]
    lag, slope = _write_slopes(p, now)
    p[_IS_KNOWN], p[_OF_PLACE], p[_KNOWN] = 1.0, now, lag
    share = slope / p[_START_SLOPES] if p[_START_SLOPES] > 0.0 else 0.0
    out[0] = slope
    out[2 + _A] = direction * (p[_OUT] - share * p[_START_SLOPES + 1])
    out[2 + _BETA] = direction * (p[_OUT + 1] - share * p[_START_SLOPES + 2])
    out[2 + _GAMMA] = direction * (p[_OUT + 2] - share * p[_START_SLOPES + 3])
    out[2 + _EXPONENT] = direction * (p[_OUT + 3] - share * p[_START_SLOPES + 4])
    out[8] = -slope
    out[9] = share
    return direction * lag


__all__ = ["N_ROOM", "lagging", "lagging_slopes", "place"]
