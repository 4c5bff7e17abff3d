"""What goes on moving a structure after its release: wind, traffic, people, machines.

It excites the mode as the release did, so it is no line beside the motion and no white noise, and an estimate of the
noise of the sensor holds next to nothing of it. What a wrong law leaves goes with the motion; this does not. A model
whose frequency is off is out of step at the end, and leaves all of a motion that decays there as it should.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._common.checks import FloatArray
from ..._common.text import per_cent
from ...measurement.rough_turning import rough_noise
from ..disturbances.close_modes import envelope_about
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..results.entries import Check
from ..weighing.evidence import residuals_as_measured

_PARTS = 4  # of a record, of which the first and the last are compared
_DECAYED = 4.0  # times as large as in the last part the motion is in the first at least
_NO_DECAY = 0.4  # of what is in the last part, that is no decay of the model
_GOES_ON = 3.0  # times as much is left in the first part as in the last at most
_OVER_NOISE = 3.0  # times what white noise as loud as what changes from sample to sample would have there
_ITS_OWN = 1.5  # times the motion in the last part, that is left there at most: of more, the model moves and not it
_NO_EXPONENTIAL = 0.1  # of what is in the last part, that is no exponential decay of one frequency
_MOST = 0.6  # of the records in which that must be so
_FLAT = 1.5  # times as much is left in the first part as in the last at most, where records are held against each other
_FEWEST, _APART = 4, 0.5  # records for that; and their mean over their root mean square, up to which they are apart


@dataclass(frozen=True)
class _Rest:
    specimen: str
    share: float  # of the largest motion, that is left at the end
    at_end: complex  # what is left there over the motion there
    is_moved: bool  # whether the end of the motion is no decay, by itself
    is_flat: bool  # whether as much is left at the begin as at the end


def ambient_check(batch: Batch, best: Fit, *, is_explained: bool = False) -> Check:
    """Look for what moves the structure at the end of the records as much as it does at their begin.

    Only where the best set leaves more than noise (``is_explained`` says that it does not): what is left there then is
    not the structure's.
    """
    name = "nothing else moves the structure"
    if not batch.has_records:
        return Check(name, True, "not testable without records")
    if is_explained:
        return Check(name, True, "what the model leaves along the motion is noise")
    looked = [found for r in range(len(batch.waveform)) if (found := _rest(batch, best, r)) is not None]
    moved, flat = [item for item in looked if item.is_moved], [item for item in looked if item.is_flat]
    most = _MOST * len(batch.waveform)
    seen = moved if len(moved) >= most else flat if len(flat) >= most and _are_apart(flat) else []
    if not seen:
        return Check(
            name, True, "no sign of it in what the model leaves: that goes with the motion, or is too little to tell"
        )
    largest = max(seen, key=lambda item: item.share)
    return Check(
        name,
        False,
        f"what moves {largest.specimen} at its end is no decay, {per_cent(largest.share)} of the largest motion at the "
        "frequency of the mode, and as much runs through the whole record: something goes on moving the structure "
        "(wind, traffic, people, machines); measure when that rests, or release from a larger amplitude",
    )


def _are_apart(flat: Sequence[_Rest]) -> bool:
    """Return whether what is left at the ends of the records has nothing in common.

    A wrong law leaves alike of specimens that are alike, also where it is out of step.
    """
    ends = np.array([item.at_end for item in flat])
    return len(flat) >= _FEWEST and bool(abs(ends.mean()) < _APART * np.sqrt((np.abs(ends) ** 2).mean()))


def _rest(batch: Batch, best: Fit, r: int) -> _Rest | None:
    """Return what a set leaves of one specimen whose motion decays, where that is no noise; else None."""
    left = residuals_as_measured(batch.waveform[r], best, r)
    term, frequency = batch.waveform[r], batch.records[r].frequency
    time, values = term.time[: left.size], term.values[: left.size]

    def parts(columns: FloatArray) -> list[NDArray[np.complex128]]:
        """Return the complex amplitude about the frequency of the mode in each part."""
        return np.array_split(envelope_about(time, columns, frequency)[0], _PARTS)

    if frequency * (time[-1] - time[0]) < 4.0 * _PARTS:
        return None
    moving, resting = parts(values), parts(left)
    motion, rest = np.array([_size(part) for part in moving]), np.array([_size(part) for part in resting])
    per_cycle = 1.0 / (frequency * float(np.median(np.diff(time))))
    noise = rough_noise(left) / np.sqrt(per_cycle)
    first = 0 if batch.records[r].band is None else 1  # other modes, which a band keeps out, have decayed then
    is_loud = _OVER_NOISE * noise < min(rest[-1], motion[-1])
    if not (motion[first] > _DECAYED * motion[-1] and is_loud and rest[-1] < _ITS_OWN * motion[-1]):
        return None
    goes_on = rest[-1] > _NO_DECAY * motion[-1] and rest[first] < _GOES_ON * rest[-1]
    is_no_decay = _size(moving[-1] - _exponential(moving[-1])) >= _NO_EXPONENTIAL * motion[-1]
    return _Rest(
        batch.specimens[r],
        float(rest[-1] / motion[0]),
        complex(np.vdot(moving[-1], resting[-1]) / np.vdot(moving[-1], moving[-1]).real),
        bool(goes_on and is_no_decay),
        bool(rest[first] < _FLAT * rest[-1]),
    )


def _size(amplitudes: NDArray[np.complex128]) -> float:
    return float(np.sqrt(np.mean(np.abs(amplitudes) ** 2)))


def _exponential(amplitudes: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the exponential nearest to complex amplitudes, by their logarithm."""
    weight = np.abs(amplitudes)
    logarithm = np.log(np.maximum(weight, 1e-300)) + 1j * np.unwrap(np.angle(amplitudes))
    columns = np.column_stack([np.ones(weight.size), np.linspace(-1.0, 1.0, weight.size)])
    nearest = np.linalg.lstsq(columns * weight[:, None], logarithm * weight, rcond=None)[0]
    return np.asarray(np.exp(columns @ nearest))


__all__ = ["ambient_check"]
