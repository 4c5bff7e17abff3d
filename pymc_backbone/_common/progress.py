"""How far a long run is, told so often that nobody takes it for dead, with a time left only where one can be known."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LINE_EVERY = 8.0
"""Seconds between lines of one stage, of which no two are to be more than ten apart."""
FIRST_AFTER = 1.5
"""Seconds until the first line at the latest."""
TICK = 0.25
THREAD = "progress"
"""Name of the thread that looks after it."""
ESTIMATE_AFTER = 2.0  # seconds of a stage before the time left is estimated
_LEAST, _LATELY, _AGREE = 0.05, 0.25, 2.0


class Pace:
    """How fast one stage advances, from the shares of it that were done when.

    Examples
    --------
    >>> pace = Pace(0.0)
    >>> for second in range(1, 11):
    ...     pace.add(float(second), 0.05 * second)
    >>> round(pace.left(10.0), 6)
    10.0
    """

    def __init__(self, begin: float) -> None:
        self.begin = begin
        self.share = 0.0
        self.known = [(begin, 0.0)]

    def add(self, now: float, share: float) -> None:
        """Note a share that is done."""
        self.share = share
        if now - self.known[-1][0] >= 0.02 * (now - self.begin) or share >= 1.0:
            self.known.append((now, share))

    def left(self, now: float) -> float | None:
        """Return the seconds left; None where the stage is too young, or was not as fast lately as on the whole."""
        spent, share = now - self.begin, self.share
        if spent < ESTIMATE_AFTER or not _LEAST < share < 1.0:
            return None
        then, earlier = next(known for known in reversed(self.known) if known[0] <= now - _LATELY * spent)
        if not share > earlier:
            return None
        on_the_whole, lately = spent * (1.0 - share) / share, (now - then) * (1.0 - share) / (share - earlier)
        return lately if 1.0 / _AGREE < on_the_whole / lately < _AGREE else None


class Progress:
    """Called with the name of the stage and the fraction done, in [0, 1] or NaN; tells of it while its block lasts.

    Parameters
    ----------
    write : callable
        Takes a line without its end.
    stage : str, optional
        What is going on before anybody says so.
    clock : callable, optional
        Seconds, from any zero.

    Notes
    -----
    A line comes with each stage, then every `LINE_EVERY` seconds, whether anything is called or not: a thread looks
    after that.
    """

    def __init__(
        self, write: Callable[[str], None], *, stage: str = "", clock: Callable[[], float] | None = None
    ) -> None:
        self.write = write
        self.clock = clock or (lambda: time.monotonic())
        self.begin = self.clock()
        self.stage, self.share = stage, float("nan")
        self.pace = Pace(0.0)
        self.last: float | None = None
        self.lock = threading.RLock()
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def __call__(self, stage: str, fraction: float) -> None:
        """Note the stage and how far it is, and tell where it is time to."""
        with self.lock:
            now = self.now()
            is_new = stage != self.stage
            if is_new:
                self.stage, self.pace = stage, Pace(now)
            self.share = min(max(float(fraction), 0.0), 1.0) if fraction == fraction else float("nan")
            if self.share == self.share:
                self.pace.add(now, self.share)
            if is_new or self.is_due(now):
                self.tell(now)

    def __enter__(self) -> Progress:
        self._over.clear()
        self._thread = threading.Thread(target=self._run, name=THREAD, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def now(self) -> float:
        """Return the seconds since the beginning."""
        return self.clock() - self.begin

    def tick(self) -> None:
        """Tell again of what still goes on, where it is time to."""
        with self.lock:
            now = self.now()
            if self.stage and self.is_due(now):
                self.tell(now)

    def is_due(self, now: float) -> bool:
        """Return whether it is time for another line."""
        return now >= FIRST_AFTER if self.last is None else now - self.last >= LINE_EVERY

    def tell(self, now: float) -> None:
        """Write a line."""
        self.last = now
        share = "     " if self.share != self.share else f"{self.share:4.0%} "
        self.write(f"{share} {self.stage}  ({clock_of(now)}{self.left(now)})")

    def left(self, now: float) -> str:
        """Return how long the stage will still take, as words; empty where that cannot be said."""
        seconds = self.pace.left(now)
        return "" if seconds is None else f", about {clock_of(seconds + 0.5)} left"

    def _run(self) -> None:
        while not self._over.wait(TICK):
            self.tick()


def clock_of(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
