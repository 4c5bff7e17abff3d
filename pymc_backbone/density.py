"""Densities over a measured population of backbones: what the likelihood of a parameter vector is read from."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from pymc_backbone._checks import (
    OBSERVABLE_UNITS,
    FloatArray,
    InputError,
    check_choice,
    check_levels,
    check_observables,
)
from pymc_backbone._density_data import check_spread, measurement_covariance, population_values
from pymc_backbone._density_joint import principal_directions
from pymc_backbone._density_kernel import (
    FAMILY_CODES,
    JOINT,
    KDE,
    LOG_TWO_PI,
    NORMAL,
    PRODUCT,
    UNIFORM,
    is_layout,
    log_density,
    log_density_batch,
    mixture_marginal,
)
from pymc_backbone._density_marginals import fit_marginal, kernel_bandwidth, shrunk_centres

__all__ = ["FAMILIES", "KINDS", "Density", "fit_density", "log_density"]

KINDS: tuple[str, ...] = ("product", "joint")
FAMILIES: tuple[str, ...] = tuple(FAMILY_CODES)
CRITERIA: tuple[str, ...] = ("bic", "aic")

_MINIMUM = {"uniform": 3, "normal": 3, "best": 3, "kde": 5, "gev": 8}
_MINIMUM_JOINT = 5


@dataclass(frozen=True, eq=False)
class Density:
    """A density over the values of a backbone, as plain data: `fit_density` makes one.

    Parameters
    ----------
    kind : {"product", "joint"}
        Independent marginals, or one density across all levels and observables.
    levels : array, shape (l,)
        Amplitude levels [m or rad].
    observables : tuple of str
        In the order frequency [Hz], damping [-], offset [-].
    codes : array of int64, shape (c,)
        Layout for the compiled `log_density`.
    table : array of float64, shape (t,)
        Numbers for the compiled `log_density`.
    description : str
        What was fitted, in words.
    rows : tuple of dict
        What `summary` returns.

    Notes
    -----
    Two densities are equal when their `digest` is. The arrays are contiguous and must not be written to.
    """

    kind: str
    levels: FloatArray
    observables: tuple[str, ...]
    codes: NDArray[np.int64]
    table: FloatArray
    description: str = ""
    rows: tuple[dict[str, Any], ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        """Bring the fields to their types and check that they belong together."""
        check_choice("kind", self.kind, KINDS)
        object.__setattr__(self, "levels", check_levels(self.levels))
        object.__setattr__(self, "observables", tuple(self.observables))
        object.__setattr__(self, "codes", np.array(self.codes, dtype=np.int64, order="C"))
        object.__setattr__(self, "table", np.array(self.table, dtype=np.float64, order="C"))
        object.__setattr__(self, "rows", tuple(self.rows))
        size = len(self.observables) * self.levels.size
        if not is_layout(self.codes, self.table.size, KINDS.index(self.kind), size):
            raise InputError(
                f"`codes` and `table` must describe a {self.kind} density of {size} values ({len(self.observables)} "
                f"observable(s) at {self.levels.size} level(s)), got {self.codes.size} codes and {self.table.size} "
                "numbers that do not. Fit the density again."
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Number of observables and of levels."""
        return len(self.observables), int(self.levels.size)

    def log_density(self, values: ArrayLike) -> FloatArray:
        """Return the log density at values (..., o, l), shape (...); -inf outside the support and at NaN."""
        return self._evaluate(values)[0]

    def gradient(self, values: ArrayLike) -> FloatArray:
        """Return the derivative of the log density at values (..., o, l), same shape; zeros where it is -inf."""
        return self._evaluate(values)[1]

    def _evaluate(self, values: ArrayLike) -> tuple[FloatArray, FloatArray]:
        array = np.asarray(values, dtype=np.float64)
        if array.ndim < 2 or array.shape[-2:] != self.shape:
            raise InputError(
                f"`values` must end in the dimensions (observable, level) = {self.shape}, got shape {array.shape}. "
                f"Evaluate {', '.join(self.observables)} at the levels of the density."
            )
        flat = np.ascontiguousarray(array.reshape(-1, array.shape[-2] * array.shape[-1]))
        result, gradients = np.empty(flat.shape[0]), np.empty_like(flat)
        log_density_batch(self.codes, self.table, flat, result, gradients)
        return result.reshape(array.shape[:-2]), gradients.reshape(array.shape)

    def marginal(self, observable: str, level_index: int) -> Callable[[ArrayLike], FloatArray]:
        """Return the probability density function of one observable at one level.

        Parameters
        ----------
        observable : str
            One of the density's observables.
        level_index : int
            Index into ``levels``; negative ones count from the end.

        Returns
        -------
        callable
            Takes values of any shape in the unit of the observable, returns the density [1 / that unit], same shape.
        """
        check_choice("observable", observable, self.observables)
        if not -self.levels.size <= level_index < self.levels.size:
            raise InputError(
                f"`level_index` must be in [{-self.levels.size}, {self.levels.size}), got {level_index}. "
                "Choose one of the levels."
            )
        index = self.observables.index(observable) * self.levels.size + level_index % self.levels.size
        if self.kind == "product":
            family, start, size = self.codes[2 + 3 * index : 5 + 3 * index]
            codes = np.array([PRODUCT, 1, family, 0, size])
            table = self.table[start : start + size].copy()
        else:
            codes, table = mixture_marginal(*self._joint_parts(), index)

        def pdf(values: ArrayLike) -> FloatArray:
            array = np.asarray(values, dtype=np.float64)
            flat = np.ascontiguousarray(array.reshape(-1, 1))
            result = np.empty(flat.shape[0])
            log_density_batch(codes, table, flat, result, np.empty_like(flat))
            return np.exp(result).reshape(array.shape)

        return pdf

    def _joint_parts(self) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Return bandwidth, mean, whitening and centres of a joint density."""
        _, d, r, n = (int(code) for code in self.codes)
        parts = np.split(self.table, [2, 2 + d, 2 + d + d * d])
        return float(parts[0][1]), parts[1], parts[2].reshape(d, d), parts[3].reshape(n, r)

    def sample(self, n: int, random_seed: int | np.random.Generator | None = None) -> FloatArray:
        """Draw ``n`` independent sets of values, shape (n, o, l)."""
        rng = np.random.default_rng(random_seed)
        o, n_levels = self.shape
        if self.kind == "joint":
            bandwidth, mean, whitening, centres = self._joint_parts()
            z = rng.standard_normal((n, o * n_levels))
            r = centres.shape[1]
            z[:, :r] = bandwidth * z[:, :r] + centres[rng.integers(centres.shape[0], size=n)]
            return np.asarray(mean + np.linalg.solve(whitening, z.T).T).reshape(n, o, n_levels)
        draws = np.empty((n, o * n_levels))
        for index in range(o * n_levels):
            family, start, size = self.codes[2 + 3 * index : 5 + 3 * index]
            p = self.table[start : start + size]
            if family == UNIFORM:
                draws[:, index] = rng.uniform(p[0], p[1], n)
            elif family == NORMAL:
                draws[:, index] = rng.normal(p[0], p[1], n)
            elif family == KDE:
                draws[:, index] = rng.choice(p[2:], n) + p[0] * rng.standard_normal(n)
            else:
                s = -np.log(rng.standard_exponential(n))
                draws[:, index] = p[0] + p[1] * (s if abs(p[2]) < 1e-200 else np.expm1(p[2] * s) / p[2])
        return draws.reshape(n, o, n_levels)

    def summary(self) -> list[dict[str, Any]]:
        """Return one row per observable and level.

        Keys: observable, unit, level, n_specimens, family, parameters (dict), criterion (name), value (of the
        criterion), candidates (dict family -> value). A joint density has one criterion for all rows: the leave-one-out
        log-likelihood of the specimens in whitened population coordinates.
        """
        return copy.deepcopy(list(self.rows))

    def digest(self) -> str:
        """Return the SHA-256 (hex) of codes, table, levels and observables."""
        digest = hashlib.sha256(json.dumps(self.observables).encode())
        for array, kind in ((self.codes, "<i8"), (self.table, "<f8"), (self.levels, "<f8")):
            digest.update(str(array.size).encode())
            digest.update(array.astype(kind).tobytes())
        return digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        """Whether the other density has the same digest."""
        return self.digest() == other.digest() if isinstance(other, Density) else NotImplemented

    def __hash__(self) -> int:
        """Hash of the digest."""
        return hash(self.digest())

    def to_dict(self) -> dict[str, Any]:
        """Return the density as a dict that JSON can hold; `from_dict` takes it back without loss."""
        return {
            "kind": self.kind,
            "levels": self.levels.tolist(),
            "observables": list(self.observables),
            "codes": self.codes.tolist(),
            "table": self.table.tolist(),
            "description": self.description,
            "rows": self.summary(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Density:
        """Return the density that `to_dict` described."""
        missing = [key for key in ("kind", "levels", "observables", "codes", "table") if key not in data]
        if missing:
            raise InputError(
                f"`data` must be a dict from `Density.to_dict`, it has no {', '.join(missing)}. Write it again."
            )
        return cls(
            data["kind"],
            data["levels"],
            check_observables(data["observables"]),
            data["codes"],
            data["table"],
            data.get("description", ""),
            tuple(data.get("rows", ())),
        )


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
    check_choice("kind", kind, KINDS)
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
            advice = ", or choose marginal='normal'" if sample.size >= _MINIMUM["normal"] else ""
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
