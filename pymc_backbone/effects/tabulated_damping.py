"""A damper of any shape: a cubic spline through the forces at some speeds, closer to each other where it is slow.

An odd part, the same in both directions, which may begin with a friction force at rest, and an even one, which tells
the directions apart. What is linear in the odd part is a viscous damper: which of the two holds it is for the user to
say.
"""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._spline import mirrored_slopes, slope_matrix, weights

COUNT = 10
"""Nodes from rest to the end of the range, rest not counted."""
NODES = np.linspace(0.0, 1.0, COUNT + 1) ** 2
"""Their places over the range, from zero on."""
_ODD, _EVEN = slope_matrix(NODES), mirrored_slopes(NODES, 1.0)
# Parameters: the odd node at the end of the range first, then the others from rest on, the even ones, the range.
_FIRST_EVEN = COUNT + 1
_RANGE = 2 * COUNT + 1


@numba.njit
def _odd(j: int) -> int:
    """Return the place of the odd part at node j, from 0 on."""
    return 0 if j == COUNT else j + 1


@numba.njit
def _along(v: float, direction: float, p: FloatArray) -> float:
    """Return the speed in the direction of motion over the range; held where a step goes far beyond a turning point."""
    return max(direction * v / p[_RANGE], -NODES[1])


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[_RANGE] <= 0.0:
        return 0.0
    u = _along(v, direction, p)
    i, a, b, c, d, _, _, _, _ = weights(u, NODES)
    odd = a * p[_odd(i)] + b * p[_odd(i + 1)]
    for j in range(COUNT + 1):
        odd += (c * _ODD[i, j] + d * _ODD[i + 1, j]) * p[_odd(j)]
    i, a, b, c, d, _, _, _, _ = weights(abs(u), NODES)
    even = b * p[_FIRST_EVEN + i]
    if i > 0:
        even += a * p[_FIRST_EVEN + i - 1]
    for j in range(COUNT):
        even += (c * _EVEN[i, j] + d * _EVEN[i + 1, j]) * p[_FIRST_EVEN + j]
    return direction * odd + even


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    reach = p[_RANGE]
    if reach <= 0.0:
        return
    u = _along(v, direction, p)
    is_held = direction * v / reach < u
    slope = 0.0
    i, a, b, c, d, by_a, by_b, by_c, by_d = weights(u, NODES)
    for j in range(COUNT + 1):
        out[2 + _odd(j)] = direction * (c * _ODD[i, j] + d * _ODD[i + 1, j])
        slope += (by_c * _ODD[i, j] + by_d * _ODD[i + 1, j]) * p[_odd(j)]
    out[2 + _odd(i)] += direction * a
    out[2 + _odd(i + 1)] += direction * b
    slope += by_a * p[_odd(i)] + by_b * p[_odd(i + 1)]
    side = direction if u >= 0.0 else -direction
    i, a, b, c, d, by_a, by_b, by_c, by_d = weights(abs(u), NODES)
    for j in range(COUNT):
        out[2 + _FIRST_EVEN + j] = c * _EVEN[i, j] + d * _EVEN[i + 1, j]
        slope += side * (by_c * _EVEN[i, j] + by_d * _EVEN[i + 1, j]) * p[_FIRST_EVEN + j]
    if i > 0:
        out[2 + _FIRST_EVEN + i - 1] += a
        slope += side * by_a * p[_FIRST_EVEN + i - 1]
    out[2 + _FIRST_EVEN + i] += b
    slope += side * by_b * p[_FIRST_EVEN + i]
    if not is_held:
        out[1] = slope / reach
        out[2 + _RANGE] = -slope * v / (reach * reach)


def _node(part: str, j: int) -> Parameter:
    return Parameter(
        name=f"tabulated_damping_{part}_{j}",
        unit="N",
        latex=f"D^{{{part}}}_{{{j}}}",
        summary=f"{part} part of the force at ({j}/{COUNT})^2 of the range" if j else "friction force at rest",
        role="strength" if (part, j) == ("odd", COUNT) else "ordinate",
        bounds=lambda mass, amplitude, angular_frequency: (
            -0.05 * mass * angular_frequency**2 * amplitude,
            0.05 * mass * angular_frequency**2 * amplitude,
        ),
        minimum=-np.inf,
    )


_NODES = (
    _node("odd", COUNT),
    *(_node("odd", j) for j in range(COUNT)),
    *(_node("even", j) for j in range(1, COUNT + 1)),
)


def _listed(part: str) -> str:
    return ", ".join(f"tabulated_damping_{part}_{j}" for j in range(part == "even", COUNT + 1))


EFFECT = Effect(
    name="tabulated_damping",
    summary="Damper of any shape, an odd and an even curve through node forces: what no named law holds.",
    text=f"sign(x') S({_listed('odd')}; |x'|/tabulated_damping_range) + S({_listed('even')}; "
    "|x'|/tabulated_damping_range), S the cubic spline through forces at (0/10)^2 to (10/10)^2, the even one 0 at 0",
    latex=r"\operatorname{sign}(\dot{x}) S("
    + ", ".join(f"D^{{odd}}_{{{j}}}" for j in range(COUNT + 1))
    + r", |\dot{x}| / V_t) + S("
    + ", ".join(f"D^{{even}}_{{{j}}}" for j in range(1, COUNT + 1))
    + r", |\dot{x}| / V_t)",
    parameters=(
        *_NODES,
        Parameter(
            name="tabulated_damping_range",
            unit="m/s",
            latex="V_t",
            summary="speed of the last node, beyond which the curve is straight; chosen, not measured",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (
                0.5 * amplitude * angular_frequency,
                2.0 * amplitude * angular_frequency,
            ),
        ),
    ),
    force=force,
    gradient=gradient,
    redundant=(("tabulated_damping_range", lambda mass, amplitude, angular_frequency: amplitude * angular_frequency),),
    references=(
        "Masri S. F., Caughey T. K. (1979) A nonparametric identification technique for nonlinear dynamic problems. "
        "Journal of Applied Mechanics 46(2), 433-447. doi:10.1115/1.3424568",
        "de Boor C. (1978) A Practical Guide to Splines. Springer. doi:10.1007/978-1-4612-6333-3",
    ),
    only_if_named=True,
    signature=Signature(
        frequency="Constant.",
        damping="Rises where the odd part is steeper than a straight line; falls where it is less steep.",
        offset="Zero without an even part, else as large as that moves the mid-line.",
        found_in="the remainder of a diagnosis, dampers known as a table",
        typical=lambda mass, amplitude, angular_frequency: (
            *(0.015 * mass * angular_frequency**2 * amplitude * (j / COUNT) ** 4 for j in (COUNT, *range(COUNT))),
            *(0.0 for _ in range(COUNT)),
            amplitude * angular_frequency,
        ),
        resembles=("quadratic_damping", "power_damping"),
    ),
)
