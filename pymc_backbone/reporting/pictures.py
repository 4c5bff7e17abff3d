"""Figures as PNG: drawn once, for the report and for the file beside it."""

from __future__ import annotations

import io
from collections.abc import Iterable
from functools import partial
from weakref import WeakKeyDictionary

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .._common.forked import in_two_processes

DPI = 170
_COMPRESSION = 3  # a tenth larger than with 6, in two thirds of the time
_drawn: WeakKeyDictionary[Figure, bytes] = WeakKeyDictionary()


def png(figure: Figure) -> bytes:
    """Return a finished figure as PNG; the layout of its text takes longest, so it is drawn the first time only."""
    if figure not in _drawn:
        _drawn[figure] = _at_once(figure)
    return _drawn[figure]


def draw_all(figures: Iterable[Figure]) -> None:
    """Draw finished figures, on two cores where that is safe: `png` has them then."""
    waiting = [figure for figure in figures if figure not in _drawn]
    _drawn.update(zip(waiting, in_two_processes([partial(_at_once, figure) for figure in waiting]), strict=True))


def _at_once(figure: Figure) -> bytes:
    """Return what ``figure.savefig`` writes, which goes through all of a figure twice: for its layout, and to draw."""
    buffer, canvas, dpi = io.BytesIO(), figure.canvas, figure.dpi
    try:
        figure.dpi = DPI
        FigureCanvasAgg(figure).print_png(buffer, pil_kwargs={"compress_level": _COMPRESSION})  # type: ignore[no-untyped-call]
    finally:
        figure.dpi = dpi
        figure.set_canvas(canvas)
    return buffer.getvalue()


__all__ = ["draw_all", "png"]
