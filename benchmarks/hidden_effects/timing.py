"""How long ``diagnose --quick`` takes as a whole process, and on what.

    python benchmarks/hidden_effects/generate.py --batches 20 --seed 15 --tier timed --out DIR
    python benchmarks/hidden_effects/timing.py DIR --markdown timing.md

Each batch is diagnosed by the command, as a user types it, in a process of its own: seconds on the clock from its start
to its end, and seconds of computation of all its threads. The same once more with a clock in every stage says where
they go: what a stage calls counts to that stage unless it is a stage itself, and imports count apart, whoever asks for
them. One batch first, not counted: compiled code and byte code are then on disk, as for a user from the second run on.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
START = "interpreter, options, end"
IMPORTS = "imports"
STAGES: dict[str, tuple[str, ...]] = {
    "reading": ("workflows.diagnose:_read",),
    "conditioning, cycles, levels": ("discrepancy.sets.question:batch_of",),
    "proposals": ("discrepancy.sets.known_sets:propose",),
    "waveform fits": ("discrepancy.workflow:_searched",),
    "disturbances": ("discrepancy.workflow:undisturbed",),
    "drifts": ("discrepancy.checks.rivals:drifting_sets",),
    "deciding": ("discrepancy.workflow:_decided",),
    "held out": ("discrepancy.workflow:verify",),
    "parameters, study": ("discrepancy.workflow:infer", "discrepancy.workflow:_study"),
    "figures": (
        "reporting.study_files:study_figures",
        "reporting.html:png",
        "reporting.output_folder:_write_png",
    ),
    "report, script, tables": ("reporting.study_files:write_study",),
}
"""Stages and the functions they are, as they are called."""


class Clock:
    """Seconds on the clock by stage; those of an inner stage are not those of the outer one."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys((IMPORTS, *STAGES), 0.0)
        self.inner: list[float] = []
        self.importing = 0

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with its seconds counted."""

        def call(*args: Any, **kwargs: Any) -> Any:
            self.inner.append(0.0)
            begin = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.perf_counter() - begin
                self.seconds[stage] += spent - self.inner.pop()
                if self.inner:
                    self.inner[-1] += spent

        return call

    def watch_imports(self) -> None:
        """Count what is not imported yet when it is asked for; threads of the search import nothing of weight."""
        machinery = sys.modules["importlib._bootstrap"]
        plain = machinery._find_and_load  # type: ignore[attr-defined]
        timed = self.timed(IMPORTS, plain)
        own = threading_ident()

        def find(name: str, import_: Any) -> Any:
            if self.importing or threading_ident() != own:
                return plain(name, import_)
            self.importing += 1
            try:
                return timed(name, import_)
            finally:
                self.importing -= 1

        machinery._find_and_load = find  # type: ignore[attr-defined]

    def watch(self) -> None:
        """Put the clock into every stage."""
        for stage, places in STAGES.items():
            for place in places:
                module, _, name = place.partition(":")
                owner: Any = importlib.import_module(f"pymc_backbone.{module}")
                *classes, last = name.split(".")
                for part in classes:
                    owner = getattr(owner, part)
                if not hasattr(owner, last):
                    raise AttributeError(f"{place} is no stage any more; mend STAGES.")
                setattr(owner, last, self.timed(stage, getattr(owner, last)))


def threading_ident() -> int:
    """Return the number of the running thread."""
    import _thread

    return _thread.get_ident()


def run_watched(arguments: Sequence[str], target: Path) -> None:
    """Run the command with a clock in every stage, to the end of the process; its seconds go to a file."""
    clock = Clock()
    clock.watch_imports()
    from pymc_backbone.cli.main import run as command

    clock.watch()
    sys.argv = ["pymc-backbone", *arguments]
    try:
        command()
    finally:
        target.write_text(json.dumps(clock.seconds))


def command_of(batch: Path, output: Path) -> list[str]:
    """Return the arguments that diagnose a batch."""
    truth = json.loads((batch / "truth.json").read_text())
    base = ["--base", *truth["base"]] if truth["base"] else []
    return [
        "diagnose", str(batch / "records"), "--mass", repr(truth["mass"]), *base,
        "--quick", "--seed", "1", "--out", str(output), "--overwrite", "--quiet",
    ]  # fmt: skip


def run(command: Sequence[str]) -> tuple[float, float]:
    """Return seconds on the clock and of computation of a process."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # as Python runs where nothing is set
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    spent = time.perf_counter() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def measure(batch: Path, output: Path) -> dict[str, Any]:
    """Return the seconds of a batch: of the process, and by stage."""
    arguments = command_of(batch, output)
    seconds, computed = run([sys.executable, "-m", "pymc_backbone", *arguments])
    stages = output.with_suffix(".json")
    total, _ = run([sys.executable, __file__, "--watched", str(stages), *arguments])
    shares = json.loads(stages.read_text())
    shares[START] = total - sum(shares.values())
    verdict = json.loads((output / "result.json").read_text())["verdict"]
    return {"batch": batch.name, "seconds": seconds, "computed": computed, "verdict": verdict, "stages": shares}


def table(results: Sequence[dict[str, Any]]) -> str:
    """Return the figures as Markdown."""
    seconds = sorted(result["seconds"] for result in results)
    computed = sorted(result["computed"] for result in results)
    last = max(len(seconds) - 1, 0)

    def quantile(values: Sequence[float], share: float) -> float:
        place = share * last
        low = int(place)
        return values[low] + (place - low) * (values[min(low + 1, last)] - values[low])

    lines = [
        f"| {len(results)} batches | median | 95th percentile | largest |",
        "|---|---|---|---|",
    ]
    for name, values in (("seconds on the clock", seconds), ("seconds of computation", computed)):
        lines.append(f"| {name} | {quantile(values, 0.5):.1f} | {quantile(values, 0.95):.1f} | {values[-1]:.1f} |")
    lines += ["", "| stage | median [s] | share |", "|---|---|---|"]
    names = [START, IMPORTS, *STAGES]
    middle = {name: statistics.median(result["stages"][name] for result in results) for name in names}
    total = sum(sum(result["stages"].values()) for result in results)
    for name in names:
        share = sum(result["stages"][name] for result in results) / total
        lines.append(f"| {name} | {middle[name]:.2f} | {share:.0%} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Time all batches of a folder."""
    if sys.argv[1:2] == ["--watched"]:
        run_watched(sys.argv[3:], Path(sys.argv[2]))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path, help="figures of each batch into this file")
    parser.add_argument("--markdown", type=Path, help="the table into this file too")
    given = parser.parse_args()
    batches = sorted(given.folder.glob("batch_*"))
    results = []
    with tempfile.TemporaryDirectory() as place:
        output = Path(place) / "out"
        measure(batches[0], output)
        for batch in batches:
            results.append(measure(batch, output))
            last = results[-1]
            said = f"{last['seconds']:.1f} s ({last['computed']:.1f} s of computation), {last['verdict']}"
            print(f"{batch.name} {said}", file=sys.stderr, flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(results, indent=1) + "\n")
    text = table(results)
    if given.markdown is not None:
        given.markdown.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
