"""The command line: ``pymc-backbone extract | update | diagnose | plan | cases | effects | demo``.

What a user can get wrong ends with one sentence on standard error and exit code 2; Ctrl-C with 130. Everything heavy is
imported when it is needed, so that help and most errors come at once.
"""

from __future__ import annotations

import _thread
import argparse
import difflib
import errno
import gc
import os
import re
import signal
import sys
import textwrap
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from .._common.checks import InputError
from .._common.quiet import hush_libraries
from . import (
    cases as _cli_cases,
)
from . import (
    common as _cli_common,
)
from . import (
    completion as _cli_completion,
)
from . import (
    diagnose as _cli_diagnose,
)
from . import (
    plan as _cli_plan,
)
from . import (
    update as _cli_update,
)
from .wording import commands_of, option_names, with_options

PROGRAM = "pymc-backbone"
INTERRUPTED = "Interrupted; files already written are complete."
AGAIN = 0.05  # seconds after which an interrupt that was lost comes again
UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
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
  pymc-backbone diagnose my_records/ --mass 1.2 --out diagnosis
      what the model lacks: the missing effect, with its probability, and a report
  pymc-backbone plan diagnosis
      which test decides, where the records could not

`pymc-backbone COMMAND --help` explains each command. Exit codes: 0 done; 1 what is printed cannot be
written, or a fault of the program; 2 something in the input or the options cannot
be used, one sentence on standard error says what; 130 stopped with Ctrl-C.
"""

DEMO_DESCRIPTION = """\
Update a model with the records that ship with the program: 24 simulated specimens of a hardening spring with viscous
damping, noise and a 14-bit converter. Their true parameters are known, and printed beside the recovered ones.
"""


class _Interrupted(BaseException):
    """Ctrl-C, as nothing but this module catches it."""


_INVALID = re.compile(r"invalid choice: '([^']*)' \(choose from (.*)\)")


def _nearest(typed: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(typed, known, n=1)
    return f"; did you mean {near[0]}?" if near else ""


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence and exit code 2."""

    def __init__(self, **kwargs: Any) -> None:
        kwargs.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(**{**kwargs, "allow_abbrev": False})

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse what was typed; an option that the command does not have is answered with the nearest of its own."""
        given, rest = self.parse_known_args(args, namespace)
        if rest:
            parser = commands_of(self).get(getattr(given, "command", None) or "", self)
            known = [option for action in parser._actions for option in action.option_strings]
            parser.error(f"unrecognized arguments: {' '.join(rest)}{_nearest(rest[0].partition('=')[0], known)}")
        return given

    def error(self, message: str) -> NoReturn:
        found = _INVALID.search(message)
        if found and "maybe" not in message:
            message += _nearest(found[1], re.findall(r"[\w-]+", found[2]))
        raise InputError(f"{message.rstrip('.')}; see `{self.prog} --help`.")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = _Parser(prog=PROGRAM, description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands", parser_class=_Parser)
    _cli_update.add_extract(commands)
    _cli_update.add_update(commands)
    _cli_diagnose.add_diagnose(commands)
    _cli_plan.add_plan(commands)
    _cli_cases.add_cases(commands)
    effects = commands.add_parser(
        "effects",
        help="list the physical effects, or explain one",
        description="List the physical effects a model can be made of, or explain one: force, parameters, units.",
    )
    effects.add_argument("name", nargs="?", metavar="NAME", help="an effect, for example cubic_stiffness")
    _cli_common.add_talk(effects, quiet=False)
    effects.set_defaults(run=_effects)
    demo = commands.add_parser(
        "demo", help="update a model with records that ship with it", description=DEMO_DESCRIPTION
    )
    demo.add_argument(
        "--out",
        dest="output",
        type=Path,
        default=Path("demo_output"),
        metavar="DIR",
        help="output folder (demo_output)",
    )
    demo.add_argument("--overwrite", action="store_true", help="use the output folder even if it is not empty")
    _cli_common.add_talk(demo)
    demo.set_defaults(run=_demo)
    _cli_completion.add_completion(commands, lambda: (PROGRAM, build_parser()))
    return parser


def run() -> NoReturn:
    """Run the command line as a process of its own.

    What is imported stays to the end and holds no garbage: looking through it again and again, and once more at the
    end, took as long as reading five records.
    """
    gc.set_threshold(20_000, 20, 20)
    code = main()
    gc.freeze()
    sys.exit(code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    _open_closed_streams()
    interrupt = _Interrupt()
    names: dict[str, str] = {}
    try:
        parser = build_parser()
        given = parser.parse_args(arguments)
        if given.version:
            print(f"{PROGRAM} {_version()}")
        elif given.command is None:
            parser.print_help()
        else:
            given.arguments = list(sys.argv[1:] if arguments is None else arguments)
            given.option_names = names = option_names(commands_of(parser)[given.command])
            given.run(given)
        sys.stdout.flush()
    except InputError as error:
        return _stop(with_options(str(error), names), 2)
    except (_Interrupted, KeyboardInterrupt):
        return _stop(INTERRUPTED, 130)
    except BrokenPipeError:  # the reader, for example `head`, has seen enough
        _print_no_more()
        return 0
    except OSError as error:
        if error.filename is not None or error.errno not in UNWRITABLE:
            return _fault(error)
        _print_no_more()
        return _stop(f"standard output cannot be written ({error.strerror}); lead it elsewhere.", 1)
    except Exception as error:
        if interrupt.came:
            return _stop(INTERRUPTED, 130)
        return _fault(error)
    finally:
        interrupt.restore()
    return 0


def _fault(error: Exception) -> int:
    """Say that the program is at fault; raise where the traceback is asked for."""
    if os.environ.get(TRACEBACK_VARIABLE):
        raise error
    return _stop(
        f"{type(error).__name__} where none was expected ({' '.join(str(error).split())[:300]}): this is a fault "
        f"of the program; set {TRACEBACK_VARIABLE}=1 to see where.",
        1,
    )


def _print_no_more() -> None:
    """Lead what is still to be printed to nowhere, the interpreter's last flush included."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _send() -> None:
    """Interrupt the main thread, also where it waits."""
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


class _Interrupt:
    """Ctrl-C ends the run at once, wherever it comes.

    PyMC takes a KeyboardInterrupt as the end of one chain and goes on with the next; compiled code that calls back
    turns any exception into another one. So the signal raises an exception of its own, and is remembered. Where it
    comes while a compiler calls back, Python can only report the exception and go on: then it is sent once more.
    """

    def __init__(self) -> None:
        self.came = False
        self.again: threading.Timer | None = None
        self.hook, sys.unraisablehook = sys.unraisablehook, self._report
        try:
            self.previous = signal.signal(signal.SIGINT, self._raise)
        except ValueError:  # not the main thread: signals do not come here
            self.previous = None

    def _raise(self, *_: Any) -> NoReturn:
        self.came = True
        raise _Interrupted

    def _report(self, lost: Any) -> None:
        if not issubclass(lost.exc_type, _Interrupted):
            self.hook(lost)
            return
        self.again = threading.Timer(AGAIN, _send)
        self.again.daemon = True
        self.again.start()

    def restore(self) -> None:
        sys.unraisablehook = self.hook
        if self.again is not None:
            self.again.cancel()
        if self.previous is not None:
            signal.signal(signal.SIGINT, self.previous)


def _effects(given: argparse.Namespace) -> None:
    from ..effects import LIBRARY, get_effect

    if given.json:
        chosen = LIBRARY.values() if given.name is None else [get_effect(given.name)]
        _cli_common.print_result(given, {effect.name: _effect_entries(effect) for effect in chosen})
        return
    if given.name is not None:
        print(_effect_text(get_effect(given.name)))
        return
    print("Every model has linear_stiffness and viscous_damping; --effect adds others. x is displacement, x' velocity.")
    for name, effect in LIBRARY.items():
        print(f"\n{name}\n{textwrap.fill(effect.summary, 112, initial_indent='  ', subsequent_indent='  ')}")
        print(textwrap.fill(effect.text, 112, initial_indent="  force: ", subsequent_indent="         "))
        print("  " + ", ".join(f"{parameter.name} [{parameter.unit}]" for parameter in effect.parameters))


def _effect_entries(effect: Any) -> dict[str, Any]:
    parameters = {p.name: {"unit": p.unit, "summary": p.summary} for p in effect.parameters}
    return {"summary": effect.summary, "force": effect.text, "parameters": parameters}


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
    if effect.variant_of:
        where = "`diagnose` looks for it in the place of these, and by itself when it is named"
        lines += ["", f"  variant of {', '.join(effect.variant_of)}: {where}"]
    if effect.with_role("ordinate"):
        lines += ["", "  no candidate: `diagnose` draws such a curve where no law explains the records"]
    elif effect.only_if_named:
        when = "only when it is named, or where nothing else explains the records"
        lines += ["", f"  `diagnose` looks for it {when}: backbones do not tell it from others"]
    if effect.references:
        lines += ["", "  references:", *(f"    {reference}" for reference in effect.references)]
    return "\n".join(lines)


def _demo(given: argparse.Namespace) -> None:
    hush_libraries(given.quiet)
    with _cli_common.shown_progress(given, delay=1.5) as (progress, say):
        from ..workflows import demo

        result = demo.run_demo(given.output, overwrite=given.overwrite, progress=progress, say=say)
    _cli_common.print_result(given, result)


def _open_closed_streams() -> None:
    """Lead to nowhere what a process writes that was started without standard output or standard error."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))


def _stop(message: str, code: int) -> int:
    print(f"{PROGRAM}: {_cli_common.visible(' '.join(message.split()))}", file=sys.stderr)
    return code


def _version() -> str:
    from .. import __version__

    return str(__version__)
