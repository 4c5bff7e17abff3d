"""The commands ``extract`` and ``update``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .._common.quiet import hush_libraries
from ..inference.options import HIERARCHICAL, Comparing, Keeping, Modelling, Sampling
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from . import options
from .common import (
    add_measurement,
    add_model,
    add_output,
    add_records,
    add_sampling,
    add_talk,
    chosen,
    print_result,
    shown_progress,
)

LIKELIHOODS = ("auto", "population", "specimen", "pooled", "hierarchical")
POPULATIONS = ("correlated", "normal", "uniform")
HIERARCHICAL_STEP = "nutpie"
STORED_STEP = "nuts"  # nutpie keeps its state to itself
DENSITIES = ("product", "joint", "data_consistent")
MARGINALS = ("best", "uniform", "normal", "kde", "gev")

EXTRACT_DESCRIPTION = """\
Turn ring-down records into backbones: amplitude, frequency, damping and offset per cycle, then their values with
standard errors at a few amplitude levels that all specimens share.

RECORDS is a file or a folder; each file is one specimen, with time (or a rate) and a channel of displacement, velocity
or acceleration. The release is found, slow drift and a sensor's offset are removed, velocity and acceleration are
integrated, cycles that sink into the noise are dropped; what was done is said in the notes.
"""

EXTRACT_EPILOG = """\
The folder holds backbones.csv, backbones.nc, result.json and figures/. Examples:
  pymc-backbone extract ring_downs/ --out backbones
  pymc-backbone extract ring_downs/ --band 90:160 --levels 8 --out backbones
  pymc-backbone extract run_7.mat --columns time=t,acc_z --unit g --out run_7
  pymc-backbone extract run_7.csv --start 0.35 --levels 0.002,0.005,0.01 --observables frequency,offset --out run_7
"""

UPDATE_DESCRIPTION = """\
Infer the parameters of an oscillator from ring-down records:

    mass x'' + viscous_damping x' + linear_stiffness x + the effects named with --effect = 0

Backbones are simulated with the same definition of a cycle as the measured ones and compared at the same amplitude
levels. Every parameter has a uniform prior, scaled with the records unless --prior says otherwise.
"""

UPDATE_EPILOG = """\
The folder holds result.json (everything in numbers and words), summary.csv, backbones.csv and .nc, posterior.nc (all
draws, for ArviZ), report.html and figures/. Read the findings first: they say if the model fits, if the chains agree,
and if the data say anything about each parameter. Examples:
  pymc-backbone update ring_downs/ --mass 1.2 --effect cubic_stiffness --out result
  pymc-backbone update ring_downs/ --mass 1.2 --effect cubic_stiffness --effect coulomb_friction \\
      --prior cubic_stiffness=0:1e7 --fix viscous_damping=0.8 --density joint --seed 4 --out result
  pymc-backbone update ring_downs/ --mass 1.2 --step nuts --seed 4 --store draws --resume --out result
  pymc-backbone update ring_downs/ --mass 1.2 --effect cubic_stiffness --likelihood hierarchical --out batch
  pymc-backbone update backbones.csv --backbones --mass 1.2 --effect quadratic_damping --step nutpie --out result
"""


def add_extract(commands: Any) -> None:
    """Add the command ``extract``."""
    parser = commands.add_parser(
        "extract",
        help="turn ring-down records into backbones",
        description=EXTRACT_DESCRIPTION,
        epilog=EXTRACT_EPILOG,
    )
    add_records(parser, tables=False)
    add_measurement(parser)
    add_output(parser, required=True)
    add_talk(parser)
    parser.set_defaults(run=_extract)


def add_update(commands: Any) -> None:
    """Add the command ``update``."""
    parser = commands.add_parser(
        "update",
        help="infer the parameters of a model from records",
        description=UPDATE_DESCRIPTION,
        epilog=UPDATE_EPILOG,
    )
    add_records(parser)
    add_measurement(parser)

    model = add_model(parser)
    model.add_argument(
        "--effect",
        dest="effects",
        action="append",
        default=[],
        metavar="NAME",
        help="add a physical effect; may be repeated (`pymc-backbone effects` lists them)",
    )
    model.add_argument(
        "--prior",
        dest="priors",
        action="append",
        default=[],
        type=options.prior,
        metavar="NAME=LOW:HIGH",
        help="bounds of a parameter's uniform prior, in SI units; may be repeated (default: scaled with the records)",
    )
    model.add_argument(
        "--fix",
        dest="fixed",
        action="append",
        default=[],
        type=options.fixed,
        metavar="NAME=VALUE",
        help="hold a parameter at a value; may be repeated",
    )

    likelihood = parser.add_argument_group("likelihood")
    likelihood.add_argument(
        "--likelihood",
        choices=LIKELIHOODS,
        default=Comparing.likelihood,
        help="population: the parameter distribution over the batch, against the density of its backbones; specimen: "
        "each specimen its own parameters; pooled: one parameter set for all; hierarchical: each specimen its own, "
        "from a population whose mean, spread and correlation are inferred (of 3 specimens at least); auto: "
        "population from 8 specimens, else specimen",
    )
    likelihood.add_argument(
        "--population",
        choices=POPULATIONS,
        default=Comparing.population,
        help="family of the hierarchical model's population: Normal with correlated or independent parameters, or "
        "Uniform (default: correlated)",
    )
    likelihood.add_argument(
        "--density",
        choices=DENSITIES,
        default=Comparing.density,
        help="population density: independent at each level (product, as in arXiv:2410.11902; recovers too little "
        "scatter), joint over the levels, or data_consistent: over what the priors predict (default: product)",
    )
    likelihood.add_argument(
        "--marginal",
        choices=MARGINALS,
        default=Comparing.marginal,
        help="family of the density at each level (default: best by information criterion)",
    )

    add_sampling(parser, step_of_hierarchical=HIERARCHICAL_STEP)
    kept = parser.add_argument_group("runs that survive")
    kept.add_argument(
        "--store",
        type=Path,
        metavar="DIR",
        help="keep draws and the sampler's state on disk as they come; Ctrl-C then ends with what was drawn (not for "
        "--step nutpie)",
    )
    kept.add_argument(
        "--resume",
        action="store_true",
        help="continue the run in --store with the draws it would have had; begin one where there is none",
    )
    add_output(parser, required=False)
    add_talk(parser)
    parser.set_defaults(run=_update)


def _extract(given: argparse.Namespace) -> None:
    with shown_progress(given, delay=1.5) as (progress, say):
        from ..workflows import extract as run

        result = run.extract(
            given.path,
            output=given.output,
            reading=chosen(Reading, given),
            measuring=chosen(Measuring, given),
            overwrite=given.overwrite,
            progress=progress,
            say=say,
        )
    print_result(given, result)


def _update(given: argparse.Namespace) -> None:
    hush_libraries(given.quiet)
    if given.step is None:
        of_many = HIERARCHICAL_STEP if given.store is None else STORED_STEP
        given.step = of_many if given.likelihood == HIERARCHICAL else Sampling.step
    modelling = Modelling(
        given.mass[0],
        options.split(given.effects),
        options.once("--prior", given.priors),
        options.once("--fix", given.fixed),
        given.mass[1],
    )
    with shown_progress(given, delay=1.5) as (progress, say):
        from ..workflows import update as run

        result = run.update(
            given.path,
            modelling,
            reading=chosen(Reading, given),
            measuring=chosen(Measuring, given),
            comparing=chosen(Comparing, given),
            sampling=chosen(Sampling, given),
            keeping=chosen(Keeping, given),
            output=given.output,
            overwrite=given.overwrite,
            progress=progress,
            say=say,
        )
    print_result(given, result)
    if result.get("interrupted"):
        raise KeyboardInterrupt
