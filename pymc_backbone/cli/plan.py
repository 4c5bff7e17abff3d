"""The command ``plan``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .._common.quiet import hush_libraries
from . import options
from .common import add_talk, print_result, shown_progress

DESCRIPTION = """\
Say which test decides where `diagnose` could not: a search over ring-downs that you can afford, from other releases,
more of them, longer ones, with a better sensor or with a mass added. Each is scored by the probability that it leaves
one set of effects, simulated with the sets that are possible now. The present test once more stands beside them.
"""

EPILOG = """\
DIR is the output folder of a `diagnose` on records that left several sets possible: `ambiguous`, or a mechanism named
whose law is open. Examples:
  pymc-backbone plan diagnosis
  pymc-backbone plan diagnosis --from 0.002 --up-to 0.03 --most-records 6
  pymc-backbone plan diagnosis --up-to 0.03 --add-mass 0.4 --noise 2e-6 --out plan.json
"""


def add_plan(commands: Any) -> None:
    """Add the command ``plan``."""
    parser = commands.add_parser(
        "plan", help="the test that decides where a diagnosis could not", description=DESCRIPTION, epilog=EPILOG
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="output folder of `diagnose`")
    limits = parser.add_argument_group("what you can afford")
    limits.add_argument(
        "--from", dest="smallest", type=options.number("--from"), metavar="A",
        help="smallest release, in the unit of the records (a quarter of the present one)",
    )  # fmt: skip
    limits.add_argument(
        "--up-to", dest="largest", type=options.number("--up-to"), metavar="A",
        help="largest release that the structure bears (one and a half times the present one)",
    )  # fmt: skip
    limits.add_argument(
        "--most-records", dest="records", type=options.count("--most-records"), default=10, metavar="N",
        help="ring-downs at most (10)",
    )  # fmt: skip
    limits.add_argument(
        "--longest", dest="duration", type=options.number("--longest"), metavar="S",
        help="seconds of a record at most (twice the present length)",
    )  # fmt: skip
    limits.add_argument(
        "--noise", type=options.number("--noise"), metavar="SD",
        help="standard deviation of a better sensor's noise, in the unit that was measured (none)",
    )  # fmt: skip
    limits.add_argument(
        "--add-mass", dest="added_masses", type=options.number("--add-mass"), action="append", default=[], metavar="M",
        help="kg, or kg m^2, that can be fixed to the structure; may be repeated (none)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", dest="random_seed", type=options.count("--seed", 0), default=0, metavar="N", help="of the draws (0)"
    )
    group = parser.add_argument_group("output")
    group.add_argument("--out", dest="output", type=Path, metavar="FILE", help="the plan as JSON (default: none)")
    group.add_argument("--overwrite", action="store_true", help="write the file even if it exists")
    add_talk(parser)
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> None:
    hush_libraries(given.quiet)
    with shown_progress(given) as (progress, say):
        from ..discrepancy.results.design import Affordable
        from ..workflows import plan as run_plan

        affordable = Affordable(
            given.smallest, given.largest, given.records, given.duration, given.noise, tuple(given.added_masses)
        )
        result = run_plan.plan(
            given.folder, affordable=affordable, random_seed=given.random_seed, output=given.output,
            overwrite=given.overwrite, progress=progress, say=say,
        )  # fmt: skip
    print_result(given, result)
