"""Units found in the headers of measured files, and their factors to SI."""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray, InputError

_DEGREE = math.pi / 180.0
_STANDARD_GRAVITY = 9.80665
_TWO_PI = 2.0 * math.pi

_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "nm": 1e-9, "in": 0.0254, "ft": 0.3048}
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE}

#: dimension -> unit as written (normalised) -> (factor to SI, SI unit)
UNITS: dict[str, dict[str, tuple[float, str]]] = {
    "time": {"s": (1.0, "s"), "ms": (1e-3, "s"), "us": (1e-6, "s"), "ns": (1e-9, "s"), "min": (60.0, "s")},
    "displacement": {
        **{unit: (factor, "m") for unit, factor in _LENGTHS.items()},
        **{unit: (factor, "rad") for unit, factor in _ANGLES.items()},
    },
    "velocity": {
        **{f"{unit}/s": (factor, "m/s") for unit, factor in _LENGTHS.items()},
        **{f"{unit}/s": (factor, "rad/s") for unit, factor in _ANGLES.items()},
    },
    "acceleration": {
        **{f"{unit}/s^2": (factor, "m/s^2") for unit, factor in _LENGTHS.items()},
        **{f"{unit}/s^2": (factor, "rad/s^2") for unit, factor in _ANGLES.items()},
        "g": (_STANDARD_GRAVITY, "m/s^2"),
        "mg": (1e-3 * _STANDARD_GRAVITY, "m/s^2"),
    },
    "frequency": {"Hz": (1.0, "Hz"), "kHz": (1e3, "Hz"), "rad/s": (1.0 / _TWO_PI, "Hz")},
    "voltage": {"V": (1.0, "V"), "mV": (1e-3, "V"), "uV": (1e-6, "V"), "kV": (1e3, "V")},
    "ratio": {"1": (1.0, "1"), "-": (1.0, "1"), "%": (1e-2, "1")},
}

LEVELS = {
    "dB": (1.0, "1"), "dBc": (1.0, "1"), "dBr": (1.0, "1"), "dBFS": (1.0, "1"), "dBV": (1.0, "V"), "dBmV": (1e-3, "V"),
    "dBuV": (1e-6, "V"), "dBm": (math.sqrt(1e-3), "sqrt(W)"), "dBW": (1.0, "sqrt(W)"),
}  # fmt: skip
"""Levels in decibels: amplitude at 0 dB and its unit. 10 dB are a factor of ten in power, 20 dB in amplitude."""
POWERS = {
    **{unit: (factor, "sqrt(W)") for unit, factor in
       {"W": 1.0, "mW": 1e-3, "uW": 1e-6, "nW": 1e-9, "pW": 1e-12, "fW": 1e-15}.items()},
    "V^2": (1.0, "V"), "mV^2": (1e-6, "V"), "uV^2": (1e-12, "V"),
}  # fmt: skip
"""Powers, and the unit of their square root."""
RELATIVE = {"1": 1.0, "-": 1.0, "%": 1e-2, "a.u.": 1.0, "au": 1.0, "arb": 1.0, "arb.": 1.0}
OF_POWER = "sqrt(W)"
"""Unit of an amplitude of which the power is known and nothing more."""
_CRESTS = (
    (r"(?:pp|p-p|pk-?pk|pkpk|peak-to-peak)", 0.5), (r"(?:rms|eff)", math.sqrt(2.0)), (r"(?:pk|peak|p|0-p)", 1.0),
)  # fmt: skip

_SPELLINGS = {
    "minutes": "min", "minute": "min", "meter": "m", "metre": "m", "meters": "m", "metres": "m",
    "micron": "um", "microns": "um", "inch": "in", "inches": "in", "feet": "ft",
    "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg", 
    "gn": "g", "hz": "Hz", "khz": "kHz", "volt": "V", "volts": "V", "millivolt": "mV", "millivolts": "mV",
    "percent": "%", "": "1",
}  # fmt: skip

_SYMBOLS = str.maketrans({"µ": "u", "μ": "u", "²": "^2", "⁻": "-", "¹": "1", "·": "*", "°": "deg"})


@dataclass(frozen=True)
class Unit:
    """A unit as written in a file: ``SI value = factor * value`` in unit ``si``."""

    written: str
    factor: float
    si: str


def _normalise(text: str) -> str:
    """Return a unit in the spelling of `UNITS` as far as spelling rules go."""
    unit = re.sub(r"\s+", "", text).translate(_SYMBOLS).replace("**", "^")
    unit = re.sub(r"sec(?:ond)?s?(?![a-z])", "s", unit)
    unit = unit.replace("-^2", "-2")
    unit = re.sub(r"[*.]?s\^?-1$", "/s", unit)
    unit = re.sub(r"[*.]?s\^?-2$|/\(s\^?2\)$|/\(s\*s\)$|/s/s$|/s\^?2$", "/s^2", unit)
    head, slash, tail = unit.partition("/")
    return _SPELLINGS.get(head, _SPELLINGS.get(head.lower(), head)) + slash + tail


def parse_unit(text: str, dimension: str) -> Unit | None:
    """Return the unit ``text`` of ``dimension``, or None if it is not one of its known units.

    Case matters only where it distinguishes units: an unknown spelling is tried once more in lower case.
    """
    known = UNITS[dimension]
    unit = _normalise(text)
    for candidate in (unit, unit.lower()):
        if candidate in known:
            factor, si = known[candidate]
            return Unit(text.strip(), factor, si)
    return None


def require_unit(text: str, dimension: str, where: str) -> Unit:
    """Return the unit ``text`` of ``dimension``, or raise `InputError` naming the known ones."""
    unit = parse_unit(text, dimension)
    if unit is not None:
        return unit
    known = list(UNITS[dimension])
    near = difflib.get_close_matches(_normalise(text), known, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise InputError(
        f"{where}: {text.strip()!r} is not a known unit of {dimension}, expected one of {', '.join(known)}; "
        f"convert the column or correct its header.{hint}"
    )


def is_voltage(text: str | None) -> bool:
    """Return whether a unit is one of voltage, in which sensors speak before their sensitivity is known."""
    return text is not None and parse_unit(text, "voltage") is not None


def dimension_of(text: str) -> str | None:
    """Return which of displacement, velocity, acceleration a unit belongs to, or None."""
    matches = [name for name in ("displacement", "velocity", "acceleration") if text.strip() and parse_unit(text, name)]
    return matches[0] if len(matches) == 1 else None


def split_header(cell: str) -> tuple[str, str | None]:
    """Split a column header into its name and the unit it states.

    ``time [ms]``, ``Acc (g)``, ``Position (mm) Run #1``, ``velocity / m/s`` and ``disp_mm`` are understood; the unit is
    None when none is stated. A subscript as in ``t_{1}`` is a part of the name.

    Examples
    --------
    >>> split_header("displacement [mm]")
    ('displacement', 'mm')
    >>> split_header("Time")
    ('Time', None)
    >>> split_header("Position (mm) Run #1")
    ('Position Run #1', 'mm')
    """
    text = re.sub(r"([_^])\{([^{}]*)\}", r"\1\2", cell.strip().strip("\"'").strip())
    inner = re.fullmatch(r"([^\[\](){}<>]*?)\s*[\[(<]\s*([^\[\](){}<>]+?)\s*[\])>]\s*([^\[\](){}<>]+)", text)
    if inner and any(parse_unit(inner.group(2), dimension) for dimension in UNITS if dimension != "ratio"):
        return f"{inner.group(1)} {inner.group(3)}".strip(), inner.group(2)
    bracket = re.fullmatch(r"(.*?)\s*[\[({<]\s*([^\[\](){}<>]*(?:\([^()]*\))?)\s*[\])}>]", text)
    if bracket:
        return bracket.group(1).strip(), bracket.group(2).strip() or None
    slash = re.fullmatch(r"([^/]+?)\s*/\s*(\S+)", text) or re.fullmatch(r"(.+?)\s+in\s+(\S+)", text)
    if slash and any(parse_unit(slash.group(2), dimension) for dimension in UNITS):
        return slash.group(1).strip(), slash.group(2)
    suffix = re.fullmatch(r"(.+?)[_\s,]([^_\s]+)", text)
    if suffix and (suffix.group(2) in LEVELS or any(parse_unit(suffix.group(2), d) for d in UNITS if d != "ratio")):
        return suffix.group(1).strip(), suffix.group(2)
    return text, None


@dataclass(frozen=True)
class EnvelopeUnit:
    """The unit of an envelope as written in a file, and how its values become an amplitude.

    Attributes
    ----------
    written : str
        As the file has it.
    law : {"amplitude", "power", "level"}
        Whether values are amplitudes, powers (their square root is the amplitude) or decibels.
    factor : float
        Amplitude in unit ``si`` at a value of 1, at 0 dB for a level.
    si : str
        ``m``, ``rad``, ``V``, ``sqrt(W)``, ``1``, or one of velocity and acceleration.
    order : int
        How often the displacement was differentiated: 1 for velocity, 2 for acceleration.
    """

    written: str
    law: str
    factor: float
    si: str
    order: int = 0

    def amplitudes(self, values: FloatArray) -> FloatArray:
        """Return the amplitudes [si] of values as the file has them; NaN for a negative power."""
        with np.errstate(over="ignore", invalid="ignore"):
            if self.law == "level":
                return np.asarray(self.factor * 10.0 ** (values / 20.0))
            return np.asarray(self.factor * (np.sqrt(values) if self.law == "power" else values))


def parse_envelope_unit(text: str) -> EnvelopeUnit | None:
    """Return the unit of an envelope, or None if it is none; ``Vrms`` and ``nm pp`` say which amplitude is meant.

    Examples
    --------
    >>> unit = parse_envelope_unit("dBm")
    >>> unit.law, unit.si, round(unit.factor**2, 6)
    ('level', 'sqrt(W)', 0.001)
    >>> round(parse_envelope_unit("mVrms").factor, 6)
    0.001414
    """
    plain = re.sub(r"\s+", "", text).translate(_SYMBOLS)
    for known, law in ((LEVELS, "level"), (POWERS, "power")):
        for name, (factor, si) in known.items():
            if plain == name or (law == "level" and plain.lower() == name.lower()):
                return EnvelopeUnit(text.strip(), law, factor if law == "level" else math.sqrt(factor), si)
    if plain in (OF_POWER, "W^0.5", "W^(1/2)"):
        return EnvelopeUnit(text.strip(), "amplitude", 1.0, OF_POWER)
    if plain.lower() in RELATIVE:
        return EnvelopeUnit(text.strip(), "amplitude", RELATIVE[plain.lower()], "1")
    for order, dimension in enumerate(("displacement", "velocity", "acceleration", "voltage")):
        unit = parse_unit(text, dimension)
        if unit is not None:
            return EnvelopeUnit(text.strip(), "amplitude", unit.factor, unit.si, order % 3)
    for pattern, crest in _CRESTS:
        found = re.fullmatch(rf"(.+?)[\s_]*[\[({{]?{pattern}[\])}}]?", text.strip(), flags=re.IGNORECASE)
        inner = None if found is None else parse_envelope_unit(found[1])
        if inner is not None and inner.law == "amplitude" and inner.si not in ("1", OF_POWER):
            return EnvelopeUnit(text.strip(), inner.law, crest * inner.factor, inner.si, inner.order)
    return None


def is_level_or_power(text: str | None) -> bool:
    """Return whether a unit is one that only an envelope has: decibels or a power."""
    unit = None if text is None else parse_envelope_unit(text)
    return unit is not None and (unit.law != "amplitude" or unit.si == OF_POWER)


def amplitude_of(given: float | str, name: str) -> tuple[float, str]:
    """Return an amplitude and its unit (m or rad) from a number [m] or a text such as ``2.5 nm``, or raise."""
    if isinstance(given, str):
        parts = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(\S*)\s*", given)
        unit = parse_unit(parts[2] or "m", "displacement") if parts else None
        try:
            value = float(parts[1]) * unit.factor if parts and unit else math.nan
        except ValueError:
            value = math.nan
        si = unit.si if unit else "m"
    else:
        try:
            value, si = float(given), "m"
        except (TypeError, ValueError):
            value, si = math.nan, "m"
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"`{name}` must be a positive amplitude such as '2.5 nm' or 2.5e-9, got {given!r}.")
    return value, si
