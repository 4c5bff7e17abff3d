"""Figures as PNG: drawn once, for the report and for the file beside it."""

from __future__ import annotations

import io
from weakref import WeakKeyDictionary

from matplotlib.figure import Figure

DPI = 170
_drawn: WeakKeyDictionary[Figure, bytes] = WeakKeyDictionary()


def png(figure: Figure) -> bytes:
    """Return a finished figure as PNG; the layout of its text takes longest, so it is drawn the first time only."""
    if figure not in _drawn:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=DPI)
        _drawn[figure] = buffer.getvalue()
    return _drawn[figure]


__all__ = ["png"]
