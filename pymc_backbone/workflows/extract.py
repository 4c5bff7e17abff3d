"""From records to backbones in a folder in one call: what the command ``extract`` does."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from .._common.options import settings_of
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from ..reporting.claimed_folder import claimed_output
from ..reporting.output_folder import package_version, write_results
from ..reporting.terminal import describe_measured
from .measure import Progress, Say, measure, say_reading, say_warnings


def extract(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str],
    reading: Reading | None = None,
    measuring: Measuring | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    say: Say = print,
) -> dict[str, Any]:
    """Extract backbones and write them with figures to an output folder.

    Parameters
    ----------
    path : path-like
        File or folder of records.
    output : path-like
        Output folder.
    reading, measuring : optional
        As in `measure`.
    overwrite : bool, optional
        Whether the folder may hold something already.
    progress : callable, optional
        Called with the stage and the fraction done while cycles are extracted.
    say : callable, optional
        Called with each line of progress; ``print`` by default.

    Returns
    -------
    dict
        What ``result.json`` holds.
    """
    reading = Reading() if reading is None else reading
    measuring = Measuring() if measuring is None else measuring
    with claimed_output(output, overwrite, records=path) as folder:
        assert folder is not None
        return _extract_into(folder, path, reading, measuring, progress, say)


def _extract_into(
    folder: Path,
    path: str | os.PathLike[str],
    reading: Reading,
    measuring: Measuring,
    progress: Progress | None,
    say: Say,
) -> dict[str, Any]:
    """Extract backbones into a folder that is ready."""
    begin = time.perf_counter()
    if progress is not None:
        progress("reading the records", float("nan"))
    measured = measure(path, reading, measuring, progress)
    say_reading(measured, say)
    say(describe_measured(measured.backbones))
    say_warnings(measured.notes, say)
    result: dict[str, Any] = {
        "version": package_version(),
        "command": "extract",
        "settings": {"records": str(path), **settings_of(reading, measuring)},
        **measured.entries(),
    }
    from .. import plots

    if progress is not None:
        progress("drawing the figures", float("nan"))
    figures = {"backbones": plots.plot_backbones(measured.backbones)}
    if measured.records:
        figures["records"] = plots.plot_records(measured.records)
    result["seconds"] = {"total": round(time.perf_counter() - begin, 2)}
    write_results(folder, result, backbones=measured.backbones, figures=figures)
    say(f"\nBackbones and figures are in {folder}.")
    return result
