"""The p-value of `goodness_of_fit`: is it uniform when the model is right, and does it see an effect that is missing.

Level values are simulated from known parameters, and Gaussian errors with a covariance over the levels are added.
Instead of sampling, the posterior is a Gaussian about the least-squares fit inside the priors, which is what a sampler
comes to with such errors: then hundreds of fits take minutes. `whole_records` goes the whole way instead: motions of
the generator of `benchmarks/hidden_effects` (no code in common with the package), white noise, extraction, fit.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import xarray as xr
from scipy import stats

sys.path.insert(0, str(Path(__file__).parent / "hidden_effects"))

from pymc_backbone import LIBRARY, Oscillator, Record, goodness_of_fit
from pymc_backbone._common.backbone_dataset import backbone_dataset
from pymc_backbone.inference.fit_verdict import P_LIMIT, GoodnessOfFit
from pymc_backbone.inference.refit import refit
from pymc_backbone.likelihood.specimen_likelihood import whiten_specimens
from pymc_backbone.measurement.extraction import measure_batch
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.simulation.response import make_response

MASS, FREQUENCY, DAMPING_RATIO, RELEASE = 1.3, 12.0, 0.01, 0.01
LEVELS = RELEASE * np.geomspace(0.12, 0.8, 8)
ERRORS = {"frequency": 2e-4, "damping": 0.02, "offset": 0.004}
"""Standard errors: of frequency and damping relative, of the offset as it is."""
CORRELATION = 0.5
"""Of the errors of neighbouring levels."""
OBSERVABLES = ("frequency", "damping", "offset")
PRIOR_DRAWS = 200
DISTANCE = 10.0
"""Standard errors by which the nearest model without the effect misses, all level values together."""


def base_parameters() -> dict[str, float]:
    """Return stiffness and damping of the linear oscillator."""
    omega = 2.0 * np.pi * FREQUENCY
    return {"linear_stiffness": MASS * omega**2, "viscous_damping": 2.0 * DAMPING_RATIO * MASS * omega}


def covariance_of(values: np.ndarray) -> np.ndarray:
    """Return the errors' covariance (o, l, l) of one specimen's level values (o, l)."""
    size = np.array([ERRORS["frequency"], ERRORS["damping"], ERRORS["offset"]])[:, None]
    error = size * np.where(np.array([True, True, False])[:, None], np.abs(values), 1.0)
    apart = np.abs(np.arange(values.shape[1])[:, None] - np.arange(values.shape[1]))
    return error[:, :, None] * error[:, None, :] * CORRELATION**apart


def batch(
    oscillator: Oscillator, parameters: np.ndarray, rng: np.random.Generator | None, levels: np.ndarray = LEVELS
) -> xr.Dataset | None:
    """Return level values of specimens (n, p) with errors; None where a level cannot be simulated."""
    response = make_response(oscillator, levels, OBSERVABLES)
    values, covariances = [], []
    for theta in parameters:
        simulated, _, completed = response.evaluate(theta, False)
        if not completed:
            return None
        covariance = covariance_of(simulated)
        if rng is not None:
            factor = np.linalg.cholesky(covariance)
            simulated = simulated + np.einsum("okl,ol->ok", factor, rng.standard_normal(simulated.shape))
        values.append(simulated)
        covariances.append(covariance)
    names = [f"specimen_{s + 1}" for s in range(len(values))]
    return backbone_dataset(names, OBSERVABLES, levels, np.array(values), np.array(covariances), "m", [])


def gaussian_posterior(
    oscillator: Oscillator,
    data: xr.Dataset,
    bounds: dict[str, tuple[float, float]],
    start: np.ndarray,
    rng: np.random.Generator,
    kind: str,
) -> xr.DataTree:
    """Return draws about the fit of each specimen, or of all of them together, inside the priors."""
    response = make_response(oscillator, data["level"].values, [str(name) for name in data["observable"].values])
    measured, whitening, _ = whiten_specimens(data)
    low, high = np.array([bounds[name] for name in oscillator.parameter_names]).T
    fits = [refit(response, m, w, start, low, high) for m, w in zip(measured, whitening, strict=True)]
    draws = []
    for s, found in enumerate(fits):
        assert found is not None
        jacobian = whitening[s] @ response.evaluate(found.point, True)[1].reshape(measured.shape[1], -1)
        scaled = jacobian * (high - low)
        information = scaled.T @ scaled + 12.0 * np.eye(low.size)
        spread = np.linalg.cholesky(np.linalg.inv(information)) @ rng.standard_normal((low.size, PRIOR_DRAWS))
        draws.append(np.clip(found.point + (high - low) * spread.T, low, high))
    table = np.array(draws)  # (n, d, p)
    if kind == "pooled":
        table = table.mean(axis=0, keepdims=True)
    elif kind == "population":
        table = rng.permutation(table.reshape(-1, low.size))[None]
    variables = {}
    for j, name in enumerate(oscillator.parameter_names):
        if kind == "specimen":
            variables[name] = (("chain", "draw", "specimen"), table[None, :, :, j].transpose(0, 2, 1))
        else:
            variables[name] = (("chain", "draw"), table[:, :, j])
    return xr.DataTree.from_dict({"posterior": xr.Dataset(variables)})


def checked(
    oscillator: Oscillator,
    data: xr.Dataset,
    bounds: dict[str, tuple[float, float]],
    start: np.ndarray,
    rng: np.random.Generator,
    kind: str = "specimen",
) -> GoodnessOfFit:
    """Return the check of a Gaussian posterior."""
    posterior = gaussian_posterior(oscillator, data, bounds, start, rng, kind)
    return goodness_of_fit(oscillator, data, posterior, bounds, likelihood=kind, random_seed=1)


def uniformity(p_values: list[float]) -> dict[str, float]:
    """Return shares below 0.01, 0.05, 0.1 and 0.5, and the p-value of a Kolmogorov-Smirnov test against uniform."""
    p = np.array(p_values)
    shares = {f"below {limit:g}": float(np.mean(p < limit)) for limit in (0.01, 0.05, 0.1, 0.5)}
    return {"fits": p.size, **shares, "Kolmogorov-Smirnov p": float(stats.kstest(p, "uniform").pvalue)}


RIGHT_MODELS: dict[str, dict[str, float]] = {
    "linear": {},
    "cubic_stiffness": {"cubic_stiffness": 0.15 * MASS * (2.0 * np.pi * FREQUENCY) ** 2 / RELEASE**2},
    "coulomb_friction": {"friction_force": 0.005 * MASS * (2.0 * np.pi * FREQUENCY) ** 2 * RELEASE},
    "no friction, though asked": {"friction_force": 0.0},
}


def right_model(name: str, kind: str, count: int, seed: int, n_specimens: int) -> dict[str, float]:
    """Return the uniformity of the p-value where the fitted model is the one that made the data."""
    rng = np.random.default_rng([seed, *name.encode(), *kind.encode()])
    added = RIGHT_MODELS[name]
    effects = {"linear": (), "no friction, though asked": ("coulomb_friction",)}.get(name, (name,))
    oscillator = Oscillator(MASS, effects)
    true = np.array([{**base_parameters(), **added}[p] for p in oscillator.parameter_names])
    bounds = bounds_of(oscillator, true)
    p_values, passed = [], 0
    scatter = 0.0 if kind == "pooled" else 0.03
    for _ in range(count):
        parameters = true * (1.0 + scatter * rng.standard_normal((n_specimens, true.size)))
        data = batch(oscillator, parameters, rng)
        assert data is not None
        found = checked(oscillator, data, bounds, true, rng, kind)
        p_values.append(found.p_value)
        passed += found.passes
    return {**uniformity(p_values), "passed": passed / count}


def draw_effect(oscillator: Oscillator, name: str, release: float, rng: np.random.Generator) -> dict[str, float]:
    """Draw an effect from its default priors: strength over two decades below its bound, the rest between."""
    bounds = oscillator.default_bounds(release, 2.0 * np.pi * FREQUENCY)
    strength, *others = (parameter.name for parameter in LIBRARY[name].parameters)
    low, high = bounds[strength]
    side = -1.0 if low < 0.0 and rng.random() < 0.5 else 1.0
    drawn = {strength: side * (-low if side < 0.0 else high) * 10.0 ** rng.uniform(-2.0, 0.0)}
    return {**drawn, **{other: rng.uniform(*bounds[other]) for other in others}}


def power(name: str, seed: int, count: int, n_specimens: int = 3) -> dict[str, float]:
    """Return how often a linear model is refused where this effect is missing, at a distance of `DISTANCE`."""
    rng = np.random.default_rng([seed, *name.encode()])
    base = base_parameters()
    linear = Oscillator(MASS, ())
    release = 0.6 if LIBRARY[name].needs_rotation else RELEASE
    levels = LEVELS * release / RELEASE
    start = np.array([base[p] for p in linear.parameter_names])
    bounds = linear.default_bounds(release, 2.0 * np.pi * FREQUENCY)
    true = Oscillator(MASS, (name,))
    distances, p_values, refused, named = [], [], 0, 0
    for _ in range(40 * count):
        if len(p_values) == count:
            break
        drawn = {**draw_effect(true, name, release, rng), **base}
        parameters = np.array([[drawn[p] for p in true.parameter_names]] * n_specimens)
        clean = batch(true, parameters, None, levels)
        if clean is None:
            continue
        least = checked(linear, clean, bounds, start, rng)
        distance = float(np.sqrt(sum(one.chi_square for one in least.specimens)))
        if not distance >= DISTANCE:
            continue
        data = batch(true, parameters, rng, levels)
        assert data is not None
        found = checked(linear, data, bounds, start, rng)
        distances.append(distance)
        p_values.append(found.p_value)
        refused += not found.describes_specimens
        named += bool(found.sentences() and "find_missing_effect" in found.sentences()[0])
    fits = len(p_values)
    return {
        "fits": fits,
        "nearest": float(min(distances, default=np.nan)),
        "median": float(np.median(distances)) if fits else float("nan"),
        "refused": refused / fits if fits else float("nan"),
        "named first": named / fits if fits else float("nan"),
    }


SAMPLING_RATE, SECONDS, NOISE_DB = 2400.0, 2.5, 50.0


def whole_records(added: dict[str, float], quantity: str, rng: np.random.Generator, n_specimens: int = 3) -> xr.Dataset:
    """Return backbones of specimens, all the way: motion, noise, conditioning, cycles, levels."""
    from motion import simulate  # the independent generator
    from scipy.interpolate import CubicSpline
    from systems import pack

    instants = np.arange(0.0, SECONDS, 1.0 / SAMPLING_RATE)
    records = []
    for s in range(n_specimens):
        apart = 1.0 + 0.02 * rng.standard_normal(4)
        true = {**base_parameters(), **added}
        scattered = {name: value * apart[i] for i, (name, value) in enumerate(true.items())}
        values = simulate(pack({"mass": MASS, **scattered}), RELEASE, instants).displacement
        if quantity == "acceleration":
            values = CubicSpline(instants, values).derivative(2)(instants)
        noise = np.abs(values).max() / np.sqrt(2.0) * 10.0 ** (-NOISE_DB / 20.0)
        unit = {"displacement": "m", "acceleration": "m/s^2"}[quantity]
        noisy = values + noise * rng.standard_normal(values.size)
        records.append(Record(f"specimen_{s + 1}", instants, noisy, quantity=quantity, unit=unit))
    return measure_batch(records, Measuring()).backbones


def of_records(name: str, quantity: str, count: int, seed: int) -> dict[str, float]:
    """Return what the check says of whole records, of the model that made them and of a linear one."""
    rng = np.random.default_rng([seed, *name.encode(), *quantity.encode()])
    added = RIGHT_MODELS[name]
    model, linear = Oscillator(MASS, (name,) if added else ()), Oscillator(MASS, ())
    p_values, reduced, refused = [], [], 0
    for _ in range(count):
        data = whole_records(added, quantity, rng)
        for oscillator in (model, linear) if added else (model,):
            true = np.array([{**base_parameters(), **added}[p] for p in oscillator.parameter_names])
            found = checked(oscillator, data, bounds_of(oscillator, true), true, rng)
            if oscillator is model:
                p_values.append(found.p_value)
                reduced.append(found.reduced_chi_square)
            else:
                refused += not found.describes_specimens
    return {
        "batches": count,
        "median reduced chi-square": float(np.median(reduced)),
        "largest": float(np.max(reduced)),
        "smallest p": float(np.min(p_values)),
        "right model refused": float(np.mean(np.array(p_values) < P_LIMIT)),
        "linear model refused": refused / count if added else float("nan"),
    }


def bounds_of(oscillator: Oscillator, true: np.ndarray) -> dict[str, tuple[float, float]]:
    """Return default priors, wider where the truth would lie outside."""
    usual = oscillator.default_bounds(RELEASE, 2.0 * np.pi * FREQUENCY)
    return {
        name: (min(usual[name][0], 0.5 * value), max(usual[name][1], 2.0 * value))
        for name, value in zip(oscillator.parameter_names, true, strict=True)
    }


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=300, help="of the right model, each (default: 300)")
    parser.add_argument("--power", type=int, default=10, help="fits of a wrong model for each effect (default: 10)")
    parser.add_argument("--records", type=int, default=8, help="batches of whole records, each (default: 8)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    begin = time.perf_counter()
    results: dict[str, dict] = {"right": {}, "power": {}, "records": {}}
    for quantity in ("displacement", "acceleration"):
        for name in ("linear", "cubic_stiffness", "coulomb_friction"):
            if options.records:
                row = of_records(name, quantity, options.records, options.seed)
                results["records"][f"{name}, {quantity}"] = row
                print(f"{name}, {quantity}", {key: round(value, 4) for key, value in row.items()}, flush=True)
    for kind, n_specimens in (("specimen", 3), ("pooled", 3), ("population", 10)):
        for name in RIGHT_MODELS if options.fits else ():
            row = right_model(name, kind, options.fits, options.seed, n_specimens)
            results["right"][f"{name}, {kind}"] = row
            print(f"{name}, {kind}", {key: round(value, 4) for key, value in row.items()}, flush=True)
    for name in LIBRARY:
        if name in ("linear_stiffness", "viscous_damping") or not options.power:
            continue
        row = power(name, options.seed, options.power)
        results["power"][name] = row
        print(name, {key: round(value, 3) for key, value in row.items()}, flush=True)
    print(f"{time.perf_counter() - begin:.0f} s; refused means p < {P_LIMIT:g} or a specimen that stands out")
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
