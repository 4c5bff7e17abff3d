"""``diagnose --many``: options, exit codes, Ctrl-C, what is printed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone.cli import main as cli
from pymc_backbone.cli import many as _cli_many
from pymc_backbone.survey import workflow

from . import many_jobs
from .test_cli import MASS, ROOT, is_one_sentence, run_cli
from .test_many_tasks import is_alive, posix


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    root = tmp_path / "structures"
    for name in ("beam_2", "beam_10", "beam_1"):
        (root / name).mkdir(parents=True)
    return root


@pytest.fixture
def hand_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workflow, "run_job", many_jobs.diagnosis)


def diagnose(capsys, *arguments: object) -> tuple[int, str, str]:
    return run_cli(capsys, "diagnose", *map(str, arguments))


def test_summary_and_files(capsys, hand_made, folders, tmp_path):
    out = tmp_path / "out"
    code, text, error = diagnose(capsys, "--many", folders, *MASS, "--seed", 3, "--workers", 0, "--out", out)
    assert code == 0 and "[3/3] beam_10: found: Coulomb friction" in text and str(out / "summary.html") in text
    assert "diagnosing the structures" in error
    command = json.loads((out / "summary.json").read_text())["command"]
    assert command.startswith("pymc-backbone diagnose --many ") and cli.build_parser().parse_args(command.split()[1:])
    code, text, error = diagnose(capsys, "--many", folders, *MASS, "--workers", 0, "--out", out)
    assert code == 2 and is_one_sentence(error) and "--overwrite" in error


def test_quiet_and_json(capsys, hand_made, folders, tmp_path):
    out = tmp_path / "out"
    silent = ["--workers", 0, "--quiet", "--out", out]
    assert diagnose(capsys, "--many", folders, *MASS, *silent) == (0, "", "")
    code, text, error = diagnose(capsys, "--many", folders, *MASS, *silent, "--resume", "--json")
    result = json.loads(text)
    assert (code, error) == (0, "") and [item["name"] for item in result["structures"]] == [
        "beam_1",
        "beam_2",
        "beam_10",
    ]
    assert result["counts"]["found"] == 3 and result["kind"] == "survey"


@posix
def test_a_structure_that_fails_is_named_and_the_exit_code_says_so(capsys, hand_made, folders, tmp_path):
    (folders / "poison").mkdir()
    code, text, error = diagnose(
        capsys, "--many", folders, *MASS, "--workers", 2, "--out", tmp_path / "out", "--overwrite"
    )
    last = error.splitlines(keepends=True)[-1]
    assert code == 2 and is_one_sentence(last) and "1 of 4 structures" in last and "poison" in last
    assert "poison: failed: its process was ended by SIGKILL" in text and text.count("found: Coulomb") == 3


def test_settings_of_single_structures(capsys, monkeypatch, folders, tmp_path):
    seen = {}

    def keep(job):
        seen[job.name] = dict(job.settings)
        return many_jobs.diagnosis(job)

    monkeypatch.setattr(workflow, "run_job", keep)
    table = tmp_path / "masses.csv"
    table.write_text("Name, mass, band, base\nbeam_1,1.5,2:8,\nbeam_2,2,,freeplay iwan\n\nbeam_10,3,,\n")
    code, _, error = diagnose(
        capsys, "--many", folders, "--structures", table, "--workers", 0, "--out", tmp_path / "out", "--draws", 7
    )
    assert code == 0, error
    assert [seen[name]["mass"] for name in ("beam_1", "beam_2", "beam_10")] == [1.5, 2.0, 3.0]
    assert seen["beam_1"]["band"] == (2.0, 8.0) and "band" not in seen["beam_2"]
    assert seen["beam_2"]["base"] == ["freeplay", "iwan"] and seen["beam_10"]["draws"] == 7


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "line 1: expected a column 'name'"),
        ("mass\n1", "line 1: expected a column 'name'"),
        ("name,mas\nbeam_1,1", "'mass'"),
        ("name,mass,mass\nbeam_1,1,2", "twice"),
        ("name,mass\nbeam_1", "line 2: expected 2 cells"),
        ("name,mass\nbeam_1,1\nbeam_1,2", "line 3: the name 'beam_1'"),
        ("name,mass\n,2", "line 2: the name '' is missing"),
        ("name,mass\nbeam_1,heavy", "line 2, column mass: expected a number"),
        ("name,band\nbeam_1,8:2", "line 2, column band"),
        ("name,mass\nbeam_1,1\nbeam_3,1", "line 3: name` must be one of beam_1, beam_2, beam_10"),
        ("name,mass\nbeam_1,1", "the mass of 'beam_2' is not given"),
    ],
)
def test_a_bad_table_of_structures_is_one_sentence(capsys, folders, tmp_path, content, words):
    table = tmp_path / "masses.csv"
    table.write_text(content)
    code, out, error = diagnose(capsys, "--many", folders, "--structures", table, "-q", "--out", tmp_path / "out")
    assert code == 2 and out == "" and is_one_sentence(error) and words in error
    assert not (tmp_path / "out").exists(), "nothing begins"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere", "--many", *MASS], "does not exist"),
        (["FOLDER/beam_1", "--many", *MASS], "holds no folder"),
        (["FOLDER", "--many"], "the mass of 'beam_1'"),
        (["FOLDER", "--many", *MASS, "--structures", "nowhere.csv"], "cannot be read"),
        (["FOLDER", "--many", *MASS, "--workers", "-1"], "at least 0"),
        (["FOLDER", "--many", *MASS, "--workers", "2", "--dask", "tcp://x:1"], "drop one"),
        (["FOLDER", *MASS, "--workers", "2"], "add --many"),
        (["FOLDER", *MASS, "--resume"], "add --many"),
    ],
)
def test_what_cannot_begin_is_one_sentence(capsys, folders, tmp_path, arguments, words):
    chosen = [text.replace("FOLDER", str(folders)) for text in arguments]
    code, out, error = diagnose(capsys, *chosen, "-q", "--out", tmp_path / "out")
    assert code == 2 and out == "" and is_one_sentence(error) and words in error


def test_a_scheduler_that_does_not_answer_is_one_sentence(capsys, folders, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(_cli_many, "CONNECT", 0.5)
    code, _, error = diagnose(
        capsys, "--many", folders, *MASS, "-q", "--dask", "tcp://127.0.0.1:9", "--out", tmp_path / "out"
    )
    assert code == 2 and is_one_sentence(error) and "no Dask scheduler answers at tcp://127.0.0.1:9" in error


def test_dask_that_is_not_installed_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pymc-backbone\[dask\]"), _cli_many._executor("tcp://x:1"):
        pass


SCRIPT = """
import sys
from pymc_backbone.cli import main as cli
from pymc_backbone.survey import workflow
from tests import many_jobs
if __name__ == "__main__":
    workflow.run_job = many_jobs.diagnosis
    sys.exit(cli.main(sys.argv[1:]))
"""


@posix
def test_ctrl_c_writes_what_is_finished_and_leaves_no_process(folders, tmp_path):
    (folders / "slow").mkdir()
    out, script = tmp_path / "out", tmp_path / "script.py"
    script.write_text(SCRIPT)
    words = ["diagnose", "--many", str(folders), *MASS, "--seed", "3", "--workers", "2", "--out", str(out)]
    process = subprocess.Popen(
        [sys.executable, str(script), *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True,
    )  # fmt: skip
    assert process.stdout is not None
    line = ""
    while "[3/4]" not in line:
        line = process.stdout.readline()
        assert line
    time.sleep(0.3)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    pids = [int(pid) for pid in children.read_text().split()] if children.exists() else []
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too
    text, error = process.communicate(timeout=60)
    assert process.returncode == 130 and is_one_sentence(error.splitlines(keepends=True)[-1])
    assert "Traceback" not in error and "1 of 4 structures are missing" in text
    summary = json.loads((out / "summary.json").read_text())
    assert len(summary["structures"]) == 3 and "Ctrl-C" in summary["interrupted"]
    assert "Ctrl-C" in (out / "summary.html").read_text() and not any(is_alive(pid) for pid in pids)
