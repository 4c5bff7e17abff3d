"""One compilation for many data sets: posteriors of models that differ in their numbers only.

PyTensor compiles data into a model's log-density, which takes longer than sampling a small posterior does. Two models
built by the same code from data sets of one shape have the same graph, so their constants correspond one to one:
compiled once with the arrays among them as shared variables, the log-density serves every further data set.
"""

from __future__ import annotations

import numpy as np
import nutpie
import pymc as pm
import pytensor
from nutpie.compiled_pyfunc import from_pyfunc
from pymc.pytensorf import join_nonshared_inputs
from pytensor.graph.replace import graph_replace
from pytensor.graph.traversal import graph_inputs
from pytensor.tensor.variable import TensorConstant


def _graphs(model: pm.Model, wanted: list[str]):
    """Return log-density and wanted variables as graphs of the unconstrained values, and their array constants."""
    outputs = [model.logp(), *model.replace_rvs_by_values([model[name] for name in wanted])]
    arrays = [v for v in graph_inputs(outputs) if isinstance(v, TensorConstant) and _is_data(v.data)]
    return outputs, arrays


def _is_data(value) -> bool:
    return isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim >= 1


class Reusable:
    """The compiled posterior of ``model``, and of every model of the same form.

    Parameters
    ----------
    model : pymc.Model
        The first one.
    wanted : list of str
        Variables to return from `draw`.
    """

    def __init__(self, model: pm.Model, wanted: list[str]) -> None:
        self.wanted = wanted
        outputs, arrays = _graphs(model, wanted)
        self.shared = [pytensor.shared(v.data.copy(), shape=v.type.shape) for v in arrays]
        outputs = graph_replace(outputs, dict(zip(arrays, self.shared, strict=True)), strict=False)
        point = model.initial_point()
        self.order = [v.name for v in model.value_vars]
        outputs, joined = join_nonshared_inputs(point, outputs, model.value_vars)
        self.size = sum(np.size(point[name]) for name in self.order)
        self.density = pytensor.function([joined], [outputs[0], pytensor.grad(outputs[0], joined)])
        self.expand = pytensor.function([joined], outputs[1:])
        self.density.trust_input = self.expand.trust_input = True
        self.shapes = [np.shape(v) for v in self.expand(self.ravel(point))]

    def ravel(self, point) -> np.ndarray:
        """Return a point of unconstrained values as one vector."""
        return np.concatenate([np.ravel(point[name]) for name in self.order]).astype(np.float64)

    def load(self, model: pm.Model) -> None:
        """Take over the numbers of ``model``."""
        _, arrays = _graphs(model, self.wanted)
        for shared, constant in zip(self.shared, arrays, strict=True):
            if shared.get_value(borrow=True).shape != constant.data.shape:
                raise ValueError("the models differ in more than their numbers")
            shared.set_value(constant.data)

    def draw(self, start, *, draws: int, tune: int, chains: int, seed: int, adaptation: str = "diag"):
        """Return draws (chain, draw, ...) by name, the share of divergences, and steps a draw; by nutpie's NUTS."""

        def make_density():
            return lambda x: tuple(v if v.ndim else float(v) for v in self.density(np.array(x)))

        def make_expand(seed1, seed2, chain):
            return lambda x: dict(zip(self.wanted, map(np.asarray, self.expand(np.array(x))), strict=True))

        compiled = from_pyfunc(
            self.size, make_density, make_expand, [np.dtype(np.float64)] * len(self.wanted), self.shapes, self.wanted,
            make_initial_point_fn=lambda seed: start(np.random.default_rng(seed)),
        )  # fmt: skip
        result = nutpie.sample(
            compiled, draws=draws, tune=tune, chains=chains, cores=1, seed=seed, progress_bar=False,
            save_warmup=False, adaptation=adaptation,
        )  # fmt: skip
        statistics = result["sample_stats"]
        posterior = {name: np.asarray(result["posterior"][name]) for name in self.wanted}
        return posterior, float(statistics["diverging"].mean()), float(statistics["n_steps"].mean())
