"""Level values of a batch as the check of the fit takes them, and each of them against draws of the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.stats import chi2
from scipy.stats import t as student

from .._common.checks import FloatArray
from ..likelihood.specimen_likelihood import whiten_specimens
from .fit_verdict import SPECIMEN_LIMIT, FitEntry, Narrow

_DISPLACED = 1.0  # standard deviations of the measured population
_NARROW = 4.0  # times the variance of the simulated population: what the measured one has more is said


@dataclass(frozen=True, eq=False)
class LevelValues:
    """Level values of all specimens, and what makes their errors independent and of unit size."""

    names: tuple[str, ...]
    observables: tuple[str, ...]
    levels: FloatArray
    values: FloatArray  # (n, o, l)
    measured: FloatArray  # (n, d), 0 where there is none
    whitening: FloatArray  # (n, d, d)
    has_errors: bool
    noise: FloatArray | None = None  # (n, d, d), of whitened residuals; None: the identity

    @classmethod
    def of(cls, data: xr.Dataset) -> LevelValues:
        """Return those of a Dataset; without standard errors their spread over the specimens stands for a unit."""
        values = np.asarray(data["value"], dtype=float)
        held = np.isfinite(values)
        errors = np.asarray(data["standard_error"], dtype=float) if "standard_error" in data else np.full(values.shape,
                                                                                                    np.nan)  # fmt: skip
        has_errors = bool((np.isfinite(errors) & (errors > 0.0))[held].all())
        if has_errors:
            measured, whitening, _ = whiten_specimens(data)
            noise = _noise(data, whitening)
        else:
            noise = None
            flat = values.reshape(len(values), -1)
            spread = np.nanstd(flat, axis=0)
            spread = np.where(spread > 0.0, spread, np.maximum(np.abs(np.nanmean(flat, axis=0)), 1e-12))
            measured = np.nan_to_num(flat)
            whitening = np.array([np.diag(np.where(np.isfinite(row), 1.0 / spread, 0.0)) for row in flat])
        return cls(
            tuple(str(name) for name in data["specimen"].values),
            tuple(str(name) for name in data["observable"].values),
            np.asarray(data["level"], dtype=float),
            values,
            measured,
            whitening,
            has_errors,
            noise,
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of specimens, observables and levels."""
        return len(self.names), len(self.observables), self.levels.size

    def position(self, observable: str, level: float) -> tuple[int, int]:
        """Return where a value stands in (o, l)."""
        return self.observables.index(observable), int(np.argmin(np.abs(self.levels - level)))

    def sizes(self) -> list[int]:
        """Count the level values of every specimen."""
        return [int(np.isfinite(one).sum()) for one in self.values]


def _noise(data: xr.Dataset, whitening: FloatArray) -> FloatArray | None:
    """Return what noise alone makes of whitened level values (n, d, d); None where that is all there is."""
    if "noise_covariance" not in data:
        return None
    given = np.nan_to_num(np.asarray(data["noise_covariance"], dtype=float))  # (n, o, l, l)
    n, observables, levels, _ = given.shape
    whole = np.zeros((n, observables, levels, observables, levels))
    for o in range(observables):
        whole[:, o, :, o] = given[:, o]
    return np.asarray(whitening @ whole.reshape(n, observables * levels, -1) @ np.swapaxes(whitening, 1, 2))


def compare_values(data: xr.Dataset, predicted: FloatArray, scatter: FloatArray | None) -> list[FitEntry]:
    """Compare level values with draws; without ``scatter`` their mean with the simulated distribution."""
    values = np.asarray(data["value"], dtype=float)
    errors = np.asarray(data["standard_error"], dtype=float) if "standard_error" in data else np.zeros_like(values)
    levels = np.asarray(data["level"], dtype=float)
    names = [str(name) for name in data["specimen"].values]
    entries = []
    for o, observable in enumerate(map(str, data["observable"].values)):
        for k, level in enumerate(levels):
            if scatter is None:
                here = values[:, o, k][np.isfinite(values[:, o, k])]
                if here.size < 2:
                    continue
                middle, low, high, spread, mean = _spread(predicted[0, :, o, k])
                of_mean = float(here.std(ddof=1) / np.sqrt(here.size))
                z = (here.mean() - mean) / max(of_mean, 1e-300)
                entries.append(
                    FitEntry(
                        None, observable, float(level), float(here.mean()), of_mean, middle, low, high,
                        float(here.std(ddof=1)), float(z),
                    )
                )  # fmt: skip
                continue
            for s, name in enumerate(names):
                if not np.isfinite(values[s, o, k]):
                    continue
                middle, low, high, spread, mean = _spread(predicted[s if len(predicted) > 1 else 0, :, o, k])
                error, own = float(errors[s, o, k]), float(scatter[o, k])
                variance = np.nan_to_num(error) ** 2 + spread**2 + own**2
                z = (values[s, o, k] - middle) / max(np.sqrt(variance), 1e-300)
                entries.append(
                    FitEntry(
                        name, observable, float(level), float(values[s, o, k]), error, middle, low, high, own, float(z)
                    )
                )
    return entries


def find_displaced(entries: Sequence[FitEntry], batch: LevelValues) -> tuple[FitEntry, ...]:
    """Return where the simulated mean lies beside the measured one: far for the population, and not by chance."""
    found = []
    for entry in entries:
        count = int(np.isfinite(batch.values[:, *batch.position(entry.observable, entry.level)]).sum())
        chance = len(entries) * 2.0 * float(student.sf(abs(entry.z), count - 1))
        if chance < SPECIMEN_LIMIT and abs(entry.measured - entry.predicted) > _DISPLACED * entry.scatter:
            found.append(entry)
    return tuple(sorted(found, key=lambda entry: -abs(entry.z)))


def find_narrow(data: xr.Dataset, predicted: FloatArray) -> tuple[Narrow, ...]:
    """Return where draws (1, d, o, l) scatter less than half as much as the specimens do, and not by chance.

    The chance is that of a sample variance of normal values; that of the measurement is taken out.
    """
    values = np.asarray(data["value"], dtype=float)
    errors = np.asarray(data["standard_error"], dtype=float) if "standard_error" in data else np.zeros_like(values)
    limit = SPECIMEN_LIMIT / (values.shape[1] * values.shape[2])
    found = []
    for o, observable in enumerate(map(str, data["observable"].values)):
        for k, level in enumerate(np.asarray(data["level"], dtype=float)):
            held = np.isfinite(values[:, o, k])
            drawn = predicted[0, :, o, k][np.isfinite(predicted[0, :, o, k])]
            if held.sum() < 3 or drawn.size < 2:
                continue
            measured, error = float(values[held, o, k].var(ddof=1)), float(np.nanmean(errors[held, o, k] ** 2))
            simulated, freedom = float(drawn.var(ddof=1)), int(held.sum()) - 1
            own = measured - np.nan_to_num(error)
            expected = simulated + np.nan_to_num(error)
            if own > _NARROW * simulated and freedom * measured > chi2.isf(limit, freedom) * expected:
                found.append(Narrow(observable, float(level), float(np.sqrt(own)), float(np.sqrt(simulated))))
    return tuple(sorted(found, key=lambda one: one.simulated / one.measured))


def _spread(drawn: FloatArray) -> tuple[float, float, float, float, float]:
    """Return median, ends of the 95 % interval, standard deviation and mean of what could be simulated."""
    here = drawn[np.isfinite(drawn)]
    if not here.size:
        return (float("nan"),) * 5
    low, middle, high = np.percentile(here, [2.5, 50.0, 97.5])
    return float(middle), float(low), float(high), float(here.std(ddof=1)) if here.size > 1 else 0.0, float(here.mean())
