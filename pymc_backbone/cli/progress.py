"""How far a long run is: a bar where there is a terminal, a line now and then elsewhere; on standard error."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from typing import TextIO

from .._common.progress import LINE_EVERY, Progress, clock_of

__all__ = ["LINE_EVERY", "ProgressBar"]

DRAW_EVERY = 0.1  # seconds between two drawings of the bar, ...
REDRAW_EVERY = 1.0  # ... and those without news, for the clock
WIDTH = 24
STARTING = "starting"


class ProgressBar(Progress):
    """Called with the name of the stage and the fraction done, in [0, 1]; use it in a ``with`` block.

    Parameters
    ----------
    stream : text stream, optional
        Default: standard error.
    is_shown : bool, optional
        Whether anything is shown at all.
    delay : float, optional
        Seconds before anything is shown, for what is mostly over by then.

    Notes
    -----
    The time left is that of the stage, from the share of it that is done; it is shown once the stage has taken 2 s, and
    where it was as fast lately as on the whole. Something comes within two seconds, and then every ten.
    """

    def __init__(self, stream: TextIO | None = None, *, is_shown: bool = True, delay: float = 0.0) -> None:
        super().__init__(lambda line: self._write(f"{line}\n"), stage=STARTING)
        self.is_shown, self.delay = is_shown, delay
        self.stream = sys.stderr if stream is None else stream
        self.is_terminal = self.stream.isatty()
        self.is_drawn = False
        self._drawn: tuple[str, float] = ("", -1.0)

    def __enter__(self) -> ProgressBar:
        if self.is_shown:
            super().__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self.clear()

    def __call__(self, stage: str, fraction: float) -> None:
        """Show the stage and how far it is."""
        if self.is_shown:
            super().__call__(stage, fraction)

    def is_due(self, now: float) -> bool:
        """Return whether it is time to show it again."""
        if now < self.delay:
            return False
        if not self.is_terminal:
            return super().is_due(now)
        every = DRAW_EVERY if self._drawn != (self.stage, self.share) else REDRAW_EVERY
        return now >= every if self.last is None else now - self.last >= every

    def tell(self, now: float) -> None:
        """Draw the bar, or write a line."""
        if now < self.delay:
            return
        if not self.is_terminal:
            super().tell(now)
            return
        self.last, self._drawn = now, (self.stage, self.share)
        is_known = self.share == self.share
        filled = round(WIDTH * self.share) if is_known else 0
        share = f"{self.share:4.0%}" if is_known else "    "
        bar = f"[{'#' * filled}{'.' * (WIDTH - filled)}] {share}  {clock_of(now)}  {self.stage}{self.left(now)}"
        self._write(f"\r\x1b[K{bar[: max(20, shutil.get_terminal_size().columns - 1)]}")
        self.is_drawn = True

    def clear(self) -> None:
        """Take the bar off the terminal, so that something else can be printed."""
        with self.lock:
            if self.is_drawn:
                self._write("\r\x1b[K")
                self.is_drawn = False

    def below(self, say: Callable[[str], None]) -> Callable[[str], None]:
        """Return what prints a line below the bar, which does not come back in between."""

        def say_below(text: str) -> None:
            with self.lock:
                self.clear()
                say(text)

        return say_below

    def _write(self, text: str) -> None:
        self.stream.write(text)
        self.stream.flush()
