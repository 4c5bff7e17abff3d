"""From records to a study in a folder in one call: what the command ``diagnose`` does."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._common.checks import InputError
from ..reporting.output_folder import REPORT, package_version, plain, prepare_output, read_result
from ..reporting.terminal import aligned, describe_reading, short
from .measure import Levels, measure
from .update import Progress, Say

if TYPE_CHECKING:
    from ..discrepancy.study import Study

TOP_CANDIDATES = 5


def diagnose(
    path: Any,
    *,
    mass: float,
    output: str | os.PathLike[str] | None,
    base: Sequence[str] = (),
    candidates: Sequence[str] | None = None,
    max_effects: int = 3,
    tolerance: Mapping[str, float] | None = None,
    held_out: int | None = None,
    quick: bool = False,
    is_table: bool = False,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    levels: Levels = None,
    columns: Sequence[str] | None = None,
    quantity: str | None = None,
    unit: str | None = None,
    sampling_rate: float | None = None,
    draws: int = 2000,
    tune: int = 1000,
    chains: int = 4,
    step: str = "metropolis",
    random_seed: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    say: Say = print,
) -> dict[str, Any]:
    """Find what a model lacks to explain records, and write report, model and figures to an output folder.

    Parameters
    ----------
    path : path-like, or what was read already
        File or folder of records, or of backbone tables if ``is_table``; or records or a Dataset of backbones.
    mass : float
        Mass [kg], or inertia [kg m^2] for a rotation.
    output : path-like or None
        Output folder; None: nothing is written.
    base : sequence of str, optional
        Effects of the model that is questioned, beside linear stiffness and viscous damping.
    candidates : sequence of str, optional
        Effects that may be missing; all of the library by default.
    max_effects : int, optional
        Largest number of missing effects; 3 by default.
    tolerance : mapping of str to float, optional
        Relative tolerance by observable; by default that of `find_missing_effect`.
    held_out : int, optional
        How much to hold out, as in `find_missing_effect`.
    quick : bool, optional
        Whether to stop before sampling.
    is_table, band, start, levels, columns, quantity, unit, sampling_rate
        As in `measurement.measure`.
    draws, tune, chains, step, random_seed
        As in `sample`.
    overwrite : bool, optional
        Whether the folder may hold something already.
    progress : callable, optional
        Called with the stage and the fraction done.
    say : callable, optional
        Called with each line of the summary; ``print`` by default.

    Returns
    -------
    dict
        What ``result.json`` holds; its keys are `diagnosis_files.DIAGNOSIS_KEYS`.
    """
    settings: dict[str, Any] = {
        "candidates": candidates,
        "max_effects": max_effects,
        "quick": quick,
        "draws": draws,
        "tune": tune,
        "chains": chains,
        "step": step,
        "band": band,
        "start": start,
        "levels": levels,
    }
    settings.update({} if tolerance is None else {"tolerance": dict(tolerance)})
    settings.update({} if held_out is None else {"held_out": held_out})
    reading: dict[str, Any] = {
        "columns": columns,
        "quantity": quantity,
        "unit": unit,
        "sampling_rate": sampling_rate,
    }
    folder = None if output is None else prepare_output(output, overwrite)
    from ..oscillator import Oscillator

    oscillator = Oscillator(mass, base)
    data, records = _read(path, is_table, {"band": band, "start": start, "levels": levels}, reading, say)
    passed = {**settings, "levels": None} if is_table else settings  # the tables are at the levels already
    from ..discrepancy.workflow import find_missing_effect

    study = find_missing_effect(oscillator, data, random_seed=random_seed, progress=progress, **passed)
    from ..reporting.study_files import study_entries, write_study

    if folder is None or output is None:
        say(describe_study(study))
        return dict(plain(study_entries(study, package_version())))
    if progress is not None:
        progress("writing the report", 1.0)
    command = ""
    if isinstance(path, str | os.PathLike):
        flags = {"backbones": is_table, "overwrite": overwrite}
        command = command_line(path, mass, base, {**settings, **reading, "seed": study.seed}, flags, output)
    write_study(study, folder, overwrite=overwrite, command=command, records=records)
    say(describe_study(study))
    say(f"\nThe report is {Path(folder) / REPORT}; numbers, figures and a PyMC script are beside it.")
    return read_result(folder)


def _read(
    path: Any, is_table: bool, measurement: Mapping[str, Any], reading: Mapping[str, Any], say: Say
) -> tuple[Any, Sequence[Any]]:
    """Return the data for the search, and the records among them."""
    if is_table:
        return measure(path, is_table=True, **measurement, **reading).backbones, ()
    if not isinstance(path, str | os.PathLike):
        given = next((name for name, value in reading.items() if value is not None), None)
        if given is not None:
            raise InputError(f"`{given}` is for files, and these records are read already; give it to `read_records`.")
        return path, path if isinstance(path, Sequence) else ()
    from ..measurement.reading.records import read_records

    records = read_records(path, **reading)
    assumed = describe_reading(records)
    if assumed:
        say(assumed + "\n")
    return records, records


def command_line(
    path: str | os.PathLike[str],
    mass: float,
    base: Sequence[str],
    settings: Mapping[str, Any],
    flags: Mapping[str, bool],
    output: str | os.PathLike[str],
) -> str:
    """Return the command that repeats a study, as it is typed into a shell; defaults are left out.

    Examples
    --------
    >>> command_line("my records", 1.2, ["freeplay"], {"draws": 2000, "seed": 4, "levels": (0.1, 0.2)}, {}, "out")
    "pymc-backbone diagnose 'my records' --mass 1.2 --base freeplay --seed 4 --levels 0.1,0.2 --out out"
    """
    defaults = {"max_effects": 3, "draws": 2000, "tune": 1000, "chains": 4, "step": "metropolis"}
    words = ["pymc-backbone", "diagnose", str(path), "--mass", f"{mass:.15g}"]
    options = {"base": list(base) or None, **settings}
    for name, value in options.items():
        if value is None or value is False or value == defaults.get(name):
            continue
        words.append(f"--{name.replace('_', '-')}")
        if isinstance(value, Mapping):
            is_zero = not any(value.values())
            words.append("0" if is_zero else ",".join(f"{key}={item:.15g}" for key, item in value.items()))
        elif value is not True:
            separator = ":" if name == "band" else ","
            parts = value if isinstance(value, list | tuple) else [value]
            texts = [f"{part:.15g}" if isinstance(part, float) else str(part) for part in parts]
            words.append(separator.join(f'"{text}"' if "," in text else text for text in texts))
    words += [f"--{name}" for name, is_set in flags.items() if is_set]
    return shlex.join([*words, "--out", str(output)])


def describe_study(study: Study) -> str:
    """Say what was found: the verdict, why, the most probable sets, the gap before and after."""
    from ..reporting.words import percent, set_name

    lines = [f"{study.verdict.upper()}: {study.sentence}"]
    lines += [f"- {sentence}" for sentence in (*study.reasons, *study.advice)]
    if study.candidates:
        rows = [("effects added to the base", "status", "probability", "reduced chi-square", "log evidence")]
        for item in study.candidates[:TOP_CANDIDATES]:
            numbers = (percent(item.probability), short(item.reduced_chi_square), short(item.log_evidence))
            rows.append((set_name(item.effects), item.status, *numbers))
        lines += ["", aligned(rows)]
        rest = len(study.candidates) - TOP_CANDIDATES
        if rest > 0:
            lines.append(f"  and {rest} more, in the report")
    gaps = []
    for held_out, what in ((study.held_out_levels, "levels"), (study.held_out_specimens, "specimens")):
        if held_out is not None:
            gaps.append(f"{what} {short(held_out.before)} before, {short(held_out.after)} after")
    if gaps:
        lines += ["", f"Gap on held-out data, as reduced chi-square: {'; '.join(gaps)}."]
    warned = [f"- {check.message}" for check in study.checks if not check.passed]
    warned += [f"- {sentence}" for sentence in study.findings]
    if warned:
        lines += ["", "Look at this:", *warned]
    return "\n".join(lines)
