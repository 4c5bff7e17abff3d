"""Sensitivities of sensors, such as 10.2 mV/g: from the volts of a record to what was measured."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

from ..._common.checks import InputError
from ..._common.text import shorten
from .units import dimension_of, parse_unit

FORCE = "force"
"""What a sensor of force measures; it finds the hits of a hammer and is no record."""
_EXAMPLES = "'10.2 mV/g', '0.0102 V/(m/s^2)' or '2.25 mV/N'"
_WRITTEN = re.compile(
    r"(?:(?P<channel>[^=]+)=)?\s*(?P<number>[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>\S.*)"
)
_PER_SECOND = re.compile(r"(?P<volts>\w+?)[\s*·.]*s(?P<power>\^?2|²)?")
FORCE_UNITS = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": 4.4482216152605}


@dataclass(frozen=True)
class Sensitivity:
    """What a sensor puts out.

    Attributes
    ----------
    written : str
        As the user gave it, without the channel.
    channel : str or None
        The channel it is for; None: every channel of volts.
    quantity : str
        ``"displacement"``, ``"velocity"``, ``"acceleration"`` or ``"force"``.
    volts : float
        Volts per SI unit of the quantity, not zero; negative for a sensor that is mounted upside down.
    si : str
        That SI unit.
    """

    written: str
    channel: str | None
    quantity: str
    volts: float
    si: str


def sensitivities_of(given: str | Sequence[str] | None) -> tuple[Sensitivity, ...]:
    """Return the sensitivities that a user gave, checked.

    Parameters
    ----------
    given : str or sequence of str, optional
        Such as ``"10.2 mV/g"``, or ``"acc_x=10.2 mV/g"`` for one channel; several may stand in one text, with a comma
        and a blank between. The number may have a decimal comma; the unit may be upside down (``"98.1 (m/s^2)/V"``).

    Returns
    -------
    tuple of Sensitivity

    Raises
    ------
    InputError
        For anything that is not volts over a unit of motion or force, and for two that are for the same channels.

    Examples
    --------
    >>> (one,) = sensitivities_of("9.80665 mV/g")
    >>> one.quantity, one.si, round(one.volts, 9)
    ('acceleration', 'm/s^2', 0.001)
    """
    texts = [given] if isinstance(given, str) else list(given or ())
    if not all(isinstance(text, str) for text in texts):
        raise InputError(f"`sensitivity` must be text such as {_EXAMPLES}, got {shorten(ascii(given))}.")
    found = tuple(_parsed(part) for text in texts for part in re.split(r"[,;]\s+", text.strip()))
    for number, item in enumerate(found):
        for other in found[:number]:
            is_same_kind = (item.quantity == FORCE) == (other.quantity == FORCE)
            if item.channel is None and other.channel is None and is_same_kind:
                raise InputError(
                    f"`sensitivity` gives both {other.written} and {item.written} for all channels; name the channel "
                    f"of each, as in 'NAME={item.written}'."
                )
            if item.channel is not None and item.channel == other.channel:
                raise InputError(f"`sensitivity` names channel {shorten(item.channel)!r} twice; keep one.")
    return found


def _parsed(text: str) -> Sensitivity:
    match = _WRITTEN.fullmatch(text.strip())
    if match is None:
        _refuse(text)
    number = float(match["number"].replace(",", "."))
    ratio = _ratio(match["unit"].strip())
    if ratio is None:
        _refuse(text)
    factor, quantity, si, is_inverse = ratio
    if number == 0.0 or not math.isfinite(number) or not math.isfinite(1.0 / number):
        raise InputError(f"`sensitivity` must not be zero and be finite, got {shorten(text)!r}.")
    volts = 1.0 / (number / factor) if is_inverse else number * factor
    channel = match["channel"]
    return Sensitivity(
        f"{match['number']} {match['unit'].strip()}", None if channel is None else channel.strip(), quantity, volts, si
    )


def _refuse(text: str) -> NoReturn:
    raise InputError(
        f"`sensitivity` must be a number with volts over a unit of motion or force, such as {_EXAMPLES}, got "
        f"{shorten(ascii(text))}."
    )


def _ratio(unit: str) -> tuple[float, str, str, bool] | None:
    """Return volts per SI unit that a ratio of units stands for, quantity, SI unit, and whether it is upside down."""
    volts, slash, per = unit.partition("/")
    voltage = parse_unit(volts.strip(), "voltage")
    if slash and voltage is not None:
        return _per(per, voltage.factor, False)
    seconds = _PER_SECOND.fullmatch(volts.strip())
    if slash and seconds is not None and (voltage := parse_unit(seconds["volts"], "voltage")) is not None:
        return _per(f"{per.strip()}/s{'^2' if seconds['power'] else ''}", voltage.factor, False)
    per, slash, volts = unit.rpartition("/")
    voltage = parse_unit(volts.strip(" ()"), "voltage")
    return _per(per, voltage.factor, True) if slash and voltage is not None else None


def _per(text: str, volts: float, is_inverse: bool) -> tuple[float, str, str, bool] | None:
    bare = text.strip()
    if bare.startswith("(") and bare.endswith(")"):
        bare = bare[1:-1].strip()
    if bare in FORCE_UNITS:
        return volts / FORCE_UNITS[bare], FORCE, "N", is_inverse
    quantity = dimension_of(bare)
    if quantity is None:
        return None
    unit = parse_unit(bare, quantity)
    assert unit is not None
    return volts / unit.factor, quantity, unit.si, is_inverse
