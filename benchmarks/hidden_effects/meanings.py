"""What may rightly be said about what is hidden: names of laws, and mechanisms where no law is exact.

A *name* is right where the named law is the hidden one at the parameters that were drawn: by its own name, or by that
of a law with as many parameters or fewer that is the same there (`same_laws`). Dahl friction is right as Bouc-Wen's law
as well, which is what the package looks for in its place. The law that a variant varies, such as quadratic damping for
an exponent of 1.5, is a wrong name; that it is of the right mechanism is told beside it.

A *mechanism* is right where it is true of the hidden force in the words that a user reads, not where it merely fits.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

from systems import LIBRARY_NAMES_OF_OUTSIDE, OUTSIDE

WORDS: dict[str, str] = {
    "cubic_stiffness": "spring",
    "quintic_stiffness": "spring",
    "pendulum_stiffness": "spring",
    "power_stiffness": "spring",
    "magnetic_stiffness": "spring",
    "geometric_stiffness": "spring",
    "quadratic_stiffness": "asymmetry",
    "bilinear_stiffness": "asymmetry",
    "freeplay": "clearance",
    "offset_freeplay": "clearance",
    "one_sided_stiffness": "clearance",
    "hertz_contact": "clearance",
    "damped_stop": "clearance",
    "coulomb_friction": "hysteresis",
    "jenkins": "hysteresis",
    "iwan": "hysteresis",
    "bouc_wen": "hysteresis",
    "dahl_friction": "hysteresis",
    "stribeck_friction": "hysteresis",
    "structural_damping": "hysteresis",
    "quadratic_damping": "drag",
    "cubic_damping": "drag",
    "power_damping": "drag",
    "asymmetric_drag": "drag",
    "bilinear_damping": "damping_asymmetry",
    "displacement_dependent_damping": "displacement_damping",
    "absolute_displacement_damping": "displacement_damping",
    "power_displacement_damping": "displacement_damping",
    "dead_band_damping": "displacement_damping",
    "mid_stroke_damping": "falling_damping",
    "speed_limited_damping": "falling_damping",
    "nonlinear_inertia": "inertia",
    "maxwell_element": "other",
}
"""The mechanism of each effect in the words of the package."""

EITHER = {
    "rising_damping": {"drag", "displacement_damping"},
    "changing_stiffness": {"spring", "clearance"},
    "changing_frequency": {"spring", "inertia"},
}
"""What is said where one of two mechanisms is certain, but not which."""

_RIGHTLY: dict[str, set[str]] = {
    # Contacts on one side, or off the middle, make a spring that differs between the sides.
    "offset_freeplay": {"clearance", "asymmetry"},
    "one_sided_stiffness": {"clearance", "asymmetry"},
    "hertz_contact": {"clearance", "asymmetry"},
    # The square of the speed alike in both directions moves the mid-line, as below.
    "asymmetric_drag": {"drag", "asymmetry"},
    # A magnet on one side pulls with even powers of the displacement first, and softens with the third.
    "magnetic_attraction": {"asymmetry", "spring"},
    # Net damping is small at low speed and rises to the viscous damper's at high speed.
    "limited_negative_damping": {"drag"},
    "damped_stop": {"clearance", "asymmetry", "displacement_damping"},
    # A stop on one side whose damping acts while it touches, and grows with how far it is pressed.
    "impact_stop": {"clearance", "asymmetry", "displacement_damping"},
    # In the coordinate in which the inertia is constant the same motion has a spring that hardens or softens.
    "displacement_dependent_inertia": {"inertia", "spring"},
    # The damper acts beyond a displacement. Nothing touches that has a stiffness, so it is no contact.
    "deadband_damper": {"displacement_damping"},
    # Half of it is drag in both directions; the other half, the square of the speed on both, moves the mid-line with
    # the amplitude as a quadratic spring does, and is one in another coordinate.
    "one_way_drag": {"drag", "asymmetry"},
}
"""Mechanisms of laws of which more than one may be said, or that have no name in the package; with the reason."""

BASE_IMITATES = "maxwell_element"
"""One mode's decay does not show it: beside linear spring and viscous damper there is nothing to be found."""
_CLOSE = 0.03
"""Difference of exponents that changes a force by less than 1 % of its peak: at most 0.03 |u^n log u|."""
_HARDLY = 0.01
"""Share of the amplitude, or of a gap, that does the same."""


class Meaning(NamedTuple):
    """What is hidden, and what may rightly be said about it.

    Attributes
    ----------
    hidden : frozenset of str
        In the package's names, without what the base imitates.
    is_in_library : bool
        Whether that is all that acts.
    accepted : set of frozenset of str
        Sets whose name is right; the empty one where nothing can be found.
    mechanisms : set of str
        That may be named.
    needed : set of str
        One of these must be among those named.
    """

    hidden: frozenset[str]
    is_in_library: bool
    accepted: set[frozenset[str]]
    mechanisms: set[str]
    needed: set[str]

    @property
    def is_answerable(self) -> bool:
        """Whether there is a set that is right."""
        return bool(self.accepted)

    def allows(self, kinds: set[str]) -> bool:
        """Return whether these mechanisms may all be named, and hold one that must be."""
        known = all(EITHER.get(kind, {kind}) & self.mechanisms for kind in kinds)
        return known and any(EITHER.get(kind, {kind}) & self.needed for kind in kinds)

    def is_kindred(self, names: frozenset[str]) -> bool:
        """Return whether the laws of a set are of mechanisms that may be named."""
        return bool(names) and self.allows({WORDS.get(name, "other") for name in names})


def rightly(law: str, nominal: Mapping[str, float]) -> set[str]:
    """Return the mechanisms that a law may rightly be called."""
    exponent = 0.5 if law == "root_damping" else nominal.get("power_damping_exponent", 2.0)
    if law in ("power_damping", "root_damping") and exponent < 1.0:
        # The force rises with the speed, and the decrement falls with the amplitude as that of friction does.
        return {"drag", "hysteresis"}
    if WORDS.get(law) == "falling_damping" and nominal.get(law, 1.0) < 0.0:  # taken away where motion is small
        return {"drag" if law == "speed_limited_damping" else "displacement_damping"}
    return _RIGHTLY.get(law) or {WORDS.get(law, "other")}


def same_laws(effect: str, nominal: Mapping[str, float], amplitude: float) -> set[frozenset[str]]:
    """Return what else the package may call an effect at these parameters, or none at all, over this amplitude."""
    found: set[str] = set()
    if effect == BASE_IMITATES:
        return {frozenset()}
    if effect == "dahl_friction":
        found = {"bouc_wen"}
    elif effect == "power_damping":
        powers = {2: "quadratic_damping", 3: "cubic_damping"}
        found = {name for n, name in powers.items() if abs(nominal.get(f"{effect}_exponent", 0.5) - n) < _CLOSE}
    elif effect == "power_displacement_damping":
        powers = {1: "absolute_displacement_damping", 2: "displacement_dependent_damping"}
        found = {name for n, name in powers.items() if abs(nominal["displacement_exponent"] - n) < _CLOSE}
    elif effect == "power_stiffness":
        powers = {3: "cubic_stiffness", 5: "quintic_stiffness"}
        found = {name for n, name in powers.items() if abs(nominal[f"{effect}_exponent"] - n) < _CLOSE}
    elif effect == "offset_freeplay":
        off = abs(nominal["play_asymmetry"])
        if off < _HARDLY:
            found = {"freeplay"}
        if nominal["play"] * (1.0 + off) >= amplitude:  # the farther stop is never reached
            found |= {"one_sided_stiffness"}
    elif effect == "one_sided_stiffness" and abs(nominal["stop_gap"]) < _HARDLY * amplitude:
        found = {"bilinear_stiffness"}
    return {frozenset((name,)) for name in found}


def meaning_of(truth: Mapping[str, Any]) -> Meaning:
    """Return what may be said about a batch; also of those written before its effects were in the library.

    Parameters
    ----------
    truth : mapping
        As ``truth.json`` holds it.

    Returns
    -------
    Meaning
    """
    nominal, amplitude = truth.get("nominal") or {}, float(truth.get("amplitude") or 0.0)
    outside = truth.get("outside")
    own_name = LIBRARY_NAMES_OF_OUTSIDE.get(outside or "")
    hidden = frozenset((*truth["hidden"], *((own_name,) if own_name else ())))
    in_library = not (outside and not own_name) and not truth.get("drift") and not truth.get("second_mode")
    accepted: set[frozenset[str]] = set()
    if in_library or hidden:
        choices = [{frozenset((name,))} | same_laws(name, nominal, amplitude) for name in hidden]
        accepted = {frozenset().union(*sets) for sets in itertools.product(*choices)}
    needed = set().union(*(rightly(name, nominal) for name in hidden if name != own_name))
    if outside:
        needed |= rightly(outside, nominal)
    needed.discard("other")
    allowed = set(needed)
    for law in set(truth.get("contaminations") or ()) & set(OUTSIDE):  # acts as well, and may be named as well
        allowed |= rightly(law, nominal)
        name = LIBRARY_NAMES_OF_OUTSIDE.get(law)
        accepted |= {names | {name} for names in accepted} if name else set()
    return Meaning(hidden - {BASE_IMITATES}, in_library, accepted, allowed, needed)
