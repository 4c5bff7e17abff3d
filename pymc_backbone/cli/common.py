"""What the commands share: groups of options, what is printed, and what libraries may say."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._common.checks import OBSERVABLES
from .._common.options import pick
from ..inference.options import Sampling
from ..measurement.reading.headers import READABLE
from . import options
from .progress import ProgressBar
from .wording import with_options

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

STEPS = ("metropolis", "elementwise", "demetropolisz", "slice", "nuts", "nutpie")


READING = """\
What was assumed or converted while reading is printed, and stands in the notes of the result and in the report.
Formats: delimited text (CSV and the like), LabVIEW .lvm, MATLAB .mat, universal files (.uff, .unv), NetCDF, NumPy
.npz, SEP-005 as .json. A folder holds files of one of these, one specimen each."""


def add_talk(parser: argparse.ArgumentParser, *, quiet: bool = True) -> None:
    """Add the options of what is printed."""
    group = parser.add_argument_group("printing")
    if quiet:
        group.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors; the files say it all")
    group.add_argument(
        "--json", action="store_true", help="print the result as one JSON object, and nothing else, on standard output"
    )


def say_of(given: argparse.Namespace) -> Callable[[str], None]:
    """Return what prints a line of the summary: `say`, or nothing where the options ask for silence or JSON."""
    if given.quiet or given.json:
        return _say_nothing
    return lambda text: say(with_options(text, given.option_names))


@contextmanager
def shown_progress(
    given: argparse.Namespace, *, delay: float = 0.0
) -> Iterator[tuple[ProgressBar, Callable[[str], None]]]:
    """Yield a bar, shown after ``delay`` seconds, and what prints a line below it."""
    with ProgressBar(is_shown=not given.quiet, delay=delay) as progress:
        yield progress, progress.below(say_of(given))


def print_result(given: argparse.Namespace, result: Any) -> None:
    """Print a result as JSON where the options ask for it."""
    if given.json:
        from ..reporting.portable import plain

        print(json.dumps(plain(result), allow_nan=False), flush=True)


def _say_nothing(text: str) -> None:
    """Print nothing."""


def add_records(parser: argparse.ArgumentParser, *, tables: bool = True) -> None:
    """Add the argument that names the records, and whether they are tables of backbones."""
    parser.add_argument("path", type=Path, metavar="RECORDS", help="a file, or a folder of files, one per specimen")
    if tables:
        parser.add_argument(
            "--backbones",
            dest="is_table",
            action="store_true",
            help="RECORDS are measured backbone tables (such as backbones.csv from extract), not time histories",
        )


def add_model(parser: argparse.ArgumentParser, *, required: bool = True) -> argparse._ArgumentGroup:
    """Add the group of options of the model, with the mass, and return it."""
    group = parser.add_argument_group("model")
    group.add_argument(
        "--mass",
        type=options.mass,
        required=required,
        metavar="M",
        help="mass [kg], or inertia [kg m^2]; with its standard deviation: 2.3±0.05 (or 2.3+-0.05)",
    )
    return group


def chosen[Options: DataclassInstance](kind: type[Options], given: argparse.Namespace) -> Options:
    """Return the options of one kind that a command has; their names are those of the options."""
    return pick(kind, vars(given))


def add_measurement(parser: argparse.ArgumentParser, *, observables: bool = True) -> None:
    """Add the options of reading and conditioning."""
    reading = parser.add_argument_group("reading", READING)
    reading.add_argument(
        "--columns",
        type=options.columns,
        action="extend",
        metavar="LIST",
        help="channels to take: names as in the file, patterns such as 'acc*', or numbers from 1, with commas between; "
        "time=NAME names the time channel; each of several channels becomes a specimen (default: the only one that "
        "is a displacement, velocity or acceleration by name or unit)",
    )
    reading.add_argument(
        "--quantity",
        choices=READABLE,
        metavar="Q",
        help="what the channel holds, or which to take: displacement, velocity, acceleration, or the envelope of one, "
        "amplitude or power over time (default: as its name or unit says)",
    )
    reading.add_argument(
        "--unit",
        metavar="U",
        help="unit of the channel, such as mm, in/s, g or deg; replaces the file's (default: the file's, else SI)",
    )
    reading.add_argument(
        "--sampling-rate",
        type=options.number("--sampling-rate"),
        metavar="HZ",
        help="samples per second; replaces the file's times (default: the file's)",
    )
    reading.add_argument(
        "--sensitivity",
        action="append",
        metavar="S",
        help="of the sensor, where a channel is in volts, such as '10.2 mV/g', '2.25 mV/N' (of a hammer), or "
        "'acc_x=10.2 mV/g' for one channel; may be repeated",
    )
    reading.add_argument(
        "--frequency",
        type=options.number("--frequency"),
        metavar="HZ",
        help="of the motion, for envelopes without a column of it; replaces the file's",
    )
    reading.add_argument(
        "--reference",
        metavar="A",
        help="for envelopes in dB, dBm, V, W or relative: amplitude at 0 dB, or at 1 of the file's unit, such as "
        "'2.5 nm' (m without a unit)",
    )
    group = parser.add_argument_group("measurement")
    group.add_argument(
        "--band", type=options.band, metavar="LO:HI", help="keep this frequency band [Hz]; for a second mode"
    )
    group.add_argument(
        "--start", type=options.number("--start"), metavar="S", help="release at this time [s], instead of finding it"
    )
    group.add_argument("--stop", type=options.number("--stop"), metavar="S", help="use the record up to this time [s]")
    group.add_argument(
        "--floor",
        type=options.amplitude,
        metavar="A",
        help="use the record down to this amplitude, such as '0.2 mm' or '0.5 deg' (m or rad without a unit)",
    )
    group.add_argument(
        "--levels",
        type=options.levels,
        metavar="N|A,B,C",
        help="number of amplitude levels, or the amplitudes [m or rad] (default: 10, or fewer for short decays)",
    )
    group.add_argument(
        "--strict",
        action="store_true",
        help="stop at the first record that cannot be used (default: leave it out and say so, as long as half remain)",
    )
    if not observables:
        return
    group.add_argument(
        "--observables",
        type=options.observables,
        metavar="LIST",
        help=f"what to compare: {', '.join(OBSERVABLES)} (default: frequency,damping)",
    )


def add_output(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Add the options of the output folder."""
    group = parser.add_argument_group("output")
    words = "output folder" if required else "output folder (default: print the summary, write nothing)"
    group.add_argument("--out", dest="output", type=Path, required=required, metavar="DIR", help=words)
    group.add_argument("--overwrite", action="store_true", help="use the output folder even if it is not empty")


def add_sampling(parser: argparse.ArgumentParser, *, step_of_hierarchical: str = "") -> None:
    """Add the options of the sampler; a step that nobody gave is None where a hierarchical model takes another."""
    sampler = parser.add_argument_group("sampling")
    words = {
        "draws": (1, f"per chain, kept ({Sampling.draws})"),
        "tune": (0, f"per chain, dropped ({Sampling.tune})"),
        "chains": (1, f"number of chains ({Sampling.chains})"),
    }
    for name, (least, meaning) in words.items():
        reader = options.count(f"--{name}", least)
        sampler.add_argument(f"--{name}", type=reader, default=getattr(Sampling, name), metavar="N", help=meaning)
    sampler.add_argument(
        "--step",
        choices=STEPS,
        default=None if step_of_hierarchical else Sampling.step,
        help="PyMC's step method: metropolis proposes jointly, elementwise one variable at a time "
        f"({Sampling.step}{f'; {step_of_hierarchical} for a hierarchical model' if step_of_hierarchical else ''})",
    )
    sampler.add_argument(
        "--seed", dest="random_seed", type=options.count("--seed", 0), metavar="N", help="repeats a run exactly"
    )


def say(text: str) -> None:
    """Print a line of the summary at once; what names in files hold cannot steer the terminal."""
    print(visible(text), flush=True)


def visible(text: str) -> str:
    """Return text with the characters escaped that no terminal shows, line ends excepted."""
    return "".join(char if char.isprintable() or char == "\n" else ascii(char)[1:-1] for char in text)
