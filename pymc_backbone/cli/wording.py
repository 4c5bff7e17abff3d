"""The library's sentences in the words of the command line: where it names an argument, the option is named."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping

ALIASES = {"read_backbones": ("is_table",), "effect": ("effects", "base", "name")}
"""What the library names otherwise than the argument which the option sets."""
_NAMED = re.compile(r"`(\w+)(?:=([^`]*))?`")


def commands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def option_names(parser: argparse.ArgumentParser) -> dict[str, str]:
    """Return the option of each argument that a command has; RECORDS and the like stand for themselves."""
    names = {}
    for action in parser._actions:
        names[action.dest] = action.option_strings[-1] if action.option_strings else str(action.metavar)
    known = {
        name: [names[argument] for argument in arguments if argument in names] for name, arguments in ALIASES.items()
    }
    return names | {name: options[0] for name, options in known.items() if options}


def with_options(text: str, names: Mapping[str, str]) -> str:
    """Name the options in a sentence that names arguments in backquotes.

    Parameters
    ----------
    text : str
        The sentence.
    names : mapping of str to str
        From `option_names`; what stands not there is left as it is.

    Returns
    -------
    str

    Examples
    --------
    >>> names = {"start": "--start", "band": "--band", "overwrite": "--overwrite"}
    >>> with_options("keep `band=(90, 160)`, begin with `start=1.92`, give `overwrite=True`, not `cores`.", names)
    'keep --band 90:160, begin with --start 1.92, give --overwrite, not `cores`.'
    """

    def replaced(found: re.Match[str]) -> str:
        name, value = found.groups()
        if name not in names:
            return found.group()
        if value in (None, "True"):
            return names[name]
        typed = value.strip("()\"'")
        return f"{names[name]} {re.sub(', *', ':', typed) if value.startswith('(') else typed}"

    return _NAMED.sub(replaced, text)
