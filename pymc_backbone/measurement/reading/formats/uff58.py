"""Universal files: time histories in data sets 58 and 58b (function at nodal degree of freedom), by ``pyuff``.

Reference: University of Cincinnati, *Universal File Formats*, data set 58,
https://www.ceas3.uc.edu/sdrluff/view.php?file_number=58
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ...._common.checks import InputError
from ...._common.text import printable
from ..headers import is_angle_name
from .channel import NO_MOTION, Channel, channel_of, missing_extra, read_bytes

_QUANTITIES = {8: "displacement", 11: "velocity", 12: "acceleration"}
_TIME_RESPONSE = (0, 1)
_LENGTH_OF_CODE = {1: "m", 2: "ft", 3: "m", 4: "ft", 5: "mm", 6: "cm", 7: "in", 8: "mm"}
_SYSTEM_OF_UNITS = {"displacement": "{}", "velocity": "{}/s", "acceleration": "{}/s^2"}
_ANGLES = {"displacement": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
_DIRECTIONS = {0: "", 1: "+X", 2: "+Y", 3: "+Z", 4: "+RX", 5: "+RY", 6: "+RZ"}
_NO_LABEL = ("", "none", "unknown", "null")


def read_uff(path: Path) -> tuple[list[Channel], list[str]]:
    """Return the time histories of a file, and notes.

    Parameters
    ----------
    path : Path
        A file of data sets between lines that hold ``-1``.

    Returns
    -------
    list of Channel, list of str

    Raises
    ------
    InputError
        When ``pyuff`` is not installed, or the file is damaged, cut off, or holds no time history.

    Notes
    -----
    Units are those of the ordinate's label; where there is none, those of the file's data set 164, else SI is assumed.
    Data sets 58 of other functions (frequency responses, spectra) are left out, and that is noted.
    """
    name = printable(path.name)
    try:
        import pyuff
    except ImportError:
        raise missing_extra(name, "pyuff", "uff", "export the time histories as CSV") from None
    data = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = pyuff.UFF(str(path))
            kinds = [int(kind) for kind in file.get_set_types()]
            wanted = [i for i, kind in enumerate(kinds) if kind == 58]
            sets = [_check(file.read_sets(i), i, name) for i in wanted]
            codes = [file.read_sets(i).get("units_code") for i, kind in enumerate(kinds) if kind == 164]
    except InputError:
        raise
    except Exception as error:  # pyuff raises bare exceptions, with little in them
        words = printable(" ".join(str(error).split())[:100])
        raise InputError(f"{name}: the universal file cannot be read ({words}); export it again.") from None
    if not sets:
        what = f"data sets of type {', '.join(map(str, sorted(set(kinds))))}" if kinds else "no complete data set"
        raise InputError(
            f"{name}: holds {what} ({len(data)} bytes), expected time histories in data sets 58; export those."
        )
    histories = [(i, dataset) for i, dataset in zip(wanted, sets, strict=True) if _is_history(dataset)]
    notes = [f"{len(sets) - len(histories)} data sets 58 that are no time histories were left out"]
    if not histories:
        raise InputError(f"{name}: its {len(sets)} data sets 58 are no time histories; export the measured signals.")
    length = _LENGTH_OF_CODE.get(int(codes[0])) if codes and codes[0] is not None else None
    return [_channel(dataset, length) for _, dataset in histories], notes if len(sets) > len(histories) else []


def _check(dataset: dict[str, Any], index: int, name: str) -> dict[str, Any]:
    """Refuse a data set that does not hold as many samples as its header promises."""
    held = int(np.size(dataset.get("data", ())))
    promised = int(dataset.get("num_pts", -1))
    # a binary data set may end in a line end that pyuff takes for a number
    if held == promised + 1 and dataset.get("binary"):
        dataset["data"], dataset["x"] = dataset["data"][:-1], dataset["x"][:-1]
    elif held != promised:
        raise InputError(
            f"{name}, data set {index + 1}: the header promises {promised} samples, found {held}; the file is damaged "
            "or cut off, export it again (for binary files see `pyuff.fix_58b`)."
        )
    return dataset


def _is_history(dataset: dict[str, Any]) -> bool:
    return dataset.get("func_type") in _TIME_RESPONSE and dataset.get("abscissa_spec_data_type", 17) in (0, 17)


def _channel(dataset: dict[str, Any], length: str | None) -> Channel:
    """Return the channel of a data set: named by its first line of text, else by node and direction."""
    direction = int(dataset.get("rsp_dir", 0))
    text = str(dataset.get("id1", "")).strip()
    node = (
        f"{dataset.get('rsp_node', 0)}{_DIRECTIONS.get(abs(direction), '').replace('+', '-' if direction < 0 else '+')}"
    )
    name = text if text.lower() not in _NO_LABEL else f"node {node}"
    kind = int(dataset.get("ordinate_spec_data_type", 0))
    quantity = _QUANTITIES.get(kind, None if kind in (0, 1) else NO_MOTION)
    label = str(dataset.get("ordinate_axis_units_lab", "")).strip()
    unit: str | None = label if label.lower() not in _NO_LABEL else None
    if unit is None and quantity in _SYSTEM_OF_UNITS:
        is_angle = abs(direction) in (4, 5, 6) or is_angle_name(name)
        if is_angle:
            unit = _ANGLES[quantity]
        elif length is not None:
            unit = _SYSTEM_OF_UNITS[quantity].format(length)
    fields: dict[str, Any] = {"unit": unit, "quantity": quantity}
    if dataset.get("abscissa_spacing") == 0:
        fields["stamps"] = np.asarray(dataset["x"], dtype=np.float64)
    else:
        fields["step"], fields["begin"] = float(dataset["abscissa_inc"]), float(dataset["abscissa_min"])
    return channel_of(name, np.asarray(dataset["data"]), **fields)
