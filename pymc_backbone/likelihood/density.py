"""A density over backbones: what the likelihood of a parameter vector is read from."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._common.checks import FloatArray, InputError, check_choice, check_levels, check_observables
from .density_kernel import (
    FAMILY_CODES,
    KDE,
    NORMAL,
    PRODUCT,
    UNIFORM,
    data_consistent_size,
    is_layout,
    log_density,
    log_density_batch,
    mixture_marginal,
)

__all__ = ["FAMILIES", "KINDS", "Density", "log_density"]

KINDS: tuple[str, ...] = ("product", "joint", "data_consistent")
FAMILIES: tuple[str, ...] = tuple(FAMILY_CODES)


@dataclass(frozen=True, eq=False)
class Density:
    """A density over the values of a backbone, as plain data: `fit_density` and `fit_data_consistent` make one.

    Parameters
    ----------
    kind : {"product", "joint", "data_consistent"}
        Independent marginals; one density across all levels and observables; or the ratio of such a one to what the
        priors predict.
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
    diagnostics : mapping
        What `fit_data_consistent` found out about itself.

    See Also
    --------
    fit_density : fits it.
    fit_data_consistent : fits the data-consistent one.

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
    diagnostics: Mapping[str, Any] = field(default_factory=dict, repr=False)

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
            codes, table = mixture_marginal(*self.population._joint_parts(), index)

        def pdf(values: ArrayLike) -> FloatArray:
            array = np.asarray(values, dtype=np.float64)
            flat = np.ascontiguousarray(array.reshape(-1, 1))
            result = np.empty(flat.shape[0])
            log_density_batch(codes, table, flat, result, np.empty_like(flat))
            return np.exp(result).reshape(array.shape)

        return pdf

    @property
    def population(self) -> Density:
        """The density of the measured population: for a data-consistent one, what its ratio has above the line."""
        if self.kind != "data_consistent":
            return self
        own = data_consistent_size(self.codes)
        return Density("joint", self.levels, self.observables, self.codes[6:], self.table[own:], "", self.rows)

    def standardise(self, values: ArrayLike) -> FloatArray:
        """Return values (..., o, l) as distances from the population's mean, shape (..., d).

        In standard deviations: of each value for a product, along the principal directions for the others.
        """
        array = np.asarray(values, dtype=np.float64)
        flat = array.reshape(*array.shape[:-2], -1)
        if self.kind == "product":
            draws = self.sample(2000, random_seed=0).reshape(2000, -1)
            return np.asarray((flat - draws.mean(axis=0)) / draws.std(axis=0))
        _, mean, whitening, _ = self.population._joint_parts()
        return np.asarray((flat - mean) @ whitening.T)

    def _joint_parts(self) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Return bandwidth, mean, whitening and centres of a joint density."""
        _, d, r, n = (int(code) for code in self.codes)
        parts = np.split(self.table, [2, 2 + d, 2 + d + d * d])
        return float(parts[0][1]), parts[1], parts[2].reshape(d, d), parts[3].reshape(n, r)

    def sample(self, n: int, random_seed: int | np.random.Generator | None = None) -> FloatArray:
        """Draw ``n`` independent sets of values (n, o, l) of the population."""
        rng = np.random.default_rng(random_seed)
        o, n_levels = self.shape
        if self.kind != "product":
            bandwidth, mean, whitening, centres = self.population._joint_parts()
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
            "diagnostics": dict(self.diagnostics),
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
            dict(data.get("diagnostics", {})),
        )
