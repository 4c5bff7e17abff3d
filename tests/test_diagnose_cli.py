"""The command ``diagnose``: options to a study to a folder, and what it says on the way."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone._common.options import settings_of
from pymc_backbone.cli import main as cli
from pymc_backbone.cli.progress import LINE_EVERY, ProgressBar
from pymc_backbone.discrepancy.options import Searching
from pymc_backbone.inference.options import Sampling
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.measurement.reading.options import Reading
from pymc_backbone.reporting.output_folder import read_result
from pymc_backbone.reporting.study_files import DIAGNOSIS_KEYS
from pymc_backbone.workflows import demo
from pymc_backbone.workflows import diagnose as run_diagnosis

from .study_cases import make_study
from .test_cli import MASS, ROOT, is_one_sentence, run_cli

WORKFLOW = "pymc_backbone.discrepancy.workflow"
HAS_WORKFLOW = (ROOT / "pymc_backbone" / "discrepancy" / "workflow.py").exists()


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> dict[str, dict]:
    """Keep what the command line hands on, instead of running it."""
    kept: dict[str, dict] = {}
    monkeypatch.setattr(
        run_diagnosis, "diagnose", lambda path, **settings: kept.update(diagnose={"path": path, **settings})
    )
    return kept


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> dict:
    """Put a hand-made study in place of the search, and keep what the search was asked."""
    kept: dict = {}
    module = ModuleType(WORKFLOW)

    def find_missing_effect(oscillator, data, **settings):
        kept.update(oscillator=oscillator, data=data, **settings)
        if settings["progress"] is not None:
            settings["progress"]("naming", 0.5)
        return make_study(kept.get("verdict", "found"), specimens=2)

    module.find_missing_effect = find_missing_effect  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, WORKFLOW, module)
    return kept


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "RECORDS, --out"),
        (["x", *MASS], "--out"),
        (["x", "--out", "o"], "--mass M"),
        (["x", *MASS, "--tolerance", "speed=1"], "frequency=0.001,damping=0.03"),
        (["x", *MASS, "--tolerance", "damping"], "frequency=0.001,damping=0.03"),
        (["x", *MASS, "--tolerance=-1"], "got '-1'"),
        (["x", *MASS, "--max-effects", "0"], "at least 1"),
        (["x", *MASS, "--step", "gibbs"], "gibbs"),
    ],
)
def test_bad_options_are_one_sentence(capsys, arguments, words):
    code, out, error = run_cli(capsys, "diagnose", *arguments)
    assert code == 2 and out == ""
    assert is_one_sentence(error) and words in error


def test_every_option_is_handed_on(capsys, calls, tmp_path):
    code, _, error = run_cli(
        capsys, "diagnose", "records", "--mass", "1.5", "--base", "cubic_stiffness", "iwan", "--base", "freeplay",
        "--candidates", "jenkins,bouc_wen", "--max-effects", "2", "--tolerance", "frequency=0.002,damping=0",
        "--held-out", "1", "--seed", "7", "--quick", "--backbones", "--draws", "10", "--tune", "0", "--chains", "2",
        "--step", "slice", "--levels", "8", "--out", str(tmp_path), "--overwrite",
    )  # fmt: skip
    assert (code, error) == (0, "")
    given = calls["diagnose"]
    assert isinstance(given.pop("progress"), ProgressBar) and callable(given.pop("say"))
    assert given == {
        "path": Path("records"), "mass": 1.5, "mass_error": 0.0, "base": ["cubic_stiffness", "iwan", "freeplay"],
        "searching": Searching(["jenkins", "bouc_wen"], 2, {"frequency": 0.002, "damping": 0.0}, 1, quick=True),
        "reading": Reading(is_table=True), "measuring": Measuring(levels=8), "sampling": Sampling(10, 0, 2, "slice", 7),
        "output": tmp_path, "overwrite": True,
    }  # fmt: skip


def test_defaults_are_those_of_the_options(capsys, calls):
    """The command line must not have defaults of its own."""
    assert run_cli(capsys, "diagnose", "records", *MASS, "--out", "o")[0] == 0
    given = calls["diagnose"]
    for name, kind in {
        "searching": Searching,
        "reading": Reading,
        "measuring": Measuring,
        "sampling": Sampling,
    }.items():
        assert given[name] == kind(), name
    assert given["base"] == [] and given["overwrite"] is False


def test_defaults_of_the_search_are_those_of_the_function():
    """The options are handed on whole: what stands there by default must be the default of the public function."""
    import inspect

    from pymc_backbone.discrepancy.workflow import find_missing_effect

    defaults = {name: item.default for name, item in inspect.signature(find_missing_effect).parameters.items()}
    for options in (Searching(), Measuring(), Sampling()):
        for name, value in settings_of(options).items():
            assert name == "observables" or value == defaults[name], name


def test_no_tolerance_is_zero_for_every_observable(capsys, calls):
    run_cli(capsys, "diagnose", "records", *MASS, "--tolerance", "0", "--out", "o")
    assert calls["diagnose"]["searching"].tolerance == {"frequency": 0.0, "damping": 0.0, "offset": 0.0}


def test_folder_and_summary(capsys, searched, tmp_path):
    """Records in, folder out: the search is asked what the user asked, and everything it found is written."""
    out = tmp_path / "out"
    code, text, error = run_cli(
        capsys, "diagnose", str(demo.demo_folder() / "specimen_01.csv"), *MASS, "--base", "freeplay", "--quick",
        "--seed", "3", "--levels", "6", "--out", str(out),
    )  # fmt: skip
    assert code == 0
    assert [record.specimen for record in searched["data"]] == ["specimen_01"]
    assert [effect.name for effect in searched["oscillator"].effects][-1] == "freeplay"
    assert searched["quick"] is True and searched["levels"] == 6 and searched["random_seed"] == 3
    assert "tolerance" not in searched  # the search's own default
    assert (
        text.startswith("FOUND: Coulomb friction is missing")
        and str(out / "report.html") in text
        and "coulomb" not in text
    )
    assert "naming" in error and "%" in error  # progress, on standard error alone
    result = read_result(out)
    assert set(result) == set(DIAGNOSIS_KEYS)
    command = result["command"]
    assert command.startswith("pymc-backbone diagnose ") and "--base freeplay" in command and "--seed 3" in command
    assert cli.build_parser().parse_args(command.split()[1:]).base == ["freeplay"]
    assert (out / "figures" / "records.png").exists() and (out / "model.py").exists()


def test_tables_of_backbones_are_read_as_such(capsys, searched, tmp_path):
    table = tmp_path / "b.csv"
    rows = [f"{a},{10 + a},{0.01},0.05,0.001" for a in np.linspace(0.01, 0.1, 12)]
    table.write_text("amplitude [m],frequency [Hz],frequency_error [Hz],damping,damping_error\n" + "\n".join(rows))
    code, _, error = run_cli(
        capsys, "diagnose", str(table), *MASS, "--backbones", "--levels", "5", "--out", str(tmp_path / "o")
    )
    assert code == 0, error
    assert searched["data"].sizes["level"] == 5 and "levels" not in searched


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--base", "cubic_stifness"], ["--base must be one of", "Did you mean 'cubic_stiffness'?"]),
        (["--candidates", "coulomb"], ["--candidates must be one of", "Did you mean 'coulomb_friction'?"]),
        (["--mass", "-1"], ["must be positive"]),
        (["--quik"], ["did you mean --quick?", "pymc-backbone diagnose --help"]),
    ],
)
def test_a_bad_model_is_told_before_anything_is_read(capsys, tmp_path, arguments, words):
    code, _, error = run_cli(capsys, "diagnose", "nowhere", *MASS, *arguments, "--out", str(tmp_path / "a" / "o"))
    assert code == 2 and is_one_sentence(error) and all(word in error for word in words)
    assert list(tmp_path.iterdir()) == []  # what was made for results that never came


def test_an_empty_folder_of_the_user_stays(capsys, tmp_path):
    code, *_ = run_cli(capsys, "diagnose", str(tmp_path / "nowhere"), *MASS, "--out", str(tmp_path))
    assert code == 2 and tmp_path.is_dir()


def test_output_in_use_is_told_first(capsys, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    code, _, error = run_cli(capsys, "diagnose", "nowhere", *MASS, "--out", str(tmp_path))
    assert code == 2 and "--overwrite" in error


@pytest.mark.parametrize(("error", "code"), [(InputError("The records\nare empty."), 2), (KeyboardInterrupt(), 130)])
def test_errors_take_the_bar_off_first(capsys, monkeypatch, error, code):
    def fail(*_, progress, **__):
        progress("reading", 0.1)
        raise error

    monkeypatch.setattr(run_diagnosis, "diagnose", fail)
    got, _, text = run_cli(capsys, "diagnose", "x", *MASS, "--out", "o")
    assert got == code and is_one_sentence(text.splitlines(keepends=True)[-1])


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_bar_on_a_terminal_is_one_line_and_goes_away():
    stream = Terminal()
    with ProgressBar(stream) as bar:
        bar("locating", 0.0)
        bar("naming", 0.42)
        bar("naming", 0.43)  # too soon to draw again
    text = stream.getvalue()
    assert "\n" not in text and "42%  0:00  naming" in text and "43%" not in text
    assert text.endswith("\r\x1b[K")


def test_time_left_is_estimated_once_there_is_something_to_go_by(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("pymc_backbone._common.progress.time.monotonic", lambda: now[0])
    stream = Terminal()
    with ProgressBar(stream) as bar:
        for at, share in ((0.0, 0.0), (1.0, 0.1), (10.0, 0.25), (20.0, 0.5)):
            now[0] = at
            bar("pairs", share)
        now[0] = 40.0
        bar("sampling", 0.5)  # a stage of its own, of which nothing is known yet
    drawn = stream.getvalue().split("\r\x1b[K")
    assert [text.partition("about ")[2] for text in drawn if text] == ["", "", "0:45 left", "0:20 left", ""]
    silent = Terminal()
    with ProgressBar(silent, is_shown=False) as bar:
        bar("pairs", 0.5)
    assert silent.getvalue() == ""
    late = Terminal()
    with ProgressBar(late, delay=2.0) as bar:
        bar("extracting cycles", 0.1)
        assert late.getvalue() == ""
        now[0] = 43.0
        bar("extracting cycles", 0.5)
        assert "50%" in late.getvalue()


def test_lines_now_and_then_where_there_is_no_terminal(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("pymc_backbone._common.progress.time.monotonic", lambda: now[0])
    stream = io.StringIO()
    with ProgressBar(stream) as bar:
        for step in range(100):
            bar("naming" if step < 50 else "sampling", step / 100)
            now[0] += 1.0
        bar("sampling", float("nan"))
    lines = stream.getvalue().splitlines()
    assert lines[0] == "  0%  naming  (0:00)" and "left)" in lines[1] and "\x1b" not in stream.getvalue()
    assert len(lines) == 2 * (1 + int(49 / LINE_EVERY)) and any("sampling" in line for line in lines)


needs_workflow = pytest.mark.skipif(not HAS_WORKFLOW, reason="discrepancy/workflow.py is not there yet")


@needs_workflow
@pytest.mark.slow
def test_diagnose_for_real(capsys, tmp_path):
    """Records of hardening specimens against a linear model, through every module."""
    records = tmp_path / "records"
    records.mkdir()
    for number in (1, 2, 3):
        name = f"specimen_0{number}.csv"
        (records / name).write_bytes((demo.demo_folder() / name).read_bytes())
    out = tmp_path / "out"
    code, _text, error = run_cli(
        capsys, "diagnose", str(records), *MASS, "--seed", "1", "--draws", "200", "--tune", "200", "--chains", "2",
        "--out", str(out),
    )  # fmt: skip
    assert code == 0, error
    result = read_result(out)
    assert set(result) == set(DIAGNOSIS_KEYS) and result["verdict"] in ("found", "ambiguous")
    named = [item["name"] for item in result["missing_effects"]]
    assert "cubic_stiffness" in [*named, *(name for names in result["ambiguous_sets"] for name in names)]
    script = subprocess.run([sys.executable, str(out / "model.py")], capture_output=True, text=True, check=False)
    assert script.returncode == 0, script.stderr


@needs_workflow
@pytest.mark.skipif(os.name != "posix", reason="signals as on POSIX")
@pytest.mark.slow
def test_interrupt_in_a_real_process(tmp_path):
    command = [sys.executable, "-m", "pymc_backbone", "diagnose", str(demo.demo_folder()), *MASS]
    process = subprocess.Popen([*command, "--out", str(tmp_path / "out")], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    time.sleep(12.0)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert process.returncode == 130 and is_one_sentence(error.splitlines(keepends=True)[-1])
