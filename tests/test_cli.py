"""The command line: what a user can get wrong ends in one sentence and exit code 2, never in a traceback."""

from __future__ import annotations

import ctypes
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone.cli import main as cli
from pymc_backbone.cli import update as _cli_update
from pymc_backbone.cli.progress import ProgressBar
from pymc_backbone.effects import LIBRARY
from pymc_backbone.inference.options import Comparing, Keeping, Modelling, Sampling
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.measurement.reading.options import Reading
from pymc_backbone.reporting.output_folder import read_result
from pymc_backbone.workflows import demo
from pymc_backbone.workflows import extract as run_extract
from pymc_backbone.workflows import update as run

from . import format_files

ROOT = Path(__file__).resolve().parents[1]
MASS = ["--mass", "1"]


def run_cli(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


# What a command that takes longer than a second and a half says meanwhile, such as "      starting  (0:01)".
PROGRESS_LINE = re.compile(r"^ *(?:\d+%)? +\S.* {2}\(\d+:\d\d[^()]*\)\n", re.MULTILINE)


def is_one_sentence(text: str) -> bool:
    text = PROGRESS_LINE.sub("", text)
    return text.startswith("pymc-backbone: ") and text[-2:] in (".\n", "?\n") and text.count("\n") == 1


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> dict[str, dict]:
    """Keep what the command line hands on, instead of running it."""
    kept: dict[str, dict] = {}

    def keep(name: str, path: object, settings: dict) -> dict:
        kept[name] = {"path": path, **settings}
        return {"interrupted": None}

    def update(path: object, modelling: Modelling, **settings: object) -> dict:
        return keep("update", path, {"modelling": modelling, **settings})

    monkeypatch.setattr(run, "update", update)
    monkeypatch.setattr(run_extract, "extract", lambda path, **settings: keep("extract", path, settings))
    return kept


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["updat"], "'update'"),
        (["update"], "RECORDS, --mass"),
        (["update", "x"], "--mass"),
        (["update", "x", "--mass", "heavy"], "'heavy'"),
        (["update", "x", *MASS, "--levels", "two"], "0.002,0.005,0.01"),
        (["update", "x", *MASS, "--levels=-1,2"], "-1,2"),
        (["update", "x", *MASS, "--levels", "0"], "at least 1"),
        (["update", "x", *MASS, "--band", "160:90"], "low end first"),
        (["update", "x", *MASS, "--band", "90"], "LO:HI"),
        (["update", "x", *MASS, "--prior", "k"], "NAME=LOW:HIGH"),
        (["update", "x", *MASS, "--prior", "k=1:nan"], "1:nan"),
        (["update", "x", *MASS, "--prior", "k=1:2", "--prior", "k=1:3"], "k twice"),
        (["update", "x", *MASS, "--fix", "k=soft"], "NAME=VALUE"),
        (["update", "x", *MASS, "--draws", "0"], "at least 1"),
        (["update", "x", *MASS, "--draws", "1.5"], "whole number"),
        (["update", "x", *MASS, "--step", "gibbs"], "demetropolisz"),
        (["update", "x", *MASS, "--observables", "frequency,colour"], "colour"),
        (["update", "x", *MASS, "--observables", ","], "at least one"),
        (["update", "x", *MASS, "--colour"], "--colour"),
        (["extract", "x"], "--out"),
        (["extract", "x", "--out", "o", "--columns", "a,,b"], "time=t,acc_z"),
        (["extract", "x", "--out", "o", "--columns", '"a'], "time=t,acc_z"),
        (["extract", "x", "--out", "o", "--quantity", "jerk"], "jerk"),
        (["extract", "x", "--out", "o", "--sampling-rate", "fast"], "'fast'"),
        (["completion", "tcsh"], "tcsh"),
        (["diagnos", "x"], "did you mean diagnose?"),
        (["effects", "cubic_stifness"], "NAME must be one of"),
        (["effects", "cubic_stifness"], "Did you mean 'cubic_stiffness'?"),
    ],
)
def test_bad_options_are_one_sentence(capsys, arguments, words):
    code, out, error = run_cli(capsys, *arguments)
    assert code == 2 and out == ""
    assert is_one_sentence(error) and words in error


@pytest.mark.parametrize("command", [[], ["extract"], ["update"], ["diagnose"], ["effects"], ["demo"], ["completion"]])
def test_help_explains_each_command(capsys, command):
    with pytest.raises(SystemExit) as stop:
        cli.main([*command, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert text.startswith(" ".join(["usage: pymc-backbone", *command]))
    assert max(map(len, text.splitlines())) <= 120


def test_no_command_prints_the_help(capsys):
    code, out, error = run_cli(capsys)
    assert code == 0 and error == "" and "First steps" in out


def test_version(capsys):
    import pymc_backbone

    assert run_cli(capsys, "--version") == (0, f"pymc-backbone {pymc_backbone.__version__}\n", "")


def test_effects_lists_the_library_with_forces_and_units(capsys):
    code, out, _ = run_cli(capsys, "effects")
    assert code == 0
    for name, effect in LIBRARY.items():
        assert f"\n{name}\n" in out
        for parameter in effect.parameters:
            assert f"{parameter.name} [{parameter.unit}]" in out


@pytest.mark.parametrize("name", sorted(LIBRARY))
def test_effects_explains_each(capsys, name):
    code, out, _ = run_cli(capsys, "effects", name)
    assert code == 0 and out.startswith(f"{name}\n")
    for parameter in LIBRARY[name].parameters:
        assert parameter.summary in out
    assert ("variant of" in out) == bool(LIBRARY[name].variant_of)
    assert f"variant of {', '.join(LIBRARY[name].variant_of)}:" in out or not LIBRARY[name].variant_of
    assert ("only when it is named, or where nothing else" in out or "no candidate" in out) == LIBRARY[
        name
    ].only_if_named


def test_update_hands_on_every_option(capsys, calls, tmp_path):
    code, _, error = run_cli(
        capsys, "update", "records", "--mass", "1.5±0.05", "--effect", "cubic_stiffness", "--effect", "freeplay,iwan",
        "--prior", "cubic_stiffness=-1e6:1e7", "--fix", "viscous_damping=0.8", "--observables", "offset,frequency",
        "--likelihood", "population", "--density", "joint", "--marginal", "kde", "--levels", "0.01,0.002",
        "--band", "5:20", "--start", "0.25", "--stop", "9", "--draws", "10", "--tune", "0",
        "--chains", "2", "--step", "nuts",
        "--seed", "7", "--store", "kept", "--resume", "--out", str(tmp_path), "--overwrite",
        "--columns", "time=t,acc z", "--quantity", "velocity",
        "--unit", "mm/s", "--sampling-rate", "512", "--strict",
        "--sensitivity", "10.2 mV/g", "--sensitivity", "hammer=2 mV/N", "--floor", "0.2 mm",
    )  # fmt: skip
    assert (code, error) == (0, "")
    assert isinstance(calls["update"].pop("progress"), ProgressBar) and callable(calls["update"].pop("say"))
    assert calls["update"] == {
        "path": Path("records"),
        "modelling": Modelling(
            1.5, ["cubic_stiffness", "freeplay", "iwan"], {"cubic_stiffness": (-1e6, 1e7)}, {"viscous_damping": 0.8},
            0.05,
        ),
        "reading": Reading(["time=t", "acc z"], "velocity", "mm/s", 512.0, ["10.2 mV/g", "hammer=2 mV/N"]),
        "measuring": Measuring((5.0, 20.0), 0.25, 9.0, (0.002, 0.01), ("frequency", "offset"), True, 0.2 * 1e-3),
        "comparing": Comparing("population", "joint", "kde"),
        "sampling": Sampling(10, 0, 2, "nuts", 7),
        "keeping": Keeping(Path("kept"), resume=True),
        "output": tmp_path, "overwrite": True,
    }  # fmt: skip


def test_defaults_of_update_are_those_of_the_options(capsys, calls):
    """The command line must not have defaults of its own."""
    assert run_cli(capsys, "update", "records", *MASS)[0] == 0
    given = calls["update"]
    assert given["modelling"] == Modelling(1.0, [], {}, {})
    kinds = {"reading": Reading, "measuring": Measuring, "comparing": Comparing, "sampling": Sampling}
    for name, kind in {**kinds, "keeping": Keeping}.items():
        assert given[name] == kind(), name


def test_the_step_of_a_hierarchical_model_is_not_a_random_walk(capsys, calls):
    assert run_cli(capsys, "update", "records", *MASS, "--likelihood", "hierarchical")[0] == 0
    assert calls["update"]["sampling"].step == "nutpie" and calls["update"]["comparing"].population == "correlated"
    options = ("--likelihood", "hierarchical", "--store", "kept", "--population", "uniform")
    assert run_cli(capsys, "update", "records", *MASS, *options)[0] == 0
    assert calls["update"]["sampling"].step == "nuts" and calls["update"]["comparing"].population == "uniform"


def test_choices_are_those_of_the_modules():
    """The command line repeats them, so as not to load PyMC for its help."""
    from pymc_backbone.inference import model, options
    from pymc_backbone.likelihood import density

    assert _cli_update.LIKELIHOODS == (*model.LIKELIHOODS, options.HIERARCHICAL)
    assert _cli_update.POPULATIONS == options.POPULATIONS
    assert _cli_update.DENSITIES == density.KINDS
    assert _cli_update.MARGINALS[0] == "best" and set(_cli_update.MARGINALS[1:]) == set(density.FAMILIES)


def test_extract_hands_on_every_option(capsys, calls):
    code, _, _ = run_cli(capsys, "extract", "r.csv", "--levels", "8", "--observables", "frequency", "--out", "o")
    assert code == 0
    assert isinstance(calls["extract"].pop("progress"), ProgressBar) and callable(calls["extract"].pop("say"))
    assert calls["extract"] == {
        "path": Path("r.csv"), "output": Path("o"), "overwrite": False, "reading": Reading(),
        "measuring": Measuring(levels=8, observables=("frequency",)),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("The records are\nempty."), 2, "The records are empty."),
        (KeyboardInterrupt(), 130, "Interrupted"),
        (RuntimeError("boom"), 1, "fault of the program"),
    ],
)
def test_errors_become_one_sentence(capsys, monkeypatch, error, code, words):
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(run_extract, "extract", fail)
    monkeypatch.delenv(cli.TRACEBACK_VARIABLE, raising=False)
    got, _, text = run_cli(capsys, "extract", "x", "--out", "o")
    assert got == code and is_one_sentence(text) and words in text


def test_interrupt_while_a_compiler_calls_back_is_not_lost(capsys, monkeypatch):
    """Python reports what a callback raises and goes on: a Ctrl-C in one left the run running, below a traceback."""
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))

    def run(_):
        callback()
        time.sleep(20.0)

    monkeypatch.setattr(cli, "_effects", run)
    begin = time.monotonic()
    code, _, error = run_cli(capsys, "effects")
    assert code == 130 and is_one_sentence(error) and time.monotonic() - begin < 10.0


def test_update_that_was_ended_early_exits_as_interrupted(capsys, monkeypatch):
    """Its results are written; a script must not take them for those of the whole run."""
    monkeypatch.setattr(run, "update", lambda *_, **__: {"interrupted": "Stopped with Ctrl-C."})
    code, _, error = run_cli(capsys, "update", "records", *MASS, "--store", "kept")
    assert code == 130 and is_one_sentence(error) and "already written are complete" in error


def test_traceback_can_be_asked_for(capsys, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("boom")

    monkeypatch.setattr(run_extract, "extract", fail)
    monkeypatch.setenv(cli.TRACEBACK_VARIABLE, "1")
    with pytest.raises(RuntimeError, match="boom"):
        cli.main(["extract", "x", "--out", "o"])


def start(*arguments: str, **options: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "pymc_backbone", *arguments]
    return subprocess.Popen(
        command,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,  # type: ignore[call-overload]
    )


@pytest.mark.parametrize("what", ["missing", "empty", "file"])
def test_unusable_records_in_a_real_process(tmp_path, what):
    path = tmp_path / what
    if what == "empty":
        path.mkdir()
    elif what == "file":
        path.write_text("this is no table of numbers\n")
    process = start("extract", str(path), "--out", str(tmp_path / "out"))
    out, error = process.communicate(timeout=120)
    assert process.returncode == 2
    assert out == "" and is_one_sentence(error)
    assert not (tmp_path / "out" / "result.json").exists()


def test_output_in_use_in_a_real_process(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    process = start("extract", "records", "--out", str(tmp_path))
    out, error = process.communicate(timeout=120)
    assert process.returncode == 2 and out == ""
    assert is_one_sentence(error) and "--overwrite" in error


@pytest.mark.parametrize("command", [["extract"], ["update", *MASS], ["diagnose", *MASS]])
def test_results_do_not_go_among_the_records(capsys, tmp_path, command):
    """The next run would take them for records, and refuse the folder."""
    (tmp_path / "a.csv").write_text("time,displacement\n0,1\n")
    arguments = [*command, str(tmp_path), "--out", f"{tmp_path}/../{tmp_path.name}", "--overwrite"]
    code, out, error = run_cli(capsys, *arguments)
    assert code == 2 and out == "" and is_one_sentence(error) and "where the records are" in error
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
@pytest.mark.parametrize("arguments", [["effects"], ["--version"]])
def test_output_that_cannot_be_written_is_one_sentence(arguments):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "pymc_backbone", *arguments], stdout=full, stderr=subprocess.PIPE, text=True,
            cwd=ROOT, check=False, timeout=300,
        )  # fmt: skip
    assert done.returncode == 1 and is_one_sentence(done.stderr)
    assert "standard output cannot be written (No space left on device)" in done.stderr


def test_update_for_real(capsys, tmp_path):
    """Records to folder through every module: two specimens that share one parameter set, a short run."""
    for number in (1, 2):
        shutil.copy(demo.demo_folder() / f"specimen_0{number}.csv", tmp_path)
    out = tmp_path / "out"
    code, text, error = run_cli(
        capsys, "update", str(tmp_path), *MASS, "--effect", "cubic_stiffness", "--likelihood", "pooled",
        "--levels", "5", "--draws", "150", "--tune", "300", "--chains", "2", "--step", "demetropolisz", "--seed", "1",
        "--out", str(out),
    )  # fmt: skip
    assert code == 0 and str(out) in text, error
    result = read_result(out)
    stiffness = result["parameters"]["linear_stiffness"]["mean"]
    truth = demo.demo_parameters()[1]["linear_stiffness"][:2]
    assert truth.min() - 100.0 < stiffness < truth.max() + 100.0  # N/m; one value for two specimens
    assert any("never moved" in s or "effective draws" in s or "R-hat" in s for s in result["findings"])  # too short


# ---- reading, printing, completion ------------------------------------------------------------


def test_words_of_reading_reach_the_records_and_what_was_assumed_is_said(capsys, tmp_path):
    path = format_files.lvm(tmp_path / "a.lvm")
    arguments = ["extract", str(path), "--columns", "hammer", "--unit", "mm", "--levels", "3", "--out"]
    code, text, error = run_cli(capsys, *arguments, str(tmp_path / "out"))
    assert code == 0, error
    assert re.search(r"Reading the records:\n- 1 record of displacement \[m\]: \S+ s at \S+ samples per second, ", text)
    assert "\n- displacement was converted from mm to m\n" in text
    result = read_result(tmp_path / "out")
    assert result["settings"]["columns"] == ["hammer"] and result["settings"]["unit"] == "mm"
    assert any("converted from mm to m" in note for note in result["notes"])
    assert (tmp_path / "out" / "backbones.nc").exists() and (tmp_path / "out" / "backbones.csv").exists()


def test_quiet_and_json(capsys, tmp_path):
    path = format_files.mat5(tmp_path / "a.mat")
    base = ["extract", str(path), "--levels", "3", "--out", str(tmp_path / "out"), "--overwrite"]
    assert run_cli(capsys, *base, "--quiet") == (0, "", "")
    code, text, error = run_cli(capsys, *base, "--json")
    assert code == 0, error
    printed, written = json.loads(text), read_result(tmp_path / "out")
    assert printed["levels"] == written["levels"] and printed["notes"] == written["notes"]
    assert "converted from g to m/s^2" in " ".join(printed["notes"])
    assert run_cli(capsys, "extract", str(tmp_path / "none"), "--out", str(tmp_path / "o"), "-q")[0::2] == (
        2,
        f"pymc-backbone: {tmp_path / 'none'}: there is no such file or folder; check the path.\n",
    )
    code, text, _ = run_cli(capsys, "effects", "freeplay", "--json")
    parameters = json.loads(text)["freeplay"]["parameters"]
    assert list(parameters) == [parameter.name for parameter in LIBRARY["freeplay"].parameters]


def complete(script: Path, *words: str) -> set[str]:
    """Ask bash what it would complete after the words."""
    line = " ".join(f"'{word}'" for word in words)
    code = f"source {script}; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _pymc_backbone; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True, cwd=script.parent)
    return set(done.stdout.split())


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not there to ask")
def test_completion_in_bash(capsys, tmp_path):
    script = tmp_path / "script.sh"
    script.write_text(run_cli(capsys, "completion", "bash")[1])
    name = cli.PROGRAM
    assert complete(script, name, "e") == {"extract", "effects"}
    assert complete(script, name, "update", "--like") == {"--likelihood"}
    assert complete(script, name, "update", "--likelihood", "po") == {"population", "pooled"}
    assert complete(script, name, "update", "--effect", "cub") == {e for e in LIBRARY if e.startswith("cub")}
    assert complete(script, name, "effects", "free") == {"freeplay"}
    assert complete(script, name, "extract", "scr") == {"script.sh"}


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_completion_for_other_shells_names_every_option(capsys, shell):
    text = run_cli(capsys, "completion", shell)[1]
    for option in ("columns", "unit", "band", "start", "prior", "candidates", "json"):
        assert f"--{option}" in text or f"-l {option}" in text
    for name in LIBRARY:
        assert name in text


@pytest.mark.slow
def test_demo_recovers_the_truth(capsys, tmp_path):
    code, text, _error = run_cli(capsys, "demo", "--out", str(tmp_path / "out"))
    assert code == 0 and "Where to look" in text
    result = read_result(tmp_path / "out")
    for name, values in demo.demo_parameters()[1].items():
        entry = result["parameters"][name]
        # About 2000 effective draws and 24 specimens measured well: means within 0.15 sd, spreads within 15 %.
        assert abs(entry["mean"] - values.mean()) < 0.15 * values.std(ddof=1)
        assert entry["sd"] == pytest.approx(values.std(ddof=1), rel=0.15)
        assert entry["r_hat"] < 1.01
    assert result["seconds"]["total"] < 120.0


@pytest.mark.skipif(os.name != "posix", reason="pipes and signals as on POSIX")
def test_a_reader_that_stops_early_is_no_error():
    process = start("effects")
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    error = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) == 0 and error == ""


@pytest.mark.skipif(sys.platform == "win32", reason="a shell closes the streams")
@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&-"])
def test_a_process_without_standard_error_does_its_work(closed, tmp_path):
    """As under a service, or Windows' pythonw: it ended in a fault of the program, or without a word."""
    record = str(demo.demo_folder() / "specimen_01.csv")
    words = [sys.executable, "-m", "pymc_backbone", "extract", record, "--out", str(tmp_path / "out")]
    shell = ["/bin/sh", "-c", f"{shlex.join(words)} {closed}"]
    done = subprocess.run(shell, capture_output=True, text=True, cwd=ROOT, check=False, timeout=300)
    assert done.returncode == 0 and (tmp_path / "out" / "result.json").exists(), done.stdout
    assert ("Backbones and figures are in" in done.stdout) == (closed == "2>&-")
