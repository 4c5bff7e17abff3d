"""Formulas as MathML, which every current browser draws by itself: no script from the network, no LaTeX installed."""

from __future__ import annotations

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)


def _convert(text: str, node: nodes.Element, *, as_block: bool) -> str:
    if text.startswith(("^", "_")):
        text = "{}" + text  # a power of something outside the formula, as in m$^3$
    try:
        return tex2mathml(text, as_block=as_block)
    except (MathError, IndexError) as error:
        LOGGER.warning("formula not understood: %s (%s)", text, error, location=node)
        return f"<code>{text}</code>"


def visit_inline(translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(_convert(node.astext(), node, as_block=False))
    raise nodes.SkipNode


def visit_block(translator, node: nodes.math_block) -> None:
    """Write a formula on its own line, which scrolls by itself where it is wider than the page."""
    translator.body.append(f'<div class="formula">{_convert(node.astext(), node, as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("offline", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
