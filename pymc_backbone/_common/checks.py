"""Checks of arguments that several modules share, and the error they raise."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class InputError(ValueError):
    """Something the user handed in cannot be used; the message is one sentence with a remedy.

    See Also
    --------
    find_missing_effect : raises it, as every public function does.
    """


def check_finite_array(name: str, values: ArrayLike, *, ndim: int = 1, minimum_size: int = 1) -> FloatArray:
    """Return ``values`` as a finite float array of ``ndim`` dimensions, or raise `InputError`."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"`{name}` must hold numbers, got {type(values).__name__}.") from None
    if array.ndim != ndim:
        raise InputError(f"`{name}` must have {ndim} dimension(s), got an array of shape {array.shape}.")
    if array.size < minimum_size:
        raise InputError(f"`{name}` must hold at least {minimum_size} value(s), got {array.size}.")
    bad = np.flatnonzero(~np.isfinite(array.ravel()))
    if bad.size:
        raise InputError(f"`{name}` must be finite, got {name}[{bad[0]}] = {array.ravel()[bad[0]]}.")
    return array


def check_levels(levels: ArrayLike, name: str = "levels") -> FloatArray:
    """Return amplitude levels as a strictly increasing, positive float array, or raise `InputError`."""
    array = check_finite_array(name, levels)
    if array[0] <= 0.0:
        raise InputError(f"`{name}` must be positive, got {name}[0] = {array[0]:g}. Drop that level.")
    drops = np.flatnonzero(np.diff(array) <= 0.0)
    if drops.size:
        index = int(drops[0]) + 1
        raise InputError(
            f"`{name}` must be strictly increasing, got {name}[{index}] = {array[index]:g} after {array[index - 1]:g}. "
            "Sort the levels and drop repeats."
        )
    return array


LARGEST_AMPLITUDE, SLOWEST, FASTEST = 1e6, 1e-7, 1e12


def check_motion(amplitude: float, frequency: float, unit: str, name: str) -> None:
    """Raise `InputError` where amplitude [m or rad] or frequency [Hz] are those of no structure at all."""
    if amplitude > LARGEST_AMPLITUDE or not SLOWEST < frequency < FASTEST:
        raise InputError(
            f"{name}: an amplitude of {amplitude:.3g} {unit} at {frequency:.3g} Hz is no motion of a structure; check "
            "the units of time and of the measured quantity, and the sampling rate."
        )


def check_positive(name: str, value: Any) -> float:
    """Return ``value`` as a positive finite float, or raise `InputError`."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"`{name}` must be a number, got {value!r}.") from None
    if not (np.isfinite(number) and number > 0.0):
        raise InputError(f"`{name}` must be positive and finite, got {number:g}.")
    return number


def check_choice(name: str, value: Any, options: Iterable[str]) -> str:
    """Return ``value`` if it is one of ``options``; else raise `InputError` naming the nearest and all of them."""
    known: Sequence[str] = list(options)
    if value in known:
        return str(value)
    near = difflib.get_close_matches(str(value), known, n=1) or [name for name in known if str(value) in name and value]
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise InputError(f"`{name}` must be one of {', '.join(known)}; got {value!r}.{hint}")


def check_observables(observables: str | Iterable[str]) -> tuple[str, ...]:
    """Return observables as a tuple in the canonical order, or raise `InputError`."""
    names = [observables] if isinstance(observables, str) else list(observables)
    if not names:
        raise InputError(f"`observables` must name at least one of {', '.join(OBSERVABLES)}.")
    for name in names:
        check_choice("observables", name, OBSERVABLES)
    return tuple(name for name in OBSERVABLES if name in names)


OBSERVABLES: tuple[str, ...] = ("frequency", "damping", "offset")
OBSERVABLE_UNITS: dict[str, str] = {"frequency": "Hz", "damping": "1", "offset": "1"}
