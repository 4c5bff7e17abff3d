r"""Bed of elastic sliders (Iwan, Segalman): micro-slip of a joint, in closed form.

The strengths of the sliders follow the power law :math:`\rho(\phi) = R \phi^\chi` up to :math:`\phi_{max}`
(Segalman's density without the delta at its end). Loading an unstressed bed by :math:`u \ge 0` gives

.. math:: V(u) = K_T u \left[1 - \frac{(u/\phi_{max})^{\chi+1}}{\chi + 2}\right], \qquad
          \phi_{max} = \frac{F_s (\chi + 2)}{K_T (\chi + 1)},

and :math:`F_s` beyond :math:`\phi_{max}`, with a continuous slope. After a turning point :math:`(x_r, f_r)` the bed
follows Masing's rule, :math:`f_r + 2 V((x - x_r)/2)`. In a free decay every turning point lies between the two before
it, so no loop is ever closed and no earlier turning point has to be remembered: the rule is exact.

For :math:`\chi < 0` the slope has a vertical tangent at the turning point (:math:`V'' \sim u^\chi`).
"""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def _slip_ratio(u: float, p: FloatArray) -> float:
    """Return |u| / phi_max, or 1 in full slip; written so that zero stiffness or strength gives no 0/0."""
    push = abs(u) * p[0] * (p[2] + 1.0)
    strength = p[1] * (p[2] + 2.0)
    return 1.0 if push >= strength else push / strength


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 0 while some sliders stick and the direction of motion when all slip."""
    scale = 2.0 if z[2] > 0.5 else 1.0
    return int(direction) if _slip_ratio((x - z[0]) / scale, p) >= 1.0 else 0


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]; odd in ``x - x_r``, so finite and smooth when a step overruns a turning point."""
    scale = 2.0 if z[2] > 0.5 else 1.0
    u = (x - z[0]) / scale
    ratio = _slip_ratio(u, p)
    if ratio >= 1.0:
        return z[1] + scale * math.copysign(p[1], u)
    return z[1] + scale * p[0] * u * (1.0 - ratio ** (p[2] + 1.0) / (p[2] + 2.0))


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v, the parameters and the memory."""
    scale = 2.0 if z[2] > 0.5 else 1.0
    u = (x - z[0]) / scale
    ratio = _slip_ratio(u, p)
    out[:] = 0.0
    out[6] = 1.0
    if ratio >= 1.0:
        out[3] = scale * math.copysign(1.0, u)
    else:
        slipped = ratio ** (p[2] + 1.0)
        out[0] = p[0] * (1.0 - slipped)
        out[2] = scale * u * (1.0 - slipped)
        out[3] = scale * math.copysign(ratio * slipped, u)
        if ratio > 0.0:
            out[4] = -scale * p[0] * u * slipped * math.log(ratio) / (p[2] + 2.0)
        out[5] = -out[0]


EFFECT = Effect(
    name="iwan",
    summary="Micro-slip of a joint: damping rises with amplitude to the power chi + 1, frequency falls with it.",
    text="f_i; f_i = f_r + 2 V((x - x_r)/2) from the last turning point (x_r, f_r), V(x) before the first; "
    "V(u) = joint_stiffness u (1 - (|u|/u_s)^(joint_exponent + 1) / (joint_exponent + 2)) up to "
    "u_s = joint_slip_force (joint_exponent + 2) / (joint_stiffness (joint_exponent + 1)), "
    "joint_slip_force sign(u) beyond",
    latex=r"f_i; f_i = f_r + 2 V\left(\tfrac{x - x_r}{2}\right); "
    r"V(u) = K_T u \left[1 - \frac{(|u|/u_s)^{\chi + 1}}{\chi + 2}\right] \le F_s; "
    r"u_s = \frac{F_s (\chi + 2)}{K_T (\chi + 1)}",
    parameters=(
        Parameter(
            name="joint_stiffness",
            unit="N/m",
            latex="K_T",
            summary="stiffness of the joint while no slider slips",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, mass * angular_frequency**2),
        ),
        Parameter(
            name="joint_slip_force",
            unit="N",
            latex="F_s",
            summary="force at which the whole joint slips",
            role="slip_force",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, mass * angular_frequency**2 * amplitude),
        ),
        Parameter(
            name="joint_exponent",
            unit="-",
            latex=r"\chi",
            summary="exponent of the distribution of slider strengths; at -1 the joint carries nothing",
            role="exponent",
            bounds=lambda mass, amplitude, angular_frequency: (-0.9, 0.0),
            minimum=-1.0,
            maximum=0.0,
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    has_memory=True,
    n_states=3,
    references=(
        "Segalman D. J. (2005) A four-parameter Iwan model for lap-type joints. "
        "Journal of Applied Mechanics 72(5), 752-760. doi:10.1115/1.1989354",
        "Iwan W. D. (1966) A distributed-element model for hysteresis and its steady-state dynamic response. "
        "Journal of Applied Mechanics 33(4), 893-900. doi:10.1115/1.3625199",
    ),
    mechanism="hysteresis",
    signature=Signature(
        frequency="Falls slowly with the amplitude, as ever more of the contact slips.",
        damping="Rises with the amplitude to the power chi + 1.",
        offset="Zero.",
        found_in="bolted lap joints in micro-slip, before they slip as a whole",
        typical=lambda mass, amplitude, angular_frequency: (
            0.3 * mass * angular_frequency**2,
            0.3 * mass * angular_frequency**2 * amplitude,
            -0.5,
        ),
        resembles=("bouc_wen", "jenkins", "quadratic_damping"),
    ),
)
