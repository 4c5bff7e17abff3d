"""A mass with effects: layout and units of the parameters, equation of motion, digest of the compiled forces."""

from __future__ import annotations

import difflib
import importlib
import math
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._common.checks import FloatArray, InputError, check_finite_array, check_positive
from ._common.digests import FunctionDigest
from .effects import BASE_EFFECTS, FUNCTIONS, LIBRARY, Effect, Parameter, get_effect

EffectLike = str | Effect


@dataclass(frozen=True, init=False, repr=False)
class Oscillator:
    """One degree of freedom: ``mass * x'' + sum of the forces of its effects = 0``.

    Parameters
    ----------
    mass : float
        Mass [kg]; for a rotation the moment of inertia [kg m^2]. Positive.
    effects : str, Effect or iterable of them, optional
        Effects, by name (see `pymc_backbone.effects.LIBRARY`) or as `Effect`. Linear stiffness and viscous damping
        are added in front when they are not named. The order decides the order of the parameters, nothing else.

    Raises
    ------
    InputError
        If the mass is not a positive number, an effect is unknown or there twice, two effects share a parameter name,
        or the force of an effect of one's own is not zero where its parameters are.

    See Also
    --------
    LIBRARY : effects by name.
    Effect : an effect of one's own.
    build_model : infers its parameters.

    Notes
    -----
    Equal oscillators have equal masses and the same effects in the same order. Pickles hold effects of the library,
    and effects at module level of a file that can be imported, by name; so they survive in another process. An effect
    made elsewhere (inside a function, in a notebook) is pickled whole, for which `cloudpickle` is needed.

    Examples
    --------
    >>> from pymc_backbone.oscillator import Oscillator
    >>> duffing = Oscillator(1.0, "cubic_stiffness")
    >>> duffing.parameter_names
    ('linear_stiffness', 'viscous_damping', 'cubic_stiffness')
    >>> print((duffing + "coulomb_friction").equation.splitlines()[0])
    m x'' + c x' + k x + k3 x^3 + Fc sign(x') = 0
    """

    mass: float
    effects: tuple[Effect, ...]

    def __init__(self, mass: float, effects: EffectLike | Iterable[EffectLike] = ()) -> None:
        chosen = _as_effects(effects)
        present = {effect.name for effect in chosen}
        chosen = (*(LIBRARY[name] for name in BASE_EFFECTS if name not in present), *chosen)
        owners: dict[str, str] = {}
        seen: set[str] = set()
        for effect in chosen:
            if effect.name in seen:
                raise InputError(f"effect {effect.name!r} is there already; name it once.")
            seen.add(effect.name)
            for name in effect.parameter_names:
                if name in owners:
                    raise InputError(
                        f"parameter {name!r} belongs to both {owners[name]!r} and {effect.name!r}; rename one of them."
                    )
                owners[name] = effect.name
        if hasattr(mass, "owner"):  # a variable of PyTensor, say a random one
            raise InputError(
                "`mass` must be a number, got a random variable: a decay shows forces over mass only. Give its middle "
                "here and its deviation as `mass_error` to build_model; in a model of your own give "
                "backbone_likelihood each parameter over (mass / its middle) ** Oscillator.mass_exponents[name]."
            )
        object.__setattr__(self, "mass", check_positive("mass", mass))
        object.__setattr__(self, "effects", chosen)

    def __add__(self, other: EffectLike | Iterable[EffectLike]) -> Oscillator:
        """Return a new oscillator with the given effect or effects added behind."""
        if not isinstance(other, str | Effect | Iterable):
            return NotImplemented
        return Oscillator(self.mass, (*self.effects, *_as_effects(other)))

    def __repr__(self) -> str:
        return f"Oscillator(mass={self.mass!r}, effects=({', '.join(repr(effect.name) for effect in self.effects)}))"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (self.mass, tuple(_reference(effect) for effect in self.effects))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, effect by effect."""
        return tuple(parameter for effect in self.effects for parameter in effect.parameters)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of all parameters: the layout of a parameter vector."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter."""
        return {parameter.name: parameter.unit for parameter in self.parameters}

    @property
    def slices(self) -> dict[str, slice]:
        """Where the parameters of each effect stand in the parameter vector."""
        slices: dict[str, slice] = {}
        start = 0
        for effect in self.effects:
            slices[effect.name] = slice(start, start + len(effect.parameters))
            start += len(effect.parameters)
        return slices

    def index(self, parameter_name: str) -> int:
        """Return the position of a parameter in the parameter vector; raise `InputError` if it is not there."""
        names = self.parameter_names
        if parameter_name not in names:
            raise InputError(f"the oscillator has {', '.join(names)}; got {_unknown([parameter_name], names)}.")
        return names.index(parameter_name)

    @property
    def mass_exponents(self) -> dict[str, float]:
        """Power of the mass with which each parameter goes where the motion stays the same.

        Forces are proportional to the parameters that hold them, and a free decay shows forces over mass: of a
        stiffness 1, of a gap 0. Read from the default bounds, which are scaled with the mass.

        Examples
        --------
        >>> Oscillator(2.0, "freeplay").mass_exponents
        {'linear_stiffness': 1.0, 'viscous_damping': 1.0, 'contact_stiffness': 1.0, 'gap': 0.0}
        """
        result = {}
        for parameter in self.parameters:
            pairs = zip(parameter.bounds(self.mass, 1.0, 1.0), parameter.bounds(2.0 * self.mass, 1.0, 1.0), strict=True)
            powers = [math.log2(heavy / light) for light, heavy in pairs if light != 0.0 and heavy / light > 0.0]
            result[parameter.name] = round(float(powers[-1]), 9) if powers else 0.0
        return result

    def default_bounds(self, amplitude: float, angular_frequency: float) -> dict[str, tuple[float, float]]:
        """Return bounds of a Uniform prior for each parameter, scaled with the record.

        Parameters
        ----------
        amplitude : float
            Largest amplitude of the records [m or rad].
        angular_frequency : float
            Angular frequency of the records [rad/s].

        Returns
        -------
        dict
            Parameter name to (low, high), in the parameter's unit.

        Examples
        --------
        >>> Oscillator(2.0).default_bounds(amplitude=0.01, angular_frequency=10.0)["viscous_damping"]
        (0.0, 4.0)
        """
        scale = (
            self.mass,
            check_positive("amplitude", amplitude),
            check_positive("angular_frequency", angular_frequency),
        )
        return {parameter.name: parameter.bounds(*scale) for parameter in self.parameters}

    def pack(self, parameters: Mapping[str, float] | ArrayLike) -> FloatArray:
        """Return a parameter vector from values by name, or check one that is a vector already.

        Parameters
        ----------
        parameters : mapping or array-like, shape (p,)
            A value for each of `parameter_names`, by name or in their order, in their units.

        Returns
        -------
        ndarray, shape (p,)
            A new array.

        Raises
        ------
        InputError
            If a name is missing or unknown, the length is wrong, or a value is not finite or outside the physical
            limits of its parameter.

        Examples
        --------
        >>> Oscillator(1.0).pack({"viscous_damping": 0.5, "linear_stiffness": 100.0}).tolist()
        [100.0, 0.5]
        """
        names = self.parameter_names
        if isinstance(parameters, Mapping):
            unknown = [str(name) for name in parameters if name not in names]
            if unknown:
                raise InputError(f"`parameters` may hold {', '.join(names)}; got {_unknown(unknown, names)}.")
            missing = [name for name in names if name not in parameters]
            if missing:
                raise InputError(f"`parameters` lacks {', '.join(missing)}; give a value for each of them.")
            parameters = [parameters[name] for name in names]
        vector = check_finite_array("parameters", parameters)
        if vector.size != len(names):
            raise InputError(f"`parameters` must hold {len(names)} values ({', '.join(names)}), got {vector.size}.")
        for parameter, value in zip(self.parameters, vector, strict=True):
            if not parameter.minimum <= value <= parameter.maximum:
                raise InputError(
                    f"`{parameter.name}` must lie between {parameter.minimum:g} and {parameter.maximum:g} "
                    f"{parameter.unit}, got {value:g}."
                )
        return vector

    def unpack(self, vector: ArrayLike) -> dict[str, float]:
        """Return the values of a parameter vector by name; the inverse of `pack`."""
        return dict(zip(self.parameter_names, self.pack(vector).tolist(), strict=True))

    @property
    def equation(self) -> str:
        """Equation of motion as text, then what its symbols mean, one per line."""
        symbols = self._symbols()
        pattern = re.compile(r"\b(" + "|".join(sorted(symbols, key=len, reverse=True)) + r")\b")

        def shorten(text: str) -> str:
            return pattern.sub(lambda match: symbols[match[0]], text)

        forces, definitions = self._terms("text")
        lines = [_sum_of(["m x''", *map(shorten, forces)]), *(f"  {shorten(text)}" for text in definitions)]
        lines.append(f"  m: mass = {self.mass:g} [kg; kg m^2 for a rotation]")
        lines += [f"  {symbols[parameter.name]}: {parameter.name} [{parameter.unit}]" for parameter in self.parameters]
        return "\n".join(lines)

    @property
    def latex(self) -> str:
        """Equation of motion in LaTeX, without dollar signs."""
        forces, definitions = self._terms("latex")
        return r",\quad ".join([_sum_of([r"m \ddot{x}", *forces]), *definitions])

    def _repr_latex_(self) -> str:
        return rf"$\displaystyle {self.latex}$"

    def _terms(self, attribute: str) -> tuple[list[str], list[str]]:
        """Split the effects' formulas into forces, damper and spring first, and the definitions behind them."""
        order = {"viscous_damping": 0, "linear_stiffness": 1}
        forces, definitions = [], []
        for effect in sorted(self.effects, key=lambda effect: order.get(effect.name, 2)):
            # The lookbehind spares LaTeX's own `\;`.
            force, *rest = re.split(r"(?<!\\);\s+", getattr(effect, attribute))
            forces.append(force)
            definitions += rest
        return forces, definitions

    def _symbols(self) -> dict[str, str]:
        """Return a short plain-text symbol per parameter; where two would be alike, the names."""
        plain = {parameter.name: _plain(parameter.latex) for parameter in self.parameters}
        taken = list(plain.values())
        return {name: symbol if symbol and taken.count(symbol) == 1 else name for name, symbol in plain.items()}

    def source_digest(self) -> str:
        """Return a SHA-256 of everything the compiled forces are made of: a key for caches.

        It covers, for each effect in order, its layout and the compiled functions with every helper function, global
        constant and closure variable that they refer to, however deep.

        Returns
        -------
        str
            64 hexadecimal digits; the same in every process with the same Python version.

        Notes
        -----
        The functions are hashed as byte code, which is what numba compiles, not as source text: it exists in a
        notebook too, moving a function or editing a comment does not change it, and a file edited after it was
        imported cannot lend its new text to the old code.
        """
        digest = FunctionDigest()
        for effect in self.effects:
            digest.add("effect", effect.name, *effect.parameter_names, str(effect.has_memory), str(effect.n_states))
            for label in FUNCTIONS:
                digest.add(label)
                digest.visit(getattr(effect, label))
        return digest.hexdigest()


def _as_effects(effects: EffectLike | Iterable[EffectLike]) -> tuple[Effect, ...]:
    """Look up names; accept one effect or several."""
    if not isinstance(effects, str | Effect | Iterable):
        raise InputError(f"`effects` must be a name, an `Effect` or several of them, got {effects!r}.")
    several = [effects] if isinstance(effects, str | Effect) else list(effects)
    for effect in several:
        if not isinstance(effect, str | Effect):
            raise InputError(f"`effects` must hold names or `Effect`s, got {effect!r}.")
        if isinstance(effect, Effect):
            _check_zero(effect)
    return tuple(get_effect(effect) if isinstance(effect, str) else effect for effect in several)


def _check_zero(effect: Effect) -> None:
    """Raise if the force of an effect of one's own is not zero where its parameters are; those of the library are."""
    force = getattr(effect.force, "py_func", None)  # as it was written: nothing is compiled for a few numbers
    if force is None or not effect.parameters or LIBRARY.get(effect.name) is effect:
        return  # an effect without parameters is a force that is known
    nothing, states = np.zeros(len(effect.parameters)), np.zeros(max(effect.n_states, 1))
    for x, v, direction in ((0.01, 0.3, 1.0), (0.7, -2.0, -1.0), (-1.3, 1.0, 1.0)):
        try:
            with np.errstate(all="ignore"):
                value = float(force(x, v, direction, states, nothing))
        except (ArithmeticError, LookupError, TypeError, ValueError):
            return  # not for plain numbers, none there, or of other parameters: compiling it says so
        if value != 0.0 and math.isfinite(value):
            raise InputError(
                f"the force of effect {effect.name!r} must be zero where all its parameters are, got {value:.4g} N at "
                f"x = {x:g} m, x' = {v:g} m/s; multiply every term by a parameter, or the model without the effect is "
                "not one of those with it."
            )


def _unknown(unknown: Iterable[str], known: Iterable[str]) -> str:
    """Name what is unknown, each with the nearest of what is known."""
    options = list(known)
    parts = []
    for name in unknown:
        near = difflib.get_close_matches(name, options, n=1)
        parts.append(f"{name!r} (did you mean {near[0]!r}?)" if near else repr(name))
    return ", ".join(parts)


def _sum_of(terms: Iterable[str]) -> str:
    return " + ".join(terms).replace("+ -", "- ") + " = 0"


def _plain(latex: str) -> str:
    r"""Turn a LaTeX symbol into plain text: ``\bar A`` into ``A``, ``k_3`` into ``k3``."""
    without_accents = re.sub(r"\\(bar|hat|tilde|mathrm|mathit|text)\b", "", latex)
    return re.sub(r"[\\{}_^\s]", "", without_accents)


def _reference(effect: Effect) -> Effect | tuple[str, str]:
    """Return (module, attribute) under which another process finds the effect, or the effect if there is none."""
    if LIBRARY.get(effect.name) is effect:
        return "", effect.name
    for label in FUNCTIONS:
        module = sys.modules.get(getattr(getattr(effect, label), "__module__", ""))
        # What is typed into a session (no file) is not there in another process.
        if module is not None and getattr(module, "__file__", None) is not None:
            for attribute, value in vars(module).items():
                if value is effect:
                    return module.__name__, attribute
    return effect


def _restore(mass: float, references: tuple[Effect | tuple[str, str], ...]) -> Oscillator:
    """Rebuild a pickled oscillator."""
    effects = []
    for reference in references:
        if isinstance(reference, Effect):
            effects.append(reference)
        else:
            module, attribute = reference
            effects.append(getattr(importlib.import_module(module), attribute) if module else get_effect(attribute))
    return Oscillator(mass, effects)
