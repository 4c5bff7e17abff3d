"""One measured free decay in SI units, checked: its waveform, or its envelope."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray, InputError, check_choice, check_finite_array
from ..._common.text import printable, shorten
from .columns import SI_UNITS
from .headers import ENVELOPE, QUANTITIES, READABLE

__all__ = ["MINIMUM_SAMPLES", "QUANTITIES", "Record"]

MINIMUM_SAMPLES = 32
"""Four cycles of eight samples: with less there is no decay to speak of."""
ENVELOPE_UNITS = ("m", "rad", "V", "sqrt(W)", "1")
"""What an envelope may be in: motion; else volts, the square root of a power, or relative to anything."""


@dataclass(frozen=True, eq=False)
class Record:
    """One measured free decay in SI units.

    Parameters
    ----------
    specimen : str
        Name of the specimen, kept as text.
    time : (n,) array
        Time stamps [s], strictly increasing.
    values : (n,) array
        Samples of ``quantity`` in ``unit``, finite.
    quantity : {"displacement", "velocity", "acceleration", "envelope"}
        What was measured. An envelope is the amplitude of the displacement over time, without its oscillation.
    unit : str
        SI unit of ``values``: ``"m"`` or ``"rad"``, the same over ``s`` or over ``s^2``. Of an envelope whose
        calibration is not known also ``"V"``, ``"sqrt(W)"`` or ``"1"`` (relative).
    source : str
        Where it came from, for messages; by default the specimen's name.
    notes : tuple of str
        Sentences about what was assumed or converted.
    starts_free : bool
        Whether the record is known to begin in free decay, after the contact of a hammer: no release is searched for.
    frequency : (n,) array, float or None
        Of an envelope only: frequency of the motion [Hz] at each sample, where it was measured; one number, where it is
        known and was not.

    Raises
    ------
    InputError
        When the lengths differ, a value is not finite, time does not increase, there are fewer than
        32 samples, the quantity or its unit is unknown, an envelope is negative or a frequency not positive.

    See Also
    --------
    read_records : reads records from files.
    condition : makes one ready for its cycles.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(200) / 100.0
    >>> record = Record("beam", time, 1e-3 * np.exp(-time) * np.cos(20.0 * time))
    >>> record.quantity, record.unit, record.time.size
    ('displacement', 'm', 200)
    """

    specimen: str
    time: FloatArray
    values: FloatArray
    quantity: str = "displacement"
    unit: str = ""
    source: str = ""
    notes: tuple[str, ...] = ()
    starts_free: bool = False
    frequency: FloatArray | float | None = None

    def __post_init__(self) -> None:
        specimen = str(self.specimen).strip().encode("utf-8", "backslashreplace").decode("utf-8")
        if not specimen or re.search("[\x00-\x1f\x7f]", specimen):
            raise InputError(f"`specimen` must be one line of text, got {shorten(ascii(self.specimen))}; rename it.")
        quantity = check_choice("quantity", self.quantity, READABLE)
        units = ENVELOPE_UNITS if quantity == ENVELOPE else SI_UNITS[quantity]
        unit = check_choice("unit", self.unit or units[0], units)
        source = self.source or specimen
        name = printable(source)
        try:
            time = check_finite_array("time", self.time)
            values = check_finite_array("values", self.values)
        except InputError as error:
            raise InputError(f"{name}: {error} Cut the record there or fill the gap.") from None
        if time.size != values.size:
            raise InputError(f"{name}: `values` must be as long as `time` ({time.size}), got {values.size}.")
        if time.size < MINIMUM_SAMPLES:
            raise InputError(
                f"{name}: a record needs at least {MINIMUM_SAMPLES} samples, got {time.size}; record longer or faster."
            )
        drop = np.flatnonzero(np.diff(time) <= 0.0)
        if drop.size:
            at = int(drop[0]) + 1
            raise InputError(
                f"{name}: `time` must increase, got time[{at}] = {time[at]:.9g} after {time[at - 1]:.9g}; "
                "sort the samples and drop repeats."
            )
        self._check_envelope(name, values)
        time.setflags(write=False)
        values.setflags(write=False)
        for field, value in (("time", time), ("values", values), ("unit", unit), ("source", source)):
            object.__setattr__(self, field, value)
        object.__setattr__(self, "specimen", specimen)
        object.__setattr__(self, "notes", tuple(self.notes))

    @property
    def is_envelope(self) -> bool:
        """Whether these are amplitudes over time instead of the motion itself."""
        return self.quantity == ENVELOPE

    def _check_envelope(self, name: str, values: FloatArray) -> None:
        """Check what only an envelope has, and freeze it."""
        if not self.is_envelope:
            if self.frequency is not None:
                raise InputError(f"{name}: `frequency` is for an envelope, and this is a {self.quantity}; drop it.")
            return
        low = np.flatnonzero(values < 0.0)
        if low.size:
            raise InputError(
                f"{name}: an envelope must not be negative, got values[{low[0]}] = {values[low[0]]:.6g}; if this is "
                "the motion itself, set `quantity`."
            )
        if self.frequency is None:
            return
        is_column = np.ndim(self.frequency) > 0
        try:
            frequency = check_finite_array("frequency", np.atleast_1d(np.asarray(self.frequency)))
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        if is_column and frequency.size != values.size:
            raise InputError(f"{name}: `frequency` must be as long as `time` ({values.size}), got {frequency.size}.")
        if not (frequency > 0.0).all():
            raise InputError(f"{name}: `frequency` must be positive, got {frequency.min():.6g} Hz.")
        frequency.setflags(write=False)
        object.__setattr__(self, "frequency", frequency if is_column else float(frequency[0]))
