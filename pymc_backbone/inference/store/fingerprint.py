"""What a model is made of, in words and digests: whether a stored run belongs to it, and if not, what differs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import pymc as pm

from ..._common.digests import FunctionDigest
from ...simulation.response import OscillatorResponse
from ..targets import Target, targets_of

_SHOWN = 60  # characters of a value in a sentence


def describe_model(model: pm.Model) -> dict[str, str]:
    """Return what the posterior depends on, item by item; the keys are words for a sentence.

    Notes
    -----
    Free variables with the numbers of their priors, and of every backbone likelihood the simulated model, the levels
    and the data. What stands outside these, the log-density at the starts shows.
    """
    items = {"the free variables": ", ".join(variable.name for variable in model.value_vars)}
    for variable in model.free_RVs:
        items[f"the prior of {variable.name}"] = _describe_prior(variable)
    for target in targets_of(model):
        items |= _describe_target(target)
    return items


def first_difference(stored: Mapping[str, str], now: Mapping[str, str]) -> str | None:
    """Return one clause on the first item that differs, or None where nothing does."""
    for name in [*stored, *(name for name in now if name not in stored)]:
        before, after = stored.get(name), now.get(name)
        if before == after:
            continue
        if before is None or after is None:
            return f"{name} {'is new' if before is None else 'is gone'}"
        if max(len(before), len(after)) > _SHOWN or _is_digest(before):
            return f"{name} changed"
        return f"{name} was {before} and is now {after}"
    return None


def _describe_prior(variable: Any) -> str:
    node = variable.owner
    name = getattr(node.op, "_print_name", (type(node.op).__name__,))[0]
    numbers = [_number(value.data) for value in node.inputs if isinstance(getattr(value, "data", None), np.ndarray)]
    shape = "x".join(str(size) for size in variable.type.shape)
    return f"{name}({', '.join(numbers)})" + (f" of shape {shape}" if shape else "")


def _number(value: Any) -> str:
    array = np.asarray(value)
    return repr(float(array)) if array.ndim == 0 and array.dtype.kind in "fiu" else str(array.tolist())


def _describe_target(target: Target) -> dict[str, str]:
    of = f" of {target.name!r}"
    response = target.response
    code = FunctionDigest()
    if isinstance(response, OscillatorResponse):
        oscillator = response.oscillator
        items = {
            f"the mass{of}": repr(float(oscillator.mass)),
            f"the model{of}": " + ".join(effect.name for effect in oscillator.effects),
            f"the simulation{of}": f"release {response.release_amplitude!r}, virgin {response.virgin}",
        }
        code.add(oscillator.source_digest())
    else:
        items = {f"the model{of}": getattr(response.function, "__qualname__", type(response.function).__name__)}
        code.visit(response.function)
    items[f"the observables{of}"] = ", ".join(response.observables)
    items[f"the levels{of}"] = ", ".join(repr(float(level)) for level in response.levels)
    items[f"the data{of}"] = _data_digest(target)
    items[f"the code of the forces{of}"] = code.hexdigest()
    return items


def _data_digest(target: Target) -> str:
    digest = hashlib.sha256()
    for array in (target.centre, target.spread):
        digest.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    if target.density is not None:
        digest.update(target.density.digest().encode())
    return digest.hexdigest()


def _is_digest(text: str) -> bool:
    return len(text) == hashlib.sha256().digest_size * 2
