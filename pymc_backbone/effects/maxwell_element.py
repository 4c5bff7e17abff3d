"""Maxwell element: a spring in series with a damper, the arm of a Zener or a generalised Maxwell solid.

At one frequency it is a spring and a damper in parallel, which every oscillator has: the decay of one mode does not
tell it apart. It is in the library to be put into a model, and looked for in data only when it is named.
"""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]; z is the stretch of the spring [m]."""
    return p[0] * z[0]


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v, the parameters and z."""
    out[:] = 0.0
    out[2] = z[0]
    out[4] = p[0]


@numba.njit
def state_rate(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write dz/dt [m/s]; without a relaxation time the spring never stretches."""
    out[0] = v - z[0] / p[1] if p[1] > 0.0 else 0.0


@numba.njit
def state_rate_gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of dz/dt to x, v, the parameters and z."""
    out[:] = 0.0
    if p[1] > 0.0:
        out[0, 1] = 1.0
        out[0, 3] = z[0] / (p[1] * p[1])
        out[0, 4] = -1.0 / p[1]


EFFECT = Effect(
    name="maxwell_element",
    summary="Spring and damper in series: a constant damping and a stiffer spring at every amplitude.",
    text="arm_stiffness z; z' = x' - z / arm_time",
    latex=r"k_a z; \dot{z} = \dot{x} - z / \tau_a",
    parameters=(
        Parameter(
            name="arm_stiffness",
            unit="N/m",
            latex="k_a",
            summary="stiffness of the spring",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, mass * angular_frequency**2),
        ),
        Parameter(
            name="arm_time",
            unit="s",
            latex=r"\tau_a",
            summary="relaxation time: the damper's coefficient over the stiffness of the spring",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.1 / angular_frequency, 10.0 / angular_frequency),
        ),
    ),
    force=force,
    gradient=gradient,
    n_states=1,
    state_rate=state_rate,
    state_rate_gradient=state_rate_gradient,
    references=(
        "Nashif A. D., Jones D. I. G., Henderson J. P. (1985) Vibration Damping. Wiley",
        "Christensen R. M. (1982) Theory of Viscoelasticity, 2nd ed. Academic Press",
    ),
    only_if_named=True,
    signature=Signature(
        frequency="Constant.",
        damping="Constant.",
        offset="Zero.",
        found_in="viscoelastic layers, rubber mounts, dampers on a soft support",
        typical=lambda mass, amplitude, angular_frequency: (
            0.02 * mass * angular_frequency**2,
            1.0 / angular_frequency,
        ),
        resembles=("viscous_damping", "linear_stiffness"),
    ),
)
