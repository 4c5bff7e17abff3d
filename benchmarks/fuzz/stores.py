"""Damaged and forged stores of draws: manifest, lock and chunks, with digests that are right all the same."""

from __future__ import annotations

import copy
import hashlib
import io
import json
import logging
import platform
import random
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pymc as pm

from pymc_backbone import sample
from pymc_backbone.inference.starts import StartFinder
from pymc_backbone.inference.store import recorder
from pymc_backbone.inference.store import run_folder as store

SETTINGS = {"draws": 12, "tune": 9, "chains": 2, "step": "nuts", "random_seed": 3}
WORDS = ["", "x", "\x1b[31m", "<f8", "|O", "float", "dict", "array", "grown", "fields", "state_0", "../../x", "1e999"]
NUMBERS = [0, -1, 1, 2, 1 << 31, 1 << 70, 10**12, 0.5, -0.0, 1e308, float("nan"), float("inf"), True, None]


class Run:
    """A stored run with its model and step, made once."""

    def __init__(self, folder: Path) -> None:
        recorder.CHUNK_DRAWS, recorder.SHORTEST_WAIT = 7, 0.0
        for name in ("pymc", "pymc_backbone"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with pm.Model() as self.model:
            pm.Normal("location", 0.2, 1.0)
            pm.Normal("slopes", 0.0, 1.0, shape=2)
            self.step = pm.NUTS()
        sample(self.model, **SETTINGS, store=folder / "run", progressbar=False)
        self.methods = self.step.step, self.step.setup_chain
        parts = [self.step, self.step.step_adapt, self.step.potential]
        self.memory = [(part, dict(vars(part))) for part in parts]
        self.finder = StartFinder(self.model, 1)
        places = sorted(path for path in (folder / "run").rglob("*") if path.is_file())
        self.files = {str(path.relative_to(folder / "run")): path.read_bytes() for path in places}
        self.files["lock.json"] = json.dumps({"process": 1, "host": platform.node(), "begun": "x"}).encode()

    def resume(self, folder: Path) -> str:
        """Do what a resumed run does with its store, up to the first draw of its own."""
        with store.DrawStore(folder, resume=True) as kept:
            kept.seed(None)
            starts = kept.starts(self.model, self.finder, SETTINGS)
            try:
                recorder = kept.record(self.step, dict)
                for start, chain in zip(starts, kept.stored, strict=True):
                    recorder.setup_chain(np.random.default_rng(1), SETTINGS["tune"], SETTINGS["draws"] + 1)
                    point = {name: np.asarray(value) for name, value in start.items()}
                    for _ in range(len(chain.points) + 1):
                        with warnings.catch_warnings():
                            # what PyMC computes from numbers that are none is its own, and may be told
                            warnings.filterwarnings("ignore", category=RuntimeWarning, module="pymc")
                            point, _ = recorder.step(point)
            finally:
                self.step.step, self.step.setup_chain = self.methods
                for part, memory in self.memory:  # as a new process has it
                    vars(part).clear()
                    vars(part).update({k: v.copy() if isinstance(v, np.ndarray) else v for k, v in memory.items()})
        return "read"


def forge(tree: Any, chance: random.Random) -> Any:
    """Return a JSON tree with one to three places changed: replaced, removed, doubled, or nested."""
    tree = copy.deepcopy(tree)
    for _ in range(chance.choice((1, 1, 2, 3))):
        places: list[tuple[Any, Any]] = []

        def collect(node: Any, places: list[tuple[Any, Any]] = places) -> None:
            items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
            for key, value in items:
                places.append((node, key))
                collect(value)

        collect(tree)
        if not places:
            return tree
        node, key = chance.choice(places)
        kind = chance.randrange(6)
        if kind == 0:
            del node[key]
        elif kind == 1:
            other, place = chance.choice(places)
            node[key] = copy.deepcopy(other[place])
        elif kind == 2:
            node[key] = [copy.deepcopy(node[key])] * chance.choice((0, 1, 3))
        elif kind == 3:
            node[key] = {chance.choice(WORDS): copy.deepcopy(node[key])}
        else:
            node[key] = chance.choice([*NUMBERS, *WORDS])
    return tree


def _forged_manifest(content: bytes, chance: random.Random) -> bytes:
    manifest = json.loads(content)
    del manifest["digest"]
    manifest = forge(manifest, chance)
    return json.dumps({**manifest, "digest": store._digest(manifest)}).encode()


def _forged_chunk(content: bytes, chance: random.Random) -> bytes:
    with np.load(io.BytesIO(content)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    if chance.randrange(3):
        header = forge(json.loads(arrays["header"].tobytes()), chance)
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    else:
        name = chance.choice(sorted(arrays))
        array = arrays[name]
        arrays[name] = chance.choice(
            [
                array.ravel()[:-1], array.astype("f4"), array[..., None], np.zeros(0), np.array("x"), array.astype("O"),
                np.zeros(2_000_000), np.full(array.shape, np.nan),
            ]
        )  # fmt: skip
    buffer = io.BytesIO()
    chance.choice((np.savez, np.savez, np.savez, np.savez_compressed))(buffer, **arrays)
    return buffer.getvalue()


def damaged_stores(
    run: Run,
    folder: Path,
    number: int,
    chance: random.Random,
    damage: Callable[[bytes, bytes, random.Random], bytes],
    judge: Callable[[str, Callable[[], str], str], bool],
    keep: Path | None,
) -> None:
    """Resume runs whose store has one file damaged (any bytes) or forged (a valid file that says something else)."""
    names = sorted(run.files)
    for _ in range(number):
        place = folder / "store"
        shutil.rmtree(place, ignore_errors=True)
        name = chance.choice(["manifest.json", "manifest.json", "lock.json", *names])
        content, is_forged = run.files[name], chance.randrange(4) > 0
        if not is_forged:
            content = damage(content, run.files[chance.choice(names)], chance)
        elif name == "lock.json":
            content = json.dumps(forge(json.loads(content), chance)).encode()
        elif name == "manifest.json":
            content = _forged_manifest(content, chance)
        else:
            content = _forged_chunk(content, chance)
        if chance.randrange(30) == 0:
            content = b"[" * 100_000
        for other, data in run.files.items():
            if other == "lock.json" and name != other:
                continue
            path = place / other
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        target = place / name
        if target.suffix == ".npz" and chance.randrange(5):
            target.unlink()
            target = target.with_name(f"{target.stem[:7]}{hashlib.sha256(content).hexdigest()[:16]}.npz")
        target.write_bytes(content)
        what = "chunk" if target.suffix == ".npz" else name
        subject = f"store, {'forged' if is_forged else 'damaged'} {what}"
        if not judge(subject, lambda p=place: run.resume(p), name) and keep is not None:
            keep.mkdir(parents=True, exist_ok=True)
            shutil.copytree(place, keep / f"{len(list(keep.iterdir()))}_store")
            (keep / f"{len(list(keep.iterdir())) - 1}_store" / "changed.txt").write_text(target.name)
