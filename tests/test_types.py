"""Type hints are complete, and mypy in strict mode finds nothing."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def settings() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]


def test_mypy_is_strict_and_covers_the_whole_package():
    assert settings()["strict"] is True and settings()["files"] == ["pymc_backbone"]
    for override in settings()["overrides"]:
        assert "ignore_errors" not in override
        # Only packages of others are skipped whole.
        assert not override.get("ignore_missing_imports") or not any(
            name.startswith("pymc_backbone") for name in override["module"]
        )


def test_the_package_says_that_it_is_typed():
    assert (ROOT / "pymc_backbone" / "py.typed").exists()


def test_mypy_finds_nothing():
    """About 25 s without mypy's cache, 2 s with it."""
    pytest.importorskip("mypy")
    done = subprocess.run([sys.executable, "-m", "mypy"], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
