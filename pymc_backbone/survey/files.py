"""The output folder of a survey.

==============================  ==============================================================================
file                            what it holds
==============================  ==============================================================================
``summary.html``                the page over all structures; needs no network, links to the reports below
``summary.json``                everything in numbers and words; see `SURVEY_KEYS`
``summary.csv``                 a row for each structure: verdict, effects, probability, parameters, or the error
``structures/NAME/``            the folder of one structure, as `diagnose` writes it
``.../structure.json``          its record, written last: what is there is finished, and `resume` keeps it
==============================  ==============================================================================
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from .._common.atomic_files import remove_leftovers, replacing
from ..reporting.claimed_folder import claimed_output
from ..reporting.output_folder import PROGRAM, REPORT, package_version, write_files
from ..reporting.portable import plain
from .survey import Survey

PAGE, SUMMARY, TABLE, STRUCTURES = "summary.html", "summary.json", "summary.csv", "structures"


@contextmanager
def begun_survey(output: str | os.PathLike[str], overwrite: bool, resume: bool, seed: int) -> Iterator[Path]:
    """Make the folder ready, keep the seed there so that a killed survey can be resumed, and yield its path.

    Until the end no other run may write there.

    Raises
    ------
    InputError
        If the folder cannot be used, or another run is writing there.
    """
    with claimed_output(output, overwrite or (resume and _summary(output) is not None)) as claimed:
        folder = Path(os.path.abspath(str(claimed)))
        remove_leftovers(folder)
        content = {
            "program": PROGRAM, "kind": "survey", "version": package_version(), "seed": seed, "structures": [],
            "interrupted": "The survey did not come to its end.",
        }  # fmt: skip
        _write_text(folder / SUMMARY, json.dumps(content, indent=1) + "\n")
        yield folder


def stored_seed(output: str | os.PathLike[str]) -> int | None:
    """Return the seed of the survey in a folder; None where there is none."""
    summary = _summary(output)
    return None if summary is None else int(summary["seed"])


def structure_folder(folder: Path, name: str) -> tuple[str, str]:
    """Return the folder of a structure, and the path of its report relative to the survey's folder."""
    return str(folder / STRUCTURES / name), f"{STRUCTURES}/{name}/{REPORT}"


def write_survey(survey: Survey, folder: Path) -> list[str]:
    """Write page, table and ``summary.json``, the last one last; return the names.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    from .page import survey_html

    texts = {
        PAGE: survey_html(survey),
        TABLE: survey_table(survey),
        SUMMARY: json.dumps(plain({"program": PROGRAM, **survey.entries()}), indent=1, allow_nan=False) + "\n",
    }
    return write_files(folder, {name: partial(_put, text) for name, text in texts.items()})


def survey_table(survey: Survey) -> str:
    """Return a row for each structure as CSV, in the order given; parameters with their units in the header."""
    units: dict[str, str] = {}
    for item in survey.done:
        units |= {name: str(estimate["unit"]) for name, estimate in item.parameters.items()}
    head = ["name", "verdict", "missing_effects", "most_probable_effects", "probability", "mass", "specimens"]
    head += ["frequency [Hz]", "damping_ratio", "gap_before", "gap_after"]
    for name, unit in units.items():
        bracket = "" if unit in ("1", "-") else f" [{unit}]"
        head += [f"{name}{bracket}", f"{name}_sd{bracket}"]
    head += ["stands_out", "seed", "seconds", "attempts", "error"]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    for item in survey.structures:
        numbers = (item.mass, item.specimens, item.frequency, item.damping_ratio, item.gap_before, item.gap_after)
        row: list[Any] = [_cell(item.name), item.verdict or "failed", "+".join(item.missing_effects)]
        row += ["+".join(item.effects), *map(_number, (item.probability, *numbers))]
        for name in units:
            estimate: Mapping[str, Any] = item.parameters.get(name, {})
            row += [_number(estimate.get(key)) for key in ("mean", "sd")]
        row += ["; ".join(survey.standing_out.get(item.name, ())), item.seed, _number(item.seconds), item.attempts]
        writer.writerow([*row, _cell(item.error or "")])
    return stream.getvalue()


def _cell(text: str) -> str:
    """Return text that a spreadsheet does not take for a formula."""
    return f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\r") else text


def _number(value: Any) -> str:
    return "" if value is None or value != value else f"{value:.9g}"


def _summary(output: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return the summary of the survey in a folder; None where there is none."""
    try:
        content = json.loads((Path(output) / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    is_survey = isinstance(content, dict) and content.get("program") == PROGRAM and content.get("kind") == "survey"
    return content if is_survey and isinstance(content.get("seed"), int) else None


def _write_text(path: Path, text: str) -> None:
    with replacing(path) as temporary:
        _put(text, temporary)


def _put(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


__all__ = ["begun_survey", "stored_seed", "survey_table", "write_survey"]
