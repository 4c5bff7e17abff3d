"""Text from files made safe and short for messages, and sorted as people sort it."""

from __future__ import annotations

import re


def printable(text: str) -> str:
    """Return text on one line with unprintable characters escaped."""
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def shorten(text: str, limit: int = 40) -> str:
    """Return text of at most ``limit`` characters for a message."""
    return text if len(text) <= limit else text[: limit - 3] + "..."


def natural_key(text: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that puts ``run_2`` before ``run_10``.

    Examples
    --------
    >>> sorted(["run_10", "run_2"], key=natural_key)
    ['run_2', 'run_10']
    """
    parts = re.split(r"([0-9]+)", text)
    key = [(0, int(part), "") if i % 2 and len(part) < 4000 else (1, 0, part.lower()) for i, part in enumerate(parts)]
    return (*key, (2, 0, text))
