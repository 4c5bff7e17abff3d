"""The same diagnosis for many structures, on any executor: `diagnose_many`."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from .._common.checks import InputError, check_choice
from .._common.options import names_of
from .._common.processes import Processes
from ..discrepancy.options import Searching
from ..inference.options import Sampling
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from .files import begun_survey, stored_seed, structure_folder, write_survey
from .names import folder_names, request_digest, seed_of, structures_of
from .structure import Job, Structure, blank, prepare_worker, read_entries, run_job
from .survey import Survey, effects_in_words
from .tasks import Here, Lost, run_tasks

SETTINGS = tuple(
    name
    for kind in (Searching, Reading, Measuring, Sampling)
    for name in names_of(kind)
    if name not in ("observables", "random_seed")
)
"""Settings of `diagnose` that are common to all structures or, in ``each``, those of one."""
STAGE = "diagnosing the structures"


def diagnose_many(
    batches: Any,
    *,
    mass: float | None = None,
    base: Sequence[str] = (),
    each: Mapping[str, Mapping[str, Any]] | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    output: str | os.PathLike[str] | None = None,
    random_seed: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    command: str = "",
    progress: Callable[[str, float], None] | None = None,
    say: Callable[[str], None] | None = None,
    **settings: Any,
) -> Survey:
    """Find what the model of each of many structures lacks, and which structures stand out.

    Parameters
    ----------
    batches : path-like, mapping or sequence of path-like
        A folder that holds a folder of records for each structure; or by name a folder or file, a list of `Record`, or
        a Dataset of backbones; or paths of folders.
    mass : float, optional
        Mass of each structure [kg], or inertia [kg m^2]; those that ``each`` gives come first.
    base : sequence of str, optional
        Effects of the model that is questioned, beside linear stiffness and viscous damping.
    each : mapping of str to mapping, optional
        Settings of single structures by name: ``mass``, ``base``, and any of ``settings``.
    executor : concurrent.futures.Executor, optional
        Where the structures run, such as ``Client.get_executor()`` of Dask; it is not shut down. By default processes
        on this machine.
    workers : int, optional
        Number of processes where there is no ``executor``; by default one for each core. 0: in this process, one
        structure after another.
    output : path-like, optional
        Folder for the summary and, below ``structures``, the report of each; workers must see it under the same path.
        By default nothing is written.
    random_seed : int, optional
        Of everything random; drawn and recorded by default. The seed of a structure depends on it and on its name.
    resume : bool, default False
        Whether to keep what an earlier run into ``output`` finished with the same settings and records.
    overwrite : bool, default False
        Whether the folder may hold something already.
    command : str, optional
        The command line that repeats the survey, for the summary.
    progress : callable, optional
        Called with the stage and the share of the structures that is finished.
    say : callable, optional
        Called with a line for each structure that is finished, and with the summary.
    **settings
        ``candidates``, ``max_effects``, ``tolerance``, ``held_out``, ``quick``, ``band``, ``start``, ``stop``,
        ``levels``, ``strict``, ``floor``, ``draws``, ``tune``, ``chains``, ``step`` as in `find_missing_effect`;
        ``columns``, ``quantity``, ``unit``, ``sampling_rate``, ``sensitivity``, ``frequency``, ``reference`` as in
        `read_records`; ``is_table``: the files are tables of backbones.

    Returns
    -------
    Survey
        A record of each structure, the failed ones included, and which stand out.

    Raises
    ------
    InputError
        When nothing can begin: no structures, an unknown setting or effect, a mass that is missing, an output folder in
        use. What is wrong with one structure is reported in its record.

    See Also
    --------
    find_missing_effect : the same for one structure.
    Structure : how each is described.

    Notes
    -----
    The result does not depend on the executor, the number of workers, or the order. A structure whose worker is lost
    (killed, out of memory) runs once more when the others are finished, alone, and is then reported as failed. Ctrl-C
    returns what is finished, with ``interrupted`` set; a second one raises. See ``docs/many_structures.md``.

    Examples
    --------
    >>> from pymc_backbone.workflows.demo import demo_folder
    >>> files = [demo_folder() / f"specimen_0{i}.csv" for i in (1, 2)]
    >>> survey = diagnose_many(files, mass=-1.0, workers=0)
    Traceback (most recent call last):
        ...
    pymc_backbone._common.checks.InputError: `mass` must be positive and finite, got -1.
    """
    begun = time.perf_counter()
    if executor is not None and workers is not None:
        raise InputError("`workers` is for the processes of this package; drop it, or drop `executor`.")
    sources = structures_of(batches, output)
    common = {"mass": mass, "base": list(base), **settings}
    own = {str(name): dict(values) for name, values in (each or {}).items()}
    by_name = _settings_of(list(sources), common, own)
    if resume and output is None:
        raise InputError("`resume` continues a survey in its folder; name it with `output`.")
    if resume and random_seed is None and output is not None:
        random_seed = stored_seed(output)
    seed = int(np.random.default_rng().integers(2**31)) if random_seed is None else int(random_seed)
    from ..reporting.output_folder import package_version

    version = package_version()
    with ExitStack() as held:
        folder = None if output is None else held.enter_context(begun_survey(output, overwrite, resume, seed))
        jobs = _jobs(sources, by_name, folder, seed, version)
        records: dict[str, Structure] = {}
        if resume and folder is not None:
            records = _finished_before(jobs, folder)
        todo = {name: job for name, job in jobs.items() if name not in records}
        if say is not None and records:
            say(f"{len(records)} of {len(jobs)} structures are finished already.")
        is_ours = executor is None
        chosen = executor if executor is not None else _own_executor(workers, len(todo))
        where = _in_words(chosen, workers, len(todo))

        def done(name: str, value: Any, attempts: int) -> None:
            entries = {**blank(jobs[name]), "error": value.reason} if isinstance(value, Lost) else value
            records[name] = item = Structure.from_entries({**entries, "attempts": attempts})
            if say is not None:
                say(f"[{len(records)}/{len(jobs)}] {_line(item)}")
            tick()

        def tick() -> None:
            if progress is not None:
                progress(STAGE, 1.0 - (len(jobs) - len(records)) / max(len(todo), 1))

        tick()
        is_cut = True
        try:
            is_cut = run_tasks(chosen, run_job, todo, done, tick)
        finally:
            if isinstance(chosen, Processes):
                chosen.kill() if is_cut else chosen.shutdown()
            elif is_ours:
                chosen.shutdown()
        missing = len(jobs) - len(records)
        survey = Survey(
            structures=tuple(records[name] for name in jobs if name in records),
            seed=seed,
            version=version,
            settings={name: value for name, value in common.items() if value is not None and value != []},
            each=own,
            workers=where,
            seconds=time.perf_counter() - begun,
            total=len(jobs),
            interrupted=f"Ctrl-C ended the survey; {missing} of {len(jobs)} structures are missing."
            if is_cut
            else None,
            command=command,
            output=None if folder is None else str(folder),
        )
        if folder is not None:
            write_survey(survey, folder)
        if say is not None:
            say(f"\n{survey.sentence}\n{survey.table()}" + (f"\n{survey.interrupted}" if survey.interrupted else ""))
        return survey


def _settings_of(
    names: Sequence[str], common: Mapping[str, Any], each: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Return the settings of each structure; raise before anything runs if they cannot be used."""
    from ..effects import LIBRARY
    from ..oscillator import Oscillator

    allowed = ("mass", "base", *SETTINGS)
    for name in each:
        check_choice("each", name, names)
    for given in (common, *each.values()):
        for setting in given:
            check_choice("settings", setting, allowed)
    result = {}
    checked: set[Any] = set()
    for name in names:
        values = {**common, **each.get(name, {})}
        if values["mass"] is None:
            raise InputError(f"the mass of {name!r} is not given; give one for all, or one for this structure.")
        key = (values["mass"], tuple(values["base"]), tuple(values.get("candidates") or ()))
        if key not in checked:
            Oscillator(values["mass"], values["base"])
            for candidate in key[2]:
                check_choice("candidates", candidate, LIBRARY)
            checked.add(key)
        result[name] = {setting: value for setting, value in values.items() if value is not None}
    return result


def _jobs(
    sources: Mapping[str, Any], settings: Mapping[str, Mapping[str, Any]], folder: Path | None, seed: int, version: str
) -> dict[str, Job]:
    folders = folder_names(list(sources))
    jobs = {}
    for name, source in sources.items():
        if isinstance(source, str | os.PathLike):
            source = os.path.abspath(source)  # a worker may have another working directory
        chosen = {**settings[name], "random_seed": seed_of(seed, name)}
        place = report = None
        request = ""
        if folder is not None:
            place, report = structure_folder(folder, folders[name])
            request = request_digest(source, chosen, version)
        jobs[name] = Job(name, source, chosen, place, report, request)
    return jobs


def _finished_before(jobs: Mapping[str, Job], folder: Path) -> dict[str, Structure]:
    found = {}
    for name, job in jobs.items():
        entries = read_entries(Path(str(job.folder)), job.request)
        if entries is not None:
            found[name] = Structure.from_entries(entries)
    return found


def _own_executor(workers: int | None, count: int) -> Executor:
    if workers is None:
        workers = _cores()
    elif not isinstance(workers, int) or workers < 0:
        raise InputError(f"`workers` must be a whole number from 0 on, got {workers!r}.")
    return Processes(max(1, min(workers, count)), prepare_worker) if workers else Here()


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def _in_words(executor: Executor, workers: int | None, count: int) -> str:
    if isinstance(executor, Here):
        return "one after another in one process"
    if isinstance(executor, Processes):
        number = max(1, min(_cores() if workers is None else workers, count))
        return f"{number} {'process' if number == 1 else 'processes'}"
    return f"{type(executor).__module__.partition('.')[0]} {type(executor).__name__}"


def _line(item: Structure) -> str:
    """Return what is said when a structure is finished."""
    from .._common.text import printable

    if not item.is_done:
        return f"{printable(item.name)}: failed: {printable(str(item.error))}"
    again = ", second attempt" if item.attempts > 1 else ""
    return f"{printable(item.name)}: {item.verdict}: {effects_in_words(item)} ({item.seconds:.1f} s{again})"


__all__ = ["SETTINGS", "diagnose_many"]
