"""Sentences of the library name its arguments; on the command line the same sentences name options."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import pymc_backbone
from pymc_backbone._common.text import capitalised, in_words
from pymc_backbone.cli import main as cli
from pymc_backbone.cli.wording import commands_of, option_names, with_options
from pymc_backbone.effects import LIBRARY

from .test_cli import MASS, is_one_sentence, run_cli

PACKAGE = Path(pymc_backbone.__file__).parent
COMMANDS = commands_of(cli.build_parser())


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_option_has_the_name_of_an_argument(command):
    names = option_names(COMMANDS[command])
    options = {option for action in COMMANDS[command]._actions for option in action.option_strings}
    assert {name for name in names.values() if name.startswith("-")} <= options
    if command == "update":
        assert names["priors"] == "--prior" and names["random_seed"] == "--seed" and names["path"] == "RECORDS"
        assert names["read_backbones"] == names["is_table"] == "--backbones"


def test_what_is_no_option_stays_as_it_is():
    names = option_names(COMMANDS["extract"])
    text = "read it with `read_backbones`, not `cores=2`; mass x'' + `k`."
    assert with_options(text, names) == text
    assert with_options("`levels` of `likelihood='pooled'`", option_names(COMMANDS["update"])) == (
        "--levels of --likelihood pooled"
    )


def test_no_sentence_of_the_library_names_an_option():
    """Someone who calls from Python has no options; the command line translates."""
    known = {option for parser in COMMANDS.values() for action in parser._actions for option in action.option_strings}
    known -= {"-h", "--help"}
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.is_relative_to(PACKAGE / "cli"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                words = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", node.value)) & known
                is_command = "pymc-backbone" in node.value or node.value in known
                if words and not is_command:
                    found.append(f"{path.name}: {node.value}")
    assert found == []


def test_a_folder_in_use_in_both_languages(capsys, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years of work")
    from pymc_backbone.reporting.claimed_folder import prepare_output

    with pytest.raises(pymc_backbone.InputError, match="give `overwrite=True`") as raised:
        prepare_output(tmp_path / "out")
    assert "--" not in str(raised.value)
    code, _, error = run_cli(capsys, "extract", "x", "--out", str(tmp_path / "out"))
    assert code == 2 and is_one_sentence(error) and "give --overwrite." in error and "`" not in error


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--resume"], "--resume continues a run that was stored; name its folder with --store."),
        (["--prior", "cubic=0:1"], "--prior must be one of linear_stiffness"),
        (["--fix", "cubic=1"], "--fix must be one of linear_stiffness"),
        (["--backbones", "--band", "1:2"], "--band is for time histories, and --backbones says these are not"),
        (["--effect", "cubic"], "Did you mean 'cubic_"),
    ],
)
def test_errors_of_update_name_its_options(capsys, options, words):
    code, _, error = run_cli(capsys, "update", "records", *MASS, *options)
    assert code == 2 and is_one_sentence(error) and words in error
    assert "`" not in error.partition("must be one of")[0]


def test_names_of_effects_are_those_of_people_and_can_be_told_apart():
    """No underscore is left, people keep their capital letter, and no two names are the same in words."""
    names = [*LIBRARY, *(parameter.name for effect in LIBRARY.values() for parameter in effect.parameters)]
    words = {name: in_words(name) for name in names}
    assert not any("_" in text for text in words.values())
    assert len(set(words.values())) == len(set(names))
    assert words["bouc_wen_alpha"] == "Bouc-Wen alpha" and words["iwan"] == "Iwan"
    assert words["displacement_dependent_damping"] == "displacement-dependent damping"
    assert words["one_sided_stiffness"] == "one-sided stiffness" and words["maxwell_element"] == "Maxwell element"
    assert [words[name] for name in ("hertz_contact", "stribeck_friction", "dahl_force")] == [
        "Hertz contact", "Stribeck friction", "Dahl force",
    ]  # fmt: skip
    assert capitalised(words["cubic_stiffness"]) == "Cubic stiffness" and capitalised("") == ""
