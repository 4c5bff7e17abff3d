"""The records that describe an effect: one named physical force term and its parameters."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, get_args

import numba
import numpy as np

from .._common.checks import FloatArray, InputError, check_choice

BoundsFunction = Callable[[float, float, float], tuple[float, float]]
TypicalFunction = Callable[[float, float, float], tuple[float, ...]]
HeldFunction = Callable[[float, float, float], float]
Role = Literal["strength", "slip_force", "gap", "exponent", "power_coefficient", "shape", "ordinate", "plain"]
ROLES: tuple[Role, ...] = get_args(Role)
Mechanism = Literal[
    "spring",
    "asymmetry",
    "clearance",
    "hysteresis",
    "drag",
    "displacement_damping",
    "falling_damping",
    "damping_asymmetry",
    "inertia",
]
MECHANISMS: Mapping[str, str] = MappingProxyType(
    {
        "spring": "hardening or softening of the spring",
        "asymmetry": "a spring that differs between the two sides",
        "clearance": "clearance or contact",
        "hysteresis": "friction-like hysteresis",
        "drag": "damping that rises with speed",
        "displacement_damping": "damping that rises with displacement",
        "falling_damping": "damping that falls with displacement or speed",
        "damping_asymmetry": "a damper that differs between the two directions",
        "inertia": "inertia that changes with the displacement",
        "other": "another mechanism",
        "rising_damping": "damping that rises with the amplitude",
        "changing_stiffness": "stiffness that changes with the amplitude",
        "changing_frequency": "a spring or an inertia that changes with the amplitude",
    }
)
"""What effects have in common, in words; `other` is of effects that do not say, the last three are either of two."""
EITHER: Mapping[str, tuple[Mechanism, Mechanism]] = MappingProxyType(
    {
        "rising_damping": ("drag", "displacement_damping"),
        "changing_stiffness": ("spring", "clearance"),
        "changing_frequency": ("spring", "inertia"),
    }
)
"""Mechanisms that backbones may be unable to tell apart, while one of the two is certain."""
FUNCTIONS = (
    "force", "gradient", "regime", "remembered", "remembered_gradient", "state_rate", "state_rate_gradient",
    "added_mass", "added_mass_gradient",
)  # fmt: skip
"""What of an effect is compiled."""
_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")


@dataclass(frozen=True)
class Parameter:
    """One physical parameter of an effect.

    Parameters
    ----------
    name : str
        Lower-case identifier, unique over all effects of an oscillator.
    unit : str
        SI unit as text, for example ``"N/m^3"``; for a rotation read N as N m and m as rad.
    latex : str
        Symbol in LaTeX without dollar signs.
    summary : str
        One line saying what it is.
    bounds : callable
        ``bounds(mass, amplitude, angular_frequency) -> (low, high)``: default bounds of a Uniform
        prior, scaled with the record (kg, m, rad/s).
    minimum, maximum : float
        Physical limits; priors must lie inside.
    role : {"plain", "strength", "slip_force", "gap", "exponent", "power_coefficient", "shape", "ordinate"}
        What the parameter is to its effect; see Notes.

    See Also
    --------
    Effect : what has parameters.

    Notes
    -----
    Only the search for a missing effect asks for roles; units and symbols are for people and decide nothing.

    ``strength``
        The effect is gone where it is zero. Fits begin with it small, its prior is as wide as what is found asks for,
        and the smallest strength that the data would show is reported. Every effect with parameters has exactly one;
        where none is declared, it is the first plain parameter.
    ``slip_force``
        Force at which the spring, whose stiffness is the strength, slips. The two are fitted as slip force and slip
        displacement over the amplitude of the records, so that a stiff slider and dry friction are neighbours. With
        an exponent the slip is gradual, without it is sudden; the larger slip displacements are left out accordingly.
    ``gap``
        Displacement at which the force sets in; fitted as it stands.
    ``exponent``
        Without a unit; it does not leave its default bounds.
    ``power_coefficient``
        Multiplies displacement to the power of the effect's one exponent. Fitted as its product with that power of
        the amplitude of the records, or it would change by orders of magnitude with the exponent. Its default bounds
        are those at an exponent of one.
    ``shape``
        Says how, not how much; it does not leave its default bounds.
    ``ordinate``
        One of the forces through which a tabulated curve goes; the curve is linear in them and gone where all of them
        and the strength are zero. What has ordinates holds any force, so it is no candidate.
    ``plain``
        Fitted as it stands, and may leave its default bounds.
    """

    name: str
    unit: str
    latex: str
    summary: str
    bounds: BoundsFunction
    minimum: float = 0.0
    maximum: float = np.inf
    role: Role = "plain"

    def __post_init__(self) -> None:
        check_choice("role", self.role, ROLES)
        if not _NAME.match(self.name):
            raise InputError(f"parameter name {self.name!r} must be lower-case letters, digits and underscores.")
        if not self.minimum < self.maximum:
            raise InputError(f"parameter {self.name!r} needs minimum < maximum, got {self.minimum} and {self.maximum}.")


TRENDS = ("Rises, then falls", "Rises", "Falls", "Constant", "Zero")
"""How the description of a curve over rising amplitude begins."""


@dataclass(frozen=True)
class Signature:
    """How free decays show an effect, in words for people; the catalogue of effects is made of it.

    Parameters
    ----------
    frequency, damping, offset : str
        What the curve does as the amplitude rises, for the values of ``typical`` beside a linear spring and a light
        viscous damper. Each begins with one of `TRENDS`, which a test compares with the simulation.
    found_in : str
        Structures that show it.
    typical : callable
        ``typical(mass, amplitude, angular_frequency)``: parameter values that show it well, in the order of ``p``.
    resembles : tuple of str
        Effects of the library whose curves are easily taken for these.

    See Also
    --------
    Effect : what has a signature.
    """

    frequency: str
    damping: str
    offset: str
    found_in: str
    typical: TypicalFunction
    resembles: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for label in ("frequency", "damping", "offset"):
            words = getattr(self, label)
            if not words.startswith(TRENDS):
                raise InputError(f"`{label}` of a signature must begin with {', '.join(TRENDS)}; got {words!r}.")


@dataclass(frozen=True)
class Effect:
    """One named physical force term of an oscillator.

    The equation of motion is ``(mass + sum of added masses) * x'' + sum of forces = 0``. All functions are compiled
    (`numba.njit`) functions of scalars and small arrays; see ``docs/architecture.md``.

    Parameters
    ----------
    name : str
        Lower-case identifier, for example ``"cubic_stiffness"``.
    summary : str
        One line saying what it is and how backbones show it.
    text, latex : str
        The force as plain text and as LaTeX, written with the parameter names and symbols.
    parameters : tuple of Parameter
        In the order in which ``p`` holds them.
    force : callable
        ``force(x, v, direction, z, p) -> float`` in newtons.
    gradient : callable, optional
        ``gradient(x, v, direction, z, p, out)``: dF/dx, dF/dv, dF/dp..., dF/dz... into ``out``.
        Without it compiled central differences are used.
    regime : callable, optional
        ``regime(x, v, direction, z, p) -> int``: label of the smooth branch, for forces with kinks.
    has_memory : bool
        Whether the force depends on the last turning point, kept in ``z = [x_r, f_r, branch]``.
    remembered, remembered_gradient : callable, optional
        ``remembered(x, v, direction, z, p) -> float``: what an effect with memory keeps as ``f_r``, where its force
        does not tell what goes on, as that of a spring of no stiffness; the gradient is written as that of the force.
    n_states : int
        Number of internal states ``z`` (3 with memory).
    state_rate : callable, optional
        ``state_rate(x, v, direction, z, p, out)``: dz/dt into ``out``.
    state_rate_gradient : callable, optional
        ``state_rate_gradient(x, v, direction, z, p, out)``: its derivatives into
        ``out[n_states, 2 + n_p + n_states]``, columns x, v, p..., z....
    n_room : int
        How many numbers of room follow the parameters in ``p``, for what is worked out once and used again. They are
        zero when a simulation begins and belong to it alone; see `with_room`.
    added_mass : callable, optional
        ``added_mass(x, p) -> float``: mass that moves along at a displacement [kg]. ``force`` is what the kinetic
        energy of that mass asks for beside it, ``dm/dx v^2 / 2``.
    added_mass_gradient : callable, optional
        ``added_mass_gradient(x, p, out)``: dm/dx, dm/dp... into ``out``; both or neither.
    references : tuple of str
        Where the force law comes from.
    redundant : tuple of (str, float or callable)
        Parameters that no free decay can tell from the others, each with the value at which it is held when the
        effect is looked for in data: a number, or ``value(mass, amplitude, angular_frequency)`` where it is scaled
        with the record as default bounds are.
    opposed : tuple of (str, str)
        Parameters that are not below minus another one where the effect is looked for in data: beyond, the force is
        no longer bounded for a bounded motion. Nor are they above three times it: beyond, hardly anything dissipates,
        and the effect imitates a spring.
    signature : Signature, optional
        How decays show it; every effect of the library has one.
    needs_rotation : bool
        Whether the law holds for an angle only, as that of a pendulum does: it is looked for where the motion is
        measured in radians, and elsewhere only when it is named.
    mechanism : str, optional
        What the effect does, whatever its law, a key of `MECHANISMS`: where records do not tell one law from another,
        that is named. Effects without one count together as another mechanism.
    mechanism_below : tuple of (str, float, str), optional
        A parameter, and the mechanism that the effect has where that is below a value; a gap in amplitudes.
    variant_of : tuple of str
        Names of the effects of the library that this is a variant of: the search for a missing effect looks for it in
        the place of each of them, where a set that holds that one comes near the records, or where its backbones are as
        likely as those of the most probable set, and not by itself. Named as a candidate, it is looked for as any
        other.
    reduces_to : tuple of str
        Names of variants with fewer parameters that this one is at an end of its range, as a play is a stop on one side
        where its other side is never reached: where it explains no more than these, they are named.
    only_if_named : bool
        Whether the effect is looked for only when it is named as a candidate, or where nothing else explains the
        samples: because the backbones of one mode do not tell it from the linear spring and the viscous damper that
        every oscillator has, or because it is a case of another effect that is looked for.

    See Also
    --------
    LIBRARY : the effects that there are.
    Oscillator : a mass with effects.
    """

    name: str
    summary: str
    text: str
    latex: str
    parameters: tuple[Parameter, ...]
    force: Callable[..., Any]
    gradient: Callable[..., Any] | None = None
    regime: Callable[..., Any] | None = None
    has_memory: bool = False
    n_states: int = 0
    remembered: Callable[..., Any] | None = None
    remembered_gradient: Callable[..., Any] | None = None
    state_rate: Callable[..., Any] | None = None
    state_rate_gradient: Callable[..., Any] | None = None
    n_room: int = 0
    added_mass: Callable[..., Any] | None = None
    added_mass_gradient: Callable[..., Any] | None = None
    references: tuple[str, ...] = ()
    redundant: tuple[tuple[str, float | HeldFunction], ...] = ()
    opposed: tuple[tuple[str, str], ...] = ()
    signature: Signature | None = None
    needs_rotation: bool = False
    mechanism: Mechanism | None = None
    mechanism_below: tuple[str, float, Mechanism] | None = None
    variant_of: tuple[str, ...] = ()
    reduces_to: tuple[str, ...] = ()
    only_if_named: bool = False

    def __post_init__(self) -> None:
        if not _NAME.match(self.name):
            raise InputError(f"effect name {self.name!r} must be lower-case letters, digits and underscores.")
        self._check_mechanisms()
        for label in FUNCTIONS:
            function = getattr(self, label)
            if function is not None and not (hasattr(function, "py_func") or numba.config.DISABLE_JIT):
                raise InputError(
                    f"`{label}` of effect {self.name!r} must be compiled: put @numba.njit above its definition."
                )
        if self.has_memory and (self.n_states != 3 or self.state_rate is not None):
            raise InputError(
                f"effect {self.name!r} has memory: it needs n_states=3 (x_r, f_r, branch) and no state_rate, "
                f"got n_states={self.n_states}."
            )
        if not self.has_memory and (self.n_states > 0) != (self.state_rate is not None):
            raise InputError(f"effect {self.name!r} needs both n_states > 0 and state_rate, or neither.")
        both = self.remembered and self.remembered_gradient and self.has_memory
        if (self.remembered or self.remembered_gradient) and not both:
            raise InputError(f"effect {self.name!r} needs remembered, remembered_gradient and has_memory, or none.")
        if self.n_room and not (self.gradient and (self.state_rate_gradient or not self.state_rate)):
            raise InputError(
                f"effect {self.name!r} has room behind its parameters, where differences are not taken: give gradients."
            )
        if (self.added_mass is None) != (self.added_mass_gradient is None):
            raise InputError(f"effect {self.name!r} needs both added_mass and added_mass_gradient, or neither.")
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) != len(names):
            raise InputError(f"effect {self.name!r} repeats a parameter name: {', '.join(names)}.")
        for name in (*(name for name, _ in self.redundant), *(name for pair in self.opposed for name in pair)):
            if name not in names:
                raise InputError(f"effect {self.name!r} has no parameter {name!r} to call redundant or opposed.")
        self._check_variants()
        self._settle_roles()

    def _check_mechanisms(self) -> None:
        """Raise `InputError` where a mechanism, or the parameter that it depends on, does not exist."""
        if self.mechanism is not None:
            check_choice("mechanism", self.mechanism, get_args(Mechanism))
        if self.mechanism_below is not None:
            check_choice("mechanism_below", self.mechanism_below[0], [parameter.name for parameter in self.parameters])
            check_choice("mechanism_below", self.mechanism_below[2], get_args(Mechanism))

    def _check_variants(self) -> None:
        """Raise `InputError` where what this is a variant of is no tuple, or looked for only when named."""
        for label in ("variant_of", "reduces_to"):
            if not isinstance(names := getattr(self, label), tuple):
                raise InputError(f"`{label}` of effect {self.name!r} must be a tuple of names, got {names!r}.")
        if self.variant_of and self.only_if_named:
            raise InputError(
                f"effect {self.name!r} is a variant of {' and '.join(self.variant_of)}, in whose place the search "
                "looks for it: leave out `variant_of` or `only_if_named`."
            )

    def _settle_roles(self) -> None:
        """Make the first plain parameter the strength where none is declared, and refuse roles that do not fit."""
        held = {name for name, _ in self.redundant}
        strengths = [parameter.name for parameter in self.parameters if parameter.role == "strength"]
        if not strengths and self.parameters:
            plain = (q.name for q in self.parameters if q.role == "plain" and q.name not in held)
            strengths = list(plain)[:1]
            settled = (replace(q, role="strength") if q.name in strengths else q for q in self.parameters)
            object.__setattr__(self, "parameters", tuple(settled))
        if self.parameters and (len(strengths) != 1 or held & set(strengths)):
            raise InputError(
                f"effect {self.name!r} needs exactly one parameter with the role 'strength', not redundant; got "
                f"{', '.join(strengths) or 'none'}."
            )
        once: tuple[Role, ...] = ("slip_force", "exponent")
        for role in once:
            several = self.with_role(role)
            if len(several) > 1:
                raise InputError(f"effect {self.name!r} can have one parameter with the role {role!r}, got {several}.")
        if self.with_role("power_coefficient") and not self.with_role("exponent"):
            raise InputError(
                f"effect {self.name!r} has a parameter with the role 'power_coefficient': give the role 'exponent' to "
                "the parameter that is the power."
            )

    def mechanism_at(self, value_of: Callable[[str], float], amplitude: float) -> Mechanism | None:
        """Return the mechanism that the effect has at these parameters, in motions of this amplitude [m or rad]."""
        if self.mechanism_below is None:
            return self.mechanism
        parameter, limit, below = self.mechanism_below
        scale = amplitude if parameter in self.with_role("gap") else 1.0
        return below if value_of(parameter) < limit * scale else self.mechanism

    def with_role(self, role: Role) -> tuple[str, ...]:
        """Return the names of the parameters with this role."""
        return tuple(parameter.name for parameter in self.parameters if parameter.role == role)

    def held(self, mass: float, amplitude: float, angular_frequency: float) -> dict[str, float]:
        """Return the values at which redundant parameters are held for such records (kg, m or rad, rad/s)."""
        return {
            name: float(value(mass, amplitude, angular_frequency) if callable(value) else value)
            for name, value in self.redundant
        }

    def along(self, x: float, v: float, a: float, z: FloatArray, p: FloatArray) -> float:
        """Return the force in a motion [N], with what the added mass takes at an acceleration ``a`` [m/s^2]."""
        total = float(self.force(x, v, -1.0 if v < 0.0 else 1.0, z, self.with_room(p)))
        if self.added_mass is not None:
            total += a * float(self.added_mass(x, p))
        return total

    def with_room(self, p: FloatArray) -> FloatArray:
        """Return parameters with the room behind them that the effect's functions ask for."""
        return np.concatenate([p, np.zeros(self.n_room)]) if self.n_room else p

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of ``p``."""
        return tuple(parameter.name for parameter in self.parameters)
