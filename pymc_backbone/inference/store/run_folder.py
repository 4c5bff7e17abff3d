"""A run on disk: draws and the sampler's state as they come, so that a run that ends early can be continued.

========================  ====================================================================================
file                      what it holds
========================  ====================================================================================
``manifest.json``         what is drawn: settings, model and data as a fingerprint, starts, shape of the proposals
``lock.json``             the process that writes here; empty when there is none
``chain_0/000000-*.npz``  draws and the state of the sampler after them, chunk after chunk; the name ends with the
                          digest of the content
========================  ====================================================================================

Every file is whole or absent; nothing here is a pickle.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pymc as pm

from ..._common.atomic_files import TEMPORARY_PREFIX, remove_leftovers, replacing
from ..._common.checks import InputError
from ..starts import StartFinder
from .draw_chunks import REMEDY, ChunkFolder, StoredChain
from .fingerprint import describe_model, first_difference
from .lock import LOCK, FolderLock
from .recorder import Recorder

MANIFEST = "manifest.json"
FORMAT = "pymc-backbone draws, 1"
_AGREEMENT = 1e-7  # of log-densities of the same model on two computers


class DrawStore:
    """The folder of one run; use it in a ``with`` block, for the length of which no other process may have it.

    Parameters
    ----------
    folder : path-like
        Made if it is not there, with its parents.
    resume : bool
        Whether to continue the run that is there. Where there is none yet, one begins.

    Raises
    ------
    InputError
        On entering: the path is a file, the folder cannot be written or read, holds other files, is in use by another
        process, holds a run (without ``resume``) or a damaged manifest.
    """

    def __init__(self, folder: str | os.PathLike[str], resume: bool = False) -> None:
        self.folder = Path(folder)
        self.resume = resume
        self.manifest: dict[str, Any] | None = None
        self.stored: list[StoredChain] = []
        self.recorder: Recorder | None = None
        self._lock = FolderLock(self.folder)

    def __enter__(self) -> DrawStore:
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(f"The store {self.folder} is a file; name a folder.")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = sorted(entry.name for entry in self.folder.iterdir())
        except OSError as error:
            raise InputError(
                f"The store {self.folder} cannot be used ({error.strerror}); name another folder."
            ) from None
        foreign = [name for name in names if name != LOCK and not name.startswith(TEMPORARY_PREFIX)]
        if foreign and MANIFEST not in names:
            raise InputError(
                f"The store {self.folder} holds files of something else ({foreign[0]}); name an empty folder."
            )
        read_manifest(self.folder)  # before anything is written: another program's folder stays as it is
        self._lock.acquire()
        try:
            self.manifest = read_manifest(self.folder)
            if self.manifest is not None and not self.resume:
                raise InputError(
                    f"The store {self.folder} holds a run already; resume it, or name another folder for a new one."
                )
            remove_leftovers(self.folder)
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def seed(self, random_seed: int | None) -> int:
        """Return the seed of the run: the one given, the stored one, or a new one."""
        if random_seed is None:
            stored = stored_seed(self.manifest)
            return int(np.random.SeedSequence().generate_state(1)[0]) if stored is None else stored
        if isinstance(random_seed, bool) or not isinstance(random_seed, int | np.integer) or random_seed < 0:
            raise InputError(f"`random_seed` must be a whole number for a run that is stored, got {random_seed!r}.")
        return int(random_seed)

    def starts(self, model: pm.Model, finder: StartFinder, settings: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the starts of all chains and give the finder its shape: found for a new run, else as stored.

        Parameters
        ----------
        model : pymc.Model
            The model.
        finder : StartFinder
            Of this model.
        settings : mapping
            ``chains``, ``draws``, ``tune``, ``step``, ``random_seed``.

        Raises
        ------
        InputError
            Where the stored run is one of another model, other data or other settings; names what differs.
        """
        items = describe_model(model)
        if self.manifest is None:
            starts = finder.find(settings["chains"])
            self._write_manifest(model, finder, starts, settings, items)
        else:
            starts = [{name: _array(value) for name, value in start.items()} for start in self.manifest["starts"]]
            finder.shape = None if self.manifest["shape"] is None else _array(self.manifest["shape"])
            self._check(model, finder, starts, settings, items)
        assert self.manifest is not None
        run = self.manifest["run"]
        self.folders = [ChunkFolder(self.folder / f"chain_{i}", f"{run}/{i}") for i in range(len(starts))]
        self.stored = [folder.read() for folder in self.folders]
        self._check_points(finder)
        return starts

    def _check_points(self, finder: StartFinder) -> None:
        """Raise `InputError` where stored draws have other variables than the model."""
        if not any(chain.points for chain in self.stored):
            return
        expected = {name: np.shape(value) for name, value in finder.model.initial_point().items()}
        for folder, chain in zip(self.folders, self.stored, strict=True):
            for drawn in chain.points:
                if {name: np.shape(value) for name, value in drawn.items()} != expected:
                    raise InputError(
                        f"The store {folder.folder} holds draws of other variables than the model's; name another "
                        "folder."
                    )

    def record(self, step: Any, count: Callable[[], Mapping[str, float]]) -> Recorder:
        """Let a step write into this store, after it has repeated what is there."""
        self.recorder = Recorder(step, self.folders, self.stored, count)
        return self.recorder

    def _write_manifest(
        self,
        model: pm.Model,
        finder: StartFinder,
        starts: list[dict[str, Any]],
        settings: Mapping[str, Any],
        items: dict[str, str],
    ) -> None:
        self.manifest = {
            "format": FORMAT,
            "run": uuid.uuid4().hex,
            "pymc": pm.__version__,
            "settings": dict(settings),
            "model": items,
            "starts": [{name: _plain(value) for name, value in start.items()} for start in starts],
            "shape": None if finder.shape is None else _plain(finder.shape),
            "log_density": _height(model, finder, starts[0]),
        }
        self._save()

    def _save(self) -> None:
        assert self.manifest is not None
        text = json.dumps({**self.manifest, "digest": _digest(self.manifest)}, indent=1)
        with replacing(self.folder / MANIFEST, REMEDY) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")

    def _check(
        self,
        model: pm.Model,
        finder: StartFinder,
        starts: list[dict[str, Any]],
        settings: Mapping[str, Any],
        items: dict[str, str],
    ) -> None:
        """Raise `InputError` unless the stored run is this one; more draws may be asked for than before."""
        assert self.manifest is not None
        stored = self.manifest["settings"]
        remedy = "resume with what it was begun with, or name another folder."
        for name in ("step", "chains", "tune", "random_seed"):
            if stored[name] != settings[name]:
                raise InputError(
                    f"The store {self.folder} holds a run with {name} {stored[name]}, not {settings[name]}; {remedy}"
                )
        if settings["draws"] < stored["draws"]:
            raise InputError(
                f"The store {self.folder} holds a run of {stored['draws']} draws, which may become longer but not "
                f"{settings['draws']}; {remedy}"
            )
        if self.manifest["pymc"] != pm.__version__:
            raise InputError(
                f"The store {self.folder} was made with PyMC {self.manifest['pymc']}, and its sampler's state does not "
                f"go into PyMC {pm.__version__}; {remedy}"
            )
        difference = first_difference(self.manifest["model"], items)
        if difference is not None:
            raise InputError(f"The store {self.folder} holds a run of another model: {difference}; {remedy}")
        before = self.manifest["log_density"]
        try:
            now = _height(model, finder, starts[0])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InputError(
                f"{self.folder / MANIFEST} is damaged: its starts do not fit the model ({type(error).__name__}); name "
                "another folder."
            ) from None
        if not abs(now - before) <= _AGREEMENT * max(1.0, abs(before)):
            raise InputError(
                f"The store {self.folder} holds a run of another model: the log-density at its first start was "
                f"{before:.10g} and is now {now:.10g}; {remedy}"
            )
        if settings["draws"] > stored["draws"]:
            self.manifest["settings"] = dict(settings)
            self._save()


def read_manifest(folder: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return what a store says about its run, or None where there is no run yet.

    Raises
    ------
    InputError
        If it cannot be read, is damaged, or is not one of this program.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        raise InputError(f"The store {folder} is a file; name a folder.") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check its permissions.") from None
    except (ValueError, RecursionError):
        manifest = None
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise InputError(f"{path} is not the manifest of a run ({FORMAT!r}); name another folder.")
    if manifest.pop("digest", None) != _digest(manifest) or not _is_manifest(manifest):
        raise InputError(f"{path} is damaged: its content is not what was written; name another folder.")
    return manifest


def _is_manifest(manifest: Mapping[str, Any]) -> bool:
    """Whether everything is there and of its kind; the digest says that the text is whole, not who wrote it."""
    settings, model, starts = (manifest.get(name) for name in ("settings", "model", "starts"))
    if not isinstance(settings, dict) or not isinstance(model, dict) or not isinstance(starts, list):
        return False
    counts = [settings.get(name) for name in ("draws", "tune", "chains", "random_seed")]
    texts = [manifest.get("run"), manifest.get("pymc"), settings.get("step"), *model.values()]
    arrays = [value for start in starts if isinstance(start, dict) for value in start.values()]
    if "shape" not in manifest:
        return False
    if manifest["shape"] is not None:
        arrays.append(manifest["shape"])
    try:
        for value in arrays:
            _array(value)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return False
    return (
        all(isinstance(value, str) and value.isprintable() for value in (*texts, *model))
        and all(isinstance(value, int) and not isinstance(value, bool) and value >= 0 for value in counts)
        and all(isinstance(start, dict) for start in starts)
        and len(starts) == settings["chains"] > 0
        and isinstance(manifest.get("log_density"), int | float)
    )


def stored_seed(manifest: Mapping[str, Any] | None) -> int | None:
    """Return the seed of the run that a manifest describes."""
    return None if manifest is None else int(manifest["settings"]["random_seed"])


def _digest(manifest: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def _height(model: pm.Model, finder: StartFinder, start: Mapping[str, Any]) -> float:
    """Return the log-density at a start given on the natural scale."""
    to_point = pm.initial_point.make_initial_point_fn(model=model, overrides=dict(start), jitter_rvs=set())
    return finder.height(to_point(0))


def _plain(value: Any) -> dict[str, Any]:
    array = np.asarray(value)
    return {"type": array.dtype.str, "values": array.tolist()}


def _array(value: Mapping[str, Any]) -> Any:
    if not re.fullmatch(r"[<>|]?[fiub]\d{1,2}", value["type"]):
        raise ValueError("no numbers")
    return np.array(value["values"], dtype=np.dtype(value["type"]))
