"""What a posterior is worth: a table of summaries, and findings in words.

The numbers are ArviZ's (rank-normalised split R-hat, effective sample sizes, highest-density intervals); the words say
what an engineer should do about them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from arviz_base import xarray_var_iter
from arviz_base.labels import BaseLabeller
from arviz_stats import summary as arviz_summary

from .._common.checks import FloatArray, InputError
from .fit_verdict import REMEDY, GoodnessOfFit

Bounds = Mapping[str, tuple[float, float]]

R_HAT_LIMIT = 1.01  # Vehtari et al. 2021
ESS_LIMIT = 400.0  # Vehtari et al. 2021: 100 for each of four chains
ACCEPTANCE_RANGE = (0.10, 0.75)  # random walks do well between about 0.2 and 0.5; outside these limits they crawl
NUTS_ACCEPTANCE_LIMIT = 0.60  # NUTS aims at 0.8 or more
MANY_FAILURES = 0.05  # of all simulations: from here on a part of the prior is out of reach
STRIP = 0.02  # of the prior's width: what counts as next to a bound
LEANING_LIMIT = 0.5  # density next to the bound over the highest density
UNIDENTIFIED_DISTANCE = 0.08  # Kolmogorov distance between posterior and Uniform prior that still counts as none
TABLE_COLUMNS = ("mean", "sd", "hdi_low", "hdi_high", "r_hat", "ess_bulk", "ess_tail", "mcse_mean", "mcse_sd")


def summarise(posterior: xr.DataTree, names: Sequence[str] | None = None, *, probability: float = 0.95) -> pd.DataFrame:
    """Tabulate each parameter's posterior: moments, highest-density interval, R-hat, effective samples.

    Parameters
    ----------
    posterior : xarray.DataTree
        What `sample` or `pymc.sample` returned.
    names : sequence of str, optional
        Variables to tabulate; all of group ``posterior`` by default. Elements of an array get a row each.
    probability : float, optional
        Mass of the highest-density interval, in (0, 1); 0.95 by default.

    Returns
    -------
    pandas.DataFrame
        A row for each parameter; columns ``mean``, ``sd``, ``hdi_low``, ``hdi_high`` in the parameter's unit,
        ``r_hat``, ``ess_bulk``, ``ess_tail`` (numbers of draws), ``mcse_mean``, ``mcse_sd`` in the parameter's unit.

    Raises
    ------
    InputError
        If there is no group ``posterior``, a name is not in it, or the probability is not in (0, 1).

    See Also
    --------
    findings : The same numbers, and the prior's bounds, in words.
    """
    dataset, names = _posterior_dataset(posterior, names)
    if not 0.0 < probability < 1.0:
        raise InputError(f"`probability` must lie between 0 and 1, got {probability:g}.")
    # Quantities of a chain that never moved are 0/0: NaN is the honest answer, a warning adds nothing.
    with np.errstate(invalid="ignore", divide="ignore"):
        table = pd.DataFrame(
            arviz_summary(dataset, var_names=names, ci_prob=probability, ci_kind="hdi", round_to="none")
        )
    interval = [column for column in table.columns if column.endswith(("_lb", "_ub"))]
    table = table.rename(columns=dict(zip(interval, ("hdi_low", "hdi_high"), strict=True)))
    table.index.name = "parameter"
    return table[list(TABLE_COLUMNS)].astype(float)


def findings(
    posterior: xr.DataTree,
    bounds: Bounds | None = None,
    *,
    names: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
    failures: int | None = None,
    simulations: int | None = None,
    fit: GoodnessOfFit | None = None,
    remedy: str = REMEDY,
) -> list[str]:
    """Say in sentences what is wrong with a posterior; an empty list means nothing was found.

    Checked are, first of all, whether the model fits what was measured, where ``fit`` says so: no other check looks at
    the measurement. Then: chains that never moved; R-hat above 1.01; fewer than 400 effective draws (bulk or tail);
    divergent transitions; acceptance too low or too high; failed simulations; posteriors that lean on a bound of their
    prior; and posteriors that are their prior, for which the data do not identify the parameter.

    Parameters
    ----------
    posterior : xarray.DataTree
        What `sample` or `pymc.sample` returned; the statistics of the sampler are read from ``sample_stats`` if there.
    bounds : mapping of str to (float, float), optional
        Low and high end of each parameter's Uniform prior, in the parameter's unit. Parameters without bounds are not
        compared with their prior.
    names : sequence of str, optional
        Variables to look at; by default those in ``bounds``, or all if there are no bounds.
    units : mapping of str to str, optional
        Units to print behind the bounds.
    failures, simulations : int, optional
        Number of simulations that gave no backbone, and of all simulations; by default those that `sample` noted in
        ``posterior.attrs``.
    fit : GoodnessOfFit, optional
        From `goodness_of_fit`.
    remedy : str, optional
        What to do about a model that lacks something.

    Returns
    -------
    list of str
        Sentences, the gravest first, each with a remedy.

    See Also
    --------
    summarise : the numbers behind the words.
    goodness_of_fit : whether the model describes what was measured.
    sample : where the draws come from.

    Notes
    -----
    A posterior leans on a bound if the density of draws in a strip next to it is more than half of the highest density
    in any strip as wide. The strip is 2 % of the prior's width, or half a posterior standard deviation if that is less,
    so that a narrow posterior well inside a wide prior does not count. A posterior is its Uniform prior if the
    Kolmogorov distance between them is below 0.08 plus the expected distance of as many independent draws.
    """
    if names is None and bounds:
        names = [name for name in bounds if "posterior" in posterior.children and name in posterior["posterior"]]
    dataset, names = _posterior_dataset(posterior, names)
    table = summarise(posterior, names)
    units = units or {}
    failed = _failures(
        posterior.attrs.get("failures") if failures is None else failures,
        simulations_of(posterior) if simulations is None else simulations,
    )
    frozen = _frozen_chains(dataset, names)
    if frozen:  # nothing else can be told from such draws
        return frozen + failed
    misfit = [] if fit is None else fit.sentences(remedy)
    sentences = misfit + _convergence(table, dataset.sizes["chain"]) + _sampler(posterior) + failed
    for name, label, draws in _elements(dataset, names):
        if bounds and name in bounds and np.ptp(draws) > 0.0:
            ess = float(table.loc[label, "ess_bulk"])
            sentences += _against_prior(label, np.sort(draws.ravel()), bounds[name], ess, units.get(name, ""))
    return sentences


def acceptance_rate(posterior: xr.DataTree) -> float | None:
    """Mean acceptance rate that the sampler noted, or None if it notes none (Slice)."""
    if "sample_stats" not in posterior.children:
        return None
    statistics = posterior["sample_stats"]
    for name in ("accepted", "acceptance_rate", "mean_tree_accept"):
        if name in statistics:
            return float(np.mean(np.asarray(statistics[name].values, dtype=float)))
    return None


def leaning_share(draws: FloatArray, low: float, high: float) -> dict[str, tuple[float, float]]:
    """Density of draws next to each bound of a Uniform prior, relative to the highest density.

    Parameters
    ----------
    draws : array of float, shape (n,)
        Posterior draws of one parameter.
    low, high : float
        Bounds of its prior.

    Returns
    -------
    dict
        For ``"lower"`` and ``"upper"``: density in the strip next to the bound over the highest density in a strip as
        wide (0 to 1), and share of the draws within 2 % of the prior's width of the bound.

    Examples
    --------
    >>> import numpy as np
    >>> inside = np.random.default_rng(1).normal(5.0, 0.5, size=4000)
    >>> {side: round(ratio, 2) for side, (ratio, _) in leaning_share(inside, 0.0, 10.0).items()}
    {'lower': 0.0, 'upper': 0.0}
    """
    ordered = np.sort(np.asarray(draws, dtype=float).ravel())
    width = high - low
    strip = min(STRIP * width, 0.5 * float(np.std(ordered)))
    highest = float(np.max(np.searchsorted(ordered, ordered + strip, side="right") - np.arange(ordered.size)))
    counts = {
        "lower": (float(np.sum(ordered <= low + strip)), float(np.sum(ordered <= low + STRIP * width))),
        "upper": (float(np.sum(ordered >= high - strip)), float(np.sum(ordered >= high - STRIP * width))),
    }
    return {side: (min(near / highest, 1.0), share / ordered.size) for side, (near, share) in counts.items()}


def distance_from_uniform(draws: FloatArray, low: float, high: float) -> float:
    """Kolmogorov distance between draws and a Uniform distribution: 0 for the same, 1 for a point at a bound."""
    ordered = np.clip((np.sort(np.asarray(draws, dtype=float).ravel()) - low) / (high - low), 0.0, 1.0)
    steps = np.arange(ordered.size + 1) / ordered.size
    return float(max(np.max(steps[1:] - ordered), np.max(ordered - steps[:-1])))


def _posterior_dataset(posterior: xr.DataTree, names: Sequence[str] | None) -> tuple[xr.Dataset, list[str]]:
    if "posterior" not in getattr(posterior, "children", {}):
        raise InputError(
            f"`posterior` must be a DataTree with a group 'posterior', as pymc.sample returns; "
            f"got {type(posterior).__name__}."
        )
    dataset = posterior["posterior"].to_dataset()
    chosen = [str(name) for name in (dataset.data_vars if names is None else names)]
    for name in chosen:
        if name not in dataset:
            known = ", ".join(str(known) for known in dataset.data_vars)
            raise InputError(f"`names` must be variables of the posterior ({known}), got {name!r}.")
    if not chosen:
        raise InputError("`names` must hold at least one variable of the posterior, got none.")
    return dataset, chosen


def _elements(dataset: xr.Dataset, names: Sequence[str]) -> Iterator[tuple[str, str, FloatArray]]:
    """Yield name, label in the table, and draws (chain, draw) of each scalar in the posterior."""
    labeller = BaseLabeller()
    for name, selection, position, values in xarray_var_iter(dataset, var_names=names, skip_dims={"chain", "draw"}):
        yield str(name), labeller.make_label_flat(name, selection, position), np.asarray(values, dtype=float)


def _frozen_chains(dataset: xr.Dataset, names: Sequence[str]) -> list[str]:
    still = np.ones(dataset.sizes["chain"], dtype=bool)
    for _, _, draws in _elements(dataset, names):
        still &= np.ptp(draws, axis=1) == 0.0
    if not still.any():
        return []
    chains = [str(chain) for chain in np.asarray(dataset["chain"])[still]]
    which = f"Chain {chains[0]} never moved" if len(chains) == 1 else f"Chains {_listed(chains)} never moved"
    return [
        f"{which}: every draw is the start, so the posterior means nothing; start where the likelihood is finite "
        "(`sample` does), or use narrower priors."
    ]


def _convergence(table: pd.DataFrame, chains: int) -> list[str]:
    sentences = []
    r_hat = table["r_hat"]
    if chains == 1:
        sentences.append("There is one chain only, so nothing says if another would agree; draw four.")
        r_hat = r_hat.fillna(1.0)
    # A row without R-hat is a parameter that stood still in every chain: `~(<=)` catches NaN too.
    mixed_badly = table.index[~(r_hat <= R_HAT_LIMIT)]
    if len(mixed_badly):
        sentences.append(
            f"R-hat is above {R_HAT_LIMIT:g} for {_listed(_with_values(r_hat[mixed_badly], '.4f'))}: the chains do not "
            "agree yet; raise tune and draws, or use another step."
        )
    effective = table[["ess_bulk", "ess_tail"]].min(axis=1)
    few = table.index[~(effective >= ESS_LIMIT)]
    if len(few):
        sentences.append(
            f"Fewer than {ESS_LIMIT:g} effective draws for {_listed(_with_values(effective[few], '.0f'))}: means and "
            "intervals are rough; raise draws, or use a step that mixes faster."
        )
    return sentences


def _sampler(posterior: xr.DataTree) -> list[str]:
    sentences = []
    statistics = posterior["sample_stats"] if "sample_stats" in posterior.children else None
    if statistics is not None and "diverging" in statistics:
        count = int(np.sum(np.asarray(statistics["diverging"].values, dtype=bool)))
        if count:
            sentences.append(
                f"{count} of {statistics['diverging'].size} transitions diverged: parts of the posterior may be "
                "missing; raise tune, or target_accept in Python."
            )
    rate = acceptance_rate(posterior)
    if rate is None or statistics is None:
        return sentences
    is_random_walk = "accepted" in statistics
    low, high = ACCEPTANCE_RANGE if is_random_walk else (NUTS_ACCEPTANCE_LIMIT, np.inf)
    if rate < low:
        remedy = "tune longer or use narrower priors" if is_random_walk else "raise tune or target_accept"
        sentences.append(f"The acceptance rate is {rate:.2f}, below {low:.2f}: most proposals are refused; {remedy}.")
    elif rate > high:
        sentences.append(
            f"The acceptance rate is {rate:.2f}, above {high:.2f}: the proposals are too short, so the draws "
            "hardly differ; tune longer."
        )
    return sentences


def simulations_of(posterior: xr.DataTree) -> int | None:
    """Return how many simulations `sample` noted, with and without gradient; None where it noted nothing."""
    if not {"simulations", "gradients"} <= set(posterior.attrs):
        return None
    return int(posterior.attrs["simulations"]) + int(posterior.attrs["gradients"])


def _failures(failures: int | None, simulations: int | None) -> list[str]:
    if not failures:
        return []
    many = bool(simulations) and failures > MANY_FAILURES * float(simulations or 0)
    remedy = "narrow the priors or lower the highest level" if many else "harmless where no parameter leans on a bound"
    total = f"{failures} of {simulations} simulations" if simulations else f"{failures} simulations"
    return [f"{total} gave no backbone, and those proposals were refused: {remedy}."]


def _against_prior(label: str, ordered: FloatArray, bounds: tuple[float, float], ess: float, unit: str) -> list[str]:
    low, high = float(bounds[0]), float(bounds[1])
    unit = f" {unit}" if unit and unit != "1" else ""
    distance = distance_from_uniform(ordered, low, high)
    # 0.87 / sqrt(n) is the expected Kolmogorov distance of n independent draws from their own distribution.
    noise = 0.87 / np.sqrt(ess) if np.isfinite(ess) and ess > 0.0 else np.inf
    if distance < UNIDENTIFIED_DISTANCE + min(noise, 0.1):
        return [
            f"The data do not identify {label}: its posterior is its prior, uniform from {low:.4g} to "
            f"{high:.4g}{unit}; observe another quantity (damping, offset), use higher levels, or fix it."
        ]
    sentences = []
    for side, (ratio, share) in leaning_share(ordered, low, high).items():
        if ratio <= LEANING_LIMIT:
            continue
        bound = low if side == "lower" else high
        remedy = "its effect may be absent" if bound == 0.0 else "widen the prior unless the bound is physical"
        sentences.append(
            f"{label} leans on the {side} bound {bound:.4g}{unit} of its prior: {share:.0%} of the draws lie within "
            f"{STRIP:.0%} of the prior's width of it, where {STRIP:.0%} would be chance; {remedy}."
        )
    return sentences


def _with_values(column: pd.Series, form: str) -> list[str]:
    return [f"{name} ({value:{form}})" for name, value in column.items()]


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
