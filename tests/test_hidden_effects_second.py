"""The second generator of `benchmarks/hidden_effects`: another integrator, other laws in code, other noise."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks" / "hidden_effects"
sys.path.insert(0, str(FOLDER))

import generate  # noqa: E402
from motion import simulate  # noqa: E402
from new_strengths import draw_new  # noqa: E402
from outcomes import read_outcomes  # noqa: E402
from second_laws import TERMS  # noqa: E402
from second_motion import decay  # noqa: E402
from second_ranges import RATES, coloured, make_second_batch  # noqa: E402
from strengths import STIFFNESS_KINDS, draw_parameters  # noqa: E402
from systems import LIBRARY, NEW, OUTSIDE, pack  # noqa: E402

MASS, STIFFNESS, DAMPING = 2.0, 800.0, 0.4
LINEAR = {"mass": MASS, "linear_stiffness": STIFFNESS, "viscous_damping": DAMPING}


def test_laws_and_integrator_are_not_those_of_the_first_generator() -> None:
    for name in ("second_laws.py", "second_motion.py"):
        tree = ast.parse((FOLDER / name).read_text(encoding="utf-8"))
        modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not modules & {"laws", "motion", "systems", "strengths", "new_strengths"}
    assert set(TERMS) == {*LIBRARY, *NEW, *OUTSIDE, "linear", "viscous"}


@pytest.mark.parametrize("effect", sorted({*LIBRARY, *NEW, *OUTSIDE}))
def test_both_generators_move_alike(effect: str, rng: np.random.Generator) -> None:
    amplitude = 0.8 if effect == "pendulum_stiffness" else 0.01
    system = {"mass": MASS, "stiffness": STIFFNESS, "amplitude": amplitude}
    strength = 0.1 if effect in STIFFNESS_KINDS else 0.003
    if effect in NEW:
        parameters, _ = draw_new(effect, strength, rng, **system)
    else:
        parameters, _ = draw_parameters(effect, strength, rng, damping=DAMPING, **system)
    time = np.linspace(-0.1, 5.0, 800)
    first = simulate(pack(LINEAR | parameters), amplitude, time)
    second = decay(LINEAR | parameters, [effect], amplitude, time)
    # Steps of 1e-11 in both; the bed of 4000 sliders is 1e-7 off the continuous one.
    scale = 1e-6 if effect == "iwan" else 1e-7
    np.testing.assert_allclose(second.values[0], first.displacement, rtol=0.0, atol=scale * amplitude)
    np.testing.assert_allclose(second.values[1], first.rates[0], rtol=0.0, atol=scale * amplitude * 20.0)
    turns = min(first.turn_times.size, second.turn_times.size, 20)
    np.testing.assert_allclose(second.turn_values[:turns], first.turn_values[:turns], rtol=0.0, atol=scale * amplitude)


@pytest.mark.parametrize("index", [2, 4, 6])
def test_batches_agree_with_the_first_generators_integrator(index: int) -> None:
    batch = make_second_batch(31, index)
    truth = batch.truth
    assert not truth["outside"]
    for record, specimen in zip(batch.records[:2], truth["parameters"], strict=False):
        parameters = {name: value for name, value in specimen.items() if name != "specimen"}
        own = simulate(pack(parameters), record.release_amplitude, record.time - record.release_time)
        order = ("displacement", "velocity", "acceleration").index(truth["quantity"])
        expected = np.vstack([own.displacement, own.rates])[order]
        scale = record.release_amplitude * (2.0 * np.pi * truth["actual_frequency"]) ** order
        # An acceleration jumps where friction turns: a sample at the very instant may be on either side.
        is_off = np.abs(record.exact - expected) > 1e-6 * scale
        assert is_off.mean() < (1e-3 if order == 2 else 1e-12)


def test_a_batch_depends_on_seed_and_index_only() -> None:
    once, again, other = make_second_batch(3, 2), make_second_batch(3, 2), make_second_batch(4, 2)
    assert once.truth == again.truth and once.truth["tier"] == "second"
    assert all(np.array_equal(a.measured, b.measured) for a, b in zip(once.records, again.records, strict=True))
    assert other.truth["mass"] != once.truth["mass"]
    rate = (once.records[0].time.size - 1) / once.records[0].time[-1]
    assert min(abs(rate / known - 1.0) for known in RATES) < 1e-9


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_coloured_noise_has_its_spectrum(power: float, rng: np.random.Generator) -> None:
    size = 4096
    window = np.hanning(size)  # a walk that was cut does not meet its beginning
    spectra = [np.abs(np.fft.rfft(coloured(rng, size, power) * window)) ** 2 for _ in range(60)]
    band = slice(20, 1000)
    frequency = np.arange(size // 2 + 1)[band]
    slope = np.polyfit(np.log(frequency), np.log(np.mean(spectra, axis=0)[band]), 1)[0]
    assert slope == pytest.approx(-power, abs=0.05)  # four times its scatter over seeds
    assert np.std(coloured(rng, size, power)) == pytest.approx(1.0)


def test_the_command_writes_batches_that_can_be_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert generate.main(["--batches", "1", "--seed", "8", "--out", str(tmp_path), "--ranges", "second"]) == 0
    (outcome,) = read_outcomes(tmp_path)
    assert outcome.tier == "second" and outcome.outcome == "no result"
    truth = json.loads((tmp_path / "batch_0000" / "truth.json").read_text(encoding="utf-8"))
    clean = np.load(tmp_path / "batch_0000" / "clean.npz", allow_pickle=False)
    assert len(truth["parameters"]) == clean["noise_sd"].size
    with pytest.raises(SystemExit):
        generate.main(["--batches", "1", "--seed", "8", "--out", str(tmp_path), "--ranges", "second", "--tier", "long"])
    assert "no tiers" in capsys.readouterr().err
