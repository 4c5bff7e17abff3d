"""Damaged, mixed-up and made-up input for all that the package reads: nothing may end in a traceback.

Readers of records and backbones, the command line, its own `result.json`, and stores of draws (manifest, lock, chunks).

Each input must be read, or be refused by one sentence (exit code 2 on the command line), within limits of time and
memory. Valid files of every format, written by independent writers, are damaged byte by byte; tables, dictionaries and
arguments are made up by hypothesis.

    python benchmarks/fuzz/fuzz.py --inputs 20000 --seed 1 --keep faults/

Every batch runs in a process of its own, so that a crash of a library is counted and not the end.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import multiprocessing
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
from hypothesis import HealthCheck, Phase, given, seed, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

from benchmarks.fuzz.stores import Run, damaged_stores  # noqa: E402
from pymc_backbone import (  # noqa: E402
    InputError,
    Record,
    condition,
    extract_cycles,
    plots,
    read_backbones,
    read_records,
)
from pymc_backbone.cli import main as cli  # noqa: E402
from pymc_backbone.measurement.reading.formats import isolation  # noqa: E402
from pymc_backbone.reporting import output_folder as results  # noqa: E402
from pymc_backbone.reporting.claimed_folder import prepare_output  # noqa: E402
from pymc_backbone.workflows import extract as run_extract  # noqa: E402
from pymc_backbone.workflows import update as run  # noqa: E402
from tests.format_files import WRITERS  # noqa: E402

SECONDS, MEGABYTES = 20.0, 1500.0
"""Limits of one input: time, and memory beyond what the process has when it begins."""
LONGEST_BATCH = 3600.0
isolation.SECONDS = 2.0  # of computation; the files are small, and a refusal must come before the limit above
BATCH = 1000
INTERESTING = [
    b"\0",
    b"\x01",
    b"\x7f",
    b"\x80",
    b"\xff",
    b"\xff\xff\xff\x7f",
    b"\xff\xff\xff\xff",
    b"\0\0\0\x80",
    b"\n",
]
INTERESTING += [np.float64(x).tobytes() for x in (np.nan, np.inf, -0.0, 1e300)] + [b"\x00\x00\x00\x00\x00\x00\x00\x10"]
TOKENS = [
    b"nan",
    b"inf",
    b"1e999",
    b"-1",
    b"0",
    b"",
    b"1,234",
    b"1.234,5",
    b"99999999999",
    b";",
    b"\t",
    b"time",
    b'"',
    b"\xb5",
]


class _TooSlow(BaseException):
    """An input took longer than `SECONDS`."""


@dataclass
class Tally:
    """What came of the inputs: counts by subject and outcome, faults with what brought them about."""

    outcomes: Counter[tuple[str, str]] = field(default_factory=Counter)
    faults: list[tuple[str, str, str]] = field(default_factory=list)
    slowest: tuple[float, str] = (0.0, "")

    def add(self, other: Tally) -> None:
        """Add what another batch found."""
        self.outcomes += other.outcomes
        self.faults += other.faults
        self.slowest = max(self.slowest, other.slowest)


def seeds(folder: Path) -> dict[str, bytes]:
    """Return a valid file of each kind by name: records of every format, and what the package itself writes."""
    files = {name: write(folder / name).read_bytes() for name, write in WRITERS.items()}
    np.save(folder / "matrix.npy", np.column_stack([np.arange(60) / 64.0, np.cos(np.arange(60.0))]))
    files["matrix.npy"] = (folder / "matrix.npy").read_bytes()
    table = "amplitude [m],frequency,frequency_error\n" + "".join(f"{k}e-3,{10 + k},0.1\n" for k in range(1, 12))
    (folder / "table.csv").write_text(table)
    backbones = read_backbones(folder / "table.csv")
    results.write_results(folder / "out", {"command": "extract", "settings": {}}, backbones=backbones)
    files["backbones.nc"] = (folder / "out" / "backbones.nc").read_bytes()
    files["result.json"] = (folder / "out" / "result.json").read_bytes()
    files["table.csv"] = table.encode()
    return files


def damage(data: bytes, other: bytes, chance: random.Random) -> bytes:
    """Return data with a few faults: bits, bytes, numbers, pieces lost, doubled, moved, or taken from another file."""
    content = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 8))):
        # headers say more than samples do
        span = min(len(content), chance.choice((64, 512, 2048, len(content) + 1, len(content) + 1)))
        at = chance.randrange(span) if span else 0
        size = chance.choice((1, 4, 8, 80, 1000))
        kind = chance.randrange(9)
        if kind == 0 and content:
            content[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            piece = chance.choice(INTERESTING)
            content[at : at + len(piece)] = piece
        elif kind == 2:
            del content[at : at + size]
        elif kind == 3:
            content[at:at] = content[at : at + size]
        elif kind == 4:
            content[at:at] = chance.randbytes(chance.choice((1, 4, 50)))
        elif kind == 5:
            del content[chance.randrange(len(content) + 1) :]
        elif kind == 6:
            begin = chance.randrange(len(other) + 1)
            content[at : at + size] = other[begin : begin + size]
        elif kind == 7:
            content[at : at + chance.choice((0, 1, 3, 8))] = chance.choice(TOKENS)
        else:
            lines = bytes(content).split(b"\n")
            i, j = chance.randrange(len(lines)), chance.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
            content = bytearray(b"\n".join(lines))
    return bytes(content)


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """Bound the time of what is done inside."""

    def stop(*_: Any) -> None:
        raise _TooSlow

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def judge(subject: str, action: Callable[[], str], tally: Tally, what: str) -> bool:
    """Do something with one input and count what came of it; return whether that was allowed."""
    begin = time.perf_counter()
    try:
        with limits(), warnings.catch_warnings():
            warnings.simplefilter("error")
            outcome = action()
    except InputError as error:
        text = str(error)
        is_sentence = text.isprintable() and text.endswith((".", "?")) and 20 < len(text) < 1500
        outcome = "refused" if is_sentence else f"no sentence: {text[:200]!r}"
    except _TooSlow:
        outcome = f"longer than {SECONDS:g} s"
    except BaseException as error:  # SystemExit and KeyboardInterrupt are faults here, too
        last = traceback.extract_tb(error.__traceback__)[-1]
        outcome = f"{type(error).__name__}: {str(error)[:150]} ({Path(last.filename).name}:{last.lineno})"
    tally.slowest = max(tally.slowest, (time.perf_counter() - begin, subject))
    is_allowed = outcome in ("read", "refused")
    tally.outcomes[subject, outcome if is_allowed else "FAULT"] += 1
    if not is_allowed:
        tally.faults.append((subject, outcome, what))
    return is_allowed


def read(path: Path) -> str:
    """Read a file as its name says, with every reader that takes it."""
    if path.name == "result.json":
        try:
            results.read_result(path.parent)
        finally:  # a second run into the same folder goes on, whatever the first one's says
            results.write_results(prepare_output(path.parent, overwrite=True), {"command": "extract"})
            path.unlink()
        return "read"
    if path.name in ("backbones.nc", "table.csv"):
        read_backbones(path)
        return "read"
    for record in read_records(path, unit="m" if path.suffix == ".npy" else None):
        assert np.isfinite(record.values).all() and (np.diff(record.time) > 0.0).all()
    return "read"


def command(arguments: list[str]) -> str:
    """Run the command line inside this process and look at its exit code and what it printed."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            code = cli.main(arguments)
        except SystemExit as stop:
            code = int(stop.code or 0)
    text = error.getvalue()
    if code == 2 and text.startswith("pymc-backbone: ") and text.count("\n") == 1:
        return "refused"
    if code == 0 and "Traceback" not in text:
        return "read"
    return f"exit code {code}: {text[:200]!r}"


def damaged_files(folder: Path, number: int, chance: random.Random, tally: Tally, keep: Path | None) -> None:
    """Read damaged files; one in twenty goes through the command line."""
    valid = seeds(folder)
    names = sorted(valid)
    for _ in range(number):
        name = chance.choice(names)
        content = damage(valid[name], valid[chance.choice(names)], chance)
        path = folder / "damaged" / (name.removesuffix(".json") if name == "result.json" else "") / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        begin = time.perf_counter()
        if chance.randrange(20) == 0 and name not in ("result.json", "table.csv", "backbones.nc"):
            arguments = ["extract", str(path), "--out", str(folder / "result"), "--overwrite"]
            arguments += chance.choice(
                [[], ["--unit", "m"], ["--start", "0.05"], ["--band", "20:90"], ["--columns", "1"]]
            )
            is_allowed = judge("command line, damaged file", lambda a=arguments: command(a), tally, name)
        else:
            is_allowed = judge(f"damaged {name}", lambda p=path: read(p), tally, name)
        is_slow = time.perf_counter() - begin > SECONDS / 4.0
        if (is_slow or not is_allowed) and keep is not None:
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{len(list(keep.iterdir()))}_{name}").write_bytes(content)


CELL = st.one_of(
    st.floats().map(repr),
    st.integers(-9999, 9999).map(str),
    st.text(max_size=6),
    st.sampled_from(["1,5", "1,234", "1.234,5", "", "nan", "time", "acc (g)", "m/s", '"', "#", "-1"]),
)
HEADER = st.sampled_from(["time", "time [ms]", "displacement [mm]", "acc [g]", "specimen", "x", "vel", "n"])
NUMBERS = st.one_of(
    st.lists(st.one_of(st.floats(), st.none(), st.text(max_size=2)), max_size=40),
    st.integers(0, 60).map(lambda n: [0.01 * k for k in range(n)]),
    st.none(),
    st.integers(),
)
CHANGES = st.dictionaries(
    st.sampled_from(["name", "data", "unit_str", "fs", "time", "quantity", "group", "start_timestamp"]),
    st.one_of(NUMBERS, st.text(max_size=5), st.sampled_from(["m", "mm", "g", "a", "d", 100.0, float("inf")])),
)
GOOD = {"name": "tip", "data": np.cos(np.arange(60.0)).tolist(), "unit_str": "mm", "fs": 100.0}
SERIES = st.one_of(CHANGES, CHANGES.map(lambda changes: {**GOOD, **changes}))
LEAF = st.one_of(
    st.integers(2, 50).map(lambda n: np.arange(n) / 64.0),
    st.floats().map(np.array),
    st.text(max_size=5),
    st.tuples(st.integers(0, 5), st.integers(0, 40)).map(lambda shape: np.ones(shape)),
    st.just(np.array([1j, 2.0])),
    st.just(np.array([True, False])),
)
NAME = st.sampled_from(
    ["t", "time", "acc", "vel_mm", "fs", "dt", "data", "unit", "units", "names", "x_values", "y_values"]
)
WHOLE = {"t": np.arange(50) / 64.0, "acc": np.cos(np.arange(50.0)), "unit": "g"}
BRANCHES = st.recursive(
    LEAF,
    lambda inner: st.one_of(
        st.dictionaries(NAME, inner, min_size=1, max_size=4), st.lists(inner, min_size=1, max_size=3)
    ),
    max_leaves=8,
)
TREE = st.one_of(BRANCHES, st.dictionaries(NAME, BRANCHES, max_size=2).map(lambda changes: {**WHOLE, **changes}))
WRONG_STEP = st.sampled_from([0.0101, 0.02, 1e-12, 1e12, 0.2, 3.0, -0.01, 1e300])
SIGNAL = st.fixed_dictionaries(
    {
        "samples": st.sampled_from([30, 50, 100, 200, 300, 400, 600, 800, 1000]),
        "wrong": st.lists(st.tuples(st.integers(1, 29), WRONG_STEP), max_size=1),
        "frequency": st.sampled_from([5.0, 3.0, 4.0, 6.0, 8.0, 0.01, 1.0, 12.0, 33.0, 49.9]),
        "decay": st.sampled_from([0.3, 0.2, 0.5, 0.1, 1.0, -1.0, 0.0, 20.0]),
        "scale": st.sampled_from([1.0, 1e-3, 1e-2, 1e-6, 0.0, 1e-300, 1e12, 1e300]),
        "offset": st.sampled_from([0.0, 1.0, -1e9]),
        "noise": st.sampled_from([0.0, 1e-6, 1e-3, 1e-2, 0.1, 10.0]),
        "quantum": st.sampled_from([0.0, 1e-4, 1e-3, 0.01, 0.5]),
        "quantity": st.sampled_from(["displacement", "velocity", "acceleration"]),
        "band": st.sampled_from([None, None, None, (1.5, 9.0), (2.0, 8.0), (0.0, 1e9), (5.0, 5.1)]),
    }
)
WORD = st.one_of(
    st.sampled_from(
        [
            "extract",
            "update",
            "diagnose",
            "effects",
            "RECORDS",
            "--out",
            "OUT",
            "--mass",
            "1",
            "--band",
            "5:20",
            "20:5",
            "--levels",
            "--start",
            "nan",
            "1e999",
            "--unit",
            "mm",
            "--columns",
            "time=t",
            "--json",
            "--quiet",
            "--prior",
            "cubic_stiffness=0:1",
            "--fix",
            "--effect",
            "freeplay",
            "--observables",
            "offset",
            "--backbones",
            "--",
            "-1",
        ]
    ),
    st.text(max_size=6),
)


def made_up(folder: Path, number: int, start: int, tally: Tally) -> None:
    """Read tables, dictionaries and variables that hypothesis makes up, and parse command lines."""
    import scipy.io

    def explore(strategy: st.SearchStrategy[Any], subject: str, action: Callable[[Any], str], count: int) -> None:
        quiet = settings(
            max_examples=count,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )

        @seed(start)
        @quiet
        @given(strategy)
        def once(value: Any) -> None:
            judge(subject, lambda: action(value), tally, repr(value)[:300])

        once()

    def table(value: tuple[str, list[str], list[list[str]]]) -> str:
        separator, header, lines = value
        path = folder / "made_up.csv"
        good = [[f"{0.01 * k}"] * len(header) for k in range(36)]
        text = "\n".join(separator.join(row) for row in [header, *good, *lines])
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        return read(path)

    def variables(value: Any) -> str:
        path = folder / "made_up.mat"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                scipy.io.savemat(path, value if isinstance(value, dict) else {"acc": value})
        except Exception:  # what SciPy cannot write
            return "refused"
        return read(path)

    def series(value: Any) -> str:
        read_records(value)
        return "read"

    def signal_(value: dict[str, Any]) -> str:
        steps = np.full(value["samples"], 0.01)
        for at, step in value["wrong"]:
            steps[at] = step
        clock = np.cumsum(steps)
        rng = np.random.default_rng(clock.size)
        shape = np.exp(-value["decay"] * np.clip(clock, -9.0, 9.0)) * np.cos(2 * np.pi * value["frequency"] * clock)
        values = value["scale"] * (shape + value["noise"] * rng.normal(size=clock.size)) + value["offset"]
        quantum = value["quantum"] * value["scale"]
        values = np.round(values / quantum) * quantum if quantum > 1e-20 else values
        extract_cycles(condition(Record("made up", clock, values, value["quantity"]), band=value["band"]))
        return "read"

    def words(value: list[str]) -> str:
        places = {"RECORDS": str(folder / "none.csv"), "OUT": str(folder / "result")}
        return command([places.get(word, word) for word in value])

    rows = st.lists(st.lists(CELL, min_size=1, max_size=4), max_size=4)
    tables = st.tuples(st.sampled_from([",", ";", "\t", " "]), st.lists(HEADER, min_size=1, max_size=4), rows)
    share = max(number // 5, 1)
    explore(tables, "made-up tables", table, share)
    explore(TREE, "made-up MATLAB variables", variables, share)
    explore(st.one_of(SERIES, st.lists(SERIES, max_size=3)), "made-up SEP-005 dictionaries", series, share)
    explore(SIGNAL, "made-up signals and time stamps", signal_, share)
    explore(st.lists(WORD, max_size=8), "made-up command lines", words, share)


def batch(number: int, start: int, keep: Path | None) -> Tally:
    """Run one batch; a third of the inputs is made up, a tenth are stores of draws."""
    tally = Tally()
    chance = random.Random(start)
    # figures and sampling are not the subject, and would take nearly all of the time
    plots.plot_backbones = plots.plot_records = lambda *_: None  # type: ignore[assignment]
    run_extract.write_results = run.write_results = lambda *_, **__: []  # type: ignore[assignment]
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    isolation._running()  # its start is not the time of an input
    try:
        damaged_files(folder, number - number // 3 - number // 10, chance, tally, keep)
        damaged_stores(
            _stored_run(),
            folder,
            number // 10,
            chance,
            damage,
            lambda subject, action, what: judge(subject, action, tally, what),
            keep,
        )
        made_up(folder, number // 3, start, tally)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return tally


@functools.cache
def _stored_run() -> Run:
    with tempfile.TemporaryDirectory() as folder:
        return Run(Path(folder))


def _child(number: int, start: int, keep: Path | None, pipe: Any) -> None:
    with open("/proc/self/statm") as stream:
        now = int(stream.read().split()[0]) * resource.getpagesize()
    most = now + int(MEGABYTES * 1e6)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pipe.send(batch(number, start, keep))


def warm_up() -> None:
    """Compile what the command line runs, once for all batches."""
    with tempfile.TemporaryDirectory() as folder:
        path = WRITERS["a.csv"](Path(folder) / "a.csv")
        with contextlib.redirect_stdout(io.StringIO()):
            assert cli.main(["extract", str(path), "--out", str(Path(folder) / "result")]) == 0
    _stored_run()


def run_batches(inputs: int, start: int, keep: Path | None, progress: Callable[[Tally, int], None]) -> Tally:
    """Run all batches, each in a process of its own."""
    warm_up()
    tally, context = Tally(), multiprocessing.get_context("fork")
    for first in range(0, inputs, BATCH):
        number = min(BATCH, inputs - first)
        receiver, sender = context.Pipe(duplex=False)
        child = context.Process(target=_child, args=(number, start * 1_000_003 + first, keep, sender))
        child.start()
        sender.close()
        try:
            if not receiver.poll(LONGEST_BATCH):  # compiled code takes no notice of the limit of one input
                child.kill()
                tally.outcomes["batch", "FAULT"] += 1
                what = f"seed {start * 1_000_003 + first}, process {child.pid}: its folder is left"
                tally.faults.append(("batch", f"no end in {LONGEST_BATCH:g} s", what))
            else:
                tally.add(receiver.recv())
        except EOFError:
            tally.outcomes["batch", "FAULT"] += 1
            tally.faults.append(("batch", "the process ended without a word", f"seed {start * 1_000_003 + first}"))
        child.join()
        progress(tally, first + number)
    return tally


def main() -> int:
    """Run as the options say, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=20_000, metavar="N", help="how many (20000)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="the same seed gives the same inputs (1)")
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="where to keep files that brought a fault about or took long"
    )
    options = parser.parse_args()
    begin = time.perf_counter()

    def progress(tally: Tally, done: int) -> None:
        if done % BATCH == 0:
            print(f"{done} inputs, {len(tally.faults)} faults, {time.perf_counter() - begin:.0f} s", file=sys.stderr)

    tally = run_batches(options.inputs, options.seed, options.keep, progress)
    subjects = sorted({subject for subject, _ in tally.outcomes})
    print("| input | read | refused | faults |\n|---|---|---|---|")
    for subject in subjects:
        print(
            f"| {subject} | " + " | ".join(str(tally.outcomes[subject, o]) for o in ("read", "refused", "FAULT")) + " |"
        )
    total = [sum(n for (_, o), n in tally.outcomes.items() if o == outcome) for outcome in ("read", "refused", "FAULT")]
    print(f"| **together: {sum(total)}** | {total[0]} | {total[1]} | {total[2]} |")
    print(
        f"\n{time.perf_counter() - begin:.0f} s; the slowest input took {tally.slowest[0]:.1f} s ({tally.slowest[1]})."
    )
    for (subject, outcome), number in Counter((s, o) for s, o, _ in tally.faults).most_common():
        example = next(what for s, o, what in tally.faults if (s, o) == (subject, outcome))
        print(f"FAULT {number} x {subject}: {outcome}; for example {example!r}")
    return 1 if tally.faults else 0


if __name__ == "__main__":
    sys.exit(main())
