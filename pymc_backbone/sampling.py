"""Sampling with safe starts, an explicit step, and the failures counted."""

from __future__ import annotations

import logging
import sys
import time
import warnings
from typing import Any

import numpy as np
import pymc as pm
import xarray as xr

from . import _native
from ._checks import InputError, check_choice
from ._proposal import make_metropolis
from ._starts import StartFinder
from .model import is_differentiable, targets_of

STEPS = ("metropolis", "elementwise", "demetropolisz", "slice", "nuts", "nutpie")
_COUNTS = {
    "evaluations": _native.EVALUATIONS,
    "failures": _native.FAILURES,
    "simulations": _native.SIMULATIONS,
    "gradients": _native.GRADIENTS,
}
_LOG_EVERY = 15.0  # seconds between lines where there is no terminal
logger = logging.getLogger("pymc_backbone")


def sample(
    model: pm.Model | None = None,
    *,
    draws: int = 2000,
    tune: int = 1000,
    chains: int = 4,
    step: str | Any = "metropolis",
    random_seed: int | None = None,
    cores: int = 1,
    progressbar: bool | None = None,
    **kwargs: Any,
) -> xr.DataTree:
    """Sample the posterior of a model that holds backbone likelihoods.

    Starts are drawn from the prior, finite and dispersed, or the run ends before it begins, with a sentence that
    names the observable and the level at fault.

    Parameters
    ----------
    model : pymc.Model, optional
        Default: the model of the current context.
    draws, tune, chains : int
        Per chain; ``tune`` draws are discarded.
    step : {"metropolis", "elementwise", "demetropolisz", "slice", "nuts", "nutpie"} or a PyMC step object
        ``metropolis`` is PyMC's Metropolis with joint proposals in the shape of the posterior near its best point
        (PyMC's own where no shape is found); ``elementwise`` is `pymc.Metropolis` as it comes, one variable at a time;
        ``nuts`` and ``nutpie`` need the gradient that oscillators have and functions have not.
    random_seed : int, optional
        Seed of starts and draws.
    cores : int, default 1
        Processes. A cheap likelihood gains nothing from several; a slow function does.
    progressbar : bool, optional
        Default: where there is a terminal; elsewhere a line is logged every 15 seconds.
    **kwargs
        Passed on to `pymc.sample`, or to `nutpie.sample` with step ``nutpie``.

    Returns
    -------
    xarray.DataTree
        Groups ``posterior``, ``sample_stats``, ...; ``attrs`` holds ``step``, ``seconds`` and, of the population
        likelihoods in this process while it sampled: ``evaluations`` asked for, ``simulations`` made for a value alone
        (fewer: the present point is remembered), ``gradients`` made with a value, and ``failures``.

    Raises
    ------
    InputError
        No finite start, an unknown step, or a step that needs a gradient the model has not.
    """
    model = pm.modelcontext(model)
    if isinstance(step, str):
        check_choice("step", step, STEPS)
        if step in ("nuts", "nutpie") and not is_differentiable(model):
            raise InputError(f"step {step!r} needs a gradient, and a backbone function has none; use 'metropolis'.")
    for label, value, least in (("draws", draws, 1), ("tune", tune, 0), ("chains", chains, 1), ("cores", cores, 1)):
        if int(value) != value or value < least:
            raise InputError(f"`{label}` must be a whole number of at least {least}, got {value}.")
    begin = time.perf_counter()
    seeds = np.random.SeedSequence(random_seed).generate_state(2)
    finder = StartFinder(model, int(seeds[0]))
    starts = finder.find(chains)
    before = _counts(model)
    shown = sys.stderr.isatty() if progressbar is None else progressbar
    if step == "nutpie":
        result = _sample_nutpie(model, draws, tune, chains, int(seeds[1]), starts, shown, cores, kwargs)
    else:
        stepper = make_metropolis(model, finder) if step == "metropolis" else _make_step(step, model)
        if not shown and progressbar is None:
            kwargs.setdefault("callback", _Reporter(chains * (draws + tune)))
        before = _counts(model)
        with model, warnings.catch_warnings():
            # PyMC warns that several processes under fork may deadlock; one process is the default here.
            warnings.filterwarnings("ignore", message="We recommend running at least 4 chains", category=UserWarning)
            result = pm.sample(
                draws=draws,
                tune=tune,
                chains=chains,
                cores=cores,
                step=stepper,
                nuts_sampler="pymc",
                initvals=starts,
                random_seed=int(seeds[1]),
                progressbar=shown,
                compute_convergence_checks=False,
                **kwargs,
            )
    after = _counts(model)
    result.attrs.update(
        {name: int(after[name] - before[name]) for name in before},
        step=step if isinstance(step, str) else type(step).__name__,
        seconds=time.perf_counter() - begin,
    )
    return result


def _make_step(step: str | Any, model: pm.Model) -> Any:
    makers = {"elementwise": pm.Metropolis, "demetropolisz": pm.DEMetropolisZ, "slice": pm.Slice, "nuts": pm.NUTS}
    with model:
        return makers[step]() if isinstance(step, str) else step


def _counts(model: pm.Model) -> dict[str, float]:
    """Return what the population likelihoods counted so far, in this process."""
    memories = [target.memory.get_value(borrow=True) for target in targets_of(model) if target.memory is not None]
    return {name: sum(float(memory[entry]) for memory in memories) for name, entry in _COUNTS.items()}


def _sample_nutpie(
    model: pm.Model,
    draws: int,
    tune: int,
    chains: int,
    seed: int,
    starts: list[dict[str, Any]],
    shown: bool,
    cores: int,
    kwargs: dict[str, Any],
) -> xr.DataTree:
    """Run nutpie from the first start; it takes one start and disperses the chains itself."""
    import nutpie

    compiled = nutpie.compile_pymc_model(model, initial_points=starts[0], jitter_rvs=set())
    copies = _copies_of_memories(model, compiled)
    begin = time.perf_counter()
    # Backbones determine combinations of parameters: a mass matrix that follows their correlation halves the cost.
    kwargs.setdefault("adaptation", "low_rank")
    result: xr.DataTree = nutpie.sample(
        compiled,
        draws=draws,
        tune=tune,
        chains=chains,
        cores=cores,
        seed=seed,
        progress_bar=shown,
        save_warmup=False,
        **kwargs,
    )
    result["posterior"].attrs.setdefault("sampling_time", time.perf_counter() - begin)  # as PyMC notes it
    for memory, copy in copies:
        memory.set_value(copy)
    return result


def _copies_of_memories(model: pm.Model, compiled: Any) -> list[tuple[Any, Any]]:
    """Return the memory of each population likelihood with the copy that nutpie made of it and counts in.

    nutpie keeps its copies under random keys, so a copy is known by what it holds.
    """
    copies = list(compiled.shared_data.values())
    pairs = []
    for target in targets_of(model):
        if target.memory is not None:
            value = target.memory.get_value(borrow=True)
            pairs += [(target.memory, copy) for copy in copies if np.array_equal(copy, value, equal_nan=True)][:1]
    return pairs


class _Reporter:
    """Logs how far a run is, now and then, where no progress bar can be shown."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.done = 0
        self.begin = self.last = time.monotonic()

    def __call__(self, **event: Any) -> None:
        """Count one draw of one chain; accept whatever PyMC passes."""
        self.done += 1
        now = time.monotonic()
        if now - self.last >= _LOG_EVERY:
            self.last = now
            left = (now - self.begin) * (self.total - self.done) / self.done
            logger.info("%d of %d draws, about %.0f s left", self.done, self.total, left)
