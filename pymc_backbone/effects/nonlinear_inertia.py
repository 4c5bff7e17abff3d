"""Nonlinear inertia: mass that moves the more the larger the displacement, as of a cantilever that bends far."""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def added_mass(x: float, p: FloatArray) -> float:
    """Return the mass that moves along [kg]."""
    return p[0] * x * x


@numba.njit
def added_mass_gradient(x: float, p: FloatArray, out: FloatArray) -> None:
    """Write its derivatives to x and the parameter."""
    out[0] = 2.0 * p[0] * x
    out[1] = x * x


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N] that the kinetic energy of the added mass asks for beside it."""
    return p[0] * x * v * v


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = p[0] * v * v
    out[1] = 2.0 * p[0] * x * v
    out[2] = x * v * v


EFFECT = Effect(
    name="nonlinear_inertia",
    summary="Mass that moves along: frequency falls with amplitude squared, third harmonic three times a spring's.",
    text="nonlinear_inertia (x^2 x'' + x x'^2)",
    latex=r"m_2 \left(x^2 \ddot{x} + x \dot{x}^2\right)",
    parameters=(
        Parameter(
            name="nonlinear_inertia",
            unit="kg/m^2",
            latex="m_2",
            summary="mass that moves along, over displacement squared; negative takes away",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -0.4 * mass / amplitude**2,  # of the mass at the largest displacement more than half stays
                1.0 * mass / amplitude**2,
            ),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    added_mass=added_mass,
    added_mass_gradient=added_mass_gradient,
    references=(
        "Nayfeh A. H., Pai P. F. (2004) Linear and Nonlinear Structural Mechanics. Wiley. doi:10.1002/9783527617562",
        "Crespo da Silva M. R. M., Glynn C. C. (1978) Nonlinear flexural-flexural-torsional dynamics of inextensional "
        "beams. Journal of Structural Mechanics 6, 437-461. doi:10.1080/03601217808907348",
    ),
    mechanism="inertia",
    variant_of=("cubic_stiffness",),
    signature=Signature(
        frequency="Falls in proportion to the amplitude squared.",
        damping="Falls in proportion to the amplitude squared, by about half as much as the frequency.",
        offset="Zero.",
        found_in="cantilevers that bend far, masses on links, liquid columns",
        typical=lambda mass, amplitude, angular_frequency: (0.3 * mass / amplitude**2,),
        resembles=("cubic_stiffness", "pendulum_stiffness"),
    ),
)
