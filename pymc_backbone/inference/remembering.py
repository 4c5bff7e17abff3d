"""A log-density that remembers: steps of PyMC ask for the present point again with every proposal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pymc as pm
from pymc.pytensorf import join_nonshared_inputs
from pytensor.compile.mode import Mode

from .._common.checks import FloatArray
from ..simulation.counts import REMEMBERED, count
from ..simulation.response import MEMORY
from .compiling import compile_once
from .targets import targets_of

_NEVER_RUN = Mode(linker="py", optimizer=None)  # what PyMC compiles for a step whose function is then replaced


class RememberingLogDensity:
    """The log-density of a model at a vector of all its unconstrained values, with the last few remembered.

    Parameters
    ----------
    model : pymc.Model
        A model with continuous variables only.
    """

    def __init__(self, model: pm.Model) -> None:
        point = model.initial_point()
        self._function = compile_once(model, "joint log-density", lambda: self._compile(model, point))
        self._function.trust_input = True
        self._known: dict[bytes, float] = {}
        self._simulations = sum(target.vectors for target in targets_of(model))
        ends = np.cumsum([np.size(point[variable.name]) for variable in model.value_vars]).tolist()
        self.size = int(ends[-1])
        self.places = {
            variable.name: slice(first, last)
            for variable, first, last in zip(model.value_vars, [0, *ends[:-1]], ends, strict=True)
        }

    @staticmethod
    def _compile(model: pm.Model, point: dict[str, FloatArray]) -> Any:
        [density], vector = join_nonshared_inputs(point, [model.logp()], model.value_vars, {})
        return model.compile_fn(density, inputs=[vector], point_fn=False)

    def __call__(self, vector: FloatArray) -> float:
        """Return the log-density; of the points asked for last, without evaluating it again."""
        key = vector.tobytes()
        value = self._known.pop(key, None)
        if value is None:
            value = float(self._function(vector))
            if len(self._known) == MEMORY:
                del self._known[next(iter(self._known))]
        else:
            count(REMEMBERED, self._simulations)
        self._known[key] = value
        return value


class _Conditional:
    """The log-density as one step sees it: a function of the step's own variables, the others as they stand."""

    def __init__(self, density: RememberingLogDensity, step: Any) -> None:
        self.density = density
        self.own = np.concatenate([np.r_[density.places[name]] for name in step.var_names])
        self.others = [(density.places[name], shared) for name, shared in step.shared.items()]
        self.vector = np.empty(density.size)

    def __call__(self, values: FloatArray) -> float:
        self.vector[self.own] = values
        for place, shared in self.others:
            self.vector[place] = np.ravel(shared.get_value(borrow=True))
        return self.density(self.vector)


class _Difference:
    """The difference of the log-density between two points, as PyMC's Metropolis steps ask for it."""

    def __init__(self, conditional: _Conditional) -> None:
        self.conditional = conditional

    def __call__(self, proposed: FloatArray, present: FloatArray) -> FloatArray:
        return np.asarray(self.conditional(proposed) - self.conditional(present))


def make_remembering(make: Callable[..., Any], model: pm.Model) -> Any:
    """Return the step that ``make`` makes for ``model``, with a log-density that remembers.

    All parts of a step that moves one variable at a time share one memory: the proposal of one is the present point of
    the next.

    Parameters
    ----------
    make : callable
        One of PyMC's steps that ask for a log-density ``logp`` or for its difference ``delta_logp``.
    model : pymc.Model
        What it samples; where a variable is not a float64, the step is PyMC's as it comes.
    """
    with model:
        if any(variable.dtype != "float64" for variable in model.value_vars):
            return make()
        step = make(compile_kwargs={"mode": _NEVER_RUN})
    density = RememberingLogDensity(model)
    for part in getattr(step, "methods", [step]):
        conditional = _Conditional(density, part)
        if hasattr(part, "delta_logp"):
            part.delta_logp = _Difference(conditional)
        else:
            part.logp = conditional
    return step
