"""Damping with any power of the speed.

The force is given at a reference speed, so that its size does not change by orders of magnitude with the exponent. At a
reference speed of 1 m/s it is the coefficient c of c |v|^p. Below a few thousandths of that speed the law is rounded:
with an exponent below 1 it would have a vertical tangent at every turning point.
"""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature

_ROUND = 1e-3  # of the reference speed: the tangent at rest is finite, the loss of a cycle the same within 1e-5


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[2] <= 0.0:
        return 0.0
    u = v / p[2]
    return p[0] * u * (u * u + _ROUND * _ROUND) ** (0.5 * (p[1] - 1.0))


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    if p[2] <= 0.0:
        return
    u = v / p[2]
    square = u * u + _ROUND * _ROUND
    power = square ** (0.5 * (p[1] - 1.0))
    out[1] = p[0] / p[2] * power * (1.0 + (p[1] - 1.0) * u * u / square)
    out[2] = u * power
    out[3] = 0.5 * p[0] * u * power * math.log(square)
    out[4] = -u * out[1]


EFFECT = Effect(
    name="power_damping",
    summary="Damping with a power of the speed: damping goes with the amplitude to that power less one.",
    text="power_damping u (u^2 + 0.001^2)^((power_damping_exponent - 1)/2); u = x'/power_damping_speed",
    latex=r"F_d u \left(u^2 + 0.001^2\right)^{(p_d - 1)/2}; u = \dot{x} / v_d",
    parameters=(
        Parameter(
            name="power_damping",
            unit="N",
            latex="F_d",
            summary="magnitude of the force at the reference speed",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.25 * mass * angular_frequency**2 * amplitude),
        ),
        Parameter(
            name="power_damping_exponent",
            unit="-",
            latex="p_d",
            summary="power of the speed: 0 dry friction, 1 viscous, 2 drag",
            role="exponent",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 3.5),
        ),
        Parameter(
            name="power_damping_speed",
            unit="m/s",
            latex="v_d",
            summary="reference speed; chosen, not measured",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (
                0.5 * amplitude * angular_frequency,
                2.0 * amplitude * angular_frequency,
            ),
        ),
    ),
    force=force,
    gradient=gradient,
    redundant=(("power_damping_speed", lambda mass, amplitude, angular_frequency: amplitude * angular_frequency),),
    references=(
        "Elliott S. J., Ghandchi Tehrani M., Langley R. S. (2015) Nonlinear damping and quasi-linear modelling. "
        "Philosophical Transactions of the Royal Society A 373, 20140402. doi:10.1098/rsta.2014.0402",
    ),
    mechanism="drag",
    mechanism_below=("power_damping_exponent", 1.0, "hysteresis"),  # damping falls with the speed, as by dry friction
    variant_of=("quadratic_damping", "cubic_damping", "coulomb_friction"),
    signature=Signature(
        frequency="Constant.",
        damping="Rises with the amplitude to the power of the exponent less one; falls where the exponent is below 1.",
        offset="Zero.",
        found_in="drag between laminar and turbulent flow, hydraulic dampers, seals",
        typical=lambda mass, amplitude, angular_frequency: (
            0.015 * mass * angular_frequency**2 * amplitude,
            1.5,
            amplitude * angular_frequency,
        ),
        resembles=("quadratic_damping", "cubic_damping", "coulomb_friction"),
    ),
)
