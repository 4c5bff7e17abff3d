"""The source paper's systems in one call: what the command ``cases`` does."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ._checks import InputError, check_choice
from .case_files import describe_case, write_cases, write_figures
from .case_study import LIKELIHOODS, run_case
from .cases import CASES, get_case
from .results import prepare_output


def run_cases(
    names: Sequence[str],
    likelihoods: Sequence[str] = ("product",),
    *,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    say: Callable[[str], None] = print,
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
    **settings
        As in `run_case`.

    Returns
    -------
    list of dict
        One record per case, likelihood and parameter, with the keys `KEYS`.
    """
    chosen = list(CASES) if "all" in names else [get_case(name).name for name in names]
    wanted = list(LIKELIHOODS) if "all" in likelihoods else list(likelihoods)
    for likelihood in wanted:
        check_choice("likelihood", likelihood, LIKELIHOODS)
    if not chosen or not wanted:
        raise InputError("`names` and `likelihoods` must hold at least one each.")
    folder: Path | None = None if output is None else prepare_output(output, overwrite)
    begin = time.perf_counter()
    records: list[dict[str, Any]] = []
    texts: list[str] = []
    for name in dict.fromkeys(chosen):
        for likelihood in dict.fromkeys(wanted):
            result = run_case(name, likelihood, **settings)
            records += result.records
            texts.append(describe_case(result))
            say(texts[-1])
            if folder is not None:
                write_figures(folder, result)
                write_cases(folder, records, texts)  # what is done is kept, whatever happens to the next case
    say(f"{len(texts)} run(s) in {time.perf_counter() - begin:.0f} s.")
    return records


__all__ = ["run_cases"]
