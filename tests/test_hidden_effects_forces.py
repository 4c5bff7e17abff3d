"""Restoring-force points and the comparison with symbolic regression: exact where an exact answer exists."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks" / "hidden_effects"
sys.path.insert(0, str(FOLDER))

import symbolic_regression as sr  # noqa: E402
from force_points import differentiated, points_of, read_truth  # noqa: E402
from generate import generate  # noqa: E402
from motion import simulate  # noqa: E402
from systems import pack  # noqa: E402


def test_points_of_a_harmonic_motion_converge_to_its_spring() -> None:
    time = np.arange(0.0, 5.0, 0.002)
    per_cycle = 2.0 * np.pi / 10.0 / 0.002

    def excess(window: float) -> float:
        points = differentiated(time, 0.02 * np.cos(10.0 * time), 3.0, per_cycle, window)
        factors = points.force[np.abs(points.x) > 0.01] / (300.0 * points.x[np.abs(points.x) > 0.01])
        assert np.ptp(factors) < 1e-7  # a harmonic comes out as one: the filter is symmetric
        return 1.0 - float(factors[0])

    # A quintic leaves the sixth derivative: the second derivative errs with the fourth power of the window.
    assert np.log2(excess(0.3) / excess(0.15)) == pytest.approx(4.0, abs=0.1)
    assert 0.0 < excess(0.5) < 0.01


def test_points_of_a_batch_are_forces_of_its_law(tmp_path: Path) -> None:
    generate(8, 990201, tmp_path, "force_curves")  # drag in one direction, 50 dB
    folder = tmp_path / "batch_0008"
    truth = read_truth(folder)
    each = [pack({k: v for k, v in row.items() if k != "specimen"}) for row in truth["parameters"]]
    for points, p, row in zip(points_of(folder, truth), each, truth["parameters"], strict=True):
        off = points.force - sr.true_force([p], truth["mass"])(points.x, points.v)
        elastic = row["linear_stiffness"] * truth["amplitude"]
        # Noise of 2.2e-3 of the displacement, differentiated twice over half a cycle.
        assert np.sqrt(np.mean(off**2)) < 8e-3 * elastic


def test_errors_know_the_truth_and_no_line() -> None:
    p = pack({"mass": 2.0, "linear_stiffness": 800.0, "viscous_damping": 0.4, "cubic_stiffness": 1e6})
    motion = simulate(p, 0.01, np.linspace(0.01, 3.0, 400))
    x, v = motion.displacement, motion.rates[0]
    true = sr.true_force([p], 2.0)
    with_line = sr.errors(lambda x, v: 1e6 * x**3 + 3.0 * x - 0.2 * v, true, x, v)
    assert with_line["rms"] < 1e-9 and with_line["within"] < 1e-9
    # Nothing found errs by the force itself, a cube of nine tenths by a tenth of it.
    nothing = sr.errors(lambda x, v: 0.0 * x, true, x, v)
    assert nothing["rms"] == pytest.approx(1.0) and 0.5 < nothing["within"] <= 1.0
    part = sr.errors(lambda x, v: 0.9e6 * x**3, true, x, v)
    assert part["rms"] == pytest.approx(0.1)
    assert part["within"] == pytest.approx(0.1 * nothing["within"])


def test_friction_jumps_at_rest_and_is_not_drawn_through_it() -> None:
    at = np.linspace(-2.0, 2.0, 41)
    v = np.array([-1.5, -0.01, -1e-9, 1e-9, 0.01, 0.33])
    found = sr.on_either_side(v, at, np.sign(at) * 3.0 + 0.5 * at)
    np.testing.assert_allclose(found, np.sign(v) * 3.0 + 0.5 * v, rtol=1e-12)


@pytest.mark.parametrize(
    "curve, law, family",
    [
        ("conservative", lambda u: u**3, "power law"),
        ("conservative", lambda u: np.abs(u) ** 1.6, "power law, even"),
        ("conservative", lambda u: np.maximum(u - 0.4, 0.0), "kink on one side"),
        ("conservative", lambda u: np.sin(9.0 * u), "none"),
        ("damping", lambda u: np.sign(u) * np.sqrt(np.abs(u)), "power law"),
        ("damping", lambda u: np.maximum(u, 0.0) ** 2, "power law on one side"),
        ("damping", lambda u: np.sign(u) * (1.0 + np.exp(-8.0 * np.abs(u))), "minimum of damping"),
    ],
)
def test_families_of_exact_curves(curve: str, law: sr.Callable, family: str) -> None:
    at = np.linspace(-0.02, 0.02, 161)
    assert sr.family_of(curve, at, 5.0 * law(at / 0.02) + 100.0 * at) == family


@pytest.mark.skipif(find_spec("pyoperon") is not None, reason="pyoperon is installed here")
def test_without_the_regressor_the_script_says_how_to_get_it(tmp_path: Path) -> None:
    command = [sys.executable, str(FOLDER / "symbolic_regression.py"), str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0 and run.stderr == ""
    assert "uv run --with pyoperon" in run.stdout and run.stdout.count("\n") == 1
