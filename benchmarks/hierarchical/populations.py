"""Populations of Duffing oscillators (case 1 of the source paper), and their backbones as a 50 dB record shows them."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.stats import truncnorm

from pymc_backbone import backbones_at_levels, condition, extract_cycles, simulate_population, simulate_waveform
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.paper.cases import get_case

CASE = get_case("1")
OSCILLATOR = CASE.model
NAMES = OSCILLATOR.parameter_names
MEAN, SD = (np.array([CASE.true[name][i] for name in NAMES]) for i in (0, 1))
DAMPING = NAMES.index("viscous_damping")
RELEASE = 1.3  # of the higher of two levels
DECIBEL = 50.0
SAMPLES = 30  # a cycle, after the release
LONGEST = 9000  # cycles of a record: of a specimen that hardly loses energy, the lower level is not waited for


def draw_population(kind: str, n: int, rng: np.random.Generator, correlation: float = 0.0) -> np.ndarray:
    """Return parameters (n, 3); a Normal population has no negative damping, and its stiffnesses may be correlated."""
    if kind == "uniform":
        return CASE.draw(n, rng)
    standard = rng.standard_normal((n, 3))
    standard[:, 2] = correlation * standard[:, 0] + np.sqrt(1.0 - correlation**2) * standard[:, 2]
    standard[:, DAMPING] = truncnorm.rvs(-MEAN[DAMPING] / SD[DAMPING], np.inf, size=n, random_state=rng)
    return MEAN + SD * standard


def true_moments(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of the population, not of a draw of it."""
    mean, sd = MEAN.copy(), SD.copy()
    if kind == "normal":
        cut = truncnorm(-MEAN[DAMPING] / SD[DAMPING], np.inf, loc=MEAN[DAMPING], scale=SD[DAMPING])
        mean[DAMPING], sd[DAMPING] = cut.mean(), cut.std()
    return mean, sd


def extract(parameters: np.ndarray, rng: np.random.Generator, levels: np.ndarray) -> xr.Dataset:
    """Return backbones of simulated 50 dB records through the package's own extraction.

    One record for each pair of levels, released above it: over the whole range the frequency changes fourfold, and the
    extraction takes the end of one such record for noise.
    """
    parts = []
    for pair in levels.reshape(-1, 2):
        release, cycles = RELEASE * pair[1], []
        for i, theta in enumerate(parameters):
            frequency = np.sqrt(theta[0] + theta[2] * release**2) / (2.0 * np.pi)
            end = min(np.log(release / (0.5 * pair[0])) / (0.5 * theta[DAMPING]), LONGEST / frequency)
            time = np.arange(0.0, end, 1.0 / (SAMPLES * frequency))
            clean = simulate_waveform(OSCILLATOR, theta, time, release).displacement
            noisy = clean + release * 10.0 ** (-DECIBEL / 20.0) * rng.standard_normal(time.size)
            cycles.append(extract_cycles(condition(Record(f"specimen_{i + 1}", time, noisy))))
        parts.append(backbones_at_levels(cycles, pair))
    covariance = np.zeros((len(parameters), 2, levels.size, levels.size))
    for k, part in enumerate(parts):
        covariance[:, :, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = part["covariance"]
    joined = xr.concat([part.drop_vars(["covariance", "level_other"]) for part in parts], "level")
    return joined.assign(covariance=((*joined["value"].dims, "level_other"), covariance))


def template(levels: np.ndarray = CASE.levels) -> np.ndarray:
    """Return the covariance (observable, level, level) of level values that one extraction at 50 dB has."""
    data = extract(MEAN[None], np.random.default_rng(0), levels)
    return np.asarray(data["covariance"])[0]


def measure(parameters: np.ndarray, covariance: np.ndarray, rng: np.random.Generator, levels=CASE.levels) -> xr.Dataset:
    """Return backbones of specimens with Gaussian level errors of a given covariance (observable, level, level)."""
    data = simulate_population(OSCILLATOR, parameters, levels)
    n = len(parameters)
    noise = np.einsum("okl,sol->sok", np.linalg.cholesky(covariance), rng.standard_normal(data["value"].shape))
    error = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    dims = data["value"].dims
    return data.assign(
        value=(dims, np.asarray(data["value"]) + noise),
        standard_error=(dims, np.tile(error, (n, 1, 1))),
        covariance=((*dims, "level_other"), np.tile(covariance, (n, 1, 1, 1))),
    )
