"""What ``diagnose --many`` adds: many structures, their own settings, where they run."""

from __future__ import annotations

import argparse
import csv
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from .._common.checks import InputError, check_choice
from .._common.options import settings_of
from .._common.quiet import hush_libraries
from ..discrepancy.options import Searching
from ..inference.options import Sampling
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from ..measurement.reading.tables import read_text
from . import options
from .common import chosen, print_result, say_of, shown_progress

MOST_NAMED = 3
CONNECT = 10.0  # seconds to reach a scheduler
# Columns of the file that --structures names, with the reader of the option they stand for.
COLUMNS: dict[str, Callable[[str], Any]] = {
    "mass": options.number("mass"),
    "base": lambda text: options.split(text.split()),
    "candidates": lambda text: options.split(text.split()),
    "band": options.band,
    "start": options.number("start"),
    "stop": options.number("stop"),
    "floor": options.amplitude,
    "levels": options.levels,
    "tolerance": options.tolerance,
    "columns": options.columns,
    "quantity": str,
    "unit": str,
    "sampling_rate": options.number("sampling_rate"),
    "sensitivity": lambda text: [text],
    "frequency": options.number("frequency"),
    "reference": str,
}
WITH_COMMAS = ("mass", "band", "start", "stop", "floor", "sampling_rate", "frequency")
"""Columns of single numbers, whose commas are decimal where cells are separated by semicolons or tabs."""


def add_many(parser: argparse.ArgumentParser) -> None:
    """Add the options of many structures."""
    group = parser.add_argument_group("many structures")
    group.add_argument(
        "--many",
        action="store_true",
        help="RECORDS is a folder that holds a folder of records for each structure: diagnose each, and compare them",
    )
    group.add_argument(
        "--structures",
        type=Path,
        metavar="CSV",
        help=f"settings of single structures: a column name (its folder), and any of {', '.join(COLUMNS)}, as the "
        "options; what is empty is that of the command line",
    )
    group.add_argument(
        "--workers",
        type=options.count("--workers", 0),
        metavar="N",
        help="number of processes (default: one for each core; 0: none but this one)",
    )
    group.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="run on a Dask cluster, such as tcp://host:8786; its workers must see the folders under the same paths",
    )
    group.add_argument(
        "--resume",
        action="store_true",
        help="keep what an earlier run into the output folder finished with the same settings and records",
    )


def searching_of(given: argparse.Namespace) -> Searching:
    """Return the options of the search for a missing effect."""
    return replace(chosen(Searching, given), candidates=options.split(given.candidates) or None)


def refuse_without_many(given: argparse.Namespace) -> None:
    """Raise if an option of many structures is given for one."""
    for name in ("structures", "workers", "dask", "resume"):
        if getattr(given, name):
            raise InputError(f"--{name} is for many structures: add --many, or drop it.")


def diagnose_many(given: argparse.Namespace) -> None:
    """Run ``diagnose --many``."""
    from ..survey.names import structures_of

    if given.mass is not None and given.mass[1]:
        raise InputError("a mass with its deviation is for one structure: give --mass without it, or drop --many.")
    names = list(structures_of(given.path, given.output))
    each = {} if given.structures is None else read_structures(given.structures, names)
    if given.dask is not None and given.workers is not None:
        raise InputError("--workers is for processes on this machine, and --dask says where else to run; drop one.")
    hush_libraries(given.quiet)
    from ..survey.workflow import SETTINGS, diagnose_many

    kinds = (chosen(Reading, given), chosen(Measuring, given), chosen(Sampling, given))
    settings = settings_of(searching_of(given), *kinds)
    say = say_of(given)
    with _executor(given.dask) as executor, shown_progress(given) as (progress, say_below):
        survey = diagnose_many(
            given.path,
            mass=None if given.mass is None else given.mass[0],
            base=options.split(given.base),
            each=each,
            executor=executor,
            workers=given.workers,
            output=given.output,
            random_seed=given.random_seed,
            **{name: value for name, value in settings.items() if name in SETTINGS},
            resume=given.resume,
            overwrite=given.overwrite,
            command=shlex.join(["pymc-backbone", *given.arguments]),
            progress=progress,
            say=say_below,
        )
    say(f"\nThe summary is {given.output / 'summary.html'}, with a link to the report of each structure.")
    print_result(given, {"program": "pymc-backbone", **survey.entries()})
    if survey.interrupted:
        raise KeyboardInterrupt
    if survey.failed:
        first = ", ".join(item.name for item in survey.failed[:MOST_NAMED])
        rest = len(survey.failed) - MOST_NAMED
        named = f"{first} and {rest} more" if rest > 0 else first
        raise InputError(
            f"{len(survey.failed)} of {survey.total} structures could not be diagnosed ({named}); the others are done, "
            f"{given.output / 'summary.html'} says why."
        )


def read_structures(path: Path, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the settings of single structures, of those named, from a CSV file with a column ``name``.

    Commas, semicolons or tabs separate the cells; with the latter two, numbers may have decimal commas.

    Raises
    ------
    InputError
        With the line and the column at fault.
    """
    if not path.is_file():
        raise InputError(f"{path}: cannot be read (there is no such file); check the path.")
    text = read_text(path, str(path))[0] if path.stat().st_size else ""
    first = text.partition("\n")[0]
    separator = next((sign for sign in ";\t" if sign in first), ",")
    try:
        rows = list(csv.reader(text.splitlines(), strict=True, skipinitialspace=True, delimiter=separator))
    except csv.Error as error:
        raise InputError(f"{path}: is not a CSV file ({error}).") from None
    head = [cell.strip().lower().replace("-", "_") for cell in rows[0]] if rows else []
    if "name" not in head:
        raise InputError(f"{path}, line 1: expected a column 'name', the folder of each structure, and others.")
    for column in head:
        check_choice(f"{path}: column", column, ("name", *COLUMNS))
        if head.count(column) > 1:
            raise InputError(f"{path}, line 1: the column {column!r} stands there twice; keep one.")
    found: dict[str, dict[str, Any]] = {}
    for line, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(head):
            raise InputError(f"{path}, line {line}: expected {len(head)} cells as in line 1, got {len(row)}.")
        cells = dict(zip(head, (cell.strip() for cell in row), strict=True))
        name = cells.pop("name")
        if not name or name in found:
            raise InputError(f"{path}, line {line}: the name {name!r} is {'twice there' if name else 'missing'}.")
        check_choice(f"{path}, line {line}: name", name, names)
        found[name] = {
            column: _read(path, line, column, _plain(column, text, separator)) for column, text in cells.items() if text
        }
    return found


def _plain(column: str, text: str, separator: str) -> str:
    """Return a cell with its decimal commas as points, where commas separate neither cells nor numbers."""
    is_number = column in WITH_COMMAS and separator != ","
    return re.sub(r"(?<=\d),(?=\d)", ".", text) if is_number else text


def _read(path: Path, line: int, column: str, text: str) -> Any:
    try:
        return COLUMNS[column](text)
    except argparse.ArgumentTypeError as error:
        raise InputError(f"{path}, line {line}, column {column}: {error}.") from None


@contextmanager
def _executor(address: str | None) -> Iterator[Executor | None]:
    """Yield an executor on a Dask cluster, or None where no address is given."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs Dask: install pymc-backbone[dask].") from None
    try:
        client = Client(address, timeout=CONNECT)
    except (OSError, ValueError, TypeError) as error:
        said = " ".join(str(error).split())[:200]
        raise InputError(f"no Dask scheduler answers at {address} ({said}); check the address.") from None
    with client:
        yield client.get_executor()
