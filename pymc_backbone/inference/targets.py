"""The backbone likelihoods of a model, read from its graph.

The Ops in the graph hold what is simulated, their neighbours hold the data. So a copy of a model has them as the model
has: `pymc.do`, `pymc.observe`, a clone, a deep copy, a pickle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pymc as pm
from numpy.typing import NDArray
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.graph.traversal import applys_between
from pytensor.scalar.basic import Cast
from pytensor.tensor import TensorVariable as Tensor

from .._common.checks import FloatArray
from ..likelihood.density import KINDS, Density
from ..likelihood.op import BackboneLogLikelihood, BackboneOp
from ..simulation.response import OscillatorResponse, Response


@dataclass(frozen=True, eq=False)
class Target:
    """What one likelihood compares: parameters in, a backbone out, and the values it should have.

    ``centre`` and ``spread`` (n, o, l) are the measured values and their standard errors per specimen, or mean and
    standard deviation of the population (n = 1); NaN where there is none.
    """

    name: str
    response: Response
    theta: Tensor
    centre: FloatArray
    spread: FloatArray
    density: Density | None

    @property
    def vectors(self) -> int:
        """Number of parameter vectors that one evaluation simulates."""
        return len(self.centre) if self.theta.ndim == 2 else 1

    def simulated(self, theta: FloatArray) -> FloatArray:
        """Return simulated values (n, o, l) of parameters, NaN where a specimen's simulation failed."""
        return self.response.evaluate_many(theta.reshape(-1, theta.shape[-1]))


def targets_of(model: pm.Model) -> list[Target]:
    """Return the backbone likelihoods of ``model``: those of populations, then those of specimens."""
    targets = []
    for potential in model.potentials:
        nodes = [node for node in nodes_of([potential]) if isinstance(node.op, BackboneLogLikelihood)]
        found = [target for node in nodes if (target := _population(potential.name, node)) is not None]
        targets += found
    for variable in model.observed_RVs:
        target = _specimens(variable, model.rvs_to_values[variable])
        if target is not None:
            targets.append(target)
    return targets


def is_differentiable(model: pm.Model) -> bool:
    """Return whether every backbone likelihood of ``model`` has a gradient."""
    return all(isinstance(target.response, OscillatorResponse) for target in targets_of(model))


def nodes_of(outputs: list[Variable]) -> Iterator[Apply]:
    """Return the nodes that ``outputs`` are computed by."""
    nodes: Iterator[Apply] = applys_between([], outputs)
    return nodes


def note_density(codes: Variable, density: Density) -> None:
    """Note beside its ``codes`` in the graph how a density came about: the words that its numbers do not hold."""
    codes.tag.density = density


def _population(name: str, node: Apply) -> Target | None:
    """Return what a node compares, or None where its data are no constants."""
    theta, *inputs = node.inputs
    inputs = [_uncast(variable) for variable in inputs]
    codes, table = (_constant(variable) for variable in inputs)
    if codes is None or table is None:
        return None
    response = node.op.response
    density = Density(KINDS[int(codes[0])], np.array(response.levels), response.observables, codes, table)
    noted = getattr(inputs[0].tag, "density", None)
    if isinstance(noted, Density) and noted == density:
        density = noted
    draws = density.sample(2000, random_seed=0)
    return Target(name, response, theta, draws.mean(axis=0)[None], draws.std(axis=0)[None], density)


def _specimens(variable: Variable, value: Variable) -> Target | None:
    """Return what an observed variable compares, or None where it is something else."""
    node = variable.owner
    inner = getattr(node.op, "fgraph", None) if node is not None else None
    ops = [] if inner is None else [_core(each.op) for each in inner.apply_nodes]
    responses = [op.response for op in ops if isinstance(op, BackboneOp)]
    observed = _constant(value)
    if len(responses) != 1 or observed is None:
        return None
    theta, _, _, errors, _ = node.op.dist_params(node)
    sizes = _constant(errors)
    return None if sizes is None else Target(variable.name, responses[0], theta, observed, sizes, None)


def _uncast(variable: Variable) -> Variable:
    """Return what a variable was before it was brought to another type."""
    node = variable.owner
    is_cast = node is not None and isinstance(getattr(node.op, "scalar_op", None), Cast)
    return node.inputs[0] if is_cast else variable


def _core(op: Op) -> Op:
    return getattr(op, "core_op", op)


def _constant(variable: Variable) -> NDArray[Any] | None:
    """Return the numbers of a constant or of a model's data as they are now, or None of anything that is computed."""
    data = variable.get_value() if isinstance(variable, SharedVariable) else getattr(variable, "data", None)
    return data if isinstance(data, np.ndarray) else None
