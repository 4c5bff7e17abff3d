"""The model with force curves as a short PyMC script, which the user can run and edit."""

from __future__ import annotations

import json

from .._common.text import printable, unit_of
from ..discrepancy.results.curve_records import ForceCurves
from ..effects import LIBRARY
from .model_script import comment
from .output_folder import BACKBONES, CURVE_SCRIPT

_HEADER = '''\
"""The model with force curves of a study with pymc-backbone: simulated, and sampled on the measured backbones.

Run it with `python {name}`: it needs pymc_backbone {version} and {data} beside it. The curves are held but for
their sizes; each specimen has its own stiffness and damping. All of it is there to be edited.
"""

from pathlib import Path

import arviz as az
import numpy as np
import pymc as pm

from pymc_backbone import Oscillator, backbone_likelihood, read_backbones, sample, simulate_backbone

'''
_REST = """\
backbones = read_backbones(Path(__file__).resolve().with_name({data}))
names = [str(name) for name in backbones["specimen"].values]
curves = [name for name in parameters if name.startswith("tabulated_") and not name.endswith("_range")]

with pm.Model(coords={{"specimen": names}}) as model:
    sizes = {{
        "tabulated_stiffness": pm.Normal("stiffness_size", 1.0, 0.1),
        "tabulated_damping": pm.Normal("damping_size", 1.0, 0.1),
    }}
    values = dict(parameters)
    for name in curves:
        values[name] = parameters[name] * sizes[name.partition("_odd_")[0].partition("_even_")[0]]
    for name, share in (("linear_stiffness", 0.1), ("viscous_damping", 0.5)):
        low, high = sorted((parameters[name] * (1.0 - share), parameters[name] * (1.0 + share)))
        values[name] = pm.Uniform(name, low, high, dims="specimen")
    backbone_likelihood("backbone", oscillator, backbones, values)

if __name__ == "__main__":
    levels = np.asarray(backbones["level"])
    simulated = simulate_backbone(oscillator, parameters, levels)
    for row in zip(levels, simulated.frequency, simulated.damping, strict=True):
        print("amplitude {{:.5g}}: frequency {{:.6g}} Hz, logarithmic decrement {{:.5g}}".format(*row))
    posterior = sample(model, draws=500, tune=500, chains=2, step="metropolis", random_seed={seed})
    print(az.summary(posterior, ci_prob=0.95, ci_kind="hdi").to_string())
"""


def curve_script(curves: ForceCurves, seed: int, version: str, amplitude_unit: str) -> str:
    """Return the text of the script: the oscillator, every parameter of the mean specimen, a model to sample."""
    oscillator = curves.oscillator
    effects = [json.dumps(effect.name) for effect in oscillator.effects]
    own = [effect.name for effect in oscillator.effects if LIBRARY.get(effect.name) is not effect]
    lines = comment(curves.sentence)
    if own:
        lines += comment(f"The library does not have {', '.join(own)}: put your effects in place of their names.")
    lines.append(f"oscillator = Oscillator({oscillator.mass!r}, [{', '.join(effects)}])")
    lines.append("parameters = {")
    for parameter in oscillator.parameters:
        value, error = curves.parameters[parameter.name]
        note = f"+- {error:.2g}" if error else "held"
        unit = printable(unit_of(parameter.unit, amplitude_unit))
        lines.append(f"    {json.dumps(parameter.name)}: {value!r},  # [{unit}], {note}")
    lines += ["}", "", ""]
    head = _HEADER.format(name=CURVE_SCRIPT, version=printable(version), data=BACKBONES)
    return head + "\n".join(lines) + _REST.format(data=json.dumps(BACKBONES), seed=int(seed))
