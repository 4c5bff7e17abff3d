"""What is asked of which data: every argument of a study checked, and the batch that the search looks at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np
import xarray as xr

from ..._common.backbone_dataset import FREQUENCY
from ..._common.checks import InputError, check_choice
from ..._common.text import in_words
from ...effects import BASE_EFFECTS, LIBRARY, Effect
from ...measurement.conditioning.conditioned import ConditionedRecord
from ...measurement.conditioning.second_mode import SecondMode
from ...measurement.extraction import measure_batch
from ...measurement.options import Measuring
from ...measurement.reading.record import Record
from ...oscillator import Oscillator
from ..fitting.batch import Batch, batch_of_backbones, batch_of_records
from ..fitting.descent import is_heavy
from ..fitting.layout import make_layout

Data = xr.Dataset | Sequence[Record] | Sequence[ConditionedRecord]

TOLERANCE: Mapping[str, float] = {"frequency": 0.001, "damping": 0.03, "offset": 0.01}
"""Change of the backbones below which a missing effect does not matter, by default: relative; of the amplitude."""
WAVEFORM_SHARE = 0.1
"""Part of the tolerance on damping, as a share of the motion, that waveforms may depart by unexplained."""
_APART = 1.5  # ratio of the frequencies of one specimen and the next, from which they are no batch
_SAME_MODE = 0.2  # relative difference of one mode's frequency in two records: amplitudes differ
_KNOWN = 0.05  # relative standard error of a frequency below which it says what a specimen is
_VANISHED = 1e-9  # of the force at a typical strength: rounding
MOST_EFFECTS = 3
"""Effects that can be missing together."""


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked, of which data.

    Attributes
    ----------
    base : Oscillator
        The model that is questioned.
    batch : Batch
        The data.
    candidates : tuple of str
        Effects that may be missing, the costly ones last.
    variants : tuple of str
        Variants of these, which are looked for in their place; none where the candidates were named.
    reserved : tuple of str
        What is asked where nothing else explains the samples; none where the candidates were named.
    own : mapping of str to Effect
        Those that the library does not hold.
    max_effects : int
        Largest number of effects that may be missing together.
    tolerance : mapping of str to float
        Relative, by observable, and on the waveform.
    notes : tuple of str
        What was assumed or done with the data.
    """

    base: Oscillator
    batch: Batch
    candidates: tuple[str, ...]
    variants: tuple[str, ...]
    reserved: tuple[str, ...]
    own: Mapping[str, Effect]
    max_effects: int
    tolerance: Mapping[str, float]
    notes: tuple[str, ...]

    def of_records(self, records: Sequence[Record] | Sequence[ConditionedRecord], measuring: Measuring) -> Question:
        """Return the same question of other records."""
        batch, found = batch_of(self.base, records, measuring)
        return replace(self, batch=batch, notes=(*found, *batch.notes))

    def saying(self, *notes: str) -> Question:
        """Return the same question, with what is to be said of its data ahead."""
        return replace(self, notes=(*notes, *self.notes))


def ask(
    oscillator: Oscillator,
    data: Data,
    *,
    candidates: Sequence[str | Effect] | None,
    max_effects: int,
    tolerance: Mapping[str, float] | float | None,
    measuring: Measuring,
) -> Question:
    """Return the question, every argument checked; arguments as in `find_missing_effect`."""
    limits = tolerances(tolerance)
    batch, notes = batch_of(oscillator, data, measuring)
    check_one_batch(batch.backbones)
    check_one_mode(batch.records)
    chosen = possible_effects(oscillator, candidates, batch)
    untold = untold_effects(chosen, own_effects(candidates), batch)
    if untold and len(untold) == len(chosen):
        raise InputError(
            f"only damping was measured, which does not tell springs: none of the candidates {', '.join(untold)} can "
            "be found; name effects that dissipate, or give records with a frequency over the amplitude."
        )
    chosen = tuple(name for name in chosen if name not in untold)
    if not 1 <= int(max_effects) <= MOST_EFFECTS:
        raise InputError(f"`max_effects` must be 1, 2 or 3, got {max_effects}; look for more in a second study.")
    return Question(
        base=oscillator,
        batch=batch,
        candidates=chosen,
        variants=() if candidates is not None else variants_of(chosen, oscillator),
        reserved=() if candidates is not None else reserved_effects(oscillator),
        own=own_effects(candidates),
        max_effects=int(max_effects),
        tolerance=limits,
        notes=(*notes, *batch.notes, *_untold_words(untold)),
    )


def check_one_batch(backbones: xr.Dataset) -> None:
    """Raise `InputError` where specimens fall into groups whose frequencies at one amplitude are far apart.

    Parameters
    ----------
    backbones : xarray.Dataset
        At levels.

    Raises
    ------
    InputError
        A specimen has half as high a frequency again as the next, at the same level, and both are known there.
    """
    if FREQUENCY not in backbones["observable"].values:
        return
    unit = backbones.attrs.get("amplitude_unit", "m")
    chosen = backbones.sel(observable=FREQUENCY)
    values, errors = (chosen[name].transpose("specimen", "level").values for name in ("value", "standard_error"))
    values = np.where(errors < _KNOWN * values, values, np.nan)  # where a record sinks into its noise, none is
    for level, column in zip(backbones["level"].values, values.T, strict=True):
        order = np.argsort(column)[: np.count_nonzero(np.isfinite(column))]
        steps = column[order[1:]] / column[order[:-1]]
        if steps.size and steps.max() > _APART:
            k = int(np.argmax(steps))
            low, high = (str(backbones["specimen"].values[order[i]]) for i in (k, k + 1))
            raise InputError(
                f"the records are not of one batch: at an amplitude of {float(level):.3g} {unit} {low} moves at "
                f"{column[order[k]]:.4g} Hz and {high} at {column[order[k + 1]]:.4g} Hz; structures that are meant to "
                "be alike differ by far less: give each kind a folder of its own, or one mode of them with `band`."
            )


def check_one_mode(records: Sequence[ConditionedRecord]) -> None:
    """Raise `InputError` where records follow different modes of structures that are alike.

    Accelerations show the higher mode more than it moves, and a hit excites one more than another: which is the larger
    differs then from record to record.

    Parameters
    ----------
    records : sequence of ConditionedRecord
        Of one batch; empty where only backbones are known.

    Raises
    ------
    InputError
        One record moves at a frequency far from that of another, which holds that as a second mode.
    """
    for one in records:
        for other in records:
            second = SecondMode(one.second_mode_frequency, one.second_mode_share)
            ratio, nearness = one.frequency / other.frequency, second.frequency / other.frequency
            if not (max(ratio, 1.0 / ratio) > _APART and abs(nearness - 1.0) < _SAME_MODE):
                continue
            bands = (
                second.suggested_band(one.frequency),
                SecondMode(one.frequency, 1.0).suggested_band(other.frequency),
            )
            either = " or ".join(f"`band=({low:.3g}, {high:.3g})`" for low, high in sorted(bands))
            raise InputError(
                f"the records follow different modes: {other.specimen} that at {other.frequency:.4g} Hz, "
                f"{one.specimen} that at {one.frequency:.4g} Hz, and it holds the other as well ({second.share:.0%} of "
                f"the spectral peak); keep one of them in all records, with {either}."
            )


def untold_effects(names: Sequence[str], own: Mapping[str, Effect], batch: Batch) -> tuple[str, ...]:
    """Return the springs among candidates where no frequency was measured over the amplitude.

    A spring takes nothing from a cycle. It changes how long one lasts, and with it a little the decrement: to be named
    by that alone it would have to change the frequency by as much, which nobody saw.
    """
    if FREQUENCY in batch.backbones["observable"].values:
        return ()
    scale = (1.0, batch.amplitude, batch.angular_frequency)
    return tuple(name for name in names if is_spring(own.get(name) or LIBRARY[name], scale))


def is_spring(effect: Effect, scale: tuple[float, float, float]) -> bool:
    """Return whether the force of an effect is one of the displacement alone, at typical values of its parameters."""
    if effect.n_states or effect.has_memory:
        return False
    middle = np.array([0.3 * low + 0.7 * high for low, high in (item.bounds(*scale) for item in effect.parameters)])
    force = getattr(effect.force, "py_func", effect.force)
    _, amplitude, angular_frequency = scale
    state = np.zeros(0)
    for x in (-0.9, -0.3, 0.2, 0.7):
        found = {
            float(force(x * amplitude, v * amplitude * angular_frequency, 1.0 if v > 0.0 else -1.0, state, middle))
            for v in (-0.8, -0.1, 0.4, 1.0)
        }
        if len(found) > 1:
            return False
    return True


def _untold_words(names: Sequence[str]) -> tuple[str, ...]:
    if not names:
        return ()
    return (f"not looked for, because only damping was measured: {', '.join(in_words(name) for name in names)}",)


def tolerances(tolerance: Mapping[str, float] | float | None) -> dict[str, float]:
    """Return the tolerance by observable, and that on the waveform which follows from it."""
    given: dict[str, float] = dict(TOLERANCE)
    if isinstance(tolerance, Mapping):
        for key in tolerance:
            check_choice("tolerance", str(key), ("frequency", "damping", "offset", "waveform"))
        given = {str(key): value for key, value in tolerance.items()}
    elif tolerance is not None:
        given = dict.fromkeys(TOLERANCE, tolerance)
    limits = {}
    for key, value in given.items():
        try:
            limits[key] = float(value)
        except (TypeError, ValueError):
            limits[key] = float("nan")
        if not (np.isfinite(limits[key]) and limits[key] >= 0.0):
            raise InputError(f"`tolerance` of {key} must be a number from 0 on, got {value!r}; 0: statistics alone.")
    limits.setdefault("waveform", WAVEFORM_SHARE * limits.get("damping", 0.0))
    return limits


def own_effects(candidates: Sequence[str | Effect] | None) -> dict[str, Effect]:
    """Return the candidates that are not the library's, by name."""
    own: dict[str, Effect] = {}
    for effect in candidates or ():
        if isinstance(effect, Effect) and LIBRARY.get(effect.name) is not effect:
            if effect.name in LIBRARY or own.get(effect.name, effect) is not effect:
                raise InputError(f"`candidates` hold another effect named {effect.name!r}; give yours another name.")
            own[effect.name] = effect
    return own


def check_vanishes(effect: Effect, scale: tuple[float, float, float]) -> None:
    """Raise where a candidate's force is still there when its strength is zero: no data could say that it is absent."""
    middle = np.array([sum(parameter.bounds(*scale)) / 2.0 for parameter in effect.parameters])
    absent = np.where([parameter.role == "strength" for parameter in effect.parameters], 0.0, middle)
    force = getattr(effect.force, "py_func", effect.force)
    _, amplitude, angular_frequency = scale
    for x, v in ((0.0, 1.0), (0.7, 0.5), (-0.7, 0.5), (1.0, -0.1), (0.0, -1.0)):
        state = np.zeros(effect.n_states)
        at = (x * amplitude, v * amplitude * angular_frequency, 1.0 if v > 0.0 else -1.0, state)
        with np.errstate(all="ignore"):
            left, present = (float(force(*at, effect.with_room(p))) for p in (absent, middle))
        if not abs(left) <= _VANISHED * abs(present):
            strength = next((q.name for q in effect.parameters if q.role == "strength"), None)
            when = "whatever its parameters are" if strength is None else f"where its strength `{strength}` is zero"
            raise InputError(
                f"candidate {effect.name!r} must vanish at zero strength, got a force of {left:.4g} {when}; "
                "multiply the force by its strength, or put the effect into the model if it is known to be there."
            )


def looked_for(unit: str) -> tuple[str, ...]:
    """Return the names of the effects that are looked for where none are named, in a motion measured in ``unit``.

    Variants are looked for in the place of what they are variants of, and what one mode does not show is not.
    """
    return tuple(
        name
        for name, effect in LIBRARY.items()
        if name not in BASE_EFFECTS
        and not effect.variant_of
        and not effect.only_if_named
        and (unit == "rad" or not effect.needs_rotation)
    )


def variants_of(candidates: Sequence[str], oscillator: Oscillator) -> tuple[str, ...]:
    """Return the effects of the library that are variants of candidates, and not in the model already."""
    held = {effect.name for effect in oscillator.effects}
    return tuple(
        name for name, effect in LIBRARY.items() if set(effect.variant_of) & set(candidates) and name not in held
    )


def reserved_effects(oscillator: Oscillator) -> tuple[str, ...]:
    """Return the laws of the library that are looked for by name, and not in the model already: no drawn curves."""
    held = {effect.name for effect in oscillator.effects}
    return tuple(
        name
        for name, effect in LIBRARY.items()
        if effect.only_if_named and not effect.with_role("ordinate") and name not in held
    )


def possible_effects(
    oscillator: Oscillator, candidates: Sequence[str | Effect] | None, batch: Batch
) -> tuple[str, ...]:
    """Return the names of the effects that may be missing, the costly ones last."""
    own = own_effects(candidates)
    for effect in own.values():
        check_vanishes(effect, (oscillator.mass, batch.amplitude, batch.angular_frequency))
    held = {effect.name for effect in oscillator.effects}
    unit = batch.amplitude_unit
    if candidates is None:
        names = list(looked_for(unit))
    else:
        every = [item.name if isinstance(item, Effect) else str(item) for item in candidates]
        names = [check_choice("candidates", name, {**LIBRARY, **own}) for name in every]
        for name in names:
            if (own.get(name) or LIBRARY[name]).with_role("ordinate"):
                raise InputError(
                    f"`candidates` hold {name!r}, a curve that fits any force: it is no law to be named. What no law "
                    "explains is drawn as a force curve by itself; leave it out."
                )
    names = [name for name in dict.fromkeys(names) if name not in held and name not in BASE_EFFECTS]
    if not names:
        raise InputError("no candidate is left: the model holds all of them; name others with `candidates`.")

    def cost(name: str) -> tuple[bool, int]:
        effect = own.get(name) or LIBRARY[name]
        layout = make_layout(oscillator + effect, batch.amplitude, batch.angular_frequency)
        return is_heavy(layout), effect.n_states

    return tuple(sorted(names, key=cost))


def batch_of(oscillator: Oscillator, data: Data, measuring: Measuring) -> tuple[Batch, list[str]]:
    """Return the batch of records or backbones, and notes on it."""
    if isinstance(data, xr.Dataset):
        return _of_backbones(oscillator, data)
    measured = measure_batch(_as_records(data), measuring, every_observable=True, whole_range=True)
    found = measured.extraction
    if not found.records:  # envelopes: there are no waveforms to decide
        return _of_backbones(oscillator, measured.backbones)
    return batch_of_records(oscillator.mass, measured.backbones, found.records, found.cycles), measured.notes


def is_of_records(data: Data) -> TypeGuard[Sequence[Record]]:
    """Return whether data are records as they were read, which can be conditioned once more."""
    return isinstance(data, Sequence) and all(isinstance(item, Record) for item in data)


def _of_backbones(oscillator: Oscillator, backbones: xr.Dataset) -> tuple[Batch, list[str]]:
    """Return the batch of backbones that were measured directly, and their notes."""
    lacking = [name for name in ("value", "standard_error") if name not in backbones]
    if lacking:
        raise InputError(f"the backbones in `data` lack `{lacking[0]}`; give values with their standard errors.")
    notes = [str(note) for note in backbones.attrs.get("notes", [])]
    return batch_of_backbones(oscillator.mass, backbones), notes


def _as_records(data: Sequence[Record] | Sequence[ConditionedRecord]) -> list[Record | ConditionedRecord]:
    """Return ``data`` as a list of records, or say what it should have been."""
    is_list = isinstance(data, Sequence) and not isinstance(data, str)
    items = [item for item in data if isinstance(item, Record | ConditionedRecord)] if is_list else []
    if not is_list or len(items) != len(data):
        raise InputError(
            f"`data` must be a list of records or a Dataset of backbones, got {type(data).__name__}; `read_records` "
            "reads a folder."
        )
    if not items:
        raise InputError("`data` must hold at least one record; check the folder.")
    return items
