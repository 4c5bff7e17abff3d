"""The command line: ``pymc-backbone extract | update | effects | demo``.

What a user can get wrong ends with one sentence on standard error and exit code 2; Ctrl-C with 130. Everything heavy is
imported when it is needed, so that help and most errors come at once.
"""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import textwrap
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from . import _options
from ._checks import OBSERVABLES, InputError

PROGRAM = "pymc-backbone"
LIKELIHOODS = ("auto", "population", "specimen", "pooled")
DENSITIES = ("product", "joint")
MARGINALS = ("best", "uniform", "normal", "kde", "gev")
STEPS = ("metropolis", "elementwise", "demetropolisz", "slice", "nuts", "nutpie")
INTERRUPTED = "Interrupted; files already written are complete."
TRACEBACK_VARIABLE = "PYMC_BACKBONE_TRACEBACK"

DESCRIPTION = """\
Nonlinear free-decay model updating from ring-down records.

A structure is displaced or struck and left to ring down. Each cycle has an amplitude, a frequency, a damping; plotted
against the amplitude they are its backbone curves. This program extracts the backbones of a batch of specimens from
their records, and infers with PyMC which stiffness, damping and friction parameters explain them, with uncertainty.
"""

EPILOG = """\
First steps:
  pymc-backbone demo --out demo_output
      infer the parameters of a batch that ships with the program, and compare them with the true ones
  pymc-backbone extract my_records/ --out backbones
      look at the backbones before any model
  pymc-backbone effects
      what a model can be made of
  pymc-backbone update my_records/ --mass 1.2 --effect cubic_stiffness --out result
      the updated model

`pymc-backbone COMMAND --help` explains each command. Exit codes: 0 done; 2 something in the input or the options cannot
be used, one sentence on standard error says what; 130 stopped with Ctrl-C.
"""

EXTRACT_DESCRIPTION = """\
Turn ring-down records into backbones: amplitude, frequency, damping and offset per cycle, then their values with
standard errors at a few amplitude levels that all specimens share.

RECORDS is a file or a folder; each file is one specimen, with a column of time and one of displacement, velocity or
acceleration. The release is found, slow drift and a sensor's offset are removed, velocity and acceleration are
integrated, cycles that sink into the noise are dropped; what was done is said in the notes.
"""

EXTRACT_EPILOG = """\
The folder holds backbones.csv, backbones.nc, result.json and figures/. Examples:
  pymc-backbone extract ring_downs/ --out backbones
  pymc-backbone extract ring_downs/ --band 90:160 --levels 8 --out backbones
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
draws, for ArviZ) and figures/. Read the findings first: they say if the chains agree, and if the data say anything
about each parameter. Examples:
  pymc-backbone update ring_downs/ --mass 1.2 --effect cubic_stiffness --out result
  pymc-backbone update ring_downs/ --mass 1.2 --effect cubic_stiffness --effect coulomb_friction \\
      --prior cubic_stiffness=0:1e7 --fix viscous_damping=0.8 --density joint --seed 4 --out result
  pymc-backbone update backbones.csv --backbones --mass 1.2 --effect quadratic_damping --step nutpie --out result
"""

DEMO_DESCRIPTION = """\
Update a model with the records that ship with the program: 24 simulated specimens of a hardening spring with viscous
damping, noise and a 14-bit converter. Their true parameters are known, and printed beside the recovered ones.
"""


class _Interrupted(BaseException):
    """Ctrl-C, as nothing but this module catches it."""


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence and exit code 2."""

    def __init__(self, **kwargs: Any) -> None:
        kwargs.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(**{**kwargs, "allow_abbrev": False})

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message.rstrip('.')}; see `{self.prog} --help`.")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = _Parser(prog=PROGRAM, description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands", parser_class=_Parser)
    _add_extract(commands)
    _add_update(commands)
    effects = commands.add_parser(
        "effects",
        help="list the physical effects, or explain one",
        description="List the physical effects a model can be made of, or explain one: force, parameters, units.",
    )
    effects.add_argument("name", nargs="?", metavar="NAME", help="an effect, for example cubic_stiffness")
    effects.set_defaults(run=_effects)
    demo = commands.add_parser(
        "demo", help="update a model with records that ship with it", description=DEMO_DESCRIPTION
    )
    demo.add_argument(
        "--out", type=Path, default=Path("demo_output"), metavar="DIR", help="output folder (demo_output)"
    )
    demo.add_argument("--overwrite", action="store_true", help="use the output folder even if it is not empty")
    demo.set_defaults(run=_demo)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    interrupt = _Interrupt()
    try:
        options = build_parser().parse_args(arguments)
        if options.version:
            print(f"{PROGRAM} {_version()}")
        elif options.command is None:
            build_parser().print_help()
        else:
            options.run(options)
        sys.stdout.flush()
    except InputError as error:
        return _stop(str(error), 2)
    except (_Interrupted, KeyboardInterrupt):
        return _stop(INTERRUPTED, 130)
    except BrokenPipeError:  # the reader, for example `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if interrupt.came:
            return _stop(INTERRUPTED, 130)
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        return _stop(
            f"{type(error).__name__} where none was expected ({' '.join(str(error).split())[:300]}): this is a fault "
            f"of the program; set {TRACEBACK_VARIABLE}=1 to see where.",
            1,
        )
    finally:
        interrupt.restore()
    return 0


class _Interrupt:
    """Ctrl-C ends the run at once, wherever it comes.

    PyMC takes a KeyboardInterrupt as the end of one chain and goes on with the next; compiled code that calls back
    turns any exception into another one. So the signal raises an exception of its own, and is remembered.
    """

    def __init__(self) -> None:
        self.came = False
        try:
            self.previous = signal.signal(signal.SIGINT, self._raise)
        except ValueError:  # not the main thread: signals do not come here
            self.previous = None

    def _raise(self, *_: Any) -> NoReturn:
        self.came = True
        raise _Interrupted

    def restore(self) -> None:
        if self.previous is not None:
            signal.signal(signal.SIGINT, self.previous)


def _add_extract(commands: Any) -> None:
    parser = commands.add_parser(
        "extract",
        help="turn ring-down records into backbones",
        description=EXTRACT_DESCRIPTION,
        epilog=EXTRACT_EPILOG,
    )
    parser.add_argument("records", type=Path, metavar="RECORDS", help="a file, or a folder of files, one per specimen")
    _add_measurement(parser)
    _add_output(parser, required=True)
    parser.set_defaults(run=_extract)


def _add_update(commands: Any) -> None:
    parser = commands.add_parser(
        "update",
        help="infer the parameters of a model from records",
        description=UPDATE_DESCRIPTION,
        epilog=UPDATE_EPILOG,
    )
    parser.add_argument("records", type=Path, metavar="RECORDS", help="a file, or a folder of files, one per specimen")
    parser.add_argument(
        "--backbones",
        action="store_true",
        help="RECORDS are measured backbone tables (such as backbones.csv from extract), not time histories",
    )
    _add_measurement(parser)

    model = parser.add_argument_group("model")
    model.add_argument(
        "--mass", type=_options.number("--mass"), required=True, metavar="M", help="mass [kg], or inertia [kg m^2]"
    )
    model.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME",
        help="add a physical effect; may be repeated (`pymc-backbone effects` lists them)",
    )
    model.add_argument(
        "--prior",
        action="append",
        default=[],
        type=_options.prior,
        metavar="NAME=LOW:HIGH",
        help="bounds of a parameter's uniform prior, in SI units; may be repeated (default: scaled with the records)",
    )
    model.add_argument(
        "--fix",
        action="append",
        default=[],
        type=_options.fixed,
        metavar="NAME=VALUE",
        help="hold a parameter at a value; may be repeated",
    )

    likelihood = parser.add_argument_group("likelihood")
    likelihood.add_argument(
        "--likelihood",
        choices=LIKELIHOODS,
        default="auto",
        help="population: the parameter distribution over the batch, against the density of its backbones; specimen: "
        "each specimen its own parameters; pooled: one parameter set for all; auto: population from 8 specimens",
    )
    likelihood.add_argument(
        "--density",
        choices=DENSITIES,
        default="product",
        help="population density: independent at each level (product, as in arXiv:2410.11902; recovers too little "
        "scatter), or joint over the levels (default: product)",
    )
    likelihood.add_argument(
        "--marginal",
        choices=MARGINALS,
        default="best",
        help="family of the density at each level (default: best by information criterion)",
    )

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
    _add_output(parser, required=False)
    parser.set_defaults(run=_update)


def _add_measurement(parser: argparse.ArgumentParser) -> None:
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
    group.add_argument(
        "--observables",
        type=_options.observables,
        metavar="LIST",
        help=f"what to compare: {', '.join(OBSERVABLES)} (default: frequency,damping)",
    )


def _add_output(parser: argparse.ArgumentParser, *, required: bool) -> None:
    group = parser.add_argument_group("output")
    words = "output folder" if required else "output folder (default: print the summary, write nothing)"
    group.add_argument("--out", type=Path, required=required, metavar="DIR", help=words)
    group.add_argument("--overwrite", action="store_true", help="use the output folder even if it is not empty")


def _extract(options: argparse.Namespace) -> None:
    from . import run

    run.extract(
        options.records,
        output=options.out,
        overwrite=options.overwrite,
        band=options.band,
        start=options.start,
        levels=options.levels,
        observables=options.observables,
        say=_say,
    )


def _update(options: argparse.Namespace) -> None:
    from . import run

    _hush_libraries()
    run.update(
        options.records,
        mass=options.mass,
        effects=_options.split(options.effect),
        priors=_options.once("--prior", options.prior),
        fixed=_options.once("--fix", options.fix),
        is_table=options.backbones,
        band=options.band,
        start=options.start,
        levels=options.levels,
        observables=options.observables,
        likelihood=options.likelihood,
        density=options.density,
        marginal=options.marginal,
        draws=options.draws,
        tune=options.tune,
        chains=options.chains,
        step=options.step,
        random_seed=options.seed,
        output=options.out,
        overwrite=options.overwrite,
        say=_say,
    )


def _effects(options: argparse.Namespace) -> None:
    from .effects import LIBRARY, get_effect

    if options.name is not None:
        print(_effect_text(get_effect(options.name)))
        return
    print("Every model has linear_stiffness and viscous_damping; --effect adds others. x is displacement, x' velocity.")
    for name, effect in LIBRARY.items():
        print(f"\n{name}\n{textwrap.fill(effect.summary, 112, initial_indent='  ', subsequent_indent='  ')}")
        print(textwrap.fill(effect.text, 112, initial_indent="  force: ", subsequent_indent="         "))
        print("  " + ", ".join(f"{parameter.name} [{parameter.unit}]" for parameter in effect.parameters))


def _effect_text(effect: Any) -> str:
    lines = [effect.name, "", textwrap.fill(effect.summary, 118), ""]
    lines += [
        textwrap.fill(effect.text, 112, initial_indent="  force: ", subsequent_indent="         "),
        "",
        "  parameters:",
    ]
    width = max(len(parameter.name) for parameter in effect.parameters)
    units = max(len(parameter.unit) for parameter in effect.parameters) + 2
    for parameter in effect.parameters:
        lines.append(f"    {parameter.name:<{width}}  {f'[{parameter.unit}]':<{units}}  {parameter.summary}")
    if effect.references:
        lines += ["", "  references:", *(f"    {reference}" for reference in effect.references)]
    return "\n".join(lines)


def _demo(options: argparse.Namespace) -> None:
    from . import demo

    _hush_libraries()
    demo.run_demo(options.out, overwrite=options.overwrite, say=_say)


def _hush_libraries() -> None:
    """Keep PyMC's own messages from the terminal, whose content the findings give; show this package's progress."""
    logging.getLogger("pymc").setLevel(logging.CRITICAL)
    logging.root.addHandler(logging.NullHandler())  # else PyMC, imported later, sets up its own
    # PyMC averages exp(log acceptance ratio), which overflows where a proposal is far better than the start.
    warnings.filterwarnings("ignore", message="overflow encountered in exp", category=RuntimeWarning)
    progress = logging.getLogger(__package__)
    if not progress.handlers:
        progress.addHandler(logging.StreamHandler())
    progress.setLevel(logging.INFO)


def _say(text: str) -> None:
    print(text, flush=True)


def _stop(message: str, code: int) -> int:
    print(f"{PROGRAM}: {' '.join(message.split())}", file=sys.stderr)
    return code


def _version() -> str:
    from . import __version__

    return str(__version__)
