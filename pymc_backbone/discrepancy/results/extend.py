"""The extended model in PyMC: the backbone of the mean specimen, Uniform priors around what was found, draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import xarray as xr
from scipy.special import stdtrit

from ..._common.backbone_dataset import FREQUENCY
from ..._common.checks import OBSERVABLES, FloatArray
from ..._common.text import unit_of
from ...effects import BASE_EFFECTS, Parameter
from ...inference.options import Sampling
from ..fitting import valleys
from ..fitting.batch import Batch
from ..fitting.curves import curve, measured, on_levels
from ..fitting.descent import is_heavy
from ..fitting.estimates import estimates_of
from ..fitting.joint_fit import Fit
from ..fitting.layout import SHAPES
from .entries import Estimate
from .study import UNMIXED

_REACH = 10.0  # standard deviations between an estimate and the ends of its prior
_LEAST = {"linear_stiffness": 0.02, "viscous_damping": 0.5}
_LEAST_SHARE = 0.5
_NINETY_FIVE = 1.96  # standard errors
_HEAVY_SHARE = 4  # fewer draws for models that take so much longer


def mean_specimen(batch: Batch, found: Fit) -> tuple[xr.Dataset, FloatArray]:
    """Return the backbone of the mean specimen, and the parameters (p,) it is expected to have.

    Each specimen's curve is moved by the difference that its own stiffness, damping and effects make in the model,
    and the mean is taken. Its covariance is that of the measurement or, where the moved curves scatter by more,
    theirs.
    """
    brought = on_levels(batch, found)
    levels = np.asarray(batch.backbones["level"])
    names = [str(name) for name in batch.backbones["observable"].values]
    rows = [OBSERVABLES.index(name) for name in names]
    vectors = np.array([brought.parameters(r) for r in range(len(batch.specimens))])
    mean = vectors.mean(axis=0)
    delta = np.zeros(found.layout.free.size)
    mean[found.layout.free] = found.layout.physical(found.centre, delta, 0.0)[0]
    reference = curve(found, mean, levels, 0.0)[rows]  # as the sampled model begins
    values, errors = measured(batch)
    own_curves = [curve(found, vectors[r], levels, term.release)[rows] for r, term in enumerate(batch.levels)]
    moved = values - np.array(own_curves) + reference
    held = np.isfinite(moved) & np.isfinite(errors)
    count = held.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        value = np.where(held, moved, 0.0).sum(axis=0) / np.where(count, count, np.nan)
        scatter = (np.where(held, moved - value, 0.0) ** 2).sum(axis=0) / np.maximum((count - 1) * count, 1)
    chosen = batch.backbones.sel(specimen=list(batch.specimens))
    covariance = np.zeros((1, len(names), levels.size, levels.size))
    for o in range(len(names)):
        total = np.zeros((levels.size, levels.size))
        for r in range(len(vectors)):
            own = np.diag(np.where(held[r, o], errors[r, o], 0.0) ** 2)
            if "covariance" in chosen:
                given = np.asarray(chosen["covariance"])[r, o]
                own = np.where(np.isfinite(given) & held[r, o][:, None] & held[r, o][None, :], given, own)
            total += own
        safe = np.maximum(count[o], 1)
        total = total / np.outer(safe, safe)
        wider = np.where(count[o] > 3, np.maximum(scatter[o] / np.maximum(np.diag(total), 1e-300), 1.0), 1.0)
        covariance[0, o] = total * np.sqrt(np.outer(wider, wider))
    keep = np.isfinite(value).all(axis=0)
    standard = np.sqrt(np.array([np.diag(covariance[0, o]) for o in range(len(names))]))[None]
    dataset = xr.Dataset(
        {
            "value": (("specimen", "observable", "level"), value[None]),
            "standard_error": (("specimen", "observable", "level"), standard),
            "covariance": (("specimen", "observable", "level", "level_other"), covariance),
        },
        coords={"specimen": ["mean specimen"], "observable": names, "level": levels, "level_other": levels},
        attrs={
            "amplitude_unit": batch.amplitude_unit,
            "notes": [],
            **{key: batch.backbones.attrs[key] for key in (FREQUENCY,) if key in batch.backbones.attrs},
        },
    )
    return dataset.isel(level=np.flatnonzero(keep), level_other=np.flatnonzero(keep)), mean


def prior_bounds(batch: Batch, found: Fit, mean: FloatArray) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Return Uniform bounds of the parameters that are inferred, and the values of those that are redundant."""
    oscillator = found.layout.oscillator
    defaults = oscillator.default_bounds(batch.amplitude, batch.angular_frequency)
    errors = {name: error for name, (_, error) in estimates_of(found).items()}
    held = dict(found.layout.held)
    if FREQUENCY not in batch.backbones["observable"].values:
        held["linear_stiffness"] = float(mean[0])  # damping per cycle alone does not tell it
    own = np.sqrt(np.nan_to_num(found.own_covariance[:, :2]).mean(axis=0))
    errors |= {"linear_stiffness": float(own[0]), "viscous_damping": float(own[1])}
    bounds = {}
    for parameter, value in zip(oscillator.parameters, mean, strict=True):
        if parameter.name in held:
            continue
        low, high = defaults[parameter.name]
        is_shape = parameter.role in SHAPES or parameter.name not in errors
        reach = max(_REACH * errors.get(parameter.name, 0.0), _LEAST.get(parameter.name, _LEAST_SHARE) * abs(value))
        if is_shape:
            bounds[parameter.name] = (low, high)
            continue
        reach = max(reach, 1e-3 * (high - low))
        bounds[parameter.name] = (max(parameter.minimum, value - reach), min(parameter.maximum, value + reach))
    return bounds, held


def _reaching(
    bounds: Mapping[str, tuple[float, float]], fitted: Mapping[str, Mapping[str, Estimate]]
) -> dict[str, tuple[float, float]]:
    """Return bounds that hold what the fit allows: a valley that parameters make up for each other along is long."""
    allowed = {name: (item.hdi_low, item.hdi_high) for group in fitted.values() for name, item in group.items()}
    wider = {}
    for name, (low, high) in bounds.items():
        least, most = allowed.get(name, (low, high))
        wider[name] = (min(low, least), max(high, most))
    return wider


@dataclass(frozen=True, eq=False)
class Inference:
    """What is known of the parameters of a model.

    Attributes
    ----------
    estimates : mapping of str to mapping of str to Estimate
        By effect, then by parameter.
    posterior : xarray.DataTree or None
        Draws; None where nothing was sampled, as are the next.
    backbone : xarray.Dataset or None
        That of the mean specimen.
    bounds : mapping of str to (float, float)
        Of the Uniform priors.
    held : mapping of str to float
        Values of the redundant parameters.
    findings : tuple of str
        What is wrong with the draws, in words.
    convergence : mapping of str to float
        Its figures, and how many draws were taken.
    """

    estimates: Mapping[str, Mapping[str, Estimate]]
    posterior: xr.DataTree | None = None
    backbone: xr.Dataset | None = None
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    convergence: Mapping[str, float] = field(default_factory=dict)


def _for_model(sampling: Sampling, found: Fit) -> Sampling:
    """Return the same sampling with fewer draws where the model takes much longer."""
    share = _HEAVY_SHARE if is_heavy(found.layout) else 1
    return replace(sampling, draws=max(sampling.draws // share, 100), tune=max(sampling.tune // share, 100))


def infer(
    batch: Batch, found: Fit, sampling: Sampling | None, progress: Callable[[str, float], None] | None = None
) -> Inference:
    """Return the parameters of a model from draws or, without ``sampling``, from the curvature of the fit."""
    if sampling is None:
        return Inference(_in_units_of(batch, estimates_from_fit(batch, found)))
    # PyMC takes seconds to import, and quick studies do without
    from ...inference.model import build_model
    from ...inference.sampling import sample

    backbone, mean = mean_specimen(batch, found)
    bounds, held = prior_bounds(batch, found, mean)
    fitted = estimates_from_fit(batch, found)
    bounds = _reaching(bounds, fitted)
    model = build_model(found.layout.oscillator, backbone, bounds=bounds, fixed=held, likelihood="pooled")
    chosen = _for_model(sampling, found)
    posterior = sample(model, progressbar=False, progress=progress, **asdict(chosen))
    estimates, said, figures = _told_by(posterior, found, held, fitted)
    return Inference(
        estimates=_in_units_of(batch, estimates),
        posterior=posterior,
        backbone=backbone,
        bounds=bounds,
        held=held,
        findings=said,
        convergence={**figures, "draws": chosen.draws, "tune": chosen.tune, "chains": chosen.chains},
    )


def _in_units_of(batch: Batch, estimates: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, Estimate]]:
    """Return estimates with the units of the motion at hand: effects are written for a straight one."""
    return {
        effect: {name: replace(item, unit=unit_of(item.unit, batch.amplitude_unit)) for name, item in group.items()}
        for effect, group in estimates.items()
    }


def _told_by(
    posterior: xr.DataTree, found: Fit, held: Mapping[str, float], fitted: Mapping[str, Mapping[str, Estimate]]
) -> tuple[Mapping[str, Mapping[str, Estimate]], tuple[str, ...], dict[str, float]]:
    """Return estimates, what is wrong with the draws, and their figures; of the fit where these did not mix."""
    from ...inference.diagnostics import findings, summarise

    table = summarise(posterior)
    figures = {"r_hat": float(table["r_hat"].max()), "ess_bulk": float(table["ess_bulk"].min())}
    said = tuple(findings(posterior))
    if figures["r_hat"] <= UNMIXED:
        return estimates_from_draws(found, posterior, held), said, figures
    unmixed = f"The draws did not mix (R-hat {figures['r_hat']:.2g}): parameters and intervals are those of the fit."
    return fitted, (unmixed, *said), figures


def estimates_from_draws(
    found: Fit, posterior: xr.DataTree, held: Mapping[str, float]
) -> dict[str, dict[str, Estimate]]:
    """Return the estimates of all parameters, by effect, from draws."""
    import arviz as az

    draws = posterior["posterior"].to_dataset()
    result: dict[str, dict[str, Estimate]] = {}
    for effect in found.layout.oscillator.effects:
        group = {}
        for parameter in effect.parameters:
            if parameter.name in held:
                value = held[parameter.name]
                group[parameter.name] = Estimate(value, 0.0, value, value, parameter.unit)
                continue
            values = np.asarray(draws[parameter.name]).ravel()
            low, high = (float(x) for x in np.asarray(az.hdi(values, prob=0.95)).ravel())
            group[parameter.name] = Estimate(float(values.mean()), float(values.std(ddof=1)), low, high, parameter.unit)
        result[effect.name] = group
    return result


def estimates_from_fit(batch: Batch, found: Fit) -> dict[str, dict[str, Estimate]]:
    """Return the estimates of all parameters, by effect: from the curvature of the fit, or along its valley."""
    values, followed = estimates_of(found), valleys.ranges(found, batch)
    count = len(batch.specimens)
    own = found.state.own[:, :2]
    oscillator = found.layout.oscillator
    held = found.layout.held
    result: dict[str, dict[str, Estimate]] = {}
    for effect in oscillator.effects:
        group = {}
        for parameter in effect.parameters:
            if effect.name in BASE_EFFECTS:
                column = oscillator.index(parameter.name)
                value = float(own[:, column].mean())
                spread = float(own[:, column].std(ddof=1)) / np.sqrt(count) if count > 1 else 0.0
                error = float(np.hypot(spread, np.sqrt(np.nan_to_num(found.own_covariance[:, column]).mean() / count)))
            elif parameter.name in held:
                value, error = held[parameter.name], 0.0
            else:
                value, error = values[parameter.name]
            reach = _NINETY_FIVE * error
            if effect.name in BASE_EFFECTS and count > 1:  # a few specimens tell their spread only roughly
                reach = float(
                    np.hypot(stdtrit(count - 1, 0.975) * spread, _NINETY_FIVE * np.sqrt(error**2 - spread**2))
                )
            low, high = max(value - reach, parameter.minimum), min(value + reach, parameter.maximum)
            group[parameter.name] = Estimate(value, error, low, high, parameter.unit)
            if parameter.name in followed:
                group[parameter.name] = _along_valley(value, followed[parameter.name], parameter)
        result[effect.name] = group
    return result


def _along_valley(value: float, allowed: valleys.Range, parameter: Parameter) -> Estimate:
    """Return an estimate whose interval is that of the valley of the fit; its deviation goes with the interval."""
    low, high = max(allowed.low, parameter.minimum), min(allowed.high, parameter.maximum)
    deviation = (high - low) / (2.0 * _NINETY_FIVE)
    return Estimate(
        float(np.clip(value, low, high)), deviation, low, high, parameter.unit,
        is_low_open=allowed.is_low_open, is_high_open=allowed.is_high_open,
    )  # fmt: skip
