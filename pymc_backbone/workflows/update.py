"""From records to an updated model in a folder in one call: what the command ``update`` and the demo do."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .._common.checks import FloatArray, InputError
from .._common.options import settings_of
from ..inference.options import Comparing, Keeping, Modelling, Sampling
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from ..reporting.claimed_folder import claimed_output
from ..reporting.output_folder import REPORT, read_result, write_results
from ..reporting.terminal import describe_batch, describe_result
from .infer import check_comparing, infer, oscillator_of
from .measure import Progress, Say, measure, say_reading, say_warnings
from .updated import figures_of, report_of, result_of


def update(
    path: str | os.PathLike[str],
    modelling: Modelling,
    *,
    reading: Reading | None = None,
    measuring: Measuring | None = None,
    comparing: Comparing | None = None,
    sampling: Sampling | None = None,
    keeping: Keeping | None = None,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    command: str = "update",
    true_values: Mapping[str, FloatArray] | None = None,
    progress: Progress | None = None,
    say: Say = print,
) -> dict[str, Any]:
    """Infer the parameters of an oscillator from records, and write everything to an output folder.

    Parameters
    ----------
    path : path-like
        File or folder of records, or of backbone tables.
    modelling : Modelling
        Mass, effects, priors, fixed parameters.
    reading, measuring : optional
        As in `measure`.
    comparing : Comparing, optional
        The likelihood.
    sampling : Sampling, optional
        Draws, chains, step, seed.
    keeping : Keeping, optional
        The folder that keeps the draws as they come, and whether to continue the run that is there.
    output : path-like, optional
        Output folder; without one nothing is written.
    overwrite : bool, optional
        Whether the folder may hold something already; where a run is resumed it may hold the result of one that Ctrl-C
        ended early.
    command : str, optional
        Written to the result.
    true_values : mapping of str to array of float, optional
        Known parameters of the specimens, drawn in the figure of the posterior.
    progress : callable, optional
        Called with the stage and the fraction done.
    say : callable, optional
        Called with each line of progress; ``print`` by default.

    Returns
    -------
    dict
        What ``result.json`` holds; its keys are `results.RESULT_KEYS`.
    """
    reading = Reading() if reading is None else reading
    measuring = Measuring() if measuring is None else measuring
    comparing = Comparing() if comparing is None else comparing
    sampling = Sampling() if sampling is None else sampling
    keeping = Keeping() if keeping is None else keeping
    with _output_of(path, output, overwrite, keeping) as folder:
        return _update_into(
            folder, path, modelling, reading, measuring, comparing, sampling, keeping, overwrite=overwrite,
            command=command, true_values=true_values, progress=progress, say=say,
        )  # fmt: skip


def _update_into(
    folder: Path | None, path: str | os.PathLike[str], modelling: Modelling, reading: Reading, measuring: Measuring,
    comparing: Comparing, sampling: Sampling, keeping: Keeping, *, overwrite: bool, command: str,
    true_values: Mapping[str, FloatArray] | None, progress: Progress | None, say: Say,
) -> dict[str, Any]:  # fmt: skip
    """Update into a folder that is ready, or into none."""
    begin = time.perf_counter()
    sampling = replace(sampling, random_seed=_seed(sampling, keeping))
    oscillator = oscillator_of(modelling)
    check_comparing(modelling, comparing, sampling)
    tell = progress or (lambda _stage, _fraction: None)
    tell("reading the records", float("nan"))
    measured = measure(path, reading, measuring, progress)
    say_reading(measured, say)
    say(describe_batch(measured.backbones))
    say_warnings(measured.notes, say)
    read = time.perf_counter()
    updated = infer(oscillator, measured, modelling, comparing, sampling, keeping, say, progress)
    sampled = time.perf_counter()
    settings = {
        "path": path,
        **settings_of(reading, measuring, modelling, comparing, sampling, keeping),
        "likelihood": updated.likelihood,
        "output": folder,
        "overwrite": overwrite,
    }
    result = result_of(updated, command, settings)
    say("\n" + describe_result(result))
    if result["interrupted"]:
        say(f"\n{result['interrupted']}")
    tell("drawing the figures", float("nan"))
    figures = {} if folder is None else figures_of(updated, true_values)
    texts = {} if folder is None else {REPORT: report_of(result, updated, figures)}
    result["seconds"] = {
        "reading": round(read - begin, 2),
        "sampling": round(sampled - read, 2),
        "total": round(time.perf_counter() - begin, 2),
    }
    if folder is not None:
        parts = {"backbones": measured.backbones, "summary": updated.table, "posterior": updated.posterior}
        write_results(folder, result, **parts, figures=figures, texts=texts)
        say(f"\nAll numbers, draws and figures are in {folder}; begin with {folder / REPORT}.")
    return result


def _output_of(
    path: str | os.PathLike[str], output: str | os.PathLike[str] | None, overwrite: bool, keeping: Keeping
) -> AbstractContextManager[Path | None]:
    """Return what makes the output folder ready; the draws are kept elsewhere."""
    is_same = output is not None and keeping.store is not None
    if is_same and Path(str(keeping.store)).resolve() == Path(str(output)).resolve():
        raise InputError(f"The store and the output are both {output}; give each a folder of its own.")
    is_rest = output is not None and keeping.resume and _ended_early(output)
    return claimed_output(output, overwrite or is_rest, records=path)


def _seed(sampling: Sampling, keeping: Keeping) -> int:
    """Return the seed: the one given, the one of the run that is resumed, or a new one; check the store on the way."""
    if keeping.store is not None:
        from ..inference.store.run_folder import DrawStore

        with DrawStore(keeping.store, keeping.resume) as kept:
            return kept.seed(sampling.random_seed)
    if keeping.resume:
        raise InputError("`resume` continues a run that was stored; name its folder with `store`.")
    if sampling.random_seed is not None:
        return sampling.random_seed
    return int(np.random.SeedSequence().generate_state(1)[0])


def _ended_early(output: str | os.PathLike[str]) -> bool:
    """Whether a folder holds the result of a run that was ended early, which the rest of that run may replace."""
    try:
        return bool(read_result(output).get("interrupted"))
    except InputError:
        return False
