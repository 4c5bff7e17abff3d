"""Formulas as drawings inside the page, set by matplotlib: no script from the network, no LaTeX and no font needed.

MathML would be shorter, but needs a mathematical font on the reader's machine: without one Chromium loses the dots
above a letter and does not stretch brackets.
"""

from __future__ import annotations

import html
import re

from docutils import nodes
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser
from matplotlib.path import Path
from matplotlib.textpath import TextPath
from sphinx.application import Sphinx
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)
SIZE = 100.0  # units of an em
FONT = FontProperties(family="STIXGeneral", math_fontfamily="stix", size=SIZE)
_OTHER_NAMES = {
    r"\tfrac": r"\frac",
    r"\le": r"\leq",
    r"\ge": r"\geq",
    r"\ne": r"\neq",
    r"\lvert": "|",
    r"\rvert": "|",
}
_LETTERS = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C", Path.CLOSEPOLY: "Z"}


def drawing(formula: str, *, large: bool = False) -> str:
    """Return a formula as an SVG element that stands on the line of the text and has its colour; fractions ``large``.

    Raises
    ------
    ValueError
        When the formula holds something that matplotlib does not know.
    """
    text = formula.replace(r"\frac", r"\dfrac") if large else formula
    text = re.sub(r"([A-Za-z0-9}]) \\(max|min|ln|sin|operatorname)\b", r"\1\\,\\\2", text)
    for name, other in _OTHER_NAMES.items():
        text = re.sub(re.escape(name) + r"(?![a-z])", lambda _, other=other: other, text)
    text = "$" + (r"{}" if text.startswith(("^", "_")) else "") + " ".join(text.split()) + "$"
    width, height, depth, *_ = MathTextParser("path").parse(text, 72, FONT)
    margin = 0.06 * SIZE
    parts = []
    for vertices, code in TextPath((0.0, 0.0), text, prop=FONT).iter_segments():
        points = " ".join(f"{value:.1f}" for x, y in vertices.reshape(-1, 2) for value in (x, -y))
        parts.append("Z" if code == Path.CLOSEPOLY else _LETTERS[code] + points)
    box = (-margin, -height - margin, width + 2.0 * margin, height + depth + 2.0 * margin)
    return (
        f'<svg class="formula" role="img" aria-label="{html.escape(formula)}" '
        f'viewBox="{" ".join(f"{value:.1f}" for value in box)}" style="width:{box[2] / SIZE:.3f}em;'
        f'height:{box[3] / SIZE:.3f}em;vertical-align:{-(depth + margin) / SIZE:.3f}em">'
        f'<path fill="currentColor" d="{"".join(parts)}"/></svg>'
    )


def _convert(node: nodes.Element, *, large: bool = False) -> str:
    try:
        return drawing(node.astext().strip(), large=large)
    except ValueError as error:
        reason = str(error).strip().splitlines()[-1]
        LOGGER.warning("formula not understood: %s (%s)", node.astext(), reason, location=node)
        return f"<code>{html.escape(node.astext())}</code>"


def visit_inline(translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(_convert(node))
    raise nodes.SkipNode


def visit_block(translator, node: nodes.math_block) -> None:
    """Write a formula on its own line, which scrolls by itself where it is wider than the page."""
    translator.body.append(f'<div class="formula">{_convert(node, large=True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("offline", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
