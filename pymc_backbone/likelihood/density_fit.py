"""Fits of densities to a measured population of backbones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr

from .._common.checks import OBSERVABLE_UNITS, FloatArray, InputError, check_choice
from .density import FAMILIES, Density
from .density_data import check_spread, measurement_covariance, population_values
from .density_joint import principal_directions
from .density_kernel import FAMILY_CODES, JOINT, LOG_TWO_PI, PRODUCT
from .density_marginals import fit_marginal, kernel_bandwidth, shrunk_centres

CRITERIA: tuple[str, ...] = ("bic", "aic")
FITTED = ("product", "joint")

_MINIMUM = {"uniform": 3, "normal": 3, "best": 3, "kde": 5, "gev": 8}
_MINIMUM_JOINT = 5


def fit_density(
    backbones: xr.Dataset,
    kind: str = "product",
    marginal: str = "best",
    observables: str | Iterable[str] | None = None,
    criterion: str = "bic",
    *,
    subtract_measurement: bool = True,
) -> Density:
    r"""Fit a density to a population of backbones.

    ``kind="product"`` is the source paper's [1]_: an independent density :math:`f_{jk}` per observable and level, log
    density :math:`\sum_{jk} \log f_{jk}(y_{jk})`. Levels of one specimen share its few parameters, so a product counts
    the same information once per level and recovers a population that is too narrow (a flat density hides it).
    ``kind="joint"`` is one density across all of them and keeps the spread.

    Parameters
    ----------
    backbones : xarray.Dataset
        Dims specimen, observable, level; variable ``value`` (NaN where a specimen does not reach a level) and, for
        ``joint``, ``standard_error`` or ``covariance``.
    kind : {"product", "joint"}
        Default "product", for the source paper's cases.
    marginal : {"best", "uniform", "normal", "kde", "gev"}
        Family of every marginal of a product. "best" takes, for each one by itself, the lowest criterion among uniform,
        normal and (from 8 specimens) gev. A kernel density has no number of parameters an information criterion could
        count, so it is fitted only by name. For ``joint``: "normal", or "kde", which is also what "best" means there
        and whose widest bandwidth is the normal.
    observables : str or iterable of str, optional
        Default all in the dataset.
    criterion : {"bic", "aic"}
        BIC = k log n - 2 log L, AIC = 2 k - 2 log L, with L the likelihood of the density as fitted.
    subtract_measurement : bool
        For ``joint``: take the measurement variance out of the population's, default true, because the density is
        evaluated at simulated values, which have none.

    Returns
    -------
    Density
        Fitted density, as plain data.

    Raises
    ------
    InputError
        A name that is not known; a dataset without the dims or variables; infinite values; too few specimens at a level
        (uniform, normal 3; kde 5; gev 8; joint 5 that reach all levels); values that do not vary.

    Notes
    -----
    *Uniform*: sample extremes moved outwards by range / (n - 1), the unbiased estimate. *Normal*: mean and unbiased
    variance. *Gev*: maximum likelihood with -0.95 <= xi <= 1. *Kde*: Gaussian kernels whose centres are drawn towards
    the mean [2]_, so that mean and variance (divisor n - 1) are the sample's; bandwidth by leave-one-out likelihood.
    Its tails are never cut off: far away it decreases like its nearest kernel.

    *Joint*: only specimens that reach all levels count. The covariance is nearly singular, because o x l values depend
    on a few parameters. With the floor F = measurement covariance + diag(0.1 s)^2, s the standard deviation of each
    value, directions that vary more than F explains are the population's: a kernel density there has the sample's mean
    and covariance (less the measurement's). Across them the density is normal with covariance F, widened with few
    specimens: it only holds the model to the measured mean. The floor is as wide as that because the surface on which
    the values lie is curved; whitening its curvature narrows the recovered spread by 10-16 %. A parameter that varies
    less than the floor comes back wider than it is; ``description`` tells how many directions were found.

    See Also
    --------
    Density : what comes back.

    References
    ----------
    .. [1] Pandey et al., "Stochastic nonlinear model updating in structural dynamics using a novel likelihood function
       within the Bayesian-MCMC framework", arXiv:2410.11902 (2024).
    .. [2] B. W. Silverman, "Density estimation for statistics and data analysis", Chapman and Hall (1986), section 6.4.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> value = np.array([12.0, 12.2, 12.4, 12.6]).reshape(4, 1, 1)
    >>> coordinates = {"observable": ["frequency"], "level": [0.01]}
    >>> backbones = xr.Dataset({"value": (("specimen", "observable", "level"), value)}, coordinates)
    >>> density = fit_density(backbones, marginal="uniform")  # the ends: 12.0 - 0.2 and 12.6 + 0.2
    >>> round(float(np.exp(density.log_density([[12.3]]))), 6)
    1.0
    """
    if kind == "data_consistent":
        raise InputError(
            "a data_consistent density needs the model and its priors; use `fit_data_consistent`, or "
            "`build_model(..., density='data_consistent')`."
        )
    check_choice("kind", kind, FITTED)
    check_choice("marginal", marginal, ("best", *FAMILIES))
    check_choice("criterion", criterion, CRITERIA)
    names, levels, value = population_values(backbones, observables)
    if kind == "joint":
        if marginal not in ("best", "kde", "normal"):
            raise InputError(
                f"`marginal` of a joint density must be best, kde or normal, got {marginal!r}. "
                "Choose one of those, or kind='product'."
            )
        return _fit_joint(backbones, names, levels, value, marginal == "normal", subtract_measurement)
    return _fit_product(names, levels, value, marginal, criterion)


def _row(observable: str, level: float, n_specimens: int, **rest: Any) -> dict[str, Any]:
    """Return one row of `Density.summary`."""
    unit = OBSERVABLE_UNITS[observable]
    return {"observable": observable, "unit": unit, "level": float(level), "n_specimens": n_specimens, **rest}


def _fit_product(
    names: tuple[str, ...], levels: FloatArray, value: FloatArray, marginal: str, criterion: str
) -> Density:
    """Fit one marginal per observable and level."""
    codes, table, rows = [PRODUCT, len(names) * levels.size], list[float](), list[dict[str, Any]]()
    for o, k in np.ndindex(len(names), levels.size):
        observable, level = names[o], float(levels[k])
        sample = np.sort(value[:, o, k][np.isfinite(value[:, o, k])])  # sorted: the order of specimens changes no bit
        if sample.size < _MINIMUM[marginal]:
            advice = ", or choose `marginal='normal'`" if sample.size >= _MINIMUM["normal"] else ""
            raise InputError(
                f"`backbones` must hold at least {_MINIMUM[marginal]} specimens at every level for marginal="
                f"{marginal!r}, got {sample.size} that reach level {level:g} in {observable}. Drop that level{advice}."
            )
        check_spread(sample, observable, level)
        families = [marginal]
        if marginal == "best":
            families = [name for name in ("uniform", "normal", "gev") if sample.size >= _MINIMUM[name]]
        fits = {family: fit_marginal(family, sample, criterion) for family in families}
        family = min(fits, key=lambda name: fits[name].score)
        codes += [FAMILY_CODES[family], len(table), len(fits[family].table)]
        table += fits[family].table
        rows.append(
            _row(
                observable,
                level,
                int(sample.size),
                family=family,
                parameters=fits[family].parameters,
                criterion="loo" if family == "kde" else criterion,
                value=fits[family].score,
                candidates={name: fits[name].score for name in fits},
            )
        )
    counts = sorted({row["n_specimens"] for row in rows})
    numbers = {name: sum(row["family"] == name for row in rows) for name in FAMILIES}
    used = ", ".join(f"{name} {number}" for name, number in numbers.items() if number)
    description = (
        f"Product of {len(rows)} independent marginals ({used}) from "
        f"{' to '.join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))} specimens. A product does "
        "not know that the levels of one specimen share its parameters: where the marginals are not flat, the "
        "recovered spread comes out too narrow."
    )
    return Density("product", levels, names, np.array(codes), np.array(table), description, tuple(rows))


def _fit_joint(
    backbones: xr.Dataset,
    names: tuple[str, ...],
    levels: FloatArray,
    value: FloatArray,
    is_normal: bool,
    subtract_measurement: bool,
) -> Density:
    """Fit one density across all observables and levels."""
    complete = np.isfinite(value).all(axis=(1, 2))
    n, d = int(complete.sum()), value.shape[1] * value.shape[2]
    if n < _MINIMUM_JOINT:
        reached = np.isfinite(value).sum(axis=0)
        o, k = np.unravel_index(int(np.argmin(reached)), reached.shape)
        raise InputError(
            f"`backbones` must hold at least {_MINIMUM_JOINT} specimens that reach every level for kind='joint', got "
            f"{n} of {value.shape[0]}; fewest, {reached[o, k]}, reach level {levels[k]:g} in {names[o]}. "
            "Drop that level."
        )
    cells = [(names[o], float(levels[k])) for o, k in np.ndindex(len(names), levels.size)]
    flat = value[complete].reshape(n, d)
    for column, cell in zip(flat.T, cells, strict=True):
        check_spread(column, *cell)
    flat = flat[np.lexsort(flat.T[::-1])]  # the order of specimens changes no bit
    measurement = measurement_covariance(backbones, names, complete)
    directions = principal_directions(flat, measurement, subtract_measurement)
    # Every kernel direction needs a few specimens of its own; population directions beyond those stay normal.
    r = 0 if is_normal else min(directions.n_population, (n - 1) // 3)
    bandwidth, score = kernel_bandwidth(directions.whitened_sample[:, :r]) if r else (1.0, None)
    r = r if bandwidth < 1.0 else 0
    centres = shrunk_centres(directions.whitened_sample[:, :r], bandwidth)
    log_constant = directions.log_determinant - 0.5 * d * LOG_TWO_PI - r * np.log(bandwidth) - np.log(len(centres))
    table = np.concatenate([[log_constant, bandwidth], directions.mean, directions.whitening.ravel(), centres.ravel()])
    spread = np.sqrt((np.linalg.inv(directions.whitening) ** 2).sum(axis=1))
    rows = tuple(
        _row(
            *cell,
            n,
            family="joint kde" if r else "joint normal",
            parameters={"mean": float(mean), "standard_deviation": float(deviation)},
            criterion="loo",
            value=None if score is None else -2.0 * score,
            candidates={},
        )
        for cell, mean, deviation in zip(cells, directions.mean, spread, strict=True)
    )
    error = "subtracted" if subtract_measurement else "kept"
    description = (
        f"Joint {f'kernel density (bandwidth {bandwidth:.2g} standard deviations)' if r else 'normal density'} over "
        f"{directions.n_population} population directions of {d} values, from {n} of {value.shape[0]} specimens (those "
        f"that reach every level). Measurement variance "
        f"{error if measurement.any() else 'not given'}. The other directions hold the model to the measured mean."
    )
    codes = np.array([JOINT, d, r, len(centres)])
    return Density("joint", levels, names, codes, table, description, rows)
