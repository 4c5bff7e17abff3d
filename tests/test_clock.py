"""Clock times and timestamps in time columns, against instants from the standard library."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from pymc_backbone.measurement.reading.clock import seconds_of

from .test_records import VALUES, one, refuses, write

TRUE = np.arange(VALUES.size) / 100.0


def written(begin: datetime, pattern: str, zone: ZoneInfo | None = None) -> list[str]:
    """Return the instants of the samples as a clock in a time zone shows them, by the standard library."""
    instants = [begin + timedelta(milliseconds=10 * k) for k in range(TRUE.size)]
    return [
        (t if zone is None else t.astimezone(zone)).strftime(pattern).replace("MS", f"{t.microsecond // 1000:03d}")
        for t in instants
    ]


CLOCK, DATED = "%H:%M:%S.MS", "%Y-%m-%dT%H:%M:%S.MS"
BERLIN = ZoneInfo("Europe/Berlin")


@pytest.mark.parametrize(
    ("begin", "pattern", "zone", "said"),
    [
        (datetime(2025, 3, 1, 12, 3, 4, tzinfo=UTC), CLOCK, None, None),
        (datetime(2025, 3, 1, 23, 59, 59, 800000, tzinfo=UTC), CLOCK, None, "midnight"),
        (datetime(2025, 3, 1, 12, 3, 4, tzinfo=UTC), "%I:%M:%S.MS %p", None, None),
        (datetime(2025, 3, 1, 12, 59, 59, 800000, tzinfo=UTC), "%I:%M:%S.MS %p", None, None),
        (datetime(2025, 3, 1, 12, 59, 59, 800000, tzinfo=UTC), "%M:%S.MS", None, "a full hour"),
        (datetime(2025, 12, 31, 23, 59, 59, 800000, tzinfo=UTC), DATED, None, None),
        (datetime(2025, 2, 28, 23, 59, 59, 800000, tzinfo=UTC), DATED + "Z", None, None),
        (datetime(2025, 2, 28, 23, 59, 59, 800000, tzinfo=UTC), "%d.%m.%Y %H:%M:%S.MS", None, None),
        (datetime(2025, 2, 28, 23, 59, 59, 800000, tzinfo=UTC), "%m/%d/%Y %H:%M:%S.MS", None, "midnight"),
        # summer time ends in Berlin at 01:00 UTC on 26 October 2025, and begins on 30 March 2025
        (datetime(2025, 10, 26, 0, 59, 59, 800000, tzinfo=UTC), DATED, BERLIN, "winter time"),
        (datetime(2025, 10, 26, 0, 59, 59, 800000, tzinfo=UTC), CLOCK, BERLIN, "winter time"),
        (datetime(2025, 3, 30, 0, 59, 59, 800000, tzinfo=UTC), DATED, BERLIN, "summer time"),
        (datetime(2025, 10, 26, 0, 59, 59, 800000, tzinfo=UTC), DATED + "%z", BERLIN, None),
        (datetime(2025, 3, 30, 0, 59, 59, 800000, tzinfo=UTC), DATED + "%z", BERLIN, None),
    ],
)
def test_seconds_from_the_first_sample(begin: datetime, pattern: str, zone: ZoneInfo | None, said: str | None) -> None:
    seconds, notes = seconds_of(written(begin, pattern, zone))
    np.testing.assert_allclose(seconds, TRUE, rtol=0.0, atol=1e-9)
    changes = [note for note in notes if "clock were read" not in note]
    assert changes == [] if said is None else len(changes) == 1 and said in changes[0]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_clock_column_of_a_file(tmp_path: Path, separator: str) -> None:
    cells = written(datetime(2025, 3, 1, 12, 3, 4, 125000, tzinfo=UTC), "%H:%M:%S.MS")
    lines = [f"{t}{separator}{x:.9g}" for t, x in zip(cells, VALUES, strict=True)]
    record = one(write(tmp_path / "a.csv", f"time{separator}displacement [m]", lines))
    np.testing.assert_allclose(record.time, TRUE, rtol=0.0, atol=1e-9)
    assert any("12:03:04.125" in note for note in record.notes)


def test_date_beside_clock_and_preamble_and_decimal_commas(tmp_path: Path) -> None:
    cells = written(datetime(2025, 3, 1, 23, 59, 59, 900000, tzinfo=UTC), "%H:%M:%S.MS")
    lines = [
        f"01.03.2025;{t.replace('.', ',')};{x:.9f}".replace("0.", "0,") for t, x in zip(cells, VALUES, strict=True)
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["Logger 7", "Operator;N. N.", "Datum;Uhrzeit;Weg [mm]", *lines, ""]))
    record = one(path)
    np.testing.assert_allclose(record.time, TRUE, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(record.values, VALUES * 1e-3, atol=1e-12)


def test_column_of_stamps_is_found_without_a_name(tmp_path: Path) -> None:
    cells = written(datetime(2025, 3, 1, 12, 0, 0, tzinfo=UTC), "%Y-%m-%dT%H:%M:%S.MS+01:00")
    lines = [f"{t},{x:.9g}" for t, x in zip(cells, VALUES, strict=True)]
    record = one(write(tmp_path / "a.csv", "when,displacement [m]", lines))
    np.testing.assert_allclose(record.time, TRUE, rtol=0.0, atol=1e-9)


def test_a_true_pause_of_an_hour_and_a_half_is_kept() -> None:
    seconds, notes = seconds_of(["12:00:00.0", "12:00:00.1", "12:00:00.2", "13:30:00.0", "13:30:00.1"])
    assert seconds.tolist() == pytest.approx([0.0, 0.1, 0.2, 5400.0, 5400.1])
    assert len(notes) == 1


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        (["12:00:00.00", "12:00:61.00"], ("line 3", "out of range")),
        (["12:00:00.00", "noon"], ("line 3", "is no time of a clock")),
        (["12:00:00.00", "2025-03-01T12:00:00.01"], ("line 3", "written otherwise")),
        (["2025-02-29T12:00:00.00", "2025-02-29T12:00:00.01"], ("line 2", "does not exist")),
        (["12:00:00.00", "12:00:00.00"], ("line 3", "twice")),
        (["12:00:01.00", "12:00:00.00"], ("line 3", "must increase")),
    ],
)
def test_what_is_no_clock_is_refused_with_its_line(tmp_path: Path, cells: list[str], words: tuple[str, ...]) -> None:
    rest = [f"12:00:{10 + 0.01 * k:05.2f}" for k in range(58)]
    lines = [f"{t},{x:.9g}" for t, x in zip([*cells, *rest], VALUES, strict=True)]
    refuses(write(tmp_path / "a.csv", "time,displacement [m]", lines), *words)
