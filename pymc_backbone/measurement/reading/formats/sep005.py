"""Time series as SDyPy's SEP-005 defines them: dictionaries, in Python or as JSON.

Reference: SDyPy, *SEP 5: time series*, as the package ``sdypy-sep005`` 1.0 checks it,
https://pypi.org/project/sdypy-sep005
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ...._common.checks import InputError
from ...._common.text import printable, shorten
from ..tables import read_text
from .channel import NO_MOTION, Channel, channel_of, text_of

_QUANTITIES = {"d": "displacement", "v": "velocity", "a": "acceleration"}
_KEYS = "name, data, unit_str, and fs or time"


def read_sep005(path: Path) -> tuple[list[Channel], list[str]]:
    """Return the channels of a JSON file that holds one dictionary or a list of them, and notes.

    Parameters
    ----------
    path : Path
        A text file.

    Returns
    -------
    list of Channel, list of str

    Raises
    ------
    InputError
        When the file is no JSON, or a dictionary is not as SEP-005 defines it.
    """
    name = printable(path.name)
    text, notes = read_text(path, name)
    try:
        content = json.loads(text.lstrip("\ufeff"))
    except (json.JSONDecodeError, RecursionError, ValueError) as error:
        words = printable(str(error))[:80]
        raise InputError(f"{name}: is no JSON text ({words}); expected a list of SEP-005 dictionaries.") from None
    return channels_of_sep005(content, name), list(notes)


def channels_of_sep005(content: Any, where: str) -> list[Channel]:
    """Return the channels of one SEP-005 dictionary, or of a sequence of them.

    Parameters
    ----------
    content : mapping or sequence of mappings
        With the keys ``data``, ``name``, ``unit_str`` and ``fs`` or ``time``; ``quantity``, ``group`` and
        ``start_timestamp`` are optional.
    where : str
        For messages.

    Returns
    -------
    list of Channel

    Raises
    ------
    InputError
        When a key is missing or holds something else than SEP-005 says.
    """
    items = [content] if isinstance(content, Mapping) else content
    if not isinstance(items, Sequence) or isinstance(items, str | bytes) or not items:
        raise InputError(f"{where}: expected SEP-005 dictionaries ({_KEYS}), got {type(content).__name__}; see SDyPy.")
    return [_channel(item, f"{where}, time series {i}") for i, item in enumerate(items, start=1)]


def _channel(item: Any, where: str) -> Channel:
    if not isinstance(item, Mapping):
        raise InputError(f"{where}: expected a dictionary with {_KEYS}, got {type(item).__name__}; correct it.")
    missing = [key for key in ("data", "name", "unit_str") if key not in item]
    if missing or not ("fs" in item or "time" in item):
        named = missing[0] if missing else "fs or time"
        raise InputError(f"{where}: the key {named} is missing, SEP-005 asks for {_KEYS}; add it.")
    values = _numbers(item["data"], "data", where)
    name = text_of(item, "name")
    if name is None:
        raise InputError(f"{where}: the key name must hold a text, got {shorten(ascii(item['name']))}; name it.")
    unit = text_of(item, "unit_str")
    group = text_of(item, "group") or ""
    code = item.get("quantity")
    quantity = (
        None
        if code is None
        else _QUANTITIES.get(str(code), str(code) if str(code) in _QUANTITIES.values() else NO_MOTION)
    )
    fields: dict[str, Any] = {"unit": unit, "quantity": quantity, "group": group}
    if item.get("time") is not None:
        stamps = _numbers(item["time"], "time", where)
        if np.iscomplexobj(stamps) or stamps.size != values.size:
            raise InputError(
                f"{where}: time holds {stamps.size} numbers and data {values.size}, expected as many; correct it."
            )
        fields["stamps"] = stamps
    else:
        fields["step"] = 1.0 / _rate(item["fs"], where)
    return channel_of(name, values, **fields)


def _rate(value: Any, where: str) -> float:
    try:
        rate = float(value)
    except (TypeError, ValueError, OverflowError):
        rate = float("nan")
    if not 0.0 < rate < float("inf"):
        raise InputError(f"{where}: fs must be a positive number [Hz], got {shorten(ascii(value))}; correct it.")
    return rate


def _numbers(value: Any, key: str, where: str) -> Any:
    """Return a one-dimensional array of numbers; None becomes NaN, which is refused with its place later."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiuc":
            array = np.array([np.nan if entry is None else entry for entry in value], dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        _fail_numbers(value, key, where)
    array = np.squeeze(array)
    if array.ndim != 1:
        _fail_numbers(value, key, where)
    return array


def _fail_numbers(value: Any, key: str, where: str) -> NoReturn:
    raise InputError(f"{where}: {key} must hold a list of numbers, got {shorten(ascii(value))}; correct it.")
