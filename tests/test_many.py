"""Many structures: the same result wherever they run, one bad batch, resuming, names, seeds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone._common.checks import InputError
from pymc_backbone._common.processes import MEGABYTES_PER_PROCESS, Processes
from pymc_backbone.reporting.output_folder import read_result
from pymc_backbone.reporting.portable import plain
from pymc_backbone.survey import workflow
from pymc_backbone.survey.files import stored_seed
from pymc_backbone.survey.names import folder_names, seed_of, structures_of
from pymc_backbone.survey.structure import Structure, prepare_worker

from . import many_jobs
from .discrepancy_cases import MASS, OMEGA, make_records, truth_of
from .test_many_tasks import posix

ROOT = Path(__file__).resolve().parents[1]
QUICK = {"quick": True, "held_out": 0, "max_effects": 1, "candidates": ["coulomb_friction"]}
SAMPLED = {"held_out": 2, "max_effects": 1, "candidates": ["coulomb_friction"], "draws": 200, "tune": 200, "chains": 2}


def backbones(number: int) -> Any:
    """Backbones of two specimens with dry friction, with errors as measured ones have them."""
    rng = np.random.default_rng(number)
    truth = np.array([list(truth_of(["coulomb_friction"]).values())] * 2)
    truth[:, :2] *= 1.0 + 0.01 * rng.standard_normal((2, 2))
    levels = np.geomspace(0.002, 0.01, 6)
    made = pb.simulate_population(pb.Oscillator(MASS, ["coulomb_friction"]), truth, levels, ("frequency", "damping"))
    error = np.array([1e-4 * OMEGA, 4e-4])[:, None] * np.ones(6)
    made["standard_error"] = (made["value"].dims, np.broadcast_to(error, made["value"].shape).copy())
    made["value"] = made["value"] + error * rng.standard_normal(made["value"].shape)
    return made.drop_vars("covariance")


def comparable(survey: pb.Survey, *leave_out: str) -> list[str]:
    """What must be equal bit for bit, as text: JSON writes every digit that a float has."""
    dropped = {"seconds", "attempts", "report", *leave_out}
    return [
        json.dumps(plain({key: value for key, value in item.entries().items() if key not in dropped}))
        for item in survey.structures
    ]


@pytest.fixture(scope="module")
def batches() -> dict[str, Any]:
    return {f"beam {i}": backbones(i) for i in range(4)} | {"bad": "nowhere"}


@pytest.fixture(scope="module")
def serial(batches) -> pb.Survey:
    return pb.diagnose_many(batches, mass=MASS, workers=0, random_seed=3, **QUICK)


def test_one_bad_batch_is_reported_and_the_rest_is_done(serial):
    assert [item.name for item in serial.structures] == ["beam 0", "beam 1", "beam 2", "beam 3", "bad"]
    assert [item.name for item in serial.failed] == ["bad"] and "nowhere" in str(serial.failed[0].error)
    assert serial.failed[0].verdict is None and serial.failed[0].traceback is None
    assert {item.verdict for item in serial.done} <= {"found", "ambiguous"}
    for item in serial.done:
        assert item.frequency == pytest.approx(5.0, rel=0.03) and item.damping_ratio == pytest.approx(0.006, rel=0.5)
        assert item.parameters["friction_force"]["unit"] == "N" and item.specimens == 2 and item.seconds > 0.0
    assert serial.counts["failed"] == 1 and "1 could not be diagnosed" in serial.sentence
    assert "nowhere" in serial.table()


def test_processes_and_threads_give_the_serial_result_bit_for_bit(batches, serial):
    pool = pb.diagnose_many(batches, mass=MASS, workers=2, random_seed=3, **QUICK)
    assert comparable(pool) == comparable(serial)
    backwards = dict(reversed(batches.items()))
    with ThreadPoolExecutor(2) as executor:
        threads = pb.diagnose_many(backwards, mass=MASS, executor=executor, random_seed=3, **QUICK)
    assert comparable(threads)[::-1] == comparable(serial)
    other = pb.diagnose_many({"beam 0": batches["beam 0"]}, mass=MASS, workers=0, random_seed=4, **QUICK)
    assert comparable(other) != comparable(serial)[:1], "negative control: another seed is another record"


@pytest.mark.slow
def test_dask_gives_the_serial_result_bit_for_bit(batches, serial):
    pytest.importorskip("distributed")
    from .test_many_dask import cluster

    with cluster(2) as client:
        dask = pb.diagnose_many(batches, mass=MASS, executor=client.get_executor(), random_seed=3, **QUICK)
    assert comparable(dask) == comparable(serial) and "distributed" in dask.workers


@pytest.mark.slow
def test_sampled_posteriors_are_the_same_everywhere(rng):
    pytest.importorskip("distributed")
    from .test_many_dask import cluster

    records = {f"beam {i}": make_records(rng, ["coulomb_friction"]) for i in range(3)}
    settings: dict[str, Any] = {"mass": MASS, "random_seed": 3, **SAMPLED}
    alone = pb.diagnose_many(records, workers=0, **settings)
    assert not alone.failed and all(np.isfinite(item.gap_after) for item in alone.done)
    assert comparable(pb.diagnose_many(records, workers=2, **settings)) == comparable(alone)
    with cluster(2) as client:
        assert comparable(pb.diagnose_many(records, executor=client.get_executor(), **settings)) == comparable(alone)


SCRIPT = """
import numpy as np
import pymc_backbone as pb
from tests.test_many import MASS, SAMPLED, comparable, make_records

rng = np.random.default_rng(12345)
records = {f"beam {i}": make_records(rng, ["coulomb_friction"]) for i in range(2)}
print(*comparable(pb.diagnose_many(records, mass=MASS, workers=0, random_seed=3, **SAMPLED)), sep="\\n")
"""


@pytest.mark.slow
def test_code_compiled_here_and_code_from_disk_give_the_same_digits(tmp_path):
    """The first process compiles everything, the second reads it: sums in another order would show in the draws."""
    flags = f"base_compiledir={tmp_path / 'pytensor'}"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "numba"), "PYTENSOR_FLAGS": flags}
    runs = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert all(json.loads(line)["parameters"]["friction_force"]["sd"] > 0.0 for line in runs[0].splitlines())
    assert runs[0].count("\n") == 2 and runs[0] == runs[1]


@posix
@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "count"),
    [(QUICK, 200), ({**SAMPLED, "held_out": 0, "draws": 100, "tune": 100}, 60)],
    ids=["quick", "sampled"],
)
def test_memory_of_a_worker_stays_flat(settings, count):
    """The allocator wanders by 3 % after 40 batches; compiled models fill what a process may hold, and go with it."""
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("the memory of a process is read from /proc")
    memory: list[float] = []
    some = {f"beam {i}": backbones(i) for i in range(count)}
    with Processes(1, prepare_worker, tasks_per_process=10**6) as executor:

        def say(text: str) -> None:
            if text.startswith("["):
                # The process that was replaced may be gone already, and the new one not there yet.
                statuses = [Path(f"/proc/{pid}/status") for pid in executor.process_ids]
                texts = [status.read_text() for status in statuses if status.exists()]
                held = [float(text.split("VmRSS:")[1].split()[0]) / 1e3 for text in texts if "VmRSS:" in text]
                memory.append(max(held, default=0.0))

        survey = pb.diagnose_many(some, mass=MASS, executor=executor, random_seed=3, say=say, **settings)
    print("MB after every tenth:", memory[::10])
    assert not survey.failed and len(memory) == count
    # one structure may go beyond what a process may hold, before the process is replaced
    allowed = 1.03 * memory[39] if "quick" in settings else memory[0] + MEGABYTES_PER_PROCESS + 150.0
    assert max(memory[40:]) < allowed


@pytest.fixture
def hand_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a quick stand-in for the diagnosis in its place; it can be sent to processes."""
    monkeypatch.setattr(workflow, "run_job", many_jobs.diagnosis)


@posix
def test_a_poison_batch_is_reported_and_takes_no_other_with_it(hand_made):
    names = ["a", "poison", "b", "c", "d"]
    survey = pb.diagnose_many(dict.fromkeys(names, "x"), mass=1.0, workers=2, random_seed=1)
    assert [item.name for item in survey.structures] == names
    assert [(item.name, item.attempts) for item in survey.failed] == [("poison", 2)]
    assert "SIGKILL" in str(survey.failed[0].error) and survey.failed[0].seed == seed_of(1, "poison")
    assert all(item.attempts == 1 for item in survey.done)


def test_seeds_depend_on_names_alone():
    names = [f"beam_{i}" for i in range(200)]
    seeds = {name: seed_of(7, name) for name in names}
    assert len(set(seeds.values())) == 200 and all(0 <= seed < 2**31 for seed in seeds.values())
    assert seed_of(7, "beam_3") == seeds["beam_3"] != seed_of(8, "beam_3")


@pytest.mark.parametrize("name", ["..", ".", "", "a/b", "/etc/passwd", "con", "x" * 300, "<b>", "a\nb", " ", "\udcff"])
def test_names_cannot_leave_the_folder(name):
    (folder,) = folder_names([name]).values()
    assert folder not in ("", ".", "..") and "/" not in folder and "\\" not in folder and len(folder) < 100
    assert not folder.startswith(" ") and folder.isprintable()


def test_folders_differ_where_names_differ_in_case_alone():
    folders = folder_names(["Beam", "beam", "a/b", "a_b"])
    assert len({folder.casefold() for folder in folders.values()}) == 4


def test_folders_of_folders_in_natural_order(tmp_path):
    for name in ("run_10", "run_2", ".hidden", "out"):
        (tmp_path / name).mkdir()
    assert list(structures_of(tmp_path, tmp_path / "out")) == ["run_2", "run_10"]
    assert list(structures_of([tmp_path / "run_2"])) == ["run_2"]


@pytest.mark.parametrize(
    ("batches", "settings", "words"),
    [
        ({}, {}, "at least one"),
        (3, {}, "folder of folders"),
        (["a/x", "b/x"], {}, "named 'x'"),
        ("nowhere", {}, "does not exist"),
        ({"a": "x"}, {"mass": None}, "mass of 'a'"),
        ({"a": "x"}, {"each": {"b": {"mass": 2.0}}}, "must be one of a"),
        ({"a": "x"}, {"each": {"a": {"mas": 2.0}}}, "mass"),
        ({"a": "x"}, {"drawz": 3}, "draws"),
        ({"a": "x"}, {"base": ["cubic"]}, "cubic_stiffness"),
        ({"a": "x"}, {"candidates": ["cubic"]}, "cubic_stiffness"),
        ({"a": "x"}, {"workers": -1}, "from 0 on"),
        ({"a": "x"}, {"resume": True}, "`output`"),
        ({"a": "x"}, {"workers": 2, "executor": Executor()}, "drop"),
    ],
)
def test_what_cannot_begin_is_told_at_once(batches, settings, words):
    with pytest.raises(InputError, match=words):
        pb.diagnose_many(batches, **{"mass": 1.0, **settings})


def test_settings_of_single_structures_come_first(monkeypatch):
    seen: dict[str, Any] = {}

    def keep(job):
        seen[job.name] = job.settings
        return many_jobs.diagnosis(job)

    monkeypatch.setattr(workflow, "run_job", keep)
    each = {"b": {"mass": 2.0, "band": (1.0, 9.0)}}
    survey = pb.diagnose_many({"a": "x", "b": "y"}, mass=1.0, each=each, workers=0, draws=50, random_seed=1)
    assert seen["a"]["mass"] == 1.0 and seen["b"]["mass"] == 2.0 and "band" not in seen["a"]
    assert seen["b"]["band"] == (1.0, 9.0) and seen["b"]["draws"] == 50
    assert [item.mass for item in survey.structures] == [1.0, 2.0]


def test_output_folder_and_resume(tmp_path, batches, monkeypatch):
    """Reports are linked, what is finished stays, what failed or changed is done again."""
    out = tmp_path / "out"
    (tmp_path / "empty").mkdir()
    chosen = {"beam/0": batches["beam 0"], "bad": str(tmp_path / "empty")}
    first = pb.diagnose_many(chosen, mass=MASS, workers=0, output=out, **QUICK)
    assert stored_seed(out) == first.seed
    good, bad = first.structures
    assert good.report is not None and (out / good.report).exists() and bad.report is None
    assert sorted(path.name for path in out.iterdir()) == ["structures", "summary.csv", "summary.html", "summary.json"]
    assert len(list((out / "structures").iterdir())) == 1, "a structure that failed leaves no empty folder"
    assert read_result((out / good.report).parent)["seed"] == good.seed
    kept = json.loads((out / "summary.json").read_text())
    assert repr(Structure.from_entries(kept["structures"][0])) == repr(good)
    with pytest.raises(InputError, match="`overwrite=True`"):
        pb.diagnose_many(chosen, mass=MASS, workers=0, output=out, **QUICK)
    run: list[str] = []
    monkeypatch.setattr(workflow, "run_job", lambda job: run.append(job.name) or many_jobs.diagnosis(job))
    again = pb.diagnose_many(chosen, mass=MASS, workers=0, output=out, resume=True, **QUICK)
    assert run == ["bad"] and again.seed == first.seed and comparable(again)[0] == comparable(first)[0]
    pb.diagnose_many(chosen, mass=2.0, workers=0, output=out, resume=True, **QUICK)
    assert run == ["bad", "beam/0", "bad"]
    monkeypatch.undo()
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="`overwrite=True`"):
        pb.diagnose_many(chosen, mass=MASS, workers=0, output=foreign, resume=True, **QUICK)


def test_a_fault_of_the_program_is_one_failure_with_its_place(monkeypatch):
    from pymc_backbone.workflows import diagnose as run_diagnosis

    def fail(*_: Any, **__: Any) -> Any:
        raise ZeroDivisionError("by\nnothing")

    monkeypatch.setattr(run_diagnosis, "diagnose", fail)
    survey = pb.diagnose_many({"a": "x"}, mass=1.0, workers=0)
    (item,) = survey.failed
    assert "ZeroDivisionError" in str(item.error) and "\n" not in str(item.error) and "fault" in str(item.error)
    assert "raise ZeroDivisionError" in str(item.traceback)
