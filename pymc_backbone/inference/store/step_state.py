"""The state of a PyMC step method as plain data: numbers, text and arrays, never a pickle.

PyMC's step methods name in ``_state_class`` what a draw depends on: scales, mass matrix, counters, random generators.
These fields become a tree for JSON and a dictionary of arrays. Reading goes by the step that is there: the tree says
which numbers, the step says which classes, so that a file can only fill in numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymc.step_methods.state import DataClassState, WithSamplingState
from pymc.util import RandomGeneratorState, get_state_from_generator

Array = NDArray[Any]
# What PyMC's states leave out although statistics of a draw show it: NUTS counts its divergences.
_UNLISTED = ("divergences",)


class StateError(ValueError):
    """A state does not belong to the step that is to take it over."""


@dataclass
class History:
    """How far the lists of a step had been written: length and last item, by their place in the state.

    DEMetropolisZ remembers every point and NUTS every acceptance: written whole each time, a run of n draws would
    write n**2. Such lists grow at the end, one item a draw, and are cut at the front; so only their ends are written.
    """

    lists: dict[str, tuple[int, Any]] = field(default_factory=dict)

    def cut_of(self, place: str, values: list[Any], draws: int) -> int | None:
        """Return how many leading items are gone since; None if ``values`` is not a continuation."""
        length, last = self.lists.get(place, (0, None))
        cut = length + draws - len(values)
        if not 0 <= cut < length:
            return None
        return cut if values[length - cut - 1] is last else None


@dataclass
class PlainState:
    """A state as plain data: a tree that JSON can hold, arrays by number, and the growing lists by place."""

    tree: Any
    arrays: dict[str, Array]
    lists: dict[str, dict[str, Any]]


class _Encoder:
    def __init__(self, before: History, draws: int) -> None:
        self.before, self.draws = before, draws
        self.arrays: dict[str, Array] = {}
        self.lists: dict[str, dict[str, Any]] = {}
        self.after = History()

    def encode(self, value: Any, place: str) -> Any:
        if value is None or (isinstance(value, bool | int | float | str) and not isinstance(value, np.generic)):
            return value
        if isinstance(value, np.ndarray | np.generic):
            return {"array" if isinstance(value, np.ndarray) else "scalar": self._add(np.asarray(value))}
        if isinstance(value, np.random.Generator):
            return self.encode(get_state_from_generator(value), place)
        if isinstance(value, RandomGeneratorState):
            return {"fields": {name: self.encode(item, place) for name, item in value._asdict().items()}}
        if isinstance(value, WithSamplingState):
            named = {name: getattr(value, name) for name in _changing(value._state_class)}
            return {"fields": {name: self.encode(item, f"{place}/{name}") for name, item in named.items()}}
        if isinstance(value, dict):
            return {"dict": {str(key): self.encode(item, f"{place}/{key}") for key, item in value.items()}}
        if isinstance(value, tuple):
            return {"tuple": [self.encode(item, f"{place}/{i}") for i, item in enumerate(value)]}
        if isinstance(value, list):
            return self._encode_list(value, place)
        raise StateError(f"a state of PyMC holds {type(value).__name__}, which cannot be kept as plain data.")

    def _encode_list(self, values: list[Any], place: str) -> Any:
        kind = _kind_of_items(values)
        if kind is None:
            return {"list": [self.encode(item, f"{place}/{i}") for i, item in enumerate(values)]}
        cut = self.before.cut_of(place, values, self.draws)
        tail = values if cut is None else values[len(values) - self.draws :]
        self.lists[place] = {"kind": kind, "cut": cut, "tail": self._add(np.stack([np.asarray(v) for v in tail]))}
        self.after.lists[place] = (len(values), values[-1])
        return {"grown": place}

    def _add(self, array: Array) -> str:
        if array.dtype.hasobject:
            raise StateError("a state of PyMC holds an array of objects, which cannot be kept as plain data.")
        key = f"state_{len(self.arrays)}"
        self.arrays[key] = array
        return key


def encode_state(step: Any, before: History, draws: int) -> tuple[PlainState, History]:
    """Return the state of a step as plain data, and how far its lists are written now.

    Parameters
    ----------
    step : BlockedStep or CompoundStep
        A PyMC step method.
    before : History
        From the last call; an empty one writes everything.
    draws : int
        Draws since the last call.
    """
    encoder = _Encoder(before, draws)
    tree = {
        "state": encoder.encode(step, ""),
        "unlisted": [
            {name: encoder.encode(getattr(part, name), "") for name in _UNLISTED if hasattr(part, name)}
            for part in _parts(step)
        ],
    }
    return PlainState(tree, encoder.arrays, encoder.lists), encoder.after


def grow_lists(so_far: dict[str, list[Any]], plain: PlainState) -> dict[str, list[Any]]:
    """Return the lists of a state, given those of the state before it."""
    grown = {}
    for place, entry in plain.lists.items():
        tail = _items(plain.arrays[entry["tail"]], entry["kind"])
        grown[place] = tail if entry["cut"] is None else so_far[place][entry["cut"] :] + tail
    return grown


def restore_state(step: Any, plain: PlainState, lists: dict[str, list[Any]]) -> History:
    """Bring a step to a state that `encode_state` wrote; return how far its lists are written.

    Raises
    ------
    StateError
        If the state is not one of such a step.
    """
    parts = list(_parts(step))
    if len(parts) != len(plain.tree["unlisted"]):
        raise StateError("the state belongs to another number of step methods.")
    step.sampling_state = _decode(plain.tree["state"], plain, lists, step.sampling_state)
    for part, extra in zip(parts, plain.tree["unlisted"], strict=True):
        for name, value in extra.items():
            if name in _UNLISTED:
                setattr(part, name, _decode(value, plain, lists, None))
    return encode_state(step, History(), 0)[1]


def _decode(tree: Any, plain: PlainState, lists: dict[str, list[Any]], template: Any) -> Any:
    if isinstance(template, DataClassState | RandomGeneratorState) and (
        not isinstance(tree, dict) or "fields" not in tree
    ):
        raise StateError("the state has no parts where the step has some.")
    if not isinstance(tree, dict):
        if isinstance(template, int | float | np.ndarray) and not isinstance(tree, int | float):
            raise StateError("the state holds no number where the step has one.")
        return tree
    ((form, content),) = tree.items()
    if form == "array":
        array = plain.arrays[content]
        if isinstance(template, np.ndarray) and array.dtype.kind != template.dtype.kind:
            raise StateError("the state holds arrays of another kind than the step.")
        return array.copy()
    if form == "scalar":
        return plain.arrays[content][()]
    if form == "grown":
        return lists[content]
    if form in ("list", "tuple"):
        models = template if isinstance(template, list | tuple) and len(template) == len(content) else [None] * len(
            content
        )  # fmt: skip
        items = [_decode(item, plain, lists, model) for item, model in zip(content, models, strict=True)]
        return items if form == "list" else tuple(items)
    if form == "dict":
        return {key: _decode(item, plain, lists, None) for key, item in content.items()}
    if form != "fields":
        raise StateError(f"the state holds {form!r}, which is unknown.")
    if isinstance(template, RandomGeneratorState):
        generator = RandomGeneratorState(**{key: _decode(item, plain, lists, None) for key, item in content.items()})
        # NumPy allocates a pool of any size that it is told.
        if generator.seed_seq_state["pool_size"] != template.seed_seq_state["pool_size"]:
            raise StateError("the state holds a random generator of another kind than the step.")
        return generator
    if not isinstance(template, DataClassState):
        raise StateError("the state holds parts that the step has not.")
    values = {item.name: getattr(template, item.name) for item in fields(template)}
    if set(content) != set(_changing(type(template))):
        raise StateError("the state holds other fields than the step.")
    for key, item in content.items():
        decoded = _decode(item, plain, lists, values[key])
        if isinstance(values[key], list | dict) and not isinstance(decoded, type(values[key])):
            raise StateError("the state holds something else where the step has a list.")
        values[key] = decoded
    return type(template)(**values)


def _changing(state_class: type[DataClassState]) -> list[str]:
    """Return the fields of a state that a draw may change; the others are settings of the step."""
    return [item.name for item in fields(state_class) if not item.metadata.get("frozen", False)]


def _parts(step: Any) -> Iterator[Any]:
    yield from getattr(step, "methods", [step])


def _kind_of_items(values: list[Any]) -> str | None:
    """Return what a list of numbers holds: arrays of one shape, NumPy's or Python's floats; None for anything else."""
    kinds = {type(value) for value in values}
    if kinds == {float}:
        return "float"
    if len(kinds) != 1 or not isinstance(values[0], np.ndarray | np.generic):
        return None
    if len({(value.shape, value.dtype) for value in values}) != 1:
        return None
    return "array" if isinstance(values[0], np.ndarray) else "scalar"


def _items(stack: Array, kind: str) -> list[Any]:
    if kind == "float":
        return [float(value) for value in stack]
    return [row.copy() for row in stack] if kind == "array" else list(stack)
