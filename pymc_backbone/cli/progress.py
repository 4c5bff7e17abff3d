"""How far a long run is: a bar where there is a terminal, a line now and then elsewhere; on standard error."""

from __future__ import annotations

import shutil
import sys
import time
from typing import TextIO

LINE_EVERY = 15.0  # seconds between lines of one stage where there is no terminal
DRAW_EVERY = 0.1  # seconds between two drawings of the bar
WIDTH = 24
ESTIMATE_AFTER = 2.0  # seconds of a stage before the time left is estimated


class ProgressBar:
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
    The time left is that of the stage, from the share of it that is done; it is shown once the stage has taken 2 s.
    """

    def __init__(self, stream: TextIO | None = None, *, is_shown: bool = True, delay: float = 0.0) -> None:
        self.is_shown, self.delay = is_shown, delay
        self.stream = sys.stderr if stream is None else stream
        self.is_terminal = self.stream.isatty()
        self.begin = time.monotonic()
        self.last = -LINE_EVERY
        self.stage = ""
        self.stage_begin = 0.0
        self.is_drawn = False

    def __call__(self, stage: str, fraction: float) -> None:
        """Show the stage and how far it is."""
        now = time.monotonic() - self.begin
        if not self.is_shown or now < self.delay:
            return
        share = min(max(float(fraction), 0.0), 1.0) if fraction == fraction else 0.0
        if stage == self.stage and now - self.last < (DRAW_EVERY if self.is_terminal else LINE_EVERY):
            return
        if stage != self.stage:
            self.stage_begin = now
        self.stage, self.last = stage, now
        left = self._left(share, now)
        if self.is_terminal:
            self._draw(stage + left, share, now)
        else:
            self._write(f"{share:4.0%}  {stage}  ({_clock(now)}{left})\n")

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def clear(self) -> None:
        """Take the bar off the terminal, so that something else can be printed."""
        if self.is_drawn:
            self._write("\r\x1b[K")
            self.is_drawn = False

    def _draw(self, stage: str, share: float, now: float) -> None:
        filled = round(WIDTH * share)
        text = f"[{'#' * filled}{'.' * (WIDTH - filled)}] {share:4.0%}  {_clock(now)}  {stage}"
        self._write(f"\r\x1b[K{text[: max(20, shutil.get_terminal_size().columns - 1)]}")
        self.is_drawn = True

    def _left(self, share: float, now: float) -> str:
        """Return how long the stage will still take, as words; empty where that cannot be said yet."""
        spent = now - self.stage_begin
        if spent < ESTIMATE_AFTER or not 0.02 < share < 1.0:
            return ""
        return f", about {_clock(spent * (1.0 - share) / share + 0.5)} left"

    def _write(self, text: str) -> None:
        self.stream.write(text)
        self.stream.flush()


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
