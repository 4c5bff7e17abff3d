"""What the commands share: groups of options, what is printed, and what libraries may say."""

from __future__ import annotations

import argparse
import logging
import warnings
from pathlib import Path
from typing import Any

from . import _options
from ._checks import OBSERVABLES

STEPS = ("metropolis", "elementwise", "demetropolisz", "slice", "nuts", "nutpie")


def add_records(parser: argparse.ArgumentParser, *, tables: bool = True) -> None:
    """Add the argument that names the records, and whether they are tables of backbones."""
    parser.add_argument("records", type=Path, metavar="RECORDS", help="a file, or a folder of files, one per specimen")
    if tables:
        parser.add_argument(
            "--backbones",
            action="store_true",
            help="RECORDS are measured backbone tables (such as backbones.csv from extract), not time histories",
        )


def add_model(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Add the group of options of the model, with the mass, and return it."""
    group = parser.add_argument_group("model")
    group.add_argument(
        "--mass", type=_options.number("--mass"), required=True, metavar="M", help="mass [kg], or inertia [kg m^2]"
    )
    return group


def measurement_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of reading and conditioning as keyword arguments."""
    return {name: getattr(options, name) for name in ("band", "start", "levels")}


def sampling_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of the sampler as keyword arguments."""
    chosen = {name: getattr(options, name) for name in ("draws", "tune", "chains", "step")}
    return {**chosen, "random_seed": options.seed}


def add_measurement(parser: argparse.ArgumentParser, *, observables: bool = True) -> None:
    """Add the options of reading and conditioning."""
    group = parser.add_argument_group("measurement")
    group.add_argument(
        "--band", type=_options.band, metavar="LO:HI", help="keep this frequency band [Hz]; for a second mode"
    )
    group.add_argument(
        "--start", type=_options.number("--start"), metavar="S", help="release at this time [s], instead of finding it"
    )
    group.add_argument(
        "--levels",
        type=_options.levels,
        metavar="N|A,B,C",
        help="number of amplitude levels, or the amplitudes [m or rad] (default: 10, or fewer for short decays)",
    )
    if not observables:
        return
    group.add_argument(
        "--observables",
        type=_options.observables,
        metavar="LIST",
        help=f"what to compare: {', '.join(OBSERVABLES)} (default: frequency,damping)",
    )


def add_output(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Add the options of the output folder."""
    group = parser.add_argument_group("output")
    words = "output folder" if required else "output folder (default: print the summary, write nothing)"
    group.add_argument("--out", type=Path, required=required, metavar="DIR", help=words)
    group.add_argument("--overwrite", action="store_true", help="use the output folder even if it is not empty")


def add_sampling(parser: argparse.ArgumentParser) -> None:
    """Add the options of the sampler."""
    sampler = parser.add_argument_group("sampling")
    sampler.add_argument(
        "--draws", type=_options.count("--draws"), default=2000, metavar="N", help="per chain, kept (2000)"
    )
    sampler.add_argument(
        "--tune", type=_options.count("--tune", 0), default=1000, metavar="N", help="per chain, dropped (1000)"
    )
    sampler.add_argument(
        "--chains", type=_options.count("--chains"), default=4, metavar="N", help="number of chains (4)"
    )
    sampler.add_argument(
        "--step",
        choices=STEPS,
        default="metropolis",
        help="PyMC's step method: metropolis proposes jointly, elementwise one variable at a time (metropolis)",
    )
    sampler.add_argument(
        "--seed", type=_options.count("--seed", 0), default=None, metavar="N", help="repeats a run exactly"
    )


def hush_libraries() -> None:
    """Keep PyMC's own messages from the terminal, whose content the findings give; show this package's progress."""
    logging.getLogger("pymc").setLevel(logging.CRITICAL)
    logging.root.addHandler(logging.NullHandler())  # else PyMC, imported later, sets up its own
    # PyMC averages exp(log acceptance ratio), which overflows where a proposal is far better than the start.
    warnings.filterwarnings("ignore", message="overflow encountered in exp", category=RuntimeWarning)
    progress = logging.getLogger(__package__)
    if not progress.handlers:
        progress.addHandler(logging.StreamHandler())
    progress.setLevel(logging.INFO)


def say(text: str) -> None:
    """Print a line of the summary at once."""
    print(text, flush=True)
