"""Shared by all tests: seeds from the test's name, a picture backend without a screen, measured records if present."""

from __future__ import annotations

import importlib
import os
import zlib
from pathlib import Path

import numpy as np
import pytest

os.environ.setdefault("MPLBACKEND", "Agg")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_configure(config: pytest.Config) -> None:
    """Compile the simulator once, with two processes, before several begin to test: each would do it by itself."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        importlib.import_module("pymc_backbone.discrepancy.workflow")  # whose functions are compiled with the simulator
        if not importlib.import_module("pymc_backbone.simulation.machine_code").is_compiled():
            print("compiling the simulator, once on this computer: a minute or two", flush=True)
        importlib.import_module("pymc_backbone.likelihood.native").define_symbols()


@pytest.fixture
def random_seed(request: pytest.FixtureRequest) -> int:
    """A seed that depends on the test's name alone, so that adding a test changes no other."""
    return zlib.crc32(request.node.name.encode())


@pytest.fixture
def rng(random_seed: int) -> np.random.Generator:
    """A random generator seeded from the test's name."""
    return np.random.default_rng(random_seed)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of measured records beside the checkout; tests that need it are skipped where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("measured records (../shared/data beside the checkout) are not on this machine")
    return SHARED_DATA
