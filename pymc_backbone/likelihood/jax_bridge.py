"""The Ops for JAX: a callback into the compiled simulation, with the derivative that the simulation gives.

So the samplers that run in JAX (numpyro, blackjax) sample backbone likelihoods. JAX compiles everything but the
simulation, and calls that as it is, one parameter vector at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pytensor.graph.basic import Apply

JAX_DISPATCH = "pytensor.link.jax.dispatch"


def register(*kinds: type) -> None:
    """Tell PyTensor how Ops of these kinds run in JAX.

    Parameters
    ----------
    *kinds : type
        Ops with two outputs, the value (...) and its derivative (..., p) by the first input (p,).
    """
    from pytensor.link.jax.dispatch.basic import jax_funcify

    for kind in kinds:
        jax_funcify.register(kind)(_convert)


def _convert(op: Any, node: Apply, **kwargs: Any) -> Callable[..., Any]:
    """Return a function of JAX arrays that does what ``op`` does."""
    import jax
    import jax.numpy as jnp

    plain = op.without_gradient()
    shape: tuple[int, ...] = op.value_shape

    def call(which: Any, *inputs: Any) -> Any:
        """Let the Op itself compute value and derivative."""

        def compute(*arrays: Any) -> tuple[Any, Any]:
            storage: list[list[Any]] = [[None], [None]]
            which.perform(None, [np.asarray(array) for array in arrays], storage)
            return np.asarray(storage[0][0], np.float64), np.asarray(storage[1][0], np.float64)

        slopes = (*shape, inputs[0].shape[-1]) if which.with_gradient else (0,) * (len(shape) + 1)
        results = tuple(jax.ShapeDtypeStruct(size, np.float64) for size in (shape, slopes))
        return jax.pure_callback(compute, results, *inputs, vmap_method="sequential")

    @jax.custom_vjp
    def value(*inputs: Any) -> Any:
        return call(plain, *inputs)[0]

    def forward(*inputs: Any) -> tuple[Any, Any]:
        op.require_gradient()
        result, slopes = call(type(op)(op.response), *inputs)
        return result, (slopes, len(inputs))

    def backward(kept: Any, cotangent: Any) -> tuple[Any, ...]:
        slopes, count = kept
        return jnp.tensordot(cotangent, slopes, axes=len(shape)), *(None,) * (count - 1)

    value.defvjp(forward, backward)

    def both(*inputs: Any) -> tuple[Any, Any]:
        slopes = call(op, *inputs)[1] if op.with_gradient else jnp.zeros((0,) * (len(shape) + 1))
        return value(*inputs), slopes

    return both
