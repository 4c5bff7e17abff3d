"""Every task of the project by its name: ``python3 -m uv run nox -l`` lists them, ``-s NAME`` runs one.

Sessions run in the environment that ``uv run`` made, so nothing is installed twice; those that need other packages or
other versions say so and let uv make an environment of its own. The workflows in ``.github`` call nothing but these and
the commands of README.md.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import nox

nox.needs_version = ">=2025.2"
nox.options.default_venv_backend = "none"
nox.options.sessions = ["lint", "types", "workflows", "tests"]

# What `constraints` resolves: all that a user, a developer and the documentation need.
RESOLVED = ("--all-extras", "--group", "dev", "--group", "docs", "--group", "benchmark")


def uv() -> tuple[str, ...]:
    """Return the command that runs uv: what started this, a program on the path, or a module of this Python."""
    found = os.environ.get("UV") or shutil.which("uv")
    return (found,) if found else (sys.executable, "-m", "uv")


def program(name: str) -> str:
    """Return a program of this environment."""
    return shutil.which(name, path=os.path.dirname(sys.executable)) or name


def python(session: nox.Session, *words: str) -> None:
    """Run a module of this environment."""
    session.run(sys.executable, "-m", *words, *session.posargs)


@nox.session
def lint(session: nox.Session) -> None:
    """Check style, form, and that generated code is what its script writes."""
    session.run(sys.executable, "-m", "ruff", "check", ".")
    session.run(sys.executable, "-m", "ruff", "format", "--check", ".")
    session.run(sys.executable, "scripts/generate_stepper.py", "--check")


@nox.session
def types(session: nox.Session) -> None:
    """Check types, strictly."""
    python(session, "mypy")


@nox.session
def workflows(session: nox.Session) -> None:
    """Check workflow files: their schema, what can be abused in them, and the settings of pre-commit."""
    files = sorted(str(path) for path in Path(".github/workflows").glob("*.yml"))
    session.run(program("check-jsonschema"), "--builtin-schema", "vendor.github-workflows", *files)
    session.run(program("zizmor"), "--offline", "--no-progress", ".github/workflows")
    session.run(program("pre-commit"), "validate-config", ".pre-commit-config.yaml")


@nox.session
def tests(session: nox.Session) -> None:
    """Run all tests but the slow ones; words after ``--`` go to pytest."""
    python(session, "pytest")


@nox.session
def slow(session: nox.Session) -> None:
    """Run the slow tests: real runs, the release, kills, notebooks, the documentation."""
    session.run(*uv(), "run", "--group", "docs", "pytest", "-m", "slow", *session.posargs)


@nox.session
def coverage(session: nox.Session) -> None:
    """Count the lines that the quick tests run, compiled functions left out."""
    session.run(sys.executable, "-m", "pytest", "--cov", "--cov-report=", *session.posargs)
    session.run(sys.executable, "-m", "coverage", "report", "--skip-covered")


@nox.session
def docs(session: nox.Session) -> None:
    """Build the documentation; warnings are errors."""
    session.run(*uv(), "run", "--group", "docs", "sphinx-build", "-W", "-b", "html", "docs", "build/site")


@nox.session
def newest(session: nox.Session) -> None:
    """Test with the newest versions that pyproject.toml allows."""
    options = ("--isolated", "--upgrade")
    session.run(*uv(), "run", *options, "pytest", *session.posargs)


@nox.session
def lowest(session: nox.Session) -> None:
    """Test with the oldest versions that pyproject.toml allows of what it names."""
    session.run(*uv(), "run", "--isolated", "--resolution", "lowest-direct", "pytest", *session.posargs)


@nox.session
def constraints(session: nox.Session) -> None:
    """Write constraints.txt, the versions that the tests were last run with, for every platform and Python."""
    options = ("--universal", "--python-version", "3.12", "--no-header", "--no-annotate", "--upgrade", "--quiet")
    session.run(*uv(), "pip", "compile", *options, *RESOLVED, "-o", "constraints.txt", "pyproject.toml")


@nox.session
def build(session: nox.Session) -> None:
    """Build wheel and source archive, in ``dist``."""
    session.run(*uv(), "build", *session.posargs)
