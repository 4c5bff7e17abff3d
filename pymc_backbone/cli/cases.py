"""The command ``cases``."""

from __future__ import annotations

import argparse
import os
from typing import Any

from .._common.quiet import hush_libraries
from . import options
from .common import add_output, add_talk, print_result, shown_progress

NAMES = ("1", "2", "3", "4", "5", "single", "beam", "all")
LIKELIHOODS = ("product", "joint", "data_consistent", "all")

DESCRIPTION = """\
Run the systems of the source paper (arXiv:2410.11902) and set the results beside its published numbers.

A population of specimens is drawn, its backbones are simulated, a density is fitted to them, and PyMC samples the
parameters of the model:

    1       Duffing oscillator                  2       dry friction
    3       quadratic damping, cubic stiffness  4       Bouc-Wen hysteresis
    5       Bouc-Wen data, polynomial model     single  one target, measured repeatedly
    beam    cantilever between electromagnets   all     all of them

Three likelihoods: product, the paper's, takes the levels for independent; joint knows that they belong together;
data_consistent divides by what the priors predict, and recovers the population's own distribution.
"""

EPILOG = """\
The folder holds cases.md (tables: true, prior, published, ours), cases.json and figures/. Examples:
  pymc-backbone cases 1
  pymc-backbone cases all --out cases
  pymc-backbone cases 3 --likelihood all --out case_3
  pymc-backbone cases 2 --observables frequency
"""


def add_cases(commands: Any) -> None:
    """Add the command ``cases``."""
    parser = commands.add_parser(
        "cases", help="run the source paper's systems beside its numbers", description=DESCRIPTION, epilog=EPILOG
    )
    parser.add_argument("names", nargs="*", default=["all"], metavar="CASE", help=f"{', '.join(NAMES)} (all)")
    model = parser.add_argument_group("model")
    model.add_argument(
        "--likelihood", nargs="+", choices=LIKELIHOODS, default=["product"], metavar="KIND",
        help=f"{', '.join(LIKELIHOODS)} (product)",
    )  # fmt: skip
    model.add_argument(
        "--observables", type=options.observables, metavar="LIST",
        help="what to compare (default: frequency,damping; for the beam frequency)",
    )  # fmt: skip
    model.add_argument(
        "--specimens", type=options.count("--specimens"), default=200, metavar="N", help="size of the population (200)"
    )
    sampler = parser.add_argument_group("sampling")
    words = {"--draws": (5000, "per chain, kept"), "--tune": (2000, "per chain, dropped"), "--chains": (4, "number")}
    for name, (default, meaning) in words.items():
        least = 0 if name == "--tune" else 1
        sampler.add_argument(
            name, type=options.count(name, least), default=default, metavar="N", help=f"{meaning} ({default})"
        )
    sampler.add_argument(
        "--seed", dest="random_seed", type=options.count("--seed", 0), default=1, metavar="N", help="(1)"
    )
    sampler.add_argument(
        "--workers", type=options.count("--workers"), default=min(2, os.cpu_count() or 1), metavar="N",
        help="processes that run cases side by side (%(default)s)",
    )  # fmt: skip
    add_output(parser, required=False)
    add_talk(parser)
    parser.set_defaults(run=_cases)


def _cases(given: argparse.Namespace) -> None:
    hush_libraries(given.quiet)
    with shown_progress(given) as (progress, say):
        from ..paper.run_cases import run_cases

        progress("running the cases", float("nan"))
        records = run_cases(
            given.names,
            given.likelihood,
            output=given.output,
            overwrite=given.overwrite,
            say=say,
            workers=given.workers,
            specimens=given.specimens,
            draws=given.draws,
            tune=given.tune,
            chains=given.chains,
            observables=given.observables,
            random_seed=given.random_seed,
        )
    print_result(given, records)
