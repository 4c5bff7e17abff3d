"""The command ``completion``: a script that completes commands, options and names in bash, zsh or fish."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable
from typing import Any

from .wording import commands_of

SHELLS = ("bash", "zsh", "fish")
DESCRIPTION = """\
Print a script for your shell that completes commands, options and their values with the tabulator key. To have it in
every new shell:
  bash   pymc-backbone completion bash > ~/.local/share/bash-completion/completions/pymc-backbone
  zsh    pymc-backbone completion zsh > ~/.pymc-backbone.zsh; echo 'source ~/.pymc-backbone.zsh' >> ~/.zshrc
  fish   pymc-backbone completion fish > ~/.config/fish/completions/pymc-backbone.fish
"""


def add_completion(commands: Any, program: Callable[[], tuple[str, argparse.ArgumentParser]]) -> None:
    """Add the command; ``program`` returns the name and the whole parser when the script is asked for."""
    parser = commands.add_parser(
        "completion", help="print a script that completes commands and options in a shell", description=DESCRIPTION
    )
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))
    parser.set_defaults(run=lambda options: print(script(options.shell, *program()), end=""))


def script(shell: str, name: str, parser: argparse.ArgumentParser) -> str:
    """Return the script for a shell.

    Parameters
    ----------
    shell : {"bash", "zsh", "fish"}
        Which shell.
    name : str
        Name of the program.
    parser : argparse.ArgumentParser
        Of the whole command line.

    Returns
    -------
    str
    """
    tree = {command: _options(sub) for command, sub in commands_of(parser).items()}
    return _fish(name, tree, parser) if shell == "fish" else _bash(name, tree, is_zsh=shell == "zsh")


def _options(parser: argparse.ArgumentParser) -> dict[str, list[str] | None]:
    """Return the options of a command: the values each takes, an empty list for any, None for none."""
    from ..effects import LIBRARY

    found: dict[str, list[str] | None] = {}
    for action in parser._actions:
        values: list[str] | None = None if action.nargs == 0 else [str(choice) for choice in action.choices or ()]
        if action.dest in ("effects", "base", "candidates") or (not action.option_strings and action.dest == "name"):
            values = sorted(LIBRARY)
        for option in action.option_strings or ["" if values is not None else "-"]:
            found[option] = values
    return found


def _bash(name: str, tree: dict[str, dict[str, list[str] | None]], *, is_zsh: bool) -> str:
    function = "_" + name.replace("-", "_")
    cases, values = [], []
    for command, options in tree.items():
        words = [option for option in options if option.startswith("-")] + (options.get("") or [])
        cases.append(f"{command}) words='{' '.join(words)}' ;;")
        for option, known in options.items():
            if option.startswith("-") and known is not None:
                reply = (
                    f'words="{" ".join(known)}"' if known else 'words=; COMPREPLY=($(compgen -f -- "$current")); return'
                )
                values.append(f"{command}:{option}) {reply} ;;")
    body = textwrap.dedent(
        f"""\
        # Completion of {name} for {"zsh" if is_zsh else "bash"}.
        {"autoload -U +X bashcompinit && bashcompinit" if is_zsh else ""}
        {function}() {{
            local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}"
            local command="${{COMP_WORDS[1]}}" words
            if [ "$COMP_CWORD" -le 1 ]; then
                COMPREPLY=($(compgen -W "{" ".join(tree)} --help --version" -- "$current")); return
            fi
            case "$command" in
        CASES
            esac
            case "$command:$before" in
        VALUES
            esac
            COMPREPLY=($(compgen -W "$words" -- "$current"))
            case "$current" in -*) ;; *) COMPREPLY+=($(compgen -f -- "$current")) ;; esac
        }}
        complete -o filenames -F {function} {name}
        """
    )
    indent = " " * 8
    return body.replace("CASES", "\n".join(indent + case for case in cases)).replace(
        "VALUES", "\n".join(indent + value for value in values)
    )


def _fish(name: str, tree: dict[str, dict[str, list[str] | None]], parser: argparse.ArgumentParser) -> str:
    helps = commands_of(parser)
    lines = [f"# Completion of {name} for fish."]
    for command, options in tree.items():
        lines.append(f"complete -c {name} -n __fish_use_subcommand -f -a {command} -d '{_first_words(helps[command])}'")
        condition = f"'__fish_seen_subcommand_from {command}'"
        if options.get(""):
            lines.append(f"complete -c {name} -n {condition} -f -a '{' '.join(options[''] or [])}'")
        for option, known in options.items():
            if not option.startswith("-") or option == "-":
                continue
            kind = f"-l {option[2:]}" if option.startswith("--") else f"-s {option[1:]}"
            takes = "" if known is None else f" -x -a '{' '.join(known)}'" if known else " -r"
            lines.append(f"complete -c {name} -n {condition} {kind}{takes}")
    return "\n".join(lines) + "\n"


def _first_words(parser: argparse.ArgumentParser) -> str:
    text = " ".join((parser.description or "").split()).partition(". ")[0].partition(":")[0]
    return text.replace("'", "")[:70]
