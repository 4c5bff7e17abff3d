"""From records to a study in a folder in one call: what the command ``diagnose`` does."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._common.checks import InputError, check_choice, check_positive
from .._common.late_imports import imported_beside
from .._common.options import settings_of
from .._common.text import in_words
from ..discrepancy.options import Searching
from ..inference.options import Sampling
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from ..reporting.claimed_folder import claimed_output
from ..reporting.output_folder import REPORT, package_version, read_result
from ..reporting.portable import plain
from ..reporting.terminal import aligned, describe_reading, measured_damping_words, short
from .measure import Progress, Say, measure, say_warnings

if TYPE_CHECKING:
    import xarray as xr

    from ..discrepancy.results.entries import Candidate, Estimate
    from ..discrepancy.results.study import Study
    from ..measurement.reading.record import Record

    Data = str | os.PathLike[str] | Sequence[Record] | xr.Dataset

TOP_CANDIDATES = 5
TOP_LAWS = 3


def diagnose(
    path: Data,
    *,
    mass: float,
    mass_error: float = 0.0,
    output: str | os.PathLike[str] | None,
    base: Sequence[str] = (),
    searching: Searching | None = None,
    reading: Reading | None = None,
    measuring: Measuring | None = None,
    sampling: Sampling | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    say: Say = print,
) -> dict[str, Any]:
    """Find what a model lacks to explain records, and write report, model and figures to an output folder.

    Parameters
    ----------
    path : path-like, or what was read already
        File or folder of records, or of backbone tables; or records or a Dataset of backbones.
    mass : float
        Mass [kg], or inertia [kg m^2] for a rotation.
    mass_error : float, optional
        Its standard deviation, which goes into those of the parameters that go with the mass.
    output : path-like or None
        Output folder; None: nothing is written.
    base : sequence of str, optional
        Effects of the model that is questioned, beside linear stiffness and viscous damping.
    searching : Searching, optional
        Candidates, tolerance, what is held out.
    reading, measuring : optional
        As in `measure`; the search takes every observable that the records tell.
    sampling : Sampling, optional
        Draws, chains, step, seed.
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
    searching = Searching() if searching is None else searching
    reading = Reading() if reading is None else reading
    measuring = Measuring() if measuring is None else measuring
    sampling = Sampling() if sampling is None else sampling
    with claimed_output(output, overwrite, records=path):
        return _diagnosed(
            path, mass, output, base, searching, reading, measuring, sampling, overwrite=overwrite, progress=progress,
            say=say, mass_error=mass_error,
        )  # fmt: skip


def _diagnosed(
    path: Data, mass: float, output: str | os.PathLike[str] | None, base: Sequence[str], searching: Searching,
    reading: Reading, measuring: Measuring, sampling: Sampling, *, overwrite: bool, progress: Progress | None, say: Say,
    mass_error: float,
) -> dict[str, Any]:  # fmt: skip
    """Diagnose into a folder that is ready."""
    from ..effects import LIBRARY
    from ..oscillator import Oscillator

    oscillator = Oscillator(mass, base)
    for name in searching.candidates or ():  # before anything is read, which may take long
        check_choice("candidates", name, LIBRARY)
    data, records, left_out = _read(path, reading, measuring, say)
    settings = {name: value for name, value in settings_of(searching, sampling).items() if value is not None}
    if not reading.is_table:  # the tables are at the levels already
        settings |= {name: value for name, value in settings_of(measuring).items() if name != "observables"}
    from ..discrepancy.workflow import find_missing_effect

    # what draws and writes at the end takes long to import and waits for the disk
    with nullcontext() if output is None else imported_beside("pymc_backbone.reporting.study_files", "h5netcdf"):
        study = find_missing_effect(oscillator, data, progress=progress, **settings)
    study = replace(study, notes=(*left_out, *study.notes))
    if mass_error:
        study = with_uncertain_mass(study, mass_error)
    from ..reporting.study_files import study_entries, write_study

    if output is None:
        _say_study(study, say)
        return dict(plain(study_entries(study, package_version())))
    if progress is not None:
        progress("writing the report", 1.0)
    command = ""
    if isinstance(path, str | os.PathLike):
        chosen = (searching, reading, measuring, replace(sampling, random_seed=study.seed))
        command = command_line(path, (mass, mass_error), base, settings_of(*chosen), output, overwrite=overwrite)
    folder = Path(output)
    write_study(study, folder, overwrite=overwrite, command=command, records=records)
    _say_study(study, say)
    say(f"\nThe report is {folder / REPORT}; numbers, figures and a PyMC script are beside it.")
    return read_result(folder)


def _say_study(study: Study, say: Say) -> None:
    say_warnings(study.notes, say)
    say(describe_study(study))
    ratio = measured_damping_words(study.backbones)
    if ratio:
        say(f"\n{ratio}")


def _read(path: Data, reading: Reading, measuring: Measuring, say: Say) -> tuple[Any, Sequence[Record], list[str]]:
    """Return the data for the search, the records among them, and notes on the files that were left out."""
    if not isinstance(path, str | os.PathLike):
        given = next((name for name, value in reading.of_records.items() if value is not None), None)
        if given is not None:
            raise InputError(f"`{given}` is for files, and these records are read already; give it to `read_records`.")
        return path, path if isinstance(path, Sequence) and not isinstance(path, str) else (), []
    if reading.is_table:
        return measure(path, reading, measuring).backbones, (), []
    from ..measurement.reading.records import read_record_files

    files = read_record_files(path, strict=measuring.strict, **reading.of_records)
    assumed = describe_reading(files.records)
    if assumed:
        say(assumed + "\n")
    from ..measurement.extraction import LEFT_OUT

    return files.records, files.records, [f"{LEFT_OUT}{sentence}" for sentence in files.refused]


def with_uncertain_mass(study: Study, mass_error: float) -> Study:
    """Return a study whose parameters hold the uncertainty of the mass they go with.

    A decay shows forces over mass: which effect is missing does not depend on the mass, but every parameter of a force
    is as uncertain as the mass, beside what the decays leave open.
    """
    check_positive("mass_error", mass_error)
    oscillator = study.extended or study.base
    mass, powers = oscillator.mass, oscillator.mass_exponents
    relative = mass_error / mass

    def widened(name: str, estimate: Estimate) -> Estimate:
        own = estimate.sd
        sd = float(np.hypot(own, powers.get(name, 0.0) * relative * estimate.mean))
        if not sd > own:
            return estimate
        # skew intervals keep their skewness: each side grows by what the mass adds to it
        added = 1.96 * abs(powers[name] * relative * estimate.mean)
        low, high = (float(np.hypot(end - estimate.mean, added)) for end in (estimate.hdi_low, estimate.hdi_high))
        return replace(estimate, sd=sd, hdi_low=estimate.mean - low, hdi_high=estimate.mean + high)

    parameters = {
        effect: {name: widened(name, estimate) for name, estimate in group.items()}
        for effect, group in study.parameters.items()
    }
    note = (
        f"the mass is {mass:g} +- {mass_error:g}: standard deviations and intervals of parameters that go with it hold "
        f"its {relative:.2%}; posterior.nc and the figures of draws are for {mass:g}"
    )
    return replace(study, parameters=parameters, notes=(*study.notes, note))


OPTIONS = {"is_table": "backbones", "random_seed": "seed"}
"""Options of the command line that have another name than the setting."""
REPEATED = ("sensitivity",)
"""Options that are given once for each of their values."""


def command_line(
    path: str | os.PathLike[str],
    mass: float | tuple[float, float],
    base: Sequence[str],
    settings: Mapping[str, Any],
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> str:
    """Return the command that repeats a study, as it is typed into a shell; defaults are left out.

    Examples
    --------
    >>> settings = {"draws": 2000, "random_seed": 4, "levels": (0.1, 0.2), "is_table": True}
    >>> command_line("my records", 1.2, ["freeplay"], settings, "out")
    "pymc-backbone diagnose 'my records' --mass 1.2 --base freeplay --seed 4 --levels 0.1,0.2 --backbones --out out"
    """
    defaults = settings_of(Searching(), Reading(), Measuring(), Sampling())
    value, error = mass if isinstance(mass, tuple) else (mass, 0.0)
    weight = f"{value:.15g}" + (f"+-{error:.15g}" if error else "")
    words = ["pymc-backbone", "diagnose", str(path), "--mass", weight]
    for name, value in {"base": list(base) or None, **settings}.items():
        if value is None or value is False or value == defaults.get(name):
            continue
        option = f"--{OPTIONS.get(name, name).replace('_', '-')}"
        if name in REPEATED:
            words += [word for item in value for word in (option, item)]
            continue
        words.append(option)
        if value is not True:
            words.append(_option_value(name, value))
    words += ["--overwrite"] if overwrite else []
    return shlex.join([*words, "--out", str(output)])


def _option_value(name: str, value: Any) -> str:
    """Return the value of an option as it is typed."""
    if isinstance(value, Mapping):
        is_zero = not any(value.values())
        return "0" if is_zero else ",".join(f"{key}={item:.15g}" for key, item in value.items())
    parts = value if isinstance(value, list | tuple) else [value]
    texts = [f"{part:.15g}" if isinstance(part, float) else str(part) for part in parts]
    return (":" if name == "band" else ",").join(f'"{text}"' if "," in text else text for text in texts)


def describe_study(study: Study) -> str:
    """Say what was found: the verdict, why, the most probable sets, the gap before and after."""
    lines = [f"{study.verdict.upper()}: {study.sentence}"]
    lines += [f"- {sentence}" for sentence in (*study.reasons, *study.advice)]
    if study.force_curves is not None:
        lines.append(f"- {study.force_curves.sentence}")
    lines += [*_mechanism_lines(study), *_candidate_lines(study), *_held_out_lines(study)]
    warned = [f"- {check.message}" for check in study.checks if not check.passed]
    warned += [f"- {sentence}" for sentence in study.findings]
    if study.evidence_basis is not None and any(item.is_doubtful for item in study.candidates):
        warned.append(f"- {study.evidence_basis.sentence}")
    if warned:
        lines += ["", "Look at this:", *warned]
    return "\n".join(lines)


def _mechanism_lines(study: Study) -> list[str]:
    from ..reporting.words import mechanism_name, percent

    if not study.mechanisms:
        return []
    heads: list[tuple[str, ...]] = [("mechanism", "laws", "probability", "share of the gap")]
    for kind in study.mechanisms:
        laws = ", ".join(f"{in_words(law.effect)} {percent(law.probability)}" for law in kind.laws[:TOP_LAWS])
        heads.append((mechanism_name(kind.mechanism), laws, percent(kind.probability), percent(kind.share_of_gap)))
    return ["", aligned(heads)]


def _best_of(study: Study) -> Candidate | None:
    """Return the set that the verdict is said of."""
    from ..discrepancy.results.verdict import Status

    return next((item for item in study.candidates if item.status == Status.BEST), None)


def _candidate_lines(study: Study) -> list[str]:
    from ..reporting.words import candidate_name, percent

    if not study.candidates:
        return []
    rows: list[tuple[str, ...]] = [
        ("effects added to the base", "status", "probability", "reduced chi-square", "log evidence")
    ]
    for item in study.candidates[:TOP_CANDIDATES]:
        numbers = (percent(item.probability), short(item.reduced_chi_square), short(item.log_evidence))
        rows.append((candidate_name(item), item.status, *numbers))
    lines = ["", aligned(rows)]
    rest = len(study.candidates) - TOP_CANDIDATES
    if rest > 0:
        lines.append(f"  and {rest} more, in the report")
    best = _best_of(study)
    if best is not None and any(item.probability > best.probability for item in study.candidates):
        lines.append(f"  best is {candidate_name(best)}: {best.reason}")
    return lines


def _held_out_lines(study: Study) -> list[str]:
    gaps = []
    for held_out, what in ((study.held_out_levels, "levels"), (study.held_out_specimens, "specimens")):
        if held_out is not None:
            gaps.append(f"{what} {short(held_out.before)} before, {short(held_out.after)} after")
    if not gaps:
        return []
    best = _best_of(study)
    beside = " The drift with time is in none of these." if best is not None and best.has_drift else ""
    return ["", f"Gap on held-out data, as reduced chi-square: {'; '.join(gaps)}.{beside}"]
