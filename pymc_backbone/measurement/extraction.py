"""Records to cycles, one after another: conditioning, extraction, one unit for all, notes with their specimen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .._common.checks import InputError
from .conditioning.condition import condition
from .conditioning.conditioned import ConditionedRecord
from .cycles import Cycles, extract_cycles
from .reading.records import Record


@dataclass(frozen=True)
class Extraction:
    """The records that could be used, their cycles, and why others could not.

    Attributes
    ----------
    records, cycles : tuples
        One each per specimen.
    refused : tuple of str
        A sentence for each record that was left out.
    """

    records: tuple[ConditionedRecord, ...]
    cycles: tuple[Cycles, ...]
    refused: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Unit of the motion: m or rad."""
        return self.records[0].unit

    def notes(self, others: Sequence[str] = ()) -> list[str]:
        """Return what was assumed or done, the specimen in front of what is about one; then what ``others`` add."""
        notes, known = [f"left out: {sentence}" for sentence in self.refused], set()
        for item in self.cycles:
            for note in item.notes:
                known.add(note)
                notes.append(note if note.startswith(f"{item.specimen}:") else f"{item.specimen}: {note}")
        return notes + [str(note) for note in others if note not in known]


def extract_all(
    records: Sequence[Record | ConditionedRecord],
    *,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    is_strict: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> Extraction:
    """Condition records and extract their cycles.

    Parameters
    ----------
    records : sequence of Record or ConditionedRecord
        At least one.
    band, start
        As in `condition`.
    is_strict : bool, optional
        Whether one record that cannot be used ends it; otherwise it is left out, as long as another can be used.
    progress : callable, optional
        Called with the stage and the fraction done, before each record.

    Raises
    ------
    InputError
        For records that cannot be used, or that are of different units.
    """
    conditioned: list[ConditionedRecord] = []
    cycles: list[Cycles] = []
    refused: list[str] = []
    for done, item in enumerate(records):
        if progress is not None:
            progress("extracting cycles", done / len(records))
        try:
            record = condition(item, band=band, start=start) if isinstance(item, Record) else item
            extracted = extract_cycles(record)
        except InputError as error:
            if is_strict:
                raise
            refused.append(str(error))
            continue
        conditioned.append(record)
        cycles.append(extracted)
    if not conditioned:
        raise InputError(refused[0])
    units = sorted({record.unit for record in conditioned})
    if len(units) > 1:
        raise InputError(f"the records must all be displacements or all be angles, got both {' and '.join(units)}.")
    return Extraction(tuple(conditioned), tuple(cycles), tuple(refused))
