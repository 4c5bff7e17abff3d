"""Runs on disk: resumed draws are those of an undisturbed run, and what cannot be used ends in one sentence."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import logging
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pymc as pm
import pytest

from pymc_backbone import InputError, build_model, fit_density, sample
from pymc_backbone._common import atomic_files
from pymc_backbone._common.atomic_files import replacing
from pymc_backbone.inference.store import lock as _store_lock
from pymc_backbone.inference.store import recorder
from pymc_backbone.inference.store import run_folder as store
from pymc_backbone.inference.store.draw_chunks import ChunkFolder
from pymc_backbone.inference.store.lock import LOCK, FolderLock
from pymc_backbone.inference.store.run_folder import MANIFEST, DrawStore, read_manifest
from pymc_backbone.inference.store.step_state import (
    History,
    PlainState,
    StateError,
    encode_state,
    grow_lists,
    restore_state,
)

from .test_model import BOUNDS, DUFFING, batch

ROOT = Path(__file__).resolve().parents[1]
TIMES = {"perf_counter_diff", "perf_counter_start", "process_time_diff"}  # NUTS's own clock
SIZES = {"draws": 30, "tune": 25, "chains": 2, "random_seed": 8, "progressbar": False}


def plain_model(prior: float = 1.0, curvature: float = 0.7) -> pm.Model:
    """Return a model without a backbone, which compiles in a moment: a scalar and a vector."""
    with pm.Model() as model:
        location = pm.Normal("location", 0.2, prior)
        pm.Normal("slopes", 0.0, 1.0, shape=2)
        pm.Potential("likelihood", -curvature * location**2)
    return model


def backbone_model() -> pm.Model:
    density = fit_density(batch(np.random.default_rng(5), 20), marginal="normal")
    return build_model(DUFFING, density, BOUNDS)


def assert_same(first, second) -> None:
    """Compare draws and statistics bit by bit."""
    for group in ("posterior", "sample_stats"):
        assert set(first[group].data_vars) == set(second[group].data_vars)
        for name in set(first[group].data_vars) - TIMES:
            a, b = np.asarray(first[group][name]), np.asarray(second[group][name])
            assert a.dtype == b.dtype and a.tobytes() == b.tobytes(), name


class Cut(RuntimeError):
    """Stands in for a power cut."""


def cut_after(draws: int):
    """Return a callback that ends the run, without any warning, in the middle of the draw after so many."""
    done = 0

    def callback(**_: object) -> None:
        nonlocal done
        done += 1
        if done > draws:
            raise Cut

    return callback


@pytest.fixture
def small_chunks(monkeypatch) -> None:
    monkeypatch.setattr(recorder, "CHUNK_DRAWS", 7)
    monkeypatch.setattr(recorder, "SHORTEST_WAIT", 0.0)


@pytest.fixture
def chunk(rng) -> tuple:
    """Points, statistics, state and costs of three draws."""
    points = [{"x": rng.standard_normal(2), "y": np.array(value)} for value in rng.standard_normal(3)]
    stats = [[{"accept": value, "accepted": True}] for value in rng.uniform(size=3)]
    return (
        points,
        stats,
        PlainState({"tree": 1}, {"state_0": rng.standard_normal(4)}, {}),
        {"evaluations": 6.0, "failures": 1.0},
        0.5,
    )


@pytest.mark.parametrize("step", ["metropolis", "elementwise", "demetropolisz", "slice", "nuts"])
def test_resumed_draws_are_those_of_an_undisturbed_run(step, tmp_path, small_chunks):
    make = backbone_model if step == "metropolis" else plain_model
    settings = {**SIZES, "step": step}
    whole = sample(make(), **settings)
    for draws in (20, 95):  # in the tuning of the first chain, after that of the second
        with pytest.raises(Cut):
            sample(make(), **settings, store=tmp_path / "run", resume=True, callback=cut_after(draws))
    resumed = sample(make(), **{**settings, "progressbar": True}, store=tmp_path / "run", resume=True)
    assert_same(whole, resumed)
    assert resumed.attrs["evaluations"] == whole.attrs["evaluations"]
    assert resumed.attrs["failures"] == whole.attrs["failures"]


def test_draws_need_the_state_of_the_sampler(tmp_path, small_chunks, monkeypatch):
    """Negative control: with draws repeated but the state left out, the comparison above fails."""
    whole = sample(plain_model(), **SIZES, step="nuts")
    with pytest.raises(Cut):
        sample(plain_model(), **SIZES, step="nuts", store=tmp_path / "run", callback=cut_after(40))
    monkeypatch.setattr(recorder, "restore_state", lambda *_: History())
    resumed = sample(plain_model(), **SIZES, step="nuts", store=tmp_path / "run", resume=True)
    with pytest.raises(AssertionError):
        assert_same(whole, resumed)


def test_interrupt_ends_with_what_was_drawn_and_the_rest_can_follow(tmp_path, small_chunks):
    settings = {**SIZES, "step": "demetropolisz"}
    whole = sample(plain_model(), **settings)
    handler = signal.getsignal(signal.SIGINT)

    def interrupt(draw, **_: object) -> None:
        if (draw.chain, draw.draw_idx) == (0, 40):
            os.kill(os.getpid(), signal.SIGINT)

    part = sample(plain_model(), **settings, store=tmp_path / "run", callback=interrupt)
    assert signal.getsignal(signal.SIGINT) is handler
    assert dict(part["posterior"].sizes) | {"slopes_dim_0": 2} == {"chain": 1, "draw": 16, "slopes_dim_0": 2}
    np.testing.assert_array_equal(part["posterior"]["location"][0], whole["posterior"]["location"][0, :16])
    assert "41 of 110 draws" in part.attrs["interrupted"] and "1 of 2 chains with 16 of 30" in part.attrs["interrupted"]
    resumed = sample(plain_model(), **settings, store=tmp_path / "run", resume=True)
    assert_same(whole, resumed)
    assert "interrupted" not in resumed.attrs


def test_interrupt_in_the_tuning_keeps_the_tuning(tmp_path, small_chunks, caplog):
    def interrupt(draw, **_: object) -> None:
        if draw.draw_idx == 9:
            os.kill(os.getpid(), signal.SIGINT)

    with caplog.at_level(logging.INFO, "pymc_backbone"), pytest.raises(KeyboardInterrupt):
        sample(plain_model(), **SIZES, step="demetropolisz", store=tmp_path / "run", callback=interrupt)
    assert "before the first draw after tuning" in caplog.text
    manifest = read_manifest(tmp_path / "run")
    assert len(ChunkFolder(tmp_path / "run" / "chain_0", f"{manifest['run']}/0").read().points) == 10


def test_a_run_can_become_longer_but_not_another(tmp_path, small_chunks):
    settings = {**SIZES, "step": "demetropolisz", "store": tmp_path / "run"}
    sample(plain_model(), **{**settings, "draws": 20})
    longer = sample(plain_model(), **{**settings, "draws": 30, "random_seed": None}, resume=True)
    assert_same(sample(plain_model(), **SIZES, step="demetropolisz"), longer)
    for change, words in (
        ({"draws": 20}, "a run of 30 draws, which may become longer but not 20"),
        ({"tune": 26}, "tune 25, not 26"),
        ({"chains": 3}, "chains 2, not 3"),
        ({"random_seed": 9}, "random_seed 8, not 9"),
        ({"step": "slice"}, "step demetropolisz, not slice"),
    ):
        assert words in refusal(plain_model(), **{**settings, **change}, resume=True)
    assert "was Normal(0.2, 1.0) and is now Normal(0.2, 2.0)" in refusal(
        plain_model(prior=2.0), **settings, resume=True
    )
    assert "log-density at its first start was" in refusal(plain_model(curvature=0.701), **settings, resume=True)
    assert "holds a run already; resume it" in refusal(plain_model(), **settings)


def refusal(model: pm.Model, **settings) -> str:
    """Return the sentence with which `sample` refuses, after a look that it is one."""
    with pytest.raises(InputError) as caught:
        sample(model, **settings)
    text = str(caught.value)
    assert text.endswith(".") and text.count(". ") == 0 and "\n" not in text
    return text


def test_another_backbone_model_is_named(tmp_path):
    density = fit_density(batch(np.random.default_rng(5), 20), marginal="normal")
    settings = {"draws": 2, "tune": 2, "chains": 1, "random_seed": 1, "progressbar": False, "store": tmp_path / "run"}
    sample(build_model(DUFFING, density, BOUNDS), **settings)
    other = fit_density(batch(np.random.default_rng(6), 20), marginal="normal")
    heavier = type(DUFFING)(1.1, ["cubic_stiffness"])
    narrower = {**BOUNDS, "viscous_damping": (0.1, 2.5)}
    for model, words in (
        (build_model(DUFFING, other, BOUNDS), "the data of 'backbone' changed"),
        (build_model(heavier, density, BOUNDS), "the mass of 'backbone' was 1.0 and is now 1.1"),
        (build_model(DUFFING, density, narrower), "the prior of viscous_damping was Uniform(0.1, 3.0)"),
        (build_model(DUFFING + "quadratic_damping", density, {**BOUNDS, "quadratic_damping": (0.0, 1.0)}),
         "the free variables"),
    ):  # fmt: skip
        assert words in refusal(model, **settings, resume=True)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"resume": True}, "name its folder with `store`"),
        ({"step": "nutpie", "store": "run"}, "use step 'nuts'"),
        ({"cores": 2, "store": "run"}, "`cores` must be 1, got 2"),
        ({"random_seed": 1.5, "store": "run"}, "`random_seed` must be a whole number"),
    ],
)
def test_what_cannot_be_stored_is_refused(settings, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert words in refusal(plain_model(), **{**SIZES, "step": "slice", **settings})


def test_a_step_object_cannot_be_stored(tmp_path):
    with plain_model() as model:
        assert "a step of your own" in refusal(model, **SIZES, step=pm.Slice(), store=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_folders_that_cannot_be_used(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.tex").write_text("x")
    (tmp_path / "web").mkdir()
    (tmp_path / "web" / MANIFEST).write_text('{"name": "app"}')
    for path, words in (
        (tmp_path / "file", "is a file"),
        (tmp_path / "foreign", "thesis.tex"),
        (tmp_path / "web", "is not the manifest of a run"),
        (Path("/proc/no_such_folder"), "cannot be used"),  # not even for root
    ):
        with pytest.raises(InputError, match=words), DrawStore(path, resume=True):
            pass
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} == {"file", MANIFEST, "thesis.tex"}


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is read-only for root")
def test_read_only_folder(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot be written"), DrawStore(tmp_path):
        pass
    tmp_path.chmod(0o700)


def test_damaged_manifest_is_refused(tmp_path):
    text = json.dumps({"format": "pymc-backbone draws, 1", "settings": {"random_seed": 3}, "digest": "0"})
    (tmp_path / MANIFEST).write_text(text)
    with pytest.raises(InputError, match="is damaged"), DrawStore(tmp_path, resume=True):
        pass


def forged(folder: Path, change) -> None:
    """Change a manifest and give it a digest that is right."""
    manifest = json.loads((folder / MANIFEST).read_text())
    del manifest["digest"]
    change(manifest)
    (folder / MANIFEST).write_text(json.dumps({**manifest, "digest": store._digest(manifest)}))


@pytest.mark.parametrize(
    "change",
    [
        lambda manifest: manifest.pop("starts"),
        lambda manifest: manifest.pop("shape"),
        lambda manifest: manifest["settings"].pop("random_seed"),
        lambda manifest: manifest["settings"].update(chains=10**12),
        lambda manifest: manifest["settings"].update(step="\x1b[31m"),
        lambda manifest: manifest["starts"][0]["location"].update(type="|O"),
        lambda manifest: manifest["starts"][0]["location"].update(values=["x"]),
        lambda manifest: manifest["starts"][0].pop("location"),
        lambda manifest: manifest["starts"][0]["slopes"].update(values=[[1.0]]),
        lambda manifest: manifest.update(model={"the free variables": 1}),
        lambda manifest: manifest.update(log_density="high"),
    ],
)
def test_a_manifest_of_other_origin_is_refused(change, tmp_path, small_chunks):
    """The digest is right: it says that a file is whole, not who wrote it."""
    settings = {**SIZES, "step": "elementwise"}
    with pytest.raises(Cut):
        sample(plain_model(), **settings, store=tmp_path / "run", callback=cut_after(20))
    forged(tmp_path / "run", change)
    with pytest.raises(InputError) as caught:
        sample(plain_model(), **settings, store=tmp_path / "run", resume=True)
    assert str(caught.value).isprintable() and str(caught.value).endswith(".")


def test_a_manifest_nested_without_end_is_refused(tmp_path):
    (tmp_path / MANIFEST).write_text("[" * 100_000)
    with pytest.raises(InputError, match="not the manifest"):
        read_manifest(tmp_path)
    (tmp_path / MANIFEST).unlink()
    (tmp_path / LOCK).write_text("[" * 100_000)
    lock = FolderLock(tmp_path)
    lock.acquire()
    lock.release()


def rewritten(folder: Path, change) -> None:
    """Change the last chunk of a folder and give it a name that is right."""
    path = max(folder.glob("*.npz"))
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(arrays["header"].tobytes())
    change(header, arrays)
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    is_bomb = sum(array.nbytes for array in arrays.values()) > 1e8
    (np.savez_compressed if is_bomb else np.savez)(buffer, **arrays)
    path.unlink()
    digest = hashlib.sha256(buffer.getvalue()).hexdigest()[:16]
    (folder / f"{path.name[:7]}{digest}.npz").write_bytes(buffer.getvalue())


@pytest.mark.parametrize(
    "change",
    [
        lambda header, arrays: header.update(draws=10**12),
        lambda header, arrays: header.update(draws=10**12, names=[], stats=[]),
        lambda header, arrays: header.pop("counts"),
        lambda header, arrays: header.update(seconds="long"),
        lambda header, arrays: header.update(lists={"x": {"kind": "array", "tail": "none", "cut": 0}}),
        lambda header, arrays: arrays.update(point_0=np.array([{}], dtype=object)),
        lambda header, arrays: arrays.update(more=np.zeros(10**8)),
    ],
)
def test_a_chunk_of_other_origin_is_set_aside(change, tmp_path, chunk, caplog):
    """The digest is right, and still nothing is unpickled, nothing grows, and the chunks before it stay."""
    folder = ChunkFolder(tmp_path, "run")
    folder.append(*chunk)
    folder.append(*chunk)
    rewritten(tmp_path, change)
    read = ChunkFolder(tmp_path, "run")
    with caplog.at_level(logging.WARNING, "pymc_backbone"):
        chain = read.read()
    assert len(chain.points) == len(chain.stats) == 3 and read.count == 1 and chain.seconds == chunk[4]
    assert "does not check" in caplog.text


def test_a_chunk_of_other_variables_is_refused(tmp_path, small_chunks):
    settings = {**SIZES, "step": "elementwise"}
    with pytest.raises(Cut):
        sample(plain_model(), **settings, store=tmp_path / "run", callback=cut_after(20))
    rewritten(tmp_path / "run" / "chain_0", lambda header, arrays: header.update(names=["elsewhere", "slopes"]))
    with pytest.raises(InputError, match="other variables"):
        sample(plain_model(), **settings, store=tmp_path / "run", resume=True)


@pytest.mark.parametrize(
    "tree", [[], 1, {"state": {"fields": {}}, "unlisted": [{}]}, {"state": {"x": 1}, "unlisted": [{}]}]
)
def test_a_state_of_other_origin_is_refused(tree, tmp_path, small_chunks):
    settings = {**SIZES, "step": "nuts"}
    with pytest.raises(Cut):
        sample(plain_model(), **settings, store=tmp_path / "run", callback=cut_after(20))
    rewritten(tmp_path / "run" / "chain_0", lambda header, arrays: header.update(tree=tree))
    with pytest.raises(InputError, match="state of another step method"):
        sample(plain_model(), **settings, store=tmp_path / "run", resume=True)


def test_a_generator_with_a_pool_of_any_size_is_refused(tmp_path, small_chunks):
    """NumPy would allocate 8 GB for it."""
    settings = {**SIZES, "step": "nuts"}
    with pytest.raises(Cut):
        sample(plain_model(), **settings, store=tmp_path / "run", callback=cut_after(20))

    def enlarge(header, arrays) -> None:
        seeds = header["tree"]["state"]["fields"]["rng"]["fields"]["seed_seq_state"]["dict"]
        assert seeds["pool_size"] == 4
        seeds["pool_size"] = 2**31

    rewritten(tmp_path / "run" / "chain_0", enlarge)
    with pytest.raises(InputError, match="random generator of another kind"):
        sample(plain_model(), **settings, store=tmp_path / "run", resume=True)


def test_chunks_come_back_as_they_were(tmp_path, chunk):
    points, stats, state, *took = chunk
    folder = ChunkFolder(tmp_path / "chain_0", "run")
    folder.append(points, stats, state, *took)
    folder.append(points[:1], stats[:1], state, *took)
    read = ChunkFolder(tmp_path / "chain_0", "run").read()
    assert len(read.points) == 4 and (read.counts, read.seconds) == ({"evaluations": 12.0, "failures": 2.0}, 1.0)
    for before, after in zip([*points, points[0]], read.points, strict=True):
        assert list(before) == list(after)
        assert all(before[name].tobytes() == after[name].tobytes() for name in before)
    assert [part[0]["accept"] for part in read.stats] == [part[0]["accept"] for part in [*stats, stats[0]]]
    assert read.state.tree == state.tree


@pytest.mark.parametrize("damage", ["byte", "cut", "missing", "another run", "object"])
def test_damaged_chunks_are_set_aside(damage, tmp_path, chunk, caplog):
    folder = ChunkFolder(tmp_path / "chain_0", "run")
    for _ in range(3):
        folder.append(*chunk)
    paths = sorted(folder.folder.iterdir())
    content = paths[1].read_bytes()
    run = "run"
    if damage == "byte":
        paths[1].write_bytes(content[:500] + bytes([content[500] ^ 1]) + content[501:])
    elif damage == "cut":
        paths[1].write_bytes(content[: len(content) // 2])
    elif damage == "missing":
        paths[1].unlink()
    elif damage == "object":  # a pickle, with the right digest in its name: not opened
        paths[1].unlink()
        buffer = io.BytesIO()
        np.savez(buffer, header=np.array([{"number": 1}], dtype=object))
        digest = hashlib.sha256(buffer.getvalue()).hexdigest()[:16]
        (folder.folder / f"000001-{digest}.npz").write_bytes(buffer.getvalue())
    else:
        run = "another"
    reader = ChunkFolder(tmp_path / "chain_0", run)
    with caplog.at_level(logging.WARNING):
        kept = 0 if damage == "another run" else 1
        assert len(reader.read().points) == 3 * kept
    assert "are drawn again" in caplog.text
    reader.append(*chunk)  # the place is free again
    assert len(ChunkFolder(tmp_path / "chain_0", run).read().points) == 3 * (kept + 1)


def test_damage_costs_draws_but_not_the_posterior(tmp_path, small_chunks, caplog):
    settings = {**SIZES, "step": "demetropolisz", "store": tmp_path / "run"}
    whole = sample(plain_model(), **settings)
    paths = sorted((tmp_path / "run" / "chain_0").iterdir())
    paths[3].write_bytes(paths[3].read_bytes()[:100])
    assert_same(whole, sample(plain_model(), **settings, resume=True))
    assert "after the first 21 are drawn again" in caplog.text


def test_full_disk_ends_in_one_sentence_and_the_store_stays_whole(tmp_path, small_chunks, monkeypatch):
    settings = {**SIZES, "step": "demetropolisz"}
    room = 5
    write = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        nonlocal room
        room -= 1
        if room < 0:
            write(path, content[: len(content) // 2])  # what fits
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        text = refusal(plain_model(), **settings, store=tmp_path / "run")
    assert "No space left on device" in text and "continue the run with resume" in text
    assert len(list((tmp_path / "run" / "chain_0").iterdir())) == 5  # whole chunks, nothing beside them
    resumed = sample(plain_model(), **settings, store=tmp_path / "run", resume=True)
    assert_same(sample(plain_model(), **settings), resumed)


def test_a_write_that_the_system_refuses_leaves_the_file_before_it(tmp_path):
    path = tmp_path / "file"
    with replacing(path) as temporary:
        temporary.write_text("whole")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with (
            pytest.raises(InputError, match=r"file cannot be written \(File too large\)"),
            replacing(path) as temporary,
        ):
            temporary.write_bytes(bytes(5000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text() == "whole" and list(tmp_path.iterdir()) == [path]


def test_content_is_on_the_disk_before_its_name(tmp_path, monkeypatch):
    events = []
    monkeypatch.setattr(
        atomic_files.os, "fsync", lambda descriptor: events.append(os.readlink(f"/proc/self/fd/{descriptor}"))
    )
    replace = os.replace
    monkeypatch.setattr(atomic_files.os, "replace", lambda *names: (events.append("replace"), replace(*names)))
    with replacing(tmp_path / "file") as temporary:
        temporary.write_text("x")
    assert events == [str(temporary), "replace", str(tmp_path)]


def test_leftovers_of_a_killed_process_are_removed(tmp_path):
    (tmp_path / ".writing-x").mkdir()
    (tmp_path / ".writing-x" / MANIFEST).write_text("{")
    with DrawStore(tmp_path):
        assert sorted(path.name for path in tmp_path.iterdir()) == [LOCK]


HOLD = """
import sys, time
from pathlib import Path
from pymc_backbone.inference.store.lock import FolderLock
FolderLock(Path(sys.argv[1])).acquire()
print("held", flush=True)
time.sleep(60)
"""


def test_second_process_is_refused_until_the_first_is_dead(tmp_path):
    first = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert first.stdout is not None and first.stdout.readline() == "held\n"
    with pytest.raises(InputError, match=rf"in use by process {first.pid} on .*; wait until") as caught:
        with DrawStore(tmp_path):
            pass
    assert str(caught.value).count(". ") == 0
    first.kill()
    first.wait()
    first.stdout.close()
    with DrawStore(tmp_path):  # what it left names a process that is gone
        assert json.loads((tmp_path / LOCK).read_text())["process"] == os.getpid()
    assert (tmp_path / LOCK).read_text() == ""


def test_file_system_without_locks_goes_by_process_and_start_time(tmp_path, monkeypatch):
    monkeypatch.setattr(_store_lock, "_lock", lambda file: True)
    parent = os.getppid()
    here = {"host": _store_lock.platform.node(), "process": parent}
    (tmp_path / LOCK).write_text(json.dumps({**here, "begun": _store_lock._start_of(parent)}))
    with pytest.raises(InputError, match=f"in use by process {parent}"):
        FolderLock(tmp_path).acquire()
    # The same number, given to another process since.
    (tmp_path / LOCK).write_text(json.dumps({**here, "begun": "another start"}))
    lock = FolderLock(tmp_path)
    lock.acquire()
    lock.release()
    (tmp_path / LOCK).write_text(json.dumps({**here, "host": "elsewhere", "begun": "x"}))
    with pytest.raises(InputError, match="elsewhere, which cannot be seen"):
        FolderLock(tmp_path).acquire()


@pytest.mark.parametrize(("seconds", "draws"), [(0.25, 40), (0.0625, 100), (2.0**-10, 1024), (25.0, 1)])
def test_at_most_a_hundred_draws_or_ten_seconds_are_lost(seconds, draws, monkeypatch):
    """Draws that take so long, and how many a chunk holds: 100, but at least a second's and at most ten seconds'."""
    now = 0.0
    written = []

    class Clock:
        @staticmethod
        def monotonic() -> float:
            return now

    class Step:
        def setup_chain(self, *_: object) -> None: ...

        def step(self, point):
            nonlocal now
            now += seconds
            return point, [{}]

    class Folder:
        def append(self, points, *_: object) -> None:
            written.append(len(points))

    monkeypatch.setattr(recorder, "time", Clock)
    monkeypatch.setattr(recorder, "encode_state", lambda *_: (None, History()))
    step = Step()
    recorder.Recorder(step, [Folder()], [recorder.StoredChain()], lambda: {"evaluations": 0.0})
    step.setup_chain(None, 0, 2 * draws + 1)
    for _ in range(2 * draws + 1):
        step.step({})
    assert written == [draws, draws, 1]  # the last one with the end of the chain


def test_growing_lists_are_written_by_their_ends(rng):
    with plain_model():
        step, other = pm.DEMetropolisZ(), pm.DEMetropolisZ()
    history, lists = History(), {}
    step._history = [rng.standard_normal(4) for _ in range(50)]
    plain, history = encode_state(step, history, 50)
    lists = grow_lists(lists, plain)
    for dropped, drawn in ((0, 5), (12, 7), (0, 1), (60, 4)):
        step._history = step._history[dropped:] + [rng.standard_normal(4) for _ in range(drawn)]
        plain, history = encode_state(step, history, drawn)
        lists = grow_lists(lists, plain)
        size = plain.arrays[plain.lists["/_history"]["tail"]].shape[0]
        assert size == (drawn if dropped < 60 else len(step._history))
        restore_state(other, plain, lists)
        np.testing.assert_array_equal(other._history, step._history)
    with plain_model(), pytest.raises(StateError):
        restore_state(pm.Metropolis(), plain, lists)


def test_state_that_is_no_plain_data_is_refused():
    with plain_model():
        step = pm.DEMetropolisZ()
    step.lamb = object()
    with pytest.raises(StateError, match="object"):
        encode_state(step, History(), 0)


@pytest.mark.slow
def test_kills_at_random_moments_change_no_draw(tmp_path, random_seed):
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import kill_and_resume
    finally:
        sys.path.pop(0)
    rng = np.random.default_rng(random_seed)
    for step in ("metropolis", "nuts"):
        outcome = kill_and_resume.torture(step, 3, True, rng, tmp_path)
        assert outcome.kills >= 3 and outcome.damaged == outcome.differing == 0
        assert max(outcome.lost_draws, default=0) <= 1  # the draw that was being written


@pytest.mark.slow
def test_command_line_survives_a_kill(tmp_path, rng):
    from pymc_backbone.reporting.backbone_files import backbone_table

    from .test_run import make_backbones

    table = tmp_path / "backbones.csv"
    backbone_table(make_backbones(rng, 3)).to_csv(table, index=False)
    command = [sys.executable, "-m", "pymc_backbone", "update", str(table), "--backbones", "--mass", "1", "--effect",
               "cubic_stiffness", "--chains", "2", "--tune", "50", "--draws", "10000", "--seed", "3"]  # fmt: skip
    kept = [*command, "--store", str(tmp_path / "run")]

    def run(arguments: list[str], out: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*arguments, "--out", str(tmp_path / out)], cwd=ROOT, capture_output=True, text=True)

    first = subprocess.Popen(kept, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 1200.0  # compilation, several times, on a busy machine
    while not list((tmp_path / "run").glob("chain_*/*.npz")):
        assert first.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    first.send_signal(signal.SIGSTOP)  # else it may end before the second has begun; it keeps the lock
    second = run([*kept, "--resume"], "second")
    assert second.returncode == 2 and f"in use by process {first.pid}" in second.stderr
    first.kill()
    first.wait()
    again = run(kept, "again")
    assert again.returncode == 2 and "holds a run already" in again.stderr
    resumed = subprocess.Popen([*kept, "--resume", "--out", str(tmp_path / "out")], cwd=ROOT, stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True)  # fmt: skip
    before = len(list((tmp_path / "run").glob("chain_*/*.npz")))
    while len(list((tmp_path / "run").glob("chain_*/*.npz"))) == before:
        assert resumed.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    resumed.send_signal(signal.SIGINT)
    text, error = resumed.communicate()
    assert resumed.returncode == 130 and "Traceback" not in error and "Stopped with Ctrl-C after" in text
    partial = json.loads((tmp_path / "out" / "result.json").read_text())
    assert partial["interrupted"] and partial["parameters"]["linear_stiffness[beam_1]"]["mean"] > 0.0
    assert run([*kept, "--resume"], "out").returncode == 0
    assert run(command, "whole").returncode == 0
    results = [json.loads((tmp_path / name / "result.json").read_text()) for name in ("out", "whole")]
    assert results[0]["interrupted"] is None
    assert results[0]["parameters"] == results[1]["parameters"]
