"""One structure of a survey: what is sent to a worker, what is done there, and the plain record that comes back."""

from __future__ import annotations

import contextlib
import gc
import json
import logging
import os
import threading
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from .._common.atomic_files import replacing
from .._common.checks import InputError
from .._common.options import pick
from ..discrepancy.options import Searching
from ..discrepancy.results.verdict import LEAST_SHARE, MECHANISM_NAMED, NamedLevel
from ..inference.options import Sampling
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading

STRUCTURE_FILE = "structure.json"
_ONE_STUDY = threading.Lock()


@dataclass(frozen=True)
class Structure:
    """What a survey knows of one structure: plain values, as in ``summary.json``.

    Attributes
    ----------
    name : str
        Its name.
    source : str
        Where the records came from; empty for what was in memory.
    verdict : {"adequate", "found", "ambiguous", "unexplained"} or None
        The decision; None where it failed.
    sentence : str
        The verdict in one sentence.
    missing_effects : tuple of str
        The named effects; empty unless the verdict is ``found`` and the law is named.
    effects : tuple of str
        The most probable set of effects beyond the base, named or not.
    probability : float
        Posterior probability of that set; NaN where it failed.
    ambiguous_sets : tuple of tuple of str
        The sets that cannot be told apart, where the verdict is ``ambiguous``.
    mass : float
        kg, or kg m^2 for a rotation.
    specimens : int
        How many records were used.
    frequency : float
        Of the linear part, from its mean stiffness and the mass [Hz].
    damping_ratio : float
        Of the linear part, from its mean viscous damping [1].
    parameters : mapping of str to mapping
        Of the extended model, by name: ``mean``, ``sd``, ``hdi_low``, ``hdi_high``, ``unit``.
    gap_before, gap_after : float
        Reduced chi-square on held-out specimens (on held-out levels where there is one specimen) with the base model
        and with the extended one; NaN where it was not measured.
    warnings : tuple of str
        Checks of the data that failed, and findings on the posterior.
    seed : int
        Of everything random in it.
    seconds : float
        Of computation.
    error : str or None
        Why it failed, in one sentence; None where it is done.
    traceback : str or None
        Where the failure is a fault of the program: where in it.
    report : str or None
        Path of its report, relative to the folder of the survey.
    attempts : int
        How often it was run: 2 where a worker was lost.
    mechanisms : tuple of str
        The named mechanisms, where the verdict is ``found`` and no law is named; else empty.

    See Also
    --------
    diagnose_many : takes many.
    Survey : what comes of them.
    """

    name: str
    source: str = ""
    verdict: str | None = None
    sentence: str = ""
    missing_effects: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    probability: float = float("nan")
    ambiguous_sets: tuple[tuple[str, ...], ...] = ()
    mass: float = float("nan")
    specimens: int = 0
    frequency: float = float("nan")
    damping_ratio: float = float("nan")
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    gap_before: float = float("nan")
    gap_after: float = float("nan")
    warnings: tuple[str, ...] = ()
    seed: int = 0
    seconds: float = float("nan")
    error: str | None = None
    traceback: str | None = None
    report: str | None = None
    attempts: int = 1
    mechanisms: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[str, ...]:
        """What is named: the missing effects or, where no law is, the mechanisms."""
        return self.missing_effects or self.mechanisms

    @property
    def is_done(self) -> bool:
        """Whether there is a verdict."""
        return self.error is None

    def entries(self) -> dict[str, Any]:
        """Return it as plain values by the names of its attributes."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Structure:
        """Return what `entries` gave, also after a way through JSON."""
        known = {item.name: item for item in fields(cls)}
        values: dict[str, Any] = {}
        for name, value in entries.items():
            if name not in known:
                continue
            if value is None and known[name].type == "float":
                value = float("nan")
            if isinstance(value, list):
                value = tuple(tuple(item) if isinstance(item, list) else item for item in value)
            values[name] = value
        return cls(**values)


@dataclass(frozen=True)
class Job:
    """What is sent to a worker: paths (or arrays that were in memory already) and plain settings.

    ``folder`` is the absolute path of the structure's own output folder; None: nothing is written. ``request`` is a
    digest of all that the result depends on, kept with it.
    """

    name: str
    source: Any
    settings: Mapping[str, Any]
    folder: str | None = None
    report: str | None = None
    request: str = ""


def run_job(job: Job) -> dict[str, Any]:
    """Diagnose one structure and return its record; what fails becomes a sentence in it."""
    from ..workflows.diagnose import diagnose

    begun = time.perf_counter()
    entries = blank(job)
    # Threads of one process take turns: warnings and compilers have state that they would share, and the interpreter
    # runs one of them at a time anyway.
    # Linear algebra rounds differently in one thread and in several; with one, a study has the same digits everywhere.
    with _ONE_STUDY, threadpool_limits(1):
        try:
            if job.folder is not None:
                Path(job.folder, STRUCTURE_FILE).unlink(missing_ok=True)
            result = diagnose(
                job.source,
                mass=job.settings["mass"],
                output=job.folder,
                base=job.settings.get("base", ()),
                searching=pick(Searching, job.settings),
                reading=pick(Reading, job.settings),
                measuring=pick(Measuring, job.settings),
                sampling=pick(Sampling, job.settings),
                overwrite=True,
                say=_say_nothing,
            )
            entries.update(summary_of(result), report=job.report)
        except InputError as error:
            entries.update(error=" ".join(str(error).split()))
        except Exception as error:
            said = " ".join(str(error).split())[:300]
            entries.update(error=f"{type(error).__name__} where none was expected ({said}): a fault of the program.")
            entries.update(traceback=traceback.format_exc())
        entries["seconds"] = time.perf_counter() - begun
        if job.folder is not None and entries["error"] is not None:
            with contextlib.suppress(OSError):
                os.rmdir(job.folder)  # if nothing is in it
        if job.folder is not None and entries["error"] is None:
            try:
                write_entries(Path(job.folder), entries, job.request)
            except InputError as error:
                entries.update(error=str(error))
    gc.collect()  # compiled models stand in reference cycles, which are small to Python and large in memory
    return entries


def blank(job: Job) -> dict[str, Any]:
    """Return the record of a structure of which nothing is known yet."""
    source = str(job.source) if isinstance(job.source, str | os.PathLike) else ""
    settings = job.settings
    return Structure(job.name, source, mass=float(settings["mass"]), seed=int(settings["random_seed"])).entries()


def summary_of(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a survey keeps of a study, from the content of its ``result.json``."""
    parameters = {
        name: {key: estimate[key] for key in ("mean", "sd", "hdi_low", "hdi_high", "unit")}
        for group in result["parameters"].values()
        for name, estimate in group.items()
    }
    stiffness, damping = (
        float(parameters.get(name, {}).get("mean") or np.nan) for name in ("linear_stiffness", "viscous_damping")
    )
    mass = float(result["mass"])
    with np.errstate(invalid="ignore", divide="ignore"):
        omega = float(np.sqrt(np.float64(stiffness) / mass))
        ratio = float(np.float64(damping) / (2.0 * mass * omega))
    gap = result["gap"]["held_out_specimens"]
    if gap["before"] is None:
        gap = result["gap"]["held_out_levels"]
    candidates = result["candidates"]
    return {
        "verdict": result["verdict"],
        "sentence": result["sentence"],
        "missing_effects": tuple(item["name"] for item in result["missing_effects"]),
        "mechanisms": tuple(
            item["mechanism"]
            for item in result.get("mechanisms", ())
            if result.get("named_level") == NamedLevel.MECHANISM
            and item["probability"] >= MECHANISM_NAMED
            and item["share_of_gap"] >= LEAST_SHARE
        ),
        "effects": tuple(candidates[0]["effects"]) if candidates else (),
        "probability": _number(result["probability"]),
        "ambiguous_sets": tuple(tuple(names) for names in result["ambiguous_sets"]),
        "mass": mass,
        "specimens": len(result["specimens"]),
        "frequency": omega / (2.0 * np.pi),
        "damping_ratio": ratio,
        "parameters": parameters,
        "gap_before": _number(gap["before"]),
        "gap_after": _number(gap["after"]),
        "warnings": (
            *(check["message"] for check in result["data_checks"] if not check["passed"]),
            *result["findings"],
        ),
    }


def write_entries(folder: Path, entries: Mapping[str, Any], request: str) -> None:
    """Keep a finished record in its folder: the sign that everything else there is written."""
    from ..reporting.portable import plain

    text = json.dumps({"request": request, **plain(entries)}, indent=1, allow_nan=False)
    with replacing(folder / STRUCTURE_FILE) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8", newline="\n")


def read_entries(folder: Path, request: str) -> dict[str, Any] | None:
    """Return the record that an earlier run finished, if it answers this request."""
    try:
        entries = json.loads((folder / STRUCTURE_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return entries if isinstance(entries, dict) and entries.get("request") == request else None


def prepare_worker() -> None:
    """Keep what libraries say out of the terminal of the survey: findings and checks say it again."""
    logging.getLogger("pymc").setLevel(logging.CRITICAL)
    logging.root.addHandler(logging.NullHandler())
    warnings.simplefilter("ignore")


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _say_nothing(text: str) -> None:
    """Print nothing."""


__all__ = ["Job", "Structure", "run_job"]
