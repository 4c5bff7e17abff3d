"""Second derivatives of a simulated backbone and of its log-likelihood, by differences of the exact first ones.

They are for Hessians (`pymc.find_hessian`, Laplace's approximation), which ask seldom: nothing here is compiled.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.link.numba.dispatch.basic import generate_fallback_impl, register_funcify_and_cache_key

from .._common.checks import FloatArray
from ..simulation.response import Response
from .density_kernel import log_density

Shape = tuple[Variable | int, ...]
_STEP = 3e-4  # of what changes a value by all of itself: truncation and rounding both stay below 1e-6
_DENSITY_STEP = 1e-7  # of a value
_SMALLEST_VALUE = 1e-3  # an offset may be zero
Compiled = Callable[..., tuple[FloatArray, FloatArray]]


class _CurvatureOp(Op):
    """What both Ops of second derivatives share: they are the last ones."""

    __props__ = ("response",)

    def __init__(self, response: Response) -> None:
        self.response = response

    def connection_pattern(self, node: Apply) -> list[list[bool]]:
        """Whoever differentiates once more is told, and does not get a zero."""
        return [[index == 0] for index in range(len(node.inputs))]

    def pullback(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], cotangents: Sequence[Variable]
    ) -> list[Variable]:
        """Refuse: a third derivative would be a difference of differences."""
        raise NotImplementedError(
            "a simulated backbone has first and second derivatives, and no third; use what needs two at most."
        )


class BackboneCurvature(_CurvatureOp):
    """Second derivatives (o, l, p, p) of a simulated backbone; NaN where a level cannot be simulated.

    Parameters
    ----------
    response : OscillatorResponse
        What is simulated.

    See Also
    --------
    BackboneOp : values and first derivatives.
    """

    gufunc_signature = "(p)->(o,l,q,r)"

    def make_node(self, theta: Any) -> Apply:
        """Check the input and make the node."""
        theta = pt.as_tensor_variable(theta, dtype="float64")
        return Apply(self, [theta], [pt.tensor("curvature", shape=(None,) * 4, dtype="float64")])

    def infer_shape(self, node: Apply, input_shapes: list[Shape]) -> list[Shape]:
        """Return the shape."""
        p = input_shapes[0][0]
        return [(len(self.response.observables), len(self.response.levels), p, p)]

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[FloatArray]]) -> None:
        """Evaluate at two points for every parameter."""
        output_storage[0][0] = second_derivatives(self.response, np.ascontiguousarray(inputs[0], dtype=np.float64))


class LogLikelihoodCurvature(_CurvatureOp):
    """Second derivatives (p, p) of the log density of a simulated backbone; NaN where a level cannot be simulated.

    Parameters
    ----------
    response : OscillatorResponse
        What is simulated.

    See Also
    --------
    BackboneLogLikelihood : value and gradient.
    """

    gufunc_signature = "(p),(c),(t)->(q,r)"

    def make_node(self, theta: Any, codes: Any, table: Any) -> Apply:
        """Make the node."""
        theta, codes, table = (pt.as_tensor_variable(value) for value in (theta, codes, table))
        inputs = [theta, pt.cast(codes, "int64"), table]
        return Apply(self, inputs, [pt.dmatrix()])

    def infer_shape(self, node: Apply, input_shapes: list[Shape]) -> list[Shape]:
        """Return the shape."""
        return [(input_shapes[0][0], input_shapes[0][0])]

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[FloatArray]]) -> None:
        """Combine the second derivatives of the density and of the backbone."""
        theta, codes, table = inputs
        theta = np.ascontiguousarray(theta, dtype=np.float64)
        values, jacobian, completed = self.response.evaluate(theta, True)
        if not completed:
            output_storage[0][0] = np.full((theta.size, theta.size), np.nan)
            return
        y, first = np.ascontiguousarray(values).ravel(), jacobian.reshape(-1, theta.size)

        def slope(point: FloatArray) -> FloatArray:
            gradient = np.empty(point.size)
            log_density(codes, table, point, gradient)
            return gradient

        # The density's own gradient is exact, so that steps far below its width are no loss.
        steps = np.diag(_DENSITY_STEP * np.maximum(np.abs(y), _SMALLEST_VALUE))
        bend = np.array([(slope(y + h) - slope(y - h)) / (2.0 * h.sum()) for h in steps])
        second = second_derivatives(self.response, theta).reshape(y.size, theta.size, theta.size)
        curvature = first.T @ (0.5 * (bend + bend.T)) @ first + np.tensordot(slope(y), second, axes=1)
        output_storage[0][0] = curvature


def second_derivatives(response: Response, theta: FloatArray) -> FloatArray:
    """Return the second derivatives (o, l, p, p) by central differences of the exact first ones.

    The step is a small share of the change of a parameter that would move a value by all of itself: a length in the
    parameter's own unit that exists where the parameter is zero, too.
    """
    values, jacobian, _ = response.evaluate(theta, True)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.abs(values)[:, :, None] / np.abs(jacobian)
    reach = np.where(np.isfinite(reach) & (reach > 0.0), reach, np.inf).min(axis=(0, 1))
    # a parameter that moves nothing here: its own size has to do
    reach = np.where(np.isfinite(reach), reach, np.where(theta != 0.0, np.abs(theta), 1.0))
    curvature = np.empty((*jacobian.shape, theta.size))
    for j, step in enumerate(_STEP * reach):
        ahead, behind = theta.copy(), theta.copy()
        ahead[j] += step
        behind[j] -= step
        there, here = (response.evaluate(point, True) for point in (ahead, behind))
        is_whole = there[2] and here[2]
        curvature[..., j] = (there[1] - here[1]) / (ahead[j] - behind[j]) if is_whole else np.nan
    return 0.5 * (curvature + np.swapaxes(curvature, -1, -2))


def run_in_python(op: Op, node: Apply) -> Compiled:
    """Return numba's object-mode call of ``perform``: what a Python function needs, so no warning is due."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Numba will use object mode", category=UserWarning)
        return generate_fallback_impl(op, node)


@register_funcify_and_cache_key(BackboneCurvature)
@register_funcify_and_cache_key(LogLikelihoodCurvature)
def _funcify_curvature(op: _CurvatureOp, node: Apply, **kwargs: Any) -> tuple[Compiled, str | None]:
    return run_in_python(op, node), None
