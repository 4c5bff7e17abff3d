"""A spring of any shape: a cubic spline through the forces at equally spaced displacements.

An odd part, the same pull on either side, and an even one, which tells the sides apart; so a symmetric structure comes
out as symmetric. What is linear in the odd part is a linear spring: which of the two holds it is for the user to say.
"""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._spline import mirrored_slopes, weights

COUNT = 12
"""Nodes on either side of zero."""
NODES = np.linspace(0.0, 1.0, COUNT + 1)
"""Their places over the range, from zero on."""
_ODD, _EVEN = mirrored_slopes(NODES, -1.0), mirrored_slopes(NODES, 1.0)
# Parameters: the odd node at the end of the range first, then the others from zero on, the even ones, the range.
_RANGE = 2 * COUNT


@numba.njit
def _odd(j: int) -> int:
    """Return the place of the odd part at node j, from 1 on."""
    return 0 if j == COUNT else j


@numba.njit
def _parts(u: float, p: FloatArray) -> tuple[float, float, float, float]:
    """Return odd and even part at u from zero on, and their slopes."""
    i, a, b, c, d, by_a, by_b, by_c, by_d = weights(u, NODES)
    odd = even = odd_slope = even_slope = 0.0
    if i > 0:
        odd, even = a * p[_odd(i)], a * p[COUNT + i - 1]
        odd_slope, even_slope = by_a * p[_odd(i)], by_a * p[COUNT + i - 1]
    odd += b * p[_odd(i + 1)]
    even += b * p[COUNT + i]
    odd_slope += by_b * p[_odd(i + 1)]
    even_slope += by_b * p[COUNT + i]
    for j in range(COUNT):
        first, second = p[_odd(j + 1)], p[COUNT + j]
        odd += (c * _ODD[i, j] + d * _ODD[i + 1, j]) * first
        odd_slope += (by_c * _ODD[i, j] + by_d * _ODD[i + 1, j]) * first
        even += (c * _EVEN[i, j] + d * _EVEN[i + 1, j]) * second
        even_slope += (by_c * _EVEN[i, j] + by_d * _EVEN[i + 1, j]) * second
    return odd, even, odd_slope, even_slope


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[_RANGE] <= 0.0:
        return 0.0
    odd, even, _, _ = _parts(abs(x) / p[_RANGE], p)
    return odd + even if x >= 0.0 else even - odd


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    reach = p[_RANGE]
    if reach <= 0.0:
        return
    side = 1.0 if x >= 0.0 else -1.0
    u = side * x / reach
    i, a, b, c, d, _, _, _, _ = weights(u, NODES)
    for j in range(COUNT):
        out[2 + _odd(j + 1)] = side * (c * _ODD[i, j] + d * _ODD[i + 1, j])
        out[2 + COUNT + j] = c * _EVEN[i, j] + d * _EVEN[i + 1, j]
    if i > 0:
        out[2 + _odd(i)] += side * a
        out[2 + COUNT + i - 1] += a
    out[2 + _odd(i + 1)] += side * b
    out[2 + COUNT + i] += b
    _, _, odd, even = _parts(u, p)
    out[0] = (odd + side * even) / reach
    out[2 + _RANGE] = -u * (side * odd + even) / reach


def _node(part: str, j: int) -> Parameter:
    return Parameter(
        name=f"tabulated_stiffness_{part}_{j}",
        unit="N",
        latex=f"F^{{{part}}}_{{{j}}}",
        summary=f"{part} part of the force at {j}/{COUNT} of the range",
        role="strength" if (part, j) == ("odd", COUNT) else "ordinate",
        bounds=lambda mass, amplitude, angular_frequency: (
            -0.25 * mass * angular_frequency**2 * amplitude,
            0.25 * mass * angular_frequency**2 * amplitude,
        ),
        minimum=-np.inf,
    )


_NODES = (
    _node("odd", COUNT),
    *(_node("odd", j) for j in range(1, COUNT)),
    *(_node("even", j) for j in range(1, COUNT + 1)),
)


def _listed(part: str) -> str:
    return ", ".join(f"tabulated_stiffness_{part}_{j}" for j in range(1, COUNT + 1))


EFFECT = Effect(
    name="tabulated_stiffness",
    summary="Spring of any shape, an odd and an even curve through node forces: what no named law holds.",
    text=f"sign(x) S({_listed('odd')}; |x|/tabulated_stiffness_range) + S({_listed('even')}; "
    "|x|/tabulated_stiffness_range), S the cubic spline through the forces at 1/12 to 12/12, 0 at 0",
    latex=r"\operatorname{sign}(x) S("
    + ", ".join(f"F^{{odd}}_{{{j}}}" for j in range(1, COUNT + 1))
    + r", |x| / X_t) + S("
    + ", ".join(f"F^{{even}}_{{{j}}}" for j in range(1, COUNT + 1))
    + r", |x| / X_t)",
    parameters=(
        *_NODES,
        Parameter(
            name="tabulated_stiffness_range",
            unit="m",
            latex="X_t",
            summary="displacement of the last node, beyond which the curve is straight; chosen, not measured",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.5 * amplitude, 2.0 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    redundant=(("tabulated_stiffness_range", lambda mass, amplitude, angular_frequency: amplitude),),
    references=(
        "Masri S. F., Caughey T. K. (1979) A nonparametric identification technique for nonlinear dynamic problems. "
        "Journal of Applied Mechanics 46(2), 433-447. doi:10.1115/1.3424568",
        "de Boor C. (1978) A Practical Guide to Splines. Springer. doi:10.1007/978-1-4612-6333-3",
    ),
    only_if_named=True,
    signature=Signature(
        frequency="Rises where the odd part is steeper than a straight line; falls where it is less steep.",
        damping="Falls a little where the frequency rises: the viscous damper has less time in a shorter cycle.",
        offset="Zero without an even part, else as large as that moves the mid-line.",
        found_in="the remainder of a diagnosis, springs known as a table",
        typical=lambda mass, amplitude, angular_frequency: (
            *(0.2 * mass * angular_frequency**2 * amplitude * (j / COUNT) ** 3 for j in (COUNT, *range(1, COUNT))),
            *(0.0 for _ in range(COUNT)),
            amplitude,
        ),
        resembles=("cubic_stiffness", "power_stiffness"),
    ),
)
