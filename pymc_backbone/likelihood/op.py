"""PyTensor Ops: the log-likelihood of a simulated backbone, and the simulated backbone itself.

Both have two outputs, the value and its derivative with respect to the parameters, so that a gradient reuses the
simulation that gave the value. Where nobody asks for the derivative, a rewrite puts the variant without it, which
costs less. The derivative has a derivative in turn: an Op of its own for each, by differences of the exact first
derivatives, so that Hessians are right, and a third derivative is refused. All are pure: what they return depends on
their inputs alone, and nothing is written in place.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import DisconnectedType, disconnected_type
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.op import Op
from pytensor.graph.rewriting.basic import node_rewriter
from pytensor.link.numba.dispatch.basic import register_funcify_and_cache_key
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.rewriting.basic import register_specialize

from .._common.checks import FloatArray, IntArray
from .._common.late_imports import after_import
from ..simulation.memory import Description
from ..simulation.response import OscillatorResponse, Response, simulator_of
from . import native
from .curvature import BackboneCurvature, Compiled, LogLikelihoodCurvature, Shape, run_in_python
from .density_kernel import log_density
from .jax_bridge import JAX_DISPATCH, register


class _SimulatingOp(Op):
    """What both Ops share: the response, whether the derivative is computed, equality by both."""

    __props__ = ("response", "with_gradient")

    def __init__(self, response: Response, with_gradient: bool | None = None) -> None:
        self.response = response
        self.with_gradient = response.has_gradient if with_gradient is None else with_gradient
        if isinstance(response, OscillatorResponse):
            native.define_symbols()

    def __setstate__(self, state: dict[str, Any]) -> None:
        # A fresh process has to know the native functions before it loads compiled code that calls them.
        self.__dict__.update(state)
        if isinstance(self.response, OscillatorResponse):
            native.define_symbols()

    def require_gradient(self) -> None:
        """Raise where what is simulated is a function without a gradient."""
        if not self.response.has_gradient:
            raise NotImplementedError(
                "a backbone function has no gradient: sample with a step that needs none, for example pm.Metropolis()."
            )

    @property
    def value_shape(self) -> tuple[int, ...]:
        """Shape of the first output."""
        return len(self.response.observables), len(self.response.levels)

    def without_gradient(self) -> _SimulatingOp:
        """Return the variant that computes the value only."""
        return type(self)(self.response, with_gradient=False)


class BackboneLogLikelihood(_SimulatingOp):
    """Log density of a simulated backbone.

    Inputs are the parameter vector ``theta`` (p,) and the plain data of a density (``codes``, ``table``; see
    `Density`). Outputs are the log density, -inf where a level cannot be simulated or lies outside the density's
    support, never NaN, and its gradient (p,), zero there.

    Parameters
    ----------
    response : OscillatorResponse or CallableResponse
        What is simulated.
    with_gradient : bool, optional
        Whether the second output is computed; default: whether the response can.

    See Also
    --------
    backbone_likelihood : adds it to a PyMC model.
    BackboneOp : the simulation alone.
    """

    gufunc_signature = "(p),(c),(t)->(),(g)"
    value_shape = ()

    def make_node(self, theta: Any, codes: Any, table: Any, memory: Any = None) -> Apply:
        """Check the inputs and make the node; ``memory`` is no longer used."""
        if memory is not None:
            warnings.warn(
                "BackboneLogLikelihood takes no `memory` any more; leave it out. `sample` remembers what it asked for.",
                FutureWarning,
                stacklevel=3,
            )
        inputs = [
            pt.as_tensor_variable(theta, dtype="float64"),
            pt.cast(pt.as_tensor_variable(codes), "int64"),  # data of a model are of 32 bits
            pt.as_tensor_variable(table, dtype="float64"),
        ]
        for name, variable in zip(("theta", "codes", "table"), inputs, strict=True):
            if variable.ndim != 1:
                raise TypeError(f"`{name}` must be a vector, got {variable.ndim} dimensions.")
        return Apply(self, inputs, [pt.dscalar(), pt.dvector()])

    def infer_shape(self, node: Apply, input_shapes: list[Shape]) -> list[Shape]:
        """Return the shapes of value and gradient."""
        return [(), (input_shapes[0][0] if self.with_gradient else 0,)]

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[FloatArray]]) -> None:
        """Evaluate in Python: the reference for the compiled path, and the path of functions."""
        theta, codes, table = inputs
        values, jacobian, completed = self.response.evaluate(
            np.ascontiguousarray(theta, dtype=np.float64), self.with_gradient
        )
        value = -np.inf
        gradient = np.zeros(theta.size if self.with_gradient else 0)
        if completed:
            slope = np.empty(values.size)
            value = log_density(codes, table, np.ascontiguousarray(values).ravel(), slope)
            if self.with_gradient:
                total = np.tensordot(slope.reshape(values.shape), jacobian, axes=2)
                gradient[:] = np.where(np.isfinite(total), total, 0.0)
        output_storage[0][0] = np.asarray(value)
        output_storage[1][0] = gradient

    def connection_pattern(self, node: Apply) -> list[list[bool]]:
        """Only the parameters carry a derivative."""
        return [[True, True], [False, False], [False, False]]

    def pullback(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], cotangents: Sequence[Variable]
    ) -> list[Variable]:
        """Return the cotangent of the parameters: the node's own second output, times that of the value.

        That of the gradient, where a second derivative is asked for, goes through the matrix of second derivatives.
        """
        self.require_gradient()
        total: Variable | float = 0.0
        if not _is_disconnected(cotangents[0]):
            gradient = outputs[1] if self.with_gradient else BackboneLogLikelihood(self.response)(*inputs)[1]
            total = cotangents[0] * gradient
        if not _is_disconnected(cotangents[1]):
            total = total + pt.dot(LogLikelihoodCurvature(self.response)(*inputs), cotangents[1])
        return [total, disconnected_type(), disconnected_type()]


class BackboneOp(_SimulatingOp):
    """The simulated backbone: parameters (p,) in, values (o, l) and their derivatives (o, l, p) out.

    Values are NaN where a level cannot be simulated, the derivatives zero there.

    Parameters
    ----------
    response : OscillatorResponse or CallableResponse
        What is simulated.
    with_gradient : bool, optional
        Whether the second output is computed; default: whether the response can.

    See Also
    --------
    backbone_deterministic : calls it with named parameters.
    BackboneLogLikelihood : the simulation under a density.
    """

    gufunc_signature = "(p)->(o,l),(u,w,q)"

    def make_node(self, theta: Any) -> Apply:
        """Check the input and make the node."""
        theta = pt.as_tensor_variable(theta, dtype="float64")
        if theta.ndim != 1:
            raise TypeError(f"`theta` must be a vector, got {theta.ndim} dimensions.")
        values = pt.tensor("backbone", shape=self.value_shape, dtype="float64")
        return Apply(self, [theta], [values, pt.dtensor3()])

    def infer_shape(self, node: Apply, input_shapes: list[Shape]) -> list[Shape]:
        """Return the shapes of values and derivatives."""
        return [self.value_shape, (*self.value_shape, input_shapes[0][0]) if self.with_gradient else (0, 0, 0)]

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[FloatArray]]) -> None:
        """Evaluate in Python."""
        theta = np.ascontiguousarray(inputs[0], dtype=np.float64)
        values, jacobian, _ = self.response.evaluate(theta, self.with_gradient)
        output_storage[0][0] = values
        output_storage[1][0] = np.nan_to_num(jacobian, nan=0.0, posinf=0.0, neginf=0.0)

    def connection_pattern(self, node: Apply) -> list[list[bool]]:
        """Values and derivatives depend on the parameters."""
        return [[True, True]]

    def pullback(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], cotangents: Sequence[Variable]
    ) -> list[Variable]:
        """Return the cotangent of the parameters through the node's own second output.

        That of the derivatives, where a second derivative is asked for, goes through the second derivatives.
        """
        self.require_gradient()
        total: Variable | float = 0.0
        if not _is_disconnected(cotangents[0]):
            jacobian = outputs[1] if self.with_gradient else BackboneOp(self.response)(*inputs)[1]
            total = pt.tensordot(cotangents[0], jacobian, axes=[[0, 1], [0, 1]])
        if not _is_disconnected(cotangents[1]):
            curvature = BackboneCurvature(self.response)(*inputs)
            total = total + pt.tensordot(cotangents[1], curvature, axes=[[0, 1, 2], [0, 1, 2]])
        return [total]


def _is_disconnected(cotangent: Variable) -> bool:
    return isinstance(cotangent.type, DisconnectedType)


@register_specialize
@node_rewriter([BackboneLogLikelihood, BackboneOp, Blockwise])
def drop_unused_gradient(fgraph: FunctionGraph, node: Apply) -> dict[Variable, Variable] | None:
    """Replace an Op by its variant without gradient where nobody uses the gradient.

    Registered late (specialize): PyMC canonicalizes a log-density before it differentiates it, and must still find
    the gradient there.
    """
    core = node.op.core_op if isinstance(node.op, Blockwise) else node.op
    if not isinstance(core, _SimulatingOp) or not core.with_gradient or fgraph.clients[node.outputs[1]]:
        return None
    plain = core.without_gradient()
    operator = Blockwise(plain, signature=node.op.signature) if isinstance(node.op, Blockwise) else plain
    return {node.outputs[0]: operator(*node.inputs, return_list=True)[0]}


@register_funcify_and_cache_key(BackboneLogLikelihood)
def _funcify_log_likelihood(op: BackboneLogLikelihood, node: Apply, **kwargs: Any) -> tuple[Compiled, str | None]:
    if not isinstance(op.response, OscillatorResponse):
        return run_in_python(op, node), None
    response = op.response
    integers, numbers = describe(response)
    call, wanted = native.call_log_likelihood, int(op.with_gradient)

    @numba.njit
    def log_likelihood(theta: FloatArray, codes: IntArray, table: FloatArray) -> tuple[FloatArray, FloatArray]:
        point = np.ascontiguousarray(theta)
        density_codes = np.ascontiguousarray(codes)
        density = np.ascontiguousarray(table)
        gradient = np.zeros(point.size * wanted)
        value = call(
            integers.ctypes, numbers.ctypes, point.ctypes, density_codes.ctypes, codes.size,
            density.ctypes, density.size, gradient.ctypes, wanted,
        )  # fmt: skip
        return np.asarray(value), gradient

    return log_likelihood, _cache_key("log_likelihood-4", op)


@register_funcify_and_cache_key(BackboneOp)
def _funcify_backbone(op: BackboneOp, node: Apply, **kwargs: Any) -> tuple[Compiled, str | None]:
    if not isinstance(op.response, OscillatorResponse):
        return run_in_python(op, node), None
    response = op.response
    integers, numbers = describe(response)
    call, wanted = native.call_backbone, int(op.with_gradient)
    rows, levels = np.array(response.rows), len(response.levels)

    @numba.njit
    def backbone(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        point = np.ascontiguousarray(theta)
        n = point.size
        values = np.empty((3, levels))
        jacobian = np.empty((3 * wanted, levels * wanted, n * wanted))
        status = np.zeros(levels, np.int64)
        call(
            integers.ctypes, numbers.ctypes, point.ctypes, values.ctypes, jacobian.ctypes, status.ctypes, wanted
        )  # fmt: skip
        chosen = np.empty((rows.size, levels))
        slopes = np.zeros((rows.size * wanted, levels * wanted, n * wanted))
        for i in range(rows.size):
            for k in range(levels):
                chosen[i, k] = values[rows[i], k]
                if wanted and status[k] == 0:
                    for j in range(n):
                        slopes[i, k, j] = jacobian[rows[i], k, j]
        return chosen, slopes

    return backbone, _cache_key("backbone-3", op)


def describe(response: OscillatorResponse) -> Description:
    """Return what the native functions simulate for ``response``."""
    return simulator_of(response.oscillator).describe(
        np.array(response.levels), response.release_amplitude, response.virgin, rows=response.rows
    )


def _cache_key(version: str, op: _SimulatingOp) -> str | None:
    """Return the key under which compiled code is kept; None where it holds the address of a user's force."""
    assert isinstance(op.response, OscillatorResponse)
    if simulator_of(op.response.oscillator).user:
        return None
    return f"pymc_backbone-{version}-{op.with_gradient}-{op.response.key}"


after_import(JAX_DISPATCH, lambda: register(BackboneLogLikelihood, BackboneOp))
