"""Readers of the command line's option values; what they raise becomes one sentence for the user."""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Callable, Sequence
from typing import Any

from .._common.checks import OBSERVABLES, InputError, check_observables


def number(option: str) -> Callable[[str], float]:
    """Return a reader of one finite number."""

    def parse(text: str) -> float:
        value = _float(text)
        if value is None:
            raise argparse.ArgumentTypeError(f"expected a number such as 0.35, got {text!r}")
        return value

    parse.__name__ = option
    return parse


def count(option: str, minimum: int = 1) -> Callable[[str], int]:
    """Return a reader of one whole number."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = minimum - 1
        if value < minimum:
            raise argparse.ArgumentTypeError(f"expected a whole number of at least {minimum}, got {text!r}")
        return value

    parse.__name__ = option
    return parse


def _float(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < float("inf") else None


def _pair(text: str, what: str) -> tuple[float, float]:
    ends = [_float(part) for part in text.split(":")]
    if len(ends) != 2 or ends[0] is None or ends[1] is None or not ends[0] < ends[1]:
        raise argparse.ArgumentTypeError(f"expected {what}, with the low end first, got {text!r}")
    return ends[0], ends[1]


def band(text: str) -> tuple[float, float]:
    """Read LO:HI, a frequency band [Hz]."""
    low, high = _pair(text, "LO:HI in Hz, such as 90:160")
    if low < 0.0:
        raise argparse.ArgumentTypeError(f"expected frequencies in Hz, not negative, got {text!r}")
    return low, high


def mass(text: str) -> tuple[float, float]:
    """Read a mass, or a mass with its standard deviation such as 2.3±0.05 or 2.3+-0.05."""
    value, sign, rest = next(
        (parts for parts in (text.partition(sign) for sign in ("±", "+-", "+/-")) if parts[1]), (text, "", "")
    )
    number, error = _float(value), _float(rest) if sign else 0.0
    if number is None or error is None or error < 0.0 or (sign and error == 0.0):
        raise argparse.ArgumentTypeError(f"expected a mass such as 2.3, or 2.3±0.05 with its deviation, got {text!r}")
    if sign and error > number:
        raise argparse.ArgumentTypeError(f"expected a deviation below the mass itself, got {text!r}")
    return number, error


def amplitude(text: str) -> float:
    """Read an amplitude of displacement in m or rad, or with its unit, such as 0.2 mm."""
    value = _float(text)
    if value is None:
        from ..measurement.reading.units import parse_unit

        parts = re.fullmatch(r"\s*([-+0-9.eE]*[0-9.])\s*(\D+)", text)
        unit = parse_unit(parts[2], "displacement") if parts else None
        value = _float(parts[1]) if parts else None
        value = None if value is None or unit is None else value * unit.factor
    if value is None or not value > 0.0:
        raise argparse.ArgumentTypeError(f"expected an amplitude such as '0.2 mm' or 0.0002, got {text!r}")
    return value


def levels(text: str) -> int | tuple[float, ...]:
    """Read a number of levels, or amplitudes [m or rad]."""
    if text.strip().isdigit():
        return count("--levels", 1)(text)
    values = [_float(part) for part in text.split(",")]
    if any(value is None or value <= 0.0 for value in values):
        raise argparse.ArgumentTypeError(
            f"expected a number of levels such as 8, or amplitudes such as 0.002,0.005,0.01, got {text!r}"
        )
    return tuple(sorted({value for value in values if value is not None}))


def observables(text: str) -> tuple[str, ...]:
    """Read a list of observables."""
    try:
        return check_observables([name.strip() for name in text.split(",") if name.strip()])
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def prior(text: str) -> tuple[str, tuple[float, float]]:
    """Read NAME=LOW:HIGH."""
    name, equals, rest = text.partition("=")
    if not equals or not name.strip():
        raise argparse.ArgumentTypeError(f"expected NAME=LOW:HIGH, such as cubic_stiffness=0:1e7, got {text!r}")
    return name.strip(), _pair(rest, "NAME=LOW:HIGH, such as cubic_stiffness=0:1e7")


def fixed(text: str) -> tuple[str, float]:
    """Read NAME=VALUE."""
    name, _, rest = text.partition("=")
    value = _float(rest)
    if not name.strip() or value is None:
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE, such as viscous_damping=0.8, got {text!r}")
    return name.strip(), value


def tolerance(text: str) -> dict[str, float]:
    """Read OBSERVABLE=VALUE,...: relative tolerances; 0 alone is none at all."""
    if _float(text) == 0.0:
        return dict.fromkeys(OBSERVABLES, 0.0)
    result = {}
    for part in text.split(","):
        name, _, rest = part.partition("=")
        value = _float(rest)
        if name.strip() not in OBSERVABLES or value is None or value < 0.0:
            raise argparse.ArgumentTypeError(
                f"expected relative tolerances such as frequency=0.001,damping=0.03, or 0, got {text!r}"
            )
        result[name.strip()] = value
    return result


def once(option: str, pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Return pairs as a dict; a name that stands twice is an error."""
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{option} names {name} twice; keep one.")
    return dict(pairs)


def columns(text: str) -> list[str]:
    """Read names of columns with commas between; a name that holds a comma stands in quotation marks."""
    try:
        (names,) = csv.reader([text], skipinitialspace=True, strict=True)
    except (ValueError, csv.Error):
        names = []
    if not names or not all(name.strip() for name in names):
        raise argparse.ArgumentTypeError(f"expected names of columns such as time=t,acc_z, got {text!r}")
    return [name.strip() for name in names]


def split(names: Sequence[str]) -> list[str]:
    """Return the names in texts that may hold several, with commas between."""
    return [name.strip() for text in names for name in text.split(",") if name.strip()]
