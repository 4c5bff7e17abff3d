"""Draws kept as they come: a PyMC step that writes what it does, and first repeats what is written already."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from pymc.exceptions import SamplingError

from ..._common.checks import InputError
from ..._common.text import printable, shorten
from .draw_chunks import ChunkFolder, Point, StoredChain
from .step_state import History, encode_state, restore_state

CHUNK_DRAWS = 100
LONGEST_WAIT = 10.0  # seconds after which a chunk is written however few draws there are
SHORTEST_WAIT = 1.0  # seconds between chunks of a fast sampler, whose 100 draws are there in no time
logger = logging.getLogger("pymc_backbone")


class Recorder:
    """Stands in for the methods ``step`` and ``setup_chain`` of a PyMC step.

    The first draws of a chain are those of the store; with the last of them the step takes over the state that was
    stored with it, and goes on as if it had drawn them itself. So `pymc.sample` runs as always: progress bar, results
    and the end of the tuning are its own.

    Parameters
    ----------
    step : BlockedStep or CompoundStep
        A PyMC step method; its two methods are replaced on the object.
    folders : sequence of ChunkFolder
        One for each chain.
    stored : sequence of StoredChain
        What they hold.
    count : callable
        Returns what the likelihoods counted so far, by name.
    """

    def __init__(
        self,
        step: Any,
        folders: Sequence[ChunkFolder],
        stored: Sequence[StoredChain],
        count: Callable[[], Mapping[str, float]],
    ) -> None:
        self.target, self.folders, self.stored, self.count = step, folders, stored, count
        self._inner_step, self._inner_setup = step.step, step.setup_chain
        step.step, step.setup_chain = self.step, self.setup_chain
        self.chain = -1
        self.is_stopping = False
        self.kept = sum(len(chain.points) for chain in stored)

    def setup_chain(self, rng: Any, tune: int, draws: int) -> None:
        """Begin the next chain; PyMC draws them one after another."""
        self._inner_setup(rng, tune, draws)
        self.chain += 1
        self.length = tune + draws
        self.done = 0
        self.history = History()
        self._points: list[Point] = []
        self._stats: list[Any] = []
        self._mark()

    def step(self, point: Point) -> tuple[Point, Any]:
        """Return the next draw and its statistics: from the store while it lasts, then from the step."""
        stored = self.stored[self.chain]
        if self.done < len(stored.points):
            self.done += 1
            if self.done == len(stored.points):
                self._take_over(stored)
            return stored.points[self.done - 1], stored.stats[self.done - 1]
        if self.is_stopping:
            self._write()
            raise KeyboardInterrupt
        # An exception out of here leaves the step in the middle of a draw: nothing after the last chunk is written.
        drawn, stats = self._go_on(point) if self.done == len(stored.points) > 0 else self._inner_step(point)
        self.done += 1
        self._points.append(drawn)
        self._stats.append(stats)
        elapsed = time.monotonic() - self._since
        is_due = len(self._points) >= CHUNK_DRAWS and elapsed >= SHORTEST_WAIT
        if is_due or elapsed >= LONGEST_WAIT or self.done == self.length:
            self._write()
        return drawn, stats

    def _go_on(self, point: Point) -> tuple[Point, Any]:
        """Draw for the first time from a state that was stored; a state may look right and be none."""
        try:
            drawn, stats = self._inner_step(point)
        except InputError:
            raise
        except (ValueError, TypeError, IndexError, ArithmeticError, SamplingError) as error:
            raise InputError(self._refusal(error)) from None
        return drawn, stats

    def _refusal(self, error: Exception) -> str:
        words = shorten(printable(" ".join(str(error).split())), 80) or type(error).__name__
        return (
            f"The store {self.folders[self.chain].folder} holds the state of another step method ({words}); "
            "resume with the versions it was made with, or name another folder."
        )

    def _take_over(self, stored: StoredChain) -> None:
        assert stored.state is not None
        try:
            self.history = restore_state(self.target, stored.state, stored.lists)
        except (
            ValueError,
            LookupError,
            TypeError,
            AttributeError,
            AssertionError,
            ArithmeticError,
            RecursionError,
        ) as error:
            raise InputError(self._refusal(error)) from None
        self._mark()

    def _write(self) -> None:
        if not self._points:
            return
        state, self.history = encode_state(self.target, self.history, len(self._points))
        counts = {name: count - self._counted[name] for name, count in self.count().items()}
        seconds = time.monotonic() - self._since
        self.folders[self.chain].append(self._points, self._stats, state, counts, seconds)
        self.kept += len(self._points)
        self._points, self._stats = [], []
        self._mark()

    def _mark(self) -> None:
        self._since = time.monotonic()
        self._counted = self.count()

    @contextmanager
    def ending_early(self) -> Iterator[None]:
        """Let the first Ctrl-C end the run after the draw it comes in; a second one does what it did before."""
        if threading.current_thread() is not threading.main_thread():  # signals do not come here
            yield
            return

        def stop(number: int, frame: Any) -> None:
            signal.signal(signal.SIGINT, previous)
            self.is_stopping = True
            logger.info("Stopping after this draw; Ctrl-C again stops at once.")

        previous = signal.signal(signal.SIGINT, stop)
        try:
            yield
        except ValueError as error:
            # PyMC makes no result of chains that were stopped before the end of their tuning.
            if not self.is_stopping or isinstance(error, InputError):
                raise
            logger.info("Stopped before the first draw after tuning; the store keeps what was tuned, for resume.")
            raise KeyboardInterrupt from None
        finally:
            signal.signal(signal.SIGINT, previous)
