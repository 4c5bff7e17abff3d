"""The draws of one chain on disk: chunk after chunk, each whole, checked, and tied to the one before."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._common.atomic_files import remove_leftovers, replacing
from ..._common.checks import InputError
from ...measurement.reading.formats.npz import unpack
from .step_state import PlainState, grow_lists

Point = dict[str, NDArray[Any]]
REMEDY = "free space there, then continue the run with resume"
_NAME = re.compile(r"(\d{6})-([0-9a-f]{16})\.npz")
logger = logging.getLogger("pymc_backbone")


@dataclass
class StoredChain:
    """What a chain's folder holds.

    ``points`` and ``stats`` hold one entry a draw; ``state`` is that of the step after the last one, with its growing
    ``lists``; ``counts`` (what the likelihoods counted, by name) and ``seconds`` are what these draws took.
    """

    points: list[Point] = field(default_factory=list)
    stats: list[list[dict[str, Any]]] = field(default_factory=list)
    state: PlainState | None = None
    lists: dict[str, list[Any]] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0


class ChunkFolder:
    """Chunks of one chain: NumPy archives whose names hold their number and the digest of their content.

    Parameters
    ----------
    folder : pathlib.Path
        Made with the first chunk.
    run : str
        Name of the run; it starts the chain of digests, so that chunks of two runs never mix.
    """

    def __init__(self, folder: Path, run: str) -> None:
        self.folder = folder
        self.count = 0
        self.last = run

    def read(self) -> StoredChain:
        """Return what is there, and make ready to append.

        What does not check, and everything after it, is set aside with a warning: the draws before it are those of
        the run, and those after it will be drawn again. What a killed process was writing is removed.
        """
        chain = StoredChain()
        try:
            if not self.folder.is_dir():
                return chain
            remove_leftovers(self.folder)
            names = sorted(path.name for path in self.folder.iterdir() if _NAME.fullmatch(path.name))
            for index, name in enumerate(names):
                try:
                    self._read_chunk(self.folder / name, chain)
                except ValueError as error:
                    logger.warning(
                        "%s does not check (%s): draws of this chain after the first %d are drawn again.",
                        self.folder / name,
                        error,
                        len(chain.points),
                    )
                    for damaged in names[index:]:
                        (self.folder / damaged).replace(self.folder / f"damaged-{damaged}")
                    break
        except OSError as error:
            raise InputError(
                f"The store {self.folder} cannot be read ({error.strerror or error}); check its permissions."
            ) from None
        return chain

    def append(
        self,
        points: Sequence[Point],
        stats: Sequence[Sequence[Mapping[str, Any]]],
        state: PlainState,
        counts: Mapping[str, float],
        seconds: float,
    ) -> None:
        """Write a chunk; raise `InputError` in one sentence where that fails, with the chunks before it untouched.

        Parameters
        ----------
        points : sequence of dict
            Unconstrained values, one entry for each draw.
        stats : sequence of sequence of mapping
            Statistics of each step method, one entry for each draw.
        state : PlainState
            Of the step after the last of these draws.
        counts : mapping of str to float
            What the likelihoods counted during these draws.
        seconds : float
            What they took.
        """
        names = list(points[0])
        arrays = {f"point_{i}": np.stack([np.asarray(point[name]) for point in points]) for i, name in enumerate(names)}
        # Objects (warnings of NUTS) are for the eye; PyMC drops them too when it makes its result.
        kept = [[name for name, value in part.items() if not np.asarray(value).dtype.hasobject] for part in stats[0]]
        for i, part in enumerate(kept):
            for j, name in enumerate(part):
                arrays[f"stat_{i}_{j}"] = np.array([draw[i][name] for draw in stats])
        header = {
            "number": self.count,
            "previous": self.last,
            "draws": len(points),
            "names": names,
            "stats": kept,
            "tree": state.tree,
            "lists": state.lists,
            "counts": dict(counts),
            "seconds": seconds,
        }
        buffer = io.BytesIO()
        text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
        np.savez(buffer, allow_pickle=False, header=text, **arrays, **state.arrays)
        content = buffer.getvalue()
        digest = hashlib.sha256(content).hexdigest()[:16]
        with replacing(self.folder / f"{self.count:06d}-{digest}.npz", REMEDY) as temporary:
            temporary.write_bytes(content)
        self.count += 1
        self.last = digest

    def _read_chunk(self, path: Path, chain: StoredChain) -> None:
        """Add a chunk to ``chain``, or raise `ValueError` and leave it as it is."""
        content = path.read_bytes()
        number, digest = path.stem.split("-")
        if hashlib.sha256(content).hexdigest()[:16] != digest:
            raise ValueError("its content is not what was written")
        # The digest says that a chunk is whole, not who wrote it.
        held = unpack(content, path.name, kinds="fiucbU", is_compressed=False)
        arrays = {key: _own(array) for key, array in held.items()}
        try:
            header = json.loads(arrays.pop("header").tobytes())
            if int(number) != self.count or header["number"] != self.count or header["previous"] != self.last:
                raise ValueError("the chunk before it is missing")
            state = PlainState(header["tree"], arrays, header["lists"])
            lists = grow_lists(chain.lists, state)
            points, stats = _draws_of(header, arrays)
            counts = {str(name): chain.counts.get(name, 0.0) + float(n) for name, n in header["counts"].items()}
            seconds = chain.seconds + float(header["seconds"])
        except (KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(f"it is no chunk of draws: {type(error).__name__}") from None
        chain.points += points
        chain.stats += stats
        chain.lists, chain.state, chain.seconds = lists, state, seconds
        chain.counts.update(counts)
        self.count += 1
        self.last = digest


def _own(array: Any) -> NDArray[Any]:
    """Return a copy that can be written to, or raise `ValueError` for what is no array."""
    if not isinstance(array, np.ndarray):
        raise ValueError("it holds something else than numbers")
    return array.copy()


def _draws_of(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> tuple[list[Point], list[Any]]:
    """Return points and statistics draw by draw; raise where the arrays do not hold as many as the header says."""
    draws, names, parts = header["draws"], header["names"], header["stats"]
    values = {str(name): arrays[f"point_{i}"] for i, name in enumerate(names)}
    columns = [{str(name): arrays[f"stat_{i}_{j}"] for j, name in enumerate(part)} for i, part in enumerate(parts)]
    every = [*values.values(), *(column for part in columns for column in part.values())]
    if not values or any(array.ndim < 1 or len(array) != draws for array in every):
        raise ValueError("it holds another number of draws than it says")
    points = [{name: array[k, ...] for name, array in values.items()} for k in range(draws)]
    return points, [[{name: array[k] for name, array in part.items()} for part in columns] for k in range(draws)]
