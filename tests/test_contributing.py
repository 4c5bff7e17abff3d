"""The example of CONTRIBUTING.md is an effect: written to a file, hidden in records, and named."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import pymc_backbone as pb

from .discrepancy_cases import (
    AMPLITUDE,
    DAMPING,
    MASS,
    RELEASE_TIME,
    STIFFNESS,
    TIME,
    Force,
    force_of,
    free_decay,
    noisy,
)

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def example(tmp_path_factory) -> ModuleType:
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    path = tmp_path_factory.mktemp("own") / "rubber_stop.py"
    path.write_text(code, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("rubber_stop", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["rubber_stop"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["rubber_stop"]


def records_of(effect: pb.Effect, rng: np.random.Generator) -> list[pb.Record]:
    """Two specimens with the effect: 40 % of the linear force at the largest amplitude, noise at -45 dB."""
    law = effect.force.py_func  # the force as it is written, integrated by SciPy
    records = []
    for number, release in ((1, AMPLITUDE), (2, 0.75 * AMPLITUDE)):
        truth = {
            "linear_stiffness": STIFFNESS * (1.0 + 0.01 * rng.standard_normal()),
            "viscous_damping": DAMPING,
            "rubber_stop_stiffness": 0.4 * STIFFNESS / AMPLITUDE**6,
        }
        p = np.array([truth["rubber_stop_stiffness"]])
        linear = force_of((), truth)

        def force(x: float, v: float, direction: float, p: np.ndarray = p, linear: Force = linear) -> float:
            return linear(x, v, direction) + law(x, v, direction, None, p)

        exact = free_decay(force, release, TIME - RELEASE_TIME)
        records.append(noisy(rng, f"specimen {number}", TIME, exact))
    return records


def test_the_example_is_no_effect_of_the_library(example):
    assert example.EFFECT.name not in pb.LIBRARY


def test_its_gradient_is_that_of_its_force(example):
    p, out = np.array([3.0e9]), np.empty(3)
    example.gradient(0.02, 0.5, 1.0, np.empty(0), p, out)
    step = 1e-6
    force = [example.force(0.02 + h, 0.5, 1.0, np.empty(0), p) for h in (-step, step)]
    # central differences of x^7: relative error (h/x)^2 35/6 = 1.5e-8
    assert out[0] == pytest.approx((force[1] - force[0]) / (2 * step), rel=1e-6)
    assert out[1] == 0.0 and out[2] * p[0] == pytest.approx(example.force(0.02, 0.5, 1.0, np.empty(0), p))


@pytest.mark.slow  # a minute and a half, most of it numba's: the search with an effect of a user's own is compiled anew
def test_the_example_is_named_where_it_is_hidden(example, rng):
    records = records_of(example.EFFECT, rng)
    springs = ["cubic_stiffness", "quintic_stiffness", "coulomb_friction"]
    options = {"max_effects": 1, "quick": True, "random_seed": 1, "held_out": 0}
    study = pb.find_missing_effect(pb.Oscillator(MASS), records, candidates=[*springs, example.EFFECT], **options)
    assert study.verdict == "found", study.sentence
    assert study.missing_effects == ("rubber_stop",) and study.probability > 0.9
    reason = study.reasons[0]
    assert reason.startswith("Rubber stop: ") and reason.endswith("In other words: stop of rubber.")
    estimate = study.parameters["rubber_stop"]["rubber_stop_stiffness"]
    assert estimate.mean == pytest.approx(0.4 * STIFFNESS / AMPLITUDE**6, rel=0.1)
    # Negative control: without it among the candidates, nothing else is taken for it.
    without = pb.find_missing_effect(pb.Oscillator(MASS), records, candidates=springs, **options)
    assert without.verdict != "found" or without.probability < 0.9, without.sentence


def test_two_effects_of_one_name_are_refused(example, rng):
    import dataclasses

    impostor = dataclasses.replace(example.EFFECT, name="cubic_stiffness")
    with pytest.raises(pb.InputError, match="another effect named 'cubic_stiffness'"):
        pb.find_missing_effect(pb.Oscillator(MASS), records_of(example.EFFECT, rng), candidates=[impostor])


def test_versions_and_deprecation_are_stated():
    for words in (
        "Semantic versioning",
        "FutureWarning",
        "at least one minor release",
        "## Release",
        "## Add an effect",
    ):
        assert words in TEXT
