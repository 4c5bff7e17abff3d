"""What remembers holds no force at a release from where it was held for long: asked, told, and only where it is so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pymc_backbone as pb
from pymc_backbone.discrepancy.sets.relaxed_release import is_relaxed_at_release
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.simulation.decay import Simulator

from .discrepancy_cases import AMPLITUDE, DAMPING, FREQUENCY, MASS, STIFFNESS, batch_of

SLIDER = {"slider_stiffness": 0.2 * STIFFNESS, "slip_force": 0.05 * STIFFNESS * AMPLITUDE}
PARAMETERS = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING} | SLIDER
TIME = np.arange(25 * 60) / (60.0 * FREQUENCY)
BASE = pb.Oscillator(MASS, ["jenkins"])


def searched(rng, virgin):
    """A search whose base holds the slider, of accelerations from releases of one kind."""
    records = []
    for r in range(2):
        release = AMPLITUDE * (1.0 - 0.15 * r)
        exact = pb.simulate_waveform(BASE, PARAMETERS, TIME, release, virgin=virgin, quantity="acceleration")
        values = exact.values + 0.003 * np.abs(exact.values).max() * rng.standard_normal(TIME.size)
        records.append(Record(f"specimen {r + 1}", TIME, values, "acceleration", "m/s^2"))
    search = Search(batch_of(records), BASE, ("cubic_stiffness",), 1, lambda _stage, _share: None)
    search.fit_set(())
    return search


def test_a_slider_without_force_at_the_release_is_told_from_one_that_was_loaded(rng):
    eased = searched(rng, virgin=False)
    assert not evidence.leaves_noise(eased.batch, eased.fits[()])
    assert is_relaxed_at_release(eased)
    again = Search(replace(eased.batch, is_relaxed=True), BASE, eased.candidates, 1, eased.progress)
    found = again.fit_set(())
    assert evidence.leaves_noise(again.batch, found)
    for name, value in SLIDER.items():
        assert found.value_of(name) == pytest.approx(value, rel=0.03)
    assert not is_relaxed_at_release(again)
    loaded = searched(rng, virgin=True)
    assert evidence.leaves_noise(loaded.batch, loaded.fits[()])
    assert not is_relaxed_at_release(loaded)


def test_a_relaxed_simulator_is_that_of_a_slider_that_begins_without_force():
    """Against the elastic slider as a differential equation with a limited force, begun at zero."""
    stiffness, limit = SLIDER["slider_stiffness"], SLIDER["slip_force"]

    def rates(_, y):
        sticks = abs(y[2]) < limit or y[2] * y[1] < 0.0
        force = STIFFNESS * y[0] + DAMPING * y[1] + float(np.clip(y[2], -limit, limit))
        return [y[1], -force / MASS, stiffness * y[1] if sticks else 0.0]

    period = 2.0 * np.pi * np.sqrt(MASS / STIFFNESS)
    instants = np.linspace(0.0, 1.5 * period, 40)
    exact = solve_ivp(
        rates, (0.0, instants[-1]), [AMPLITUDE, 0.0, 0.0], t_eval=instants, rtol=1e-9, atol=1e-12 * AMPLITUDE,
        max_step=period / 4000.0,
    ).y[0]  # fmt: skip
    vector = np.array([PARAMETERS[name] for name in BASE.parameter_names])
    eased = Simulator(BASE, is_relaxed=True).waveform(vector, AMPLITUDE, instants, 0)[0]
    loaded = Simulator(BASE).waveform(vector, AMPLITUDE, instants, 0)[0]
    assert np.abs(eased - exact).max() < 2e-4 * AMPLITUDE
    assert np.abs(loaded - exact).max() > 1e-2 * AMPLITUDE
