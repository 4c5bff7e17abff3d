"""The command ``diagnose``."""

from __future__ import annotations

import argparse
from typing import Any

from .._common.checks import InputError
from .._common.quiet import hush_libraries
from ..discrepancy.options import Searching
from ..inference.options import Sampling
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
from .many import add_many, diagnose_many, refuse_without_many, searching_of

DESCRIPTION = """\
Find where simulation and measurement disagree, name the missing effect, add it, and show the gap shrink.

The base model is mass x'' + viscous_damping x' + linear_stiffness x + the effects named with --base. Sets of effects
of the library are added to it and compared by evidence. The verdict is one of

    adequate      nothing is missing, within measurement error or the tolerance
    found         one set of effects is missing, named with its probability
    ambiguous     several sets explain the records, with what measurement would tell them apart
    unexplained   something is missing that no set explains
"""

EPILOG = """\
The folder holds report.html (begin there; one file, to be forwarded), result.json, model.py (the extended model as a
PyMC script), backbones.csv and .nc, posterior.nc and figures/. Examples:
  pymc-backbone diagnose ring_downs/ --mass 1.2 --out diagnosis
  pymc-backbone diagnose ring_downs/ --mass 1.2 --base cubic_stiffness --quick --out diagnosis
  pymc-backbone diagnose ring_downs/ --mass 1.2 --candidates coulomb_friction quadratic_damping jenkins \\
      --tolerance frequency=0.0005,damping=0.02 --seed 4 --out diagnosis
Many structures, a folder of records for each; begin with summary.html (docs/many_structures.md):
  pymc-backbone diagnose --many structures/ --mass 1.2 --out survey
  pymc-backbone diagnose --many structures/ --structures masses.csv --workers 8 --seed 4 --resume --out survey
"""


def add_diagnose(commands: Any) -> None:
    """Add the command ``diagnose``."""
    parser = commands.add_parser(
        "diagnose",
        help="find the effect that a model lacks",
        description=DESCRIPTION,
        epilog=EPILOG,
    )
    add_records(parser)
    add_measurement(parser, observables=False)

    model = add_model(parser, required=False)
    model.add_argument(
        "--base",
        action="extend",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="effects that the model has already, beside linear stiffness and viscous damping",
    )

    search = parser.add_argument_group("search")
    search.add_argument(
        "--candidates",
        action="extend",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="effects that may be missing (default: all but variants; `pymc-backbone effects` lists them)",
    )
    search.add_argument(
        "--max-effects",
        type=options.count("--max-effects"),
        default=Searching.max_effects,
        metavar="N",
        help="largest number of missing effects (3)",
    )
    search.add_argument(
        "--tolerance",
        type=options.tolerance,
        metavar="LIST",
        help="differences that do not matter, relative, of the offset as a share of the amplitude "
        "(frequency=0.001,damping=0.03,offset=0.01); 0: statistics alone",
    )
    search.add_argument(
        "--held-out", type=options.count("--held-out", 0), metavar="N", help="number of specimens to hold out"
    )
    search.add_argument("--quick", action="store_true", help="stop before sampling: no posterior, intervals of the fit")
    add_sampling(parser)
    add_many(parser)
    add_output(parser, required=True)
    add_talk(parser)
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> None:
    if given.many:
        diagnose_many(given)
        return
    refuse_without_many(given)
    if given.mass is None:
        raise InputError("the mass is missing: give --mass M, in kg, or kg m^2 for a rotation.")
    _diagnose(given)


def _diagnose(given: argparse.Namespace) -> None:
    hush_libraries(given.quiet)
    with shown_progress(given) as (progress, say):
        from ..workflows import diagnose as run_diagnosis

        result = run_diagnosis.diagnose(
            given.path,
            mass=given.mass[0],
            mass_error=given.mass[1],
            output=given.output,
            base=options.split(given.base),
            searching=searching_of(given),
            reading=chosen(Reading, given),
            measuring=chosen(Measuring, given),
            sampling=chosen(Sampling, given),
            overwrite=given.overwrite,
            progress=progress,
            say=say,
        )
    print_result(given, result)
