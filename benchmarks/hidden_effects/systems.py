"""What can act in the systems whose decays are generated, and their parameters as one vector.

Nothing here comes from the package under test. A system is a flat vector of parameters in the order of `PARAMETERS`;
a parameter of zero switches its effect off. `laws.py` holds the forces.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

LIBRARY: dict[str, tuple[str, ...]] = {
    "bilinear_stiffness": ("bilinear_stiffness",),
    "bouc_wen": (
        "bouc_wen_stiffness",
        "bouc_wen_amplitude",
        "bouc_wen_alpha",
        "bouc_wen_beta",
        "bouc_wen_gamma",
        "bouc_wen_exponent",
    ),
    "coulomb_friction": ("friction_force",),
    "cubic_damping": ("cubic_damping",),
    "cubic_stiffness": ("cubic_stiffness",),
    "displacement_dependent_damping": ("displacement_dependent_damping",),
    "freeplay": ("contact_stiffness", "gap"),
    "iwan": ("joint_stiffness", "joint_slip_force", "joint_exponent"),
    "jenkins": ("slider_stiffness", "slip_force"),
    "pendulum_stiffness": ("pendulum_stiffness",),
    "quadratic_damping": ("quadratic_damping",),
    "quadratic_stiffness": ("quadratic_stiffness",),
    "quintic_stiffness": ("quintic_stiffness",),
}
"""Effects that the package looks for, with its names of their parameters; what most kinds of batches hide."""

NEW: dict[str, tuple[str, ...]] = {
    "absolute_displacement_damping": ("absolute_displacement_damping",),
    "dahl_friction": ("dahl_stiffness", "dahl_force"),
    "hertz_contact": ("hertz_stiffness", "hertz_gap"),
    "magnetic_stiffness": ("magnet_force", "magnet_distance", "magnet_exponent"),
    "maxwell_element": ("arm_stiffness", "arm_time"),
    "offset_freeplay": ("play_stiffness", "play", "play_asymmetry"),
    "one_sided_stiffness": ("stop_stiffness", "stop_gap"),
    "power_damping": ("power_damping", "power_damping_exponent", "power_damping_speed"),
    "power_stiffness": ("power_stiffness", "power_stiffness_exponent", "power_stiffness_displacement"),
    "stribeck_friction": ("kinetic_friction", "stribeck_excess", "stribeck_speed"),
    "structural_damping": ("structural_damping",),
    "asymmetric_drag": ("asymmetric_drag", "drag_asymmetry"),  # last: batches of the others stay what they were
    "bilinear_damping": ("bilinear_damping",),
    "nonlinear_inertia": ("nonlinear_inertia",),
    "power_displacement_damping": ("power_displacement_damping", "displacement_exponent", "damping_displacement"),
    "dead_band_damping": ("dead_band_damping", "dead_band"),
    "mid_stroke_damping": ("mid_stroke_damping", "mid_stroke"),
    "speed_limited_damping": ("speed_limited_damping", "critical_speed"),
    "damped_stop": ("damped_stop_stiffness", "damped_stop_gap", "stop_loss"),
    "geometric_stiffness": ("geometric_stiffness", "inclined_length"),
}
"""Effects that the package holds beside these, as variants or to be named, with its names of their parameters."""

OUTSIDE: dict[str, tuple[str, ...]] = {
    "magnetic_attraction": ("magnet_strength", "magnet_distance"),
    "root_damping": ("root_damping",),
    "structural_damping": ("structural_damping",),
    "limited_negative_damping": ("negative_damping", "negative_damping_speed"),
    "stribeck_friction": ("stribeck_kinetic", "stribeck_static", "stribeck_speed"),
    "impact_stop": ("stop_stiffness", "stop_gap", "stop_damping"),
    "displacement_dependent_inertia": ("inertia_growth",),
    "deadband_damper": ("deadband_damping", "deadband"),
    "one_way_drag": ("one_way_drag",),
}
"""Laws drawn as lying outside of the library, in parameters of their own; see `LIBRARY_NAMES_OF_OUTSIDE`."""

LIBRARY_NAMES_OF_OUTSIDE: dict[str, str] = {
    "root_damping": "power_damping",
    "stribeck_friction": "stribeck_friction",
    "structural_damping": "structural_damping",
    "one_way_drag": "asymmetric_drag",
    "displacement_dependent_inertia": "nonlinear_inertia",
    "deadband_damper": "dead_band_damping",
    "impact_stop": "damped_stop",
    "limited_negative_damping": "speed_limited_damping",
}
"""Laws of `OUTSIDE` that an effect of the package describes by now: the same force, written in other parameters, or
with an exponent of one half, an asymmetry of one, a band of sharp edge, or a coefficient below zero. A magnet on one
side is not the package's pair of magnets: its force has even powers."""

BASE: tuple[str, ...] = ("linear_stiffness", "linear_stiffness_rate", "viscous_damping", "viscous_damping_rate")

PARAMETERS: tuple[str, ...] = (
    "mass",
    *BASE,
    *dict.fromkeys(name for effects in (LIBRARY, OUTSIDE, NEW) for effect in effects.values() for name in effect),
)
"""Names of all parameters, in the order of the vector that the compiled functions take."""

INDEX: dict[str, int] = {name: index for index, name in enumerate(PARAMETERS)}
"""Where each stands."""


def pack(parameters: Mapping[str, float]) -> np.ndarray:
    """Return the vector of a system from named parameters; those not named are zero.

    Parameters
    ----------
    parameters : mapping of str to float
        SI units; must hold ``mass`` and ``linear_stiffness``.

    Returns
    -------
    ndarray, shape (len(PARAMETERS),)

    Raises
    ------
    KeyError
        If a name is not one of `PARAMETERS`.
    """
    vector = np.zeros(len(PARAMETERS))
    for name, value in parameters.items():
        vector[INDEX[name]] = value
    if "kinetic_friction" in parameters:  # the package's way to write the law of `OUTSIDE`
        kinetic = parameters["kinetic_friction"]
        vector[INDEX["stribeck_kinetic"]] = kinetic
        vector[INDEX["stribeck_static"]] = kinetic * (1.0 + parameters["stribeck_excess"])
    return vector
