"""The source paper's systems in one call: what the command ``cases`` does."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from .._common.checks import InputError, check_choice
from .._common.processes import Processes, WorkerDied
from .._common.quiet import hush_libraries
from ..reporting.claimed_folder import claimed_output
from .case_files import describe_case, describe_refusal, write_cases, write_figures
from .case_study import LIKELIHOODS, refused_records, run_case
from .cases import CASES, get_case


def run_cases(
    names: Sequence[str],
    likelihoods: Sequence[str] = ("product",),
    *,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    say: Callable[[str], None] = print,
    workers: int = 1,
    **settings: Any,
) -> list[dict[str, Any]]:
    """Run cases with likelihoods, print a table of each, and write tables, figures and ``cases.json``.

    Parameters
    ----------
    names : sequence of str
        Cases, or ``all``.
    likelihoods : sequence of str
        Any of `LIKELIHOODS`, or ``all``.
    output : path-like, optional
        Folder to write to; nothing is written without one.
    overwrite : bool
        Whether the folder may hold something already.
    say : callable
        Called with each piece of text.
    workers : int
        Processes that run cases side by side; 1 stays in this one. The numbers do not depend on it.
    **settings
        As in `run_case`.

    Returns
    -------
    list of dict
        One record per case, likelihood and parameter, with the keys `KEYS`. Where a density refuses a case (the
        data-consistent one a model that cannot produce the population), what would follow from draws is None.

    Raises
    ------
    InputError
        Unknown names, or no run that came to an end.
    """
    chosen = list(CASES) if "all" in names else [get_case(name).name for name in names]
    wanted = list(LIKELIHOODS) if "all" in likelihoods else list(likelihoods)
    for likelihood in wanted:
        check_choice("likelihood", likelihood, LIKELIHOODS)
    if not chosen or not wanted:
        raise InputError("`names` and `likelihoods` must hold at least one each.")
    with claimed_output(output, overwrite) as folder:
        begin = time.perf_counter()
        runs = [(name, likelihood) for name in dict.fromkeys(chosen) for likelihood in dict.fromkeys(wanted)]
        records: list[dict[str, Any]] = []
        texts: list[str] = []
        refusals: list[InputError] = []
        for found, text, refusal in _outcomes(runs, folder, settings, min(workers, len(runs))):
            records += found
            texts.append(text)
            say(text)
            if refusal is not None:
                refusals.append(refusal)
            if folder is not None:
                write_cases(folder, records, texts)  # what is done is kept, whatever happens to the next case
        if len(refusals) == len(runs):
            raise refusals[0]
        say(f"{len(texts)} run(s) in {time.perf_counter() - begin:.0f} s.")
        return records


Outcome = tuple[list[dict[str, Any]], str, InputError | None]


def _outcomes(
    runs: Sequence[tuple[str, str]], folder: Path | None, settings: dict[str, Any], workers: int
) -> Iterator[Outcome]:
    """Yield what became of each run, in their order."""
    if workers <= 1:
        for name, likelihood in runs:
            yield _run(name, likelihood, folder, settings)
        return
    pool = Processes(workers, partial(hush_libraries, is_quiet=True))
    futures = [pool.submit(_run, name, likelihood, folder, settings) for name, likelihood in runs]
    try:
        for (name, likelihood), future in zip(runs, futures, strict=True):
            try:
                outcome: Outcome = future.result()
            except WorkerDied as death:
                outcome = _refused(name, likelihood, settings, InputError(f"{death}."))
            yield outcome
    except BaseException:
        pool.kill()
        raise
    pool.shutdown()


def _run(name: str, likelihood: str, folder: Path | None, settings: dict[str, Any]) -> Outcome:
    """Run one case with one likelihood and write its figures."""
    try:
        result = run_case(name, likelihood, **settings)
    except InputError as error:
        return _refused(name, likelihood, settings, error)
    if folder is not None:
        write_figures(folder, result)
    return result.records, describe_case(result), None


def _refused(name: str, likelihood: str, settings: dict[str, Any], error: InputError) -> Outcome:
    case = get_case(name)
    records = refused_records(case, likelihood, settings.get("observables"), settings.get("random_seed", 1))
    return records, describe_refusal(case, likelihood, str(error)), error


__all__ = ["run_cases"]
