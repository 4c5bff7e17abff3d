"""Compiled functions of a model, kept as long as the model is: with other data it is not compiled again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import pymc as pm
import pytensor

_KEPT: WeakKeyDictionary[pm.Model, dict[tuple[Any, ...], Any]] = WeakKeyDictionary()


def compile_once(model: pm.Model, what: str, make: Callable[[], Any]) -> Any:
    """Return what ``make`` compiles for ``model``: what it returned before, unless the model was changed since.

    Other data (`set_backbones`, `pymc.set_data`) are no change: compiled functions read them when they are called. A
    thread has functions of its own, because two must not call one at the same time.

    Parameters
    ----------
    model : pymc.Model
        The model.
    what : str
        Name of what is compiled.
    make : callable
        Compiles it; it must depend on nothing but the model and PyTensor's settings.
    """
    # the variables themselves, not their numbers: as long as they are held nobody else has their place
    variables = (*model.value_vars, *model.basic_RVs, *model.potentials, *model.deterministics)
    settings = (
        pytensor.config.mode,
        pytensor.config.linker,
        pytensor.config.optimizer,
        pytensor.config.numba__fastmath,
    )
    key = (what, threading.get_ident(), *map(str, settings), variables)
    held = _KEPT.setdefault(model, {})
    if key not in held:
        # an earlier state of the model will not come back
        for old in [other for other in held if other[-1] != variables]:
            del held[old]
        held[key] = make()
    return held[key]
