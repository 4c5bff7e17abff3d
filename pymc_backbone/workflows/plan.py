"""From the folder of a diagnosis that leaves several sets to the test that decides: what the command ``plan`` does."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import ascii_uppercase
from typing import Any

from .._common.atomic_files import replacing
from .._common.checks import InputError
from ..discrepancy.results.design import Affordable, Contender, Design, contenders_from
from ..discrepancy.results.verdict import NamedLevel
from ..effects import LIBRARY
from ..reporting.output_folder import read_result
from ..reporting.terminal import aligned
from .measure import Progress, Say

NOTHING_TO_TELL: Mapping[tuple[str, str | None], str] = {
    ("adequate", None): ", because nothing is missing",
    ("found", NamedLevel.LAW): ", because the law is named",
    ("found", NamedLevel.MECHANISM): ", because none is exact: no test can be simulated that decides between laws; "
    "measure at other amplitudes, and diagnose all records together",
    ("unexplained", None): ", because none explains the records; `What to do next` in report.html says more",
}
"""Why a verdict has no sets to plan a test for, by verdict and what is named."""


def plan(
    folder: str | os.PathLike[str],
    *,
    affordable: Affordable | None = None,
    random_seed: int = 0,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    say: Say = print,
) -> dict[str, Any]:
    """Say which test would tell apart what a diagnosis left possible.

    Parameters
    ----------
    folder : path-like
        Output folder of ``diagnose``.
    affordable : Affordable, optional
        What the next test may cost.
    random_seed : int, default 0
        Of the draws.
    output : path-like, optional
        A JSON file for the plan; none by default.
    overwrite : bool, optional
        Whether ``output`` may exist.
    progress : callable, optional
        Called with the stage and the fraction done.
    say : callable, optional
        Called with each line; ``print`` by default.

    Returns
    -------
    dict
        ``contenders``, ``best``, ``repeat`` and ``looked_at``, as under ``plan`` in ``result.json``.

    Raises
    ------
    InputError
        Where the folder is none of ``diagnose``, or its verdict leaves nothing to tell apart.
    """
    target = None if output is None else Path(output)
    if target is not None and target.exists() and not overwrite:
        raise InputError(f"{target} exists already; choose another file, or allow it to be overwritten.")
    result = read_result(folder)
    present, contenders = _of(result, Path(folder))
    from ..discrepancy.planning.plan import plan_tests
    from ..discrepancy.wording.plan_words import describe, name_of, percent, sentences
    from ..oscillator import Oscillator
    from ..reporting.portable import plain
    from ..reporting.study_files import plan_entries

    unit = str(result.get("amplitude_unit", "m"))
    base = Oscillator(float(result["mass"]), [str(name) for name in result["base_effects"]])
    found = plan_tests(base, contenders, present, affordable=affordable, random_seed=random_seed, progress=progress)
    letters = ascii_uppercase[: len(found.contenders)]
    told = [f"{letter}: {name_of(item)}" for letter, item in zip(letters, found.contenders, strict=True)]
    rows = [("test", "decides", *(f"if {letter}" for letter in letters), "recording [s]")]
    for item in (*found.best, found.repeat):
        name = describe(item.design, present, unit) if item is not found.repeat else "the same again"
        rows.append((name, percent(item.probability), *(percent(p) for p in item.by_set), f"{item.seconds:.3g}"))
    say(
        "\n".join(
            ["", *told, "", aligned(rows), "", *(f"- {sentence}" for sentence in sentences(found, present, unit))]
        )
    )
    entries = dict(plain(plan_entries(found)))
    if target is not None:
        import json

        with replacing(target) as temporary:
            temporary.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
        say(f"\nThe plan is in {target}.")
    return entries


def _of(result: Mapping[str, Any], folder: Path) -> tuple[Design, Sequence[Contender]]:
    """Return the test and the sets that a result holds, or say what is lacking."""
    if "verdict" not in result:
        raise InputError(f"{folder} is no output folder of `diagnose`; make one with `pymc-backbone diagnose`.")
    if not result.get("ambiguous_sets"):
        why = NOTHING_TO_TELL.get((str(result["verdict"]), result.get("named_level")), "")
        raise InputError(f"the verdict in {folder} is `{result['verdict']}`: no sets left to tell apart{why}.")
    if not result.get("present"):
        raise InputError(f"{folder} was made from backbones alone; a plan needs to know how the records were made.")
    if len(result.get("contenders") or ()) < 2:
        raise InputError(f"{folder} holds fewer than two sets that remain possible; diagnose the records again.")
    try:
        present, contenders = Design(**result["present"]), contenders_from(result["contenders"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder}: `present` or `contenders` in result.json are not as `diagnose` writes them."
        ) from error
    strange = [name for item in contenders for name in item.effects if name not in LIBRARY]
    if strange:
        raise InputError(f"{folder} names {strange[0]!r}, which the library does not hold; plan in Python instead.")
    return present, contenders
