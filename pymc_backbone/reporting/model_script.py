"""The extended model of a study as a short PyMC script, which the user can run and edit.

The script reads the backbones it was sampled on beside it and builds, variable by variable, what `build_model` builds,
so that the same seed gives the same draws. No text from a file gets into it as code: names are checked identifiers or
written with ``json.dumps``, sentences are comments on one line.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .._common.backbone_dataset import typical_frequency
from .._common.checks import OBSERVABLES
from .._common.text import printable, unit_of
from ..discrepancy.results.study import Study
from ..effects import LIBRARY
from ..inference.options import LIKELIHOODS, STEPS
from ..oscillator import Oscillator
from .output_folder import BACKBONES, MEAN_BACKBONE

HEADER = '''\
"""{title}

Run it with `python model.py`: it needs pymc_backbone {version} and {data} beside it, and prints the posterior
of every parameter with its 95 % highest-density interval. Priors, effects and sampler are there to be edited.
"""

from pathlib import Path

import arviz as az
import pymc as pm

from pymc_backbone import {imports}

'''


def model_script(study: Study, version: str) -> str:
    """Return the text of ``model.py``: the extended model, or the base model where nothing was added.

    Parameters
    ----------
    study : Study
        Its ``settings`` decide the likelihood (``likelihood``, ``density``, ``marginal``, ``observables``), parameters
        that were held (``fixed``) and the sampler (``draws``, ``tune``, ``chains``, ``step``, ``sampling_seed``;
        without the last one the study's own seed).
    version : str
        Of this package.

    Returns
    -------
    str
        Python source.
    """
    model = study.base if study.extended is None else study.extended
    settings = dict(study.settings)
    wanted = str(settings.get("likelihood", "specimen"))
    data = sampled_backbones(study)
    likelihood = _likelihood(wanted, data.sizes["specimen"])
    own = [effect.name for effect in model.effects if LIBRARY.get(effect.name) is not effect]
    imports = ["Oscillator", "backbone_likelihood", "read_backbones", "sample"]
    if likelihood == "population":
        imports.append("fit_density")
    title = "The extended model" if study.extended is not None else "The base model, to which nothing was added"
    parts = [
        HEADER.format(
            title=f"{title} of a study with pymc-backbone.",
            version=printable(version),
            data=BACKBONES if study.posterior_backbone is None else MEAN_BACKBONE,
            imports=", ".join(sorted(imports, key=lambda name: (name[0].islower(), name))),
        ),
        _verdict(study),
        _data(study, settings),
        _oscillator(model, own),
        _model(model, study, likelihood, wanted, settings),
        _sampling(study, settings),
    ]
    return "".join(parts)


def sampled_backbones(study: Study) -> xr.Dataset:
    """Return the backbones that the posterior of a study was sampled on."""
    return study.backbones if study.posterior_backbone is None else study.posterior_backbone


def _verdict(study: Study) -> str:
    return "\n".join(comment(f"{study.verdict.capitalize()}: {study.sentence}")) + "\n\n"


def comment(text: str) -> list[str]:
    """Return a text broken into comment lines; nothing in it can end the comment."""
    safe = "".join(char if char.isascii() or char.isprintable() else " " for char in printable(text))
    return [f"# {line}" for line in textwrap.wrap(safe, 110)]


def _data(study: Study, settings: Mapping[str, Any]) -> str:
    held = [str(name) for name in sampled_backbones(study)["observable"].values]
    chosen = settings.get("observables")
    name = BACKBONES if study.posterior_backbone is None else MEAN_BACKBONE
    lines = [f'backbones = read_backbones(Path(__file__).resolve().with_name("{name}"))']
    if study.posterior_backbone is not None:
        lines.insert(0, "# The backbone of the mean specimen: each specimen's own stiffness and damping are taken out.")
    used = [name for name in OBSERVABLES if name in held and (not chosen or name in chosen)]
    if used != held:
        lines.append(f"backbones = backbones.sel(observable={json.dumps(used)})")
    return "\n".join(lines) + "\n"


def _oscillator(model: Oscillator, own: list[str]) -> str:
    lines = []
    names = [json.dumps(effect.name) for effect in model.effects]
    if own:
        lines += [
            "",
            "# The library of pymc_backbone does not have these effects: import yours, and put it in place of None.",
            f"OWN_EFFECTS = {{{', '.join(f'{json.dumps(name)}: None' for name in own)}}}",
            "for name, effect in OWN_EFFECTS.items():",
            "    if effect is None:",
            '        raise SystemExit(f"model.py: import your effect {name} and enter it in OWN_EFFECTS.")',
        ]
        names = [f"OWN_EFFECTS[{name}]" if json.loads(name) in own else name for name in names]
    lines.append(f"oscillator = Oscillator({model.mass!r}, [{', '.join(names)}])")
    return "\n".join(lines) + "\n\n"


def _model(model: Oscillator, study: Study, likelihood: str, wanted: str, settings: Mapping[str, Any]) -> str:
    fixed = {name: float(value) for name, value in dict(settings.get("fixed") or {}).items()}
    bounds = _bounds(model, study)
    lines = []
    if wanted not in (*LIKELIHOODS, likelihood):
        lines += comment(f"The study used the likelihood {wanted!r}; this script gives each specimen its own values.")
    data, moved_in = "backbones", study.amplitude_unit
    if likelihood == "population":
        kind, marginal = str(settings.get("density", "product")), str(settings.get("marginal", "best"))
        lines.append(f"density = fit_density(backbones, kind={json.dumps(kind)}, marginal={json.dumps(marginal)})")
        data = "density"
    each = likelihood == "specimen"
    coordinates = 'coords={"specimen": backbones["specimen"].values}' if each else ""
    lines.append(f"with pm.Model({coordinates}) as model:")
    lines.append("    # Uniform priors, in SI units" + ("; each specimen has its own value." if each else "."))
    lines.append("    parameters = {")
    for parameter in model.parameters:
        name, unit = parameter.name, printable(unit_of(parameter.unit, moved_in))
        if name in fixed:
            lines.append(f"        {json.dumps(name)}: {fixed[name]!r},  # [{unit}], held")
            continue
        low, high = bounds[name]
        dims = ', dims="specimen"' if each else ""
        prior = f"pm.Uniform({json.dumps(name)}, {low!r}, {high!r}{dims})"
        lines.append(f"        {json.dumps(name)}: {prior},  # [{unit}]")
    lines += ["    }", f'    backbone_likelihood("backbone", oscillator, {data}, parameters)']
    return "\n".join(lines) + "\n\n"


def _sampling(study: Study, settings: Mapping[str, Any]) -> str:
    step = settings.get("step", "metropolis")
    lines = []
    if step not in STEPS:
        lines.append("# The study was sampled with a step of the user's own; this is the package's.")
        step = "metropolis"
    seed = settings.get("sampling_seed")
    arguments = [
        "model",
        *(f"{name}={int(settings.get(name, default))}" for name, default in _SAMPLER.items()),
        f"step={json.dumps(step)}",
        f"random_seed={int(study.seed if seed is None else seed)}",
    ]
    lines += [
        'if __name__ == "__main__":',
        f"    posterior = sample({', '.join(arguments)})",
        '    table = az.summary(posterior, ci_prob=0.95, ci_kind="hdi", round_to="none")',
        '    print(table.to_string(float_format="{:.5g}".format))',
        '    posterior.to_netcdf(Path(__file__).resolve().with_name("posterior_again.nc"), engine="h5netcdf")',
    ]
    return "\n".join(lines) + "\n"


_SAMPLER = {"draws": 2000, "tune": 1000, "chains": 4}


def _likelihood(wanted: str, specimens: int) -> str:
    """Return the likelihood of the script: a single specimen is pooled, as in `build_model`."""
    if wanted == "population":
        return wanted
    return "pooled" if wanted == "pooled" or specimens == 1 else "specimen"


def _bounds(model: Oscillator, study: Study) -> dict[str, tuple[float, float]]:
    """Return the bounds of the sampled model; where nothing was sampled, the defaults that `build_model` takes."""
    held = {name: (float(low), float(high)) for name, (low, high) in study.posterior_bounds.items()}
    if all(name in held for name in model.parameter_names):
        return held
    backbones = sampled_backbones(study)
    levels = np.asarray(backbones["level"], dtype=float)
    frequency = typical_frequency(backbones)
    default = model.default_bounds(float(levels[-1]), 2.0 * math.pi * frequency)
    return {name: held.get(name, (float(low), float(high))) for name, (low, high) in default.items()}
