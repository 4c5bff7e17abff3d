"""Named physical force terms, one file each.

An effect is added by adding one file to this folder that holds ``EFFECT = Effect(...)``; nothing else has to be
touched, and the generic tests run over it by themselves.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from types import MappingProxyType

from .._common.checks import InputError, check_choice
from .._common.compiled import keep
from ._base import EITHER, FUNCTIONS, MECHANISMS, ROLES, Effect, Mechanism, Parameter, Role, Signature

BASE_EFFECTS: tuple[str, str] = ("linear_stiffness", "viscous_damping")
"""The effects that every oscillator has."""


def _load_library() -> Mapping[str, Effect]:
    """Import every public module of this package and collect its ``EFFECT``."""
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))
    library: dict[str, Effect] = {}
    owners: dict[str, str] = {}
    for name in (*BASE_EFFECTS, *(name for name in modules if name not in BASE_EFFECTS)):
        effect = importlib.import_module(f"{__name__}.{name}").EFFECT
        if effect.name != name:
            raise InputError(f"effects/{name}.py holds an effect named {effect.name!r}; give both the same name.")
        for parameter in effect.parameter_names:
            if parameter in owners:
                raise InputError(
                    f"parameter {parameter!r} belongs to both {owners[parameter]!r} and {name!r}; rename one of them."
                )
            owners[parameter] = name
        for function in filter(None, (effect.force, effect.gradient, effect.added_mass)):
            keep(function)  # who calls them by themselves, for a few forces, does not compile them each time
        library[name] = effect
    _check_variants(library)
    return MappingProxyType(library)


def _check_variants(library: Mapping[str, Effect]) -> None:
    """Raise where an effect is a variant of what the search does not look for by itself."""
    for effect in library.values():
        for name in effect.variant_of:
            original = library.get(name)
            if original is None or original.variant_of or original.only_if_named or name in BASE_EFFECTS:
                raise InputError(
                    f"effects/{effect.name}.py: `variant_of` must name other effects of the library that the search "
                    f"looks for by themselves, got {name!r}."
                )
        for name in effect.reduces_to:
            if name not in library or not library[name].variant_of or not effect.variant_of:
                raise InputError(
                    f"effects/{effect.name}.py: `reduces_to` must name other variants, for a variant, got {name!r}."
                )


LIBRARY: Mapping[str, Effect] = _load_library()
"""All effects by name (read-only): the two of every oscillator first, the others in alphabetical order."""


def get_effect(name: str) -> Effect:
    """Return the effect of the library called ``name``.

    Parameters
    ----------
    name : str
        A key of `LIBRARY`.

    Returns
    -------
    Effect

    Raises
    ------
    InputError
        If there is no such effect; the message lists those there are and the nearest name.

    See Also
    --------
    LIBRARY : all of them.
    Oscillator : takes names as well.

    Examples
    --------
    >>> from pymc_backbone.effects import get_effect
    >>> get_effect("cubic_stiffness").text
    'cubic_stiffness x^3'
    """
    return LIBRARY[check_choice("effect", name, LIBRARY)]


__all__ = [
    "BASE_EFFECTS",
    "EITHER",
    "FUNCTIONS",
    "LIBRARY",
    "MECHANISMS",
    "ROLES",
    "Effect",
    "Mechanism",
    "Parameter",
    "Role",
    "Signature",
    "get_effect",
]
