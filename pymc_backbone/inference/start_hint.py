"""Where chains of a model may start, said in its graph: whoever copies the model copies the hint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import pymc as pm
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.op import Op
from pytensor.graph.rewriting.basic import node_rewriter
from pytensor.tensor.rewriting.basic import register_canonicalize
from pytensor.tensor.type import TensorType

from .._common.checks import FloatArray
from ..likelihood.curvature import Shape
from .targets import nodes_of


@dataclass(frozen=True)
class StartHint:
    """Where chains may start: plain data, hashable, picklable.

    Parameters
    ----------
    names : tuple of str
        Of the variables that the model may have.
    shapes : tuple of tuple of int
        Of their unconstrained values.
    centres : tuple of tuple of float
        These values in C order.
    spreads : tuple of float
        Standard deviation of starts about them, on the unconstrained scale.
    unidentified : tuple of str
        Parameters of which the data say nothing.
    """

    names: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]
    centres: tuple[tuple[float, ...], ...]
    spreads: tuple[float, ...]
    unidentified: tuple[str, ...]

    @classmethod
    def of(cls, centres: Mapping[str, tuple[FloatArray, float]], unidentified: tuple[str, ...]) -> Self:
        """Return the hint with these centres and spreads, by variable."""
        middles = [middle for middle, _ in centres.values()]
        return cls(
            tuple(centres),
            tuple(middle.shape for middle in middles),
            tuple(tuple(middle.ravel().tolist()) for middle in middles),
            tuple(spread for _, spread in centres.values()),
            unidentified,
        )

    def draw(self, variables: Mapping[str, str], rng: np.random.Generator) -> dict[str, FloatArray]:
        """Return a start by the names of the unconstrained values, which ``variables`` gives for each variable."""
        known = dict(zip(self.names, zip(self.centres, self.shapes, self.spreads, strict=True), strict=True))
        start = {}
        for name, value_name in variables.items():
            middle, shape, spread = known[name]
            start[value_name] = np.reshape(middle, shape) + spread * rng.standard_normal(shape)
        return start


class HintOp(Op):
    """Passes its input on, and holds a `StartHint` for whoever reads the graph.

    Parameters
    ----------
    hint : StartHint
        What it holds.
    """

    __props__ = ("hint",)
    view_map: ClassVar[dict[int, list[int]]] = {0: [0]}

    def __init__(self, hint: StartHint) -> None:
        self.hint = hint

    def make_node(self, value: Variable) -> Apply:
        """Make the node; the output has the type of the input."""
        return Apply(self, [value], [value.type()])

    def infer_shape(self, node: Apply, input_shapes: list[Shape]) -> list[Shape]:
        """Return the shape of the input."""
        return input_shapes

    def perform(self, node: Apply, inputs: Sequence[FloatArray], output_storage: list[list[FloatArray]]) -> None:
        """Pass the input on."""
        output_storage[0][0] = inputs[0]

    def pullback(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], cotangents: Sequence[Variable]
    ) -> list[Variable]:
        """Pass the cotangent on."""
        return list(cotangents)


@register_canonicalize
@node_rewriter([HintOp])
def drop_hint(fgraph: FunctionGraph, node: Apply) -> list[Variable]:
    """Compute without the hint."""
    return list(node.inputs)


def give_hint(value: Variable, hint: StartHint) -> Variable:
    """Return ``value`` with a hint in its graph."""
    assert isinstance(value.type, TensorType)
    result: Variable = HintOp(hint)(value)
    return result


def start_hint_of(model: pm.Model) -> StartHint | None:
    """Return the hint that ``model`` holds, or None."""
    return next((node.op.hint for node in nodes_of(model.potentials) if isinstance(node.op, HintOp)), None)
