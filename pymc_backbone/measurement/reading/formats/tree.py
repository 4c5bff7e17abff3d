"""From named arrays, structs and cells, as MAT and NPZ files hold them, to channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...._common.checks import FloatArray
from ...._common.text import printable, shorten
from ..headers import RATE_WORDS, STEP_WORDS, is_time, key_of, mentions_time, words_of
from ..units import parse_unit, split_header
from .channel import ITEM, Channel, channel_of, text_of

MOST_COLUMNS = 1000
_UNIT_KEYS = ("unit", "units", "unit_str", "Unit", "Units", "yunit", "YUnit")
_NAME_KEYS = {"names", "labels", "channels", "channelnames", "columns", "header", "headers", "columnnames", "varnames"}


@dataclass(frozen=True)
class Refused:
    """A variable that is not read, and why, as the end of a sentence."""

    reason: str


def channels_of_tree(tree: Mapping[str, Any]) -> tuple[list[Channel], list[str]]:
    """Return the channels of a tree of variables, and notes.

    Parameters
    ----------
    tree : mapping
        Arrays, texts, mappings (structs), lists (cells, struct arrays) and `Refused` by name.

    Returns
    -------
    list of Channel, list of str

    Notes
    -----
    A vector is a channel, whether it is a row or a column; of a matrix, the vectors along its longer side are. The
    sampling is taken from a vector beside it named for time, from a number named ``fs`` or ``dt``, or, in a matrix
    alone, from a first column that rises in equal steps.
    """
    walker = _Walker()
    walker.walk(tree, "", None)
    return walker.channels, walker.notes


class _Walker:
    """Collects channels on the way through the tree."""

    def __init__(self) -> None:
        self.channels: list[Channel] = []
        self.notes: list[str] = []

    def walk(self, node: Mapping[str, Any], prefix: str, outer: _Step | None) -> None:
        """Collect the channels of one struct; ``outer`` is the sampling interval of the struct around it."""
        step = _step(node)
        if _has_time(node):  # instants say more than a rate
            step = None
        elif step is None:
            step = outer
        elif step.note not in self.notes:
            self.notes.append(step.note)
        if isinstance(node.get("x_values"), Mapping) and isinstance(node.get("y_values"), Mapping):
            found = _response(node, prefix)
            if found is not None:
                self.channels.append(found)
                return
        begin = len(self.channels)
        for name, value in node.items():
            self._take(node, name, value, prefix, step)
        self._find_time_in_matrix(begin, prefix, step)

    def _take(self, node: Mapping[str, Any], name: str, value: Any, prefix: str, step: Any) -> None:
        path = f"{prefix}.{name}" if prefix else name
        if isinstance(value, Refused):
            self.channels.append(Channel(path, refusal=value.reason, group=prefix))
        elif isinstance(value, Mapping):
            self.walk(value, path, step)
        elif isinstance(value, list):
            for i, item in enumerate(value, start=1):
                if isinstance(item, Mapping):
                    self.walk(item, f"{path}({i})", step)
                elif isinstance(item, np.ndarray):
                    self._item(node, name, i, np.squeeze(item), prefix, step)
                elif isinstance(item, Refused):
                    self._take(node, f"{name}:{i}", item, prefix, step)
        elif isinstance(value, np.ndarray):
            self._array(node, name, np.squeeze(value), path, prefix, step)

    def _item(
        self, node: Mapping[str, Any], name: str, number: int, value: NDArray[Any], prefix: str, step: Any
    ) -> None:
        """Collect an item of a cell array: a record of its own, timed by the item of the same number beside it."""
        path = f"{prefix}.{name}" if prefix else name
        begin, group = len(self.channels), f"{prefix}{ITEM}{number}"
        self._array(node, name, value, f"{path}:{number}", prefix, step)
        for k in range(begin, len(self.channels)):
            self.channels[k] = replace(self.channels[k], group=group, cell=path)
        if value.ndim == 2:
            self._find_time_in_matrix(begin, group, step)

    def _array(
        self, node: Mapping[str, Any], name: str, value: NDArray[Any], path: str, prefix: str, step: Any
    ) -> None:
        if value.size < 2:
            return
        if value.ndim > 2 or (value.ndim == 2 and min(value.shape) > MOST_COLUMNS):
            shape = " x ".join(map(str, value.shape))
            self.channels.append(
                Channel(
                    path, refusal=f"has the dimensions {shape}, expected a vector or a matrix; split it.", group=prefix
                )
            )
            return
        fields = {"group": prefix, "step": None if step is None else step.value}
        if value.ndim == 1:
            unit = text_of(node, f"{name}_unit", f"{name}_units", f"{name}Unit")
            listed = _listed_units(node)
            if unit is None and listed:
                unit = listed.get(name)
            elif unit is None and not is_time(split_header(name)[0]):
                unit = text_of(node, *_UNIT_KEYS)
            self.channels.append(_timeless(channel_of(path, value, unit=unit, **fields)))
            return
        matrix = value if value.shape[0] >= value.shape[1] else value.T
        count = matrix.shape[1]
        names, units = _texts(node, _NAME_KEYS, count), _texts(node, {key.lower() for key in _UNIT_KEYS}, count)
        for i in range(count):
            label = f"{prefix}.{names[i]}" if names and prefix else names[i] if names else f"{path}:{i + 1}"
            unit = units[i] if units else None
            self.channels.append(_timeless(channel_of(label, matrix[:, i], unit=unit, **fields)))

    def _find_time_in_matrix(self, begin: int, group: str, step: Any) -> None:
        """Name the first column of a lone matrix time, where nothing else is and it rises in equal steps."""
        mine = [k for k in range(begin, len(self.channels)) if self.channels[k].group == group]
        first = [k for k in mine if self.channels[k].name.endswith(":1")]
        named = [k for k in mine if _is_time_channel(self.channels[k].name)]
        if step is not None or named or len(first) != 1 or not _is_uniform(self.channels[first[0]].values):
            return
        channel = self.channels[first[0]]
        self.notes.append(f"{shorten(printable(channel.name))} rises in equal steps and was taken as time [s]")
        self.channels[first[0]] = replace(channel, name=f"{channel.name.removesuffix(':1')}.time", unit="s")


@dataclass(frozen=True)
class _Step:
    """A sampling interval [s] and the note that says where it is from."""

    value: float
    note: str


def _has_time(node: Mapping[str, Any]) -> bool:
    """Return whether a vector of sampling instants is among the variables."""
    return any(
        isinstance(value, np.ndarray) and value.size > 1 and _is_time_channel(name) for name, value in node.items()
    )


def _step(node: Mapping[str, Any]) -> _Step | None:
    """Return the sampling interval that a number among the variables states."""
    for name, value in node.items():
        if not isinstance(value, np.ndarray) or value.size != 1 or np.iscomplexobj(value):
            continue
        label, unit_text = split_header(name)
        number, key = float(value.ravel()[0]), key_of(label)
        if not 0.0 < number < np.inf:
            continue
        if key in RATE_WORDS:
            unit = parse_unit(unit_text or "Hz", "frequency")
            if unit is not None:
                return _Step(1.0 / (number * unit.factor), f"time was counted at {printable(name)} = {number:g}")
        if key in STEP_WORDS:
            unit = parse_unit(unit_text or "s", "time")
            if unit is not None:
                return _Step(number * unit.factor, f"time was counted in steps of {printable(name)} = {number:g}")
    return None


def _timeless(channel: Channel) -> Channel:
    """Return a time channel without a sampling interval: it is what the interval is taken from."""
    return replace(channel, step=None) if _is_time_channel(channel.name) else channel


def _is_time_channel(name: str) -> bool:
    last = split_header(name)[0].rsplit(".", 1)[-1]
    return is_time(last) or mentions_time(last)


def _is_uniform(values: FloatArray) -> bool:
    steps = np.diff(values)
    if not np.isfinite(steps).all() or steps.size < 8:
        return False
    mean = float(steps.mean())
    return mean > 0.0 and bool(np.abs(steps - mean).max() < 1e-3 * mean)


def _texts(node: Mapping[str, Any], keys: set[str], count: int) -> list[str] | None:
    """Return the texts of a cell of as many texts as there are columns."""
    for name, value in node.items():
        if "".join(words_of(name)) in keys and isinstance(value, list) and len(value) == count:
            if all(isinstance(item, str) for item in value):
                return [str(item).strip() for item in value]
    return None


def _listed_units(node: Mapping[str, Any]) -> dict[str, str]:
    """Return the units of the vectors of a struct by name, where a cell or a text with commas lists several.

    They are as many as the vectors, in their order; or one of time and one of all else.
    """
    found: list[str] = []
    for name, value in node.items():
        if name not in _UNIT_KEYS:
            continue
        if isinstance(value, list) and all(isinstance(item, str) for item in value):
            found = [str(item).strip() for item in value]
        elif isinstance(value, str):
            found = [item.strip() for item in value.split(",")]
    vectors = [name for name, value in node.items() if isinstance(value, np.ndarray) and np.squeeze(value).ndim == 1]
    vectors = [name for name in vectors if name not in _UNIT_KEYS and "".join(words_of(name)) not in _NAME_KEYS]
    if len(found) < 2:
        return {}
    if len(found) == len(vectors):
        return dict(zip(vectors, found, strict=True))
    times = [item for item in found if parse_unit(item, "time")]
    others = [item for item in found if item not in times]
    if len(times) != 1 or len(others) != 1:
        return {}
    return {name: times[0] if _is_time_channel(name) else others[0] for name in vectors}


def _response(node: Mapping[str, Any], prefix: str) -> Channel | None:
    """Return the channel of a struct as vibration test programs export it: x_values and y_values."""
    x, y = node["x_values"], node["y_values"]
    values = y.get("values")
    parts = [x.get(key) for key in ("start_value", "increment")]
    if not isinstance(values, np.ndarray) or not all(isinstance(p, np.ndarray) and p.size == 1 for p in parts):
        return None
    begin, increment = (float(np.ravel(part)[0]) for part in parts)
    units = [_label(side) for side in (x, y)]
    factor = 1.0
    if units[0] is not None:
        time_unit = parse_unit(units[0], "time")
        if time_unit is None:
            return Channel(prefix, refusal="is over frequency, not over time; export the time history.")
        factor = time_unit.factor
    title = text_of(node, "name", "title")
    name = f"{prefix}.{title}" if title else prefix
    flat = np.squeeze(values)
    if flat.ndim != 1:
        return Channel(name, refusal="holds several signals in y_values, expected one; export them apart.")
    return channel_of(name, flat, unit=units[1], step=increment * factor, begin=begin * factor, group=prefix)


def _label(side: Mapping[str, Any]) -> str | None:
    quantity = side.get("quantity")
    return text_of(quantity, "label", "unit") if isinstance(quantity, Mapping) else text_of(side, *_UNIT_KEYS)
