"""Sampling with safe starts, an explicit step, and the failures counted."""

from __future__ import annotations

import logging
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
import pymc as pm
import pytensor
import xarray as xr

from .._common.checks import InputError, check_choice
from .._common.progress import Progress
from ..likelihood.dims import label_units
from ..simulation.counts import read_counts
from .options import GRADIENT_STEPS, STEPS
from .proposal import make_metropolis
from .remembering import make_remembering
from .starts import StartFinder
from .store.run_folder import DrawStore
from .targets import is_differentiable

# What of PyMC's own arguments `sample` sets itself, and what to do instead.
_OWN = {
    "nuts_sampler": "`step` chooses the sampler, 'nuts' PyMC's own and 'nutpie' nutpie's; for 'numpyro', or "
    "'blackjax' up to 1.3, install it with JAX and call pymc.sample(nuts_sampler=...)",
    "initvals": "starts are found from the data; call pymc.sample(initvals=...) for starts of your own",
    "compute_convergence_checks": "`findings` says what they would",
}
# Arguments that belong to the step, where PyMC makes it itself; a step that is given would never see them.
_WIDE = 110  # columns from which on PyMC's bar has room for statistics and times
_OF_NUTS = ("target_accept", "max_treedepth")
logger = logging.getLogger("pymc_backbone")


def sample(
    model: pm.Model | None = None,
    *,
    draws: int = 2000,
    tune: int = 1000,
    chains: int = 4,
    step: str | Any = "metropolis",
    random_seed: int | np.random.Generator | None = None,
    cores: int = 1,
    progressbar: bool | str | None = None,
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Callable[[str, float], None] | None = None,
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
        ``metropolis`` is PyMC's Metropolis with joint proposals in the shape of the posterior, d of them a draw for d
        parameters (PyMC's own where no shape is found); ``elementwise`` is `pymc.Metropolis` as it comes, one variable
        at a time. Both simulate a proposal once; a Metropolis step that you make yourself simulates twice, because PyMC
        computes the density of the present point anew for each proposal. ``nuts`` and ``nutpie`` need the gradient that
        oscillators have and functions have not.
    random_seed : int or numpy.random.Generator, optional
        Seed of starts and draws; of a Generator one is drawn.
    cores : int, default 1
        Processes. A cheap likelihood gains nothing from several; a slow function does.
    progressbar : bool or str, optional
        Default: where there is a terminal; elsewhere a line is logged at least every ten seconds. In fewer than 110
        columns PyMC's bar comes without the step's statistics, which would cut off elapsed and remaining time; a word
        that `pymc.sample` knows chooses.
    store : path-like, optional
        Folder that keeps draws and the sampler's state on disk as they come; empty or new. For all steps by name but
        ``nutpie``, in one process. A Ctrl-C then ends the run after the draw it comes in, with what was drawn.
    resume : bool, default False
        Continue the run in ``store``, with the draws that it would have had without the interruption; begin one where
        there is none. ``draws`` may be more than before.
    progress : callable, optional
        Called with the stage and the fraction done (NaN where it is not known), in place of bar and lines.
    **kwargs
        Passed on to `pymc.sample`, or to `nutpie.sample` with step ``nutpie``; ``target_accept`` and
        ``max_treedepth`` go to NUTS.

    Returns
    -------
    xarray.DataTree
        Groups ``posterior``, ``sample_stats``, ...; ``attrs`` holds ``step``, ``seconds`` and, of this process while
        it sampled (with ``store``: of the run), in parameter vectors: ``evaluations`` asked for, ``simulations`` made
        for values alone (fewer: the present point is remembered), ``gradients`` made with values, and ``failures``;
        and ``interrupted``, a sentence, where Ctrl-C ended a stored run.

    Raises
    ------
    InputError
        No finite start, an unknown step, or a step that needs a gradient the model has not; a store that is in use,
        cannot be written, or holds something else than this run.

    See Also
    --------
    build_model : makes a model.
    findings : whether the draws can be trusted.
    summarise : a row for each parameter.
    """
    model = pm.modelcontext(model)
    for name in _OWN.keys() & kwargs.keys():
        raise InputError(f"`{name}` is no argument of `sample`: {_OWN[name]}.")
    seed = _as_number(random_seed)
    if isinstance(step, str):
        check_choice("step", step, STEPS)
        if step in GRADIENT_STEPS and not is_differentiable(model):
            raise InputError(f"step {step!r} needs a gradient, and a backbone function has none; use 'metropolis'.")
    for label, value, least in (("draws", draws, 1), ("tune", tune, 0), ("chains", chains, 1), ("cores", cores, 1)):
        if int(value) != value or value < least:
            raise InputError(f"`{label}` must be a whole number of at least {least}, got {value}.")
    arguments = (model, draws, tune, chains, step, cores, progressbar, kwargs)
    if store is None:
        if resume:
            raise InputError("`resume` continues a run that was stored; name its folder with `store`.")
        with _exact(), _told(progress, progressbar) as tell:
            return _run(seed, None, *arguments, tell)
    if step == "nutpie":
        raise InputError("step 'nutpie' keeps its state to itself and cannot be stored; use step 'nuts'.")
    if not isinstance(step, str):
        raise InputError(f"a step of your own cannot be stored; use one of {', '.join(STEPS[:-1])}.")
    if cores != 1:
        raise InputError(f"a run that is stored draws its chains one after another: `cores` must be 1, got {cores}.")
    with _exact(), DrawStore(store, resume) as kept, _told(progress, progressbar) as tell:
        return _run(kept.seed(seed), kept, *arguments, tell)


def _is_terminal() -> bool:
    """Whether somebody sees standard error; a process without a console has none."""
    return sys.stderr is not None and sys.stderr.isatty()


def _told(
    progress: Callable[[str, float], None] | None, progressbar: bool | str | None
) -> AbstractContextManager[Callable[[str, float], None] | None]:
    """Return what is told of stages and fractions: what was given, or the log where no bar can be shown."""
    if progress is not None or progressbar is not None or _is_terminal():
        return nullcontext(progress)
    return Progress(lambda line: logger.info("%s", line.strip()))


def _as_number(random_seed: int | np.random.Generator | None) -> int | None:
    """Return the seed as a number, drawn where a Generator is given; None for none."""
    if isinstance(random_seed, np.random.Generator):
        return int(random_seed.integers(2**63))
    if random_seed is None:
        return None
    if isinstance(random_seed, bool) or not isinstance(random_seed, int | np.integer) or random_seed < 0:
        raise InputError(
            f"`random_seed` must be a whole number of at least 0 or a numpy.random.Generator, got {random_seed!r}."
        )
    return int(random_seed)


def _exact() -> AbstractContextManager[None]:
    """Return a context in which PyTensor compiles sums in the order they are written in.

    With fast mathematics the order depends on what was compiled in this process and what was read from disk: the same
    seed would not give the same digits in a resumed run, or in another process.
    """
    flags: AbstractContextManager[None] = pytensor.config.change_flags(numba__fastmath=False)
    return flags


def _run(
    random_seed: int | None,
    kept: DrawStore | None,
    model: pm.Model,
    draws: int,
    tune: int,
    chains: int,
    step: str | Any,
    cores: int,
    progressbar: bool | str | None,
    kwargs: dict[str, Any],
    tell: Callable[[str, float], None] | None,
) -> xr.DataTree:
    """Find starts, sample, and note what it took; in the order that gives a stored run the draws of any other."""
    begin = time.perf_counter()
    own = {name: kwargs.pop(name) for name in _OF_NUTS if name in kwargs and step == "nuts"}
    seeds = np.random.SeedSequence(random_seed).generate_state(2)
    told = tell or (lambda _stage, _fraction: None)
    told("looking for starts", float("nan"))
    finder = StartFinder(model, int(seeds[0]))
    if kept is None:
        starts = finder.find(chains)
    else:
        settings = {"draws": draws, "tune": tune, "chains": chains, "step": step, "random_seed": random_seed, **own}
        starts = kept.starts(model, finder, settings)
    before = read_counts()
    shown = (tell is None and _is_terminal()) if progressbar is None else bool(progressbar)
    told("compiling the sampler", float("nan"))
    recorder = None
    if step == "nutpie":
        result = _sample_nutpie(model, draws, tune, chains, int(seeds[1]), starts, shown, cores, kwargs, told)
    else:
        stepper = make_metropolis(model, finder) if step == "metropolis" else _make_step(step, model, own)
        recorder = None if kept is None else kept.record(stepper, read_counts)
        if tell is not None:
            repeated = 0 if recorder is None else recorder.kept
            kwargs.setdefault("callback", _Reporter(chains * (draws + tune), repeated, tell))
        before = read_counts()
        with model, warnings.catch_warnings(), nullcontext() if recorder is None else recorder.ending_early():
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
                progressbar=_bar_that_fits(progressbar) if shown else False,
                compute_convergence_checks=False,
                **kwargs,
            )
    after = read_counts()
    earlier = [] if kept is None else kept.stored
    result.attrs.update(
        {
            name: int(after[name] - before[name] + sum(chain.counts.get(name, 0.0) for chain in earlier))
            for name in before
        },
        step=step if isinstance(step, str) else type(step).__name__,
        seconds=time.perf_counter() - begin + sum(chain.seconds for chain in earlier),
    )
    label_units(model, result)
    if recorder is not None and recorder.is_stopping:
        sizes = result["posterior"].sizes
        result.attrs["interrupted"] = (
            f"Stopped with Ctrl-C after {recorder.kept} of {chains * (tune + draws)} draws, tuning included; this is "
            f"{sizes['chain']} of {chains} chains with {sizes['draw']} of {draws} draws. Resume to have the rest."
        )
    return result


def _bar_that_fits(asked: bool | str | None) -> bool | str:
    """Return the bar that PyMC is to show: without the step's statistics where they would cut off the times."""
    if isinstance(asked, str):
        return asked
    return True if shutil.get_terminal_size().columns >= _WIDE else "split"


def _make_step(step: str | Any, model: pm.Model, own: dict[str, Any]) -> Any:
    """Return the step of that name, or the step given; ``own`` are arguments of NUTS."""
    if not isinstance(step, str):
        return step
    if step == "nuts":
        return pm.NUTS(model=model, **own)
    makers = {"elementwise": pm.Metropolis, "demetropolisz": pm.DEMetropolisZ, "slice": pm.Slice}
    return make_remembering(makers[step], model)


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
    told: Callable[[str, float], None],
) -> xr.DataTree:
    """Run nutpie from the first start; it takes one start and disperses the chains itself."""
    import nutpie

    compiled = nutpie.compile_pymc_model(model, initial_points=starts[0], jitter_rvs=set())
    told("sampling with nutpie", float("nan"))
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
    return result


class _Reporter:
    """Counts the draws of all chains and tells of them."""

    def __init__(self, total: int, repeated: int, tell: Callable[[str, float], None]) -> None:
        self.total, self.repeated, self.tell = total, repeated, tell  # draws of an earlier run take no time
        self.done = 0

    def __call__(self, **event: Any) -> None:
        """Count one draw of one chain; accept whatever PyMC passes."""
        self.done += 1
        if self.done > self.repeated:
            self.tell("sampling", (self.done - self.repeated) / max(1, self.total - self.repeated))
