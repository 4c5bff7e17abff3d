"""How files are read, as one value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Reading:
    """How files are read.

    Attributes
    ----------
    columns, quantity, unit, sampling_rate, sensitivity, frequency, reference
        As in `read_records`; for records only.
    is_table : bool
        Whether the files are tables of backbones instead of records.
    """

    columns: Sequence[str] | None = None
    quantity: str | None = None
    unit: str | None = None
    sampling_rate: float | None = None
    sensitivity: str | Sequence[str] | None = None
    frequency: float | None = None
    reference: float | str | None = None
    is_table: bool = False

    @property
    def of_records(self) -> dict[str, Any]:
        """The arguments of `read_records`."""
        return {
            "columns": self.columns,
            "quantity": self.quantity,
            "unit": self.unit,
            "sampling_rate": self.sampling_rate,
            "sensitivity": self.sensitivity,
            "frequency": self.frequency,
            "reference": self.reference,
        }
