"""The demo: update a model with the records that ship with the package, and compare with the true parameters."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from .._common.checks import FloatArray, InputError
from ..inference.options import Comparing, Modelling, Sampling
from ..measurement.options import Measuring
from ..reporting.output_folder import read_result
from ..reporting.terminal import aligned, short
from .measure import Progress
from .update import update

SAMPLING = Sampling(draws=4000, tune=2000, random_seed=1)
TRUTH = "true_parameters.json"


def demo_folder() -> Path:
    """Return the folder of the demo batch: 24 ring-down records, and ``true_parameters.json``.

    Returns
    -------
    pathlib.Path
        Inside the installed package; read it, write elsewhere.

    See Also
    --------
    demo_parameters : what its records were made with.
    read_records : reads it.

    Examples
    --------
    >>> from pymc_backbone.workflows.demo import demo_folder
    >>> len(list(demo_folder().glob("specimen_*.csv")))
    24
    """
    return Path(str(resources.files("pymc_backbone"))) / "data" / "demo"


def demo_parameters() -> tuple[float, dict[str, FloatArray]]:
    """Return what the demo's records were simulated with: the mass, and the true parameters of every specimen.

    Returns
    -------
    mass : float
        [kg], the same for all specimens.
    parameters : dict of str to (n,) array
        By name of the parameter, in SI units, one value for each specimen.

    See Also
    --------
    demo_folder : the records.

    Examples
    --------
    >>> mass, parameters = demo_parameters()
    >>> mass, len(parameters["cubic_stiffness"])
    (1.0, 24)
    """
    data = json.loads((demo_folder() / TRUTH).read_text(encoding="utf-8"))
    specimens = data["specimens"]
    return float(data["mass"]), {
        name: np.array([specimen[name] for specimen in specimens]) for name in data["distributions"]
    }


def run_demo(
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    say: Callable[[str], None] = print,
    sampling: Sampling = SAMPLING,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Infer stiffness, damping and cubic stiffness of the demo batch, and print them beside the true ones.

    Parameters
    ----------
    output : path-like
        Output folder. The output of an earlier demo is replaced; any other folder must be empty.
    overwrite : bool, optional
        Whether any other folder may hold something already.
    say : callable, optional
        Called with each line of progress; ``print`` by default.
    sampling : Sampling, optional
        Draws, chains, step, seed.
    progress : callable, optional
        Called with the stage and the fraction done.

    Returns
    -------
    dict
        What ``result.json`` holds.
    """
    mass, truth = demo_parameters()
    say("24 ring-down records of nominally equal specimens, simulated with known parameters (not by this program).\n")
    result = update(
        demo_folder(),
        Modelling(mass, ["cubic_stiffness"]),
        measuring=Measuring(observables=["frequency", "damping"]),
        comparing=Comparing(density="joint"),
        sampling=sampling,
        output=output,
        overwrite=overwrite or _is_demo(output),
        command="demo",
        true_values=truth,
        progress=progress,
        say=say,
    )
    say("\n" + compare_with_truth(result["parameters"], truth))
    figures = Path(output) / "figures"
    say(
        f"\nWhere to look: {figures / 'predictive.png'} (measured against simulated), "
        f"{figures / 'prior_posterior.png'} (with the true values), {Path(output) / 'result.json'} (all numbers)."
    )
    return result


def compare_with_truth(parameters: Mapping[str, Mapping[str, Any]], truth: Mapping[str, FloatArray]) -> str:
    """Lay out, for each parameter, the true mean and scatter over the specimens beside the inferred ones."""
    rows = [("parameter", "unit", "true mean", "inferred mean", "true sd", "inferred sd", "true values in 95 % HDI")]
    for name, values in truth.items():
        entry = parameters[name]
        inside = int(np.sum((values >= entry["hdi_low"]) & (values <= entry["hdi_high"])))
        rows.append(
            (
                name,
                entry["unit"],
                short(float(values.mean())),
                short(entry["mean"]),
                short(float(values.std(ddof=1))),
                short(entry["sd"]),
                f"{inside} of {values.size}",
            )
        )
    return "True against inferred, over the specimens:\n" + aligned(rows)


def _is_demo(output: str | os.PathLike[str]) -> bool:
    try:
        return bool(read_result(output).get("command") == "demo")
    except InputError:
        return False
