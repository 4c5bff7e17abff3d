"""Effects that the search does not look for by itself: records made by SciPy, in which they are found when named."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone import Oscillator, Record, find_missing_effect
from pymc_backbone.discrepancy.sets.question import ask, looked_for
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.effects import BASE_EFFECTS, LIBRARY
from pymc_backbone.measurement.options import Measuring

from .decay_oracles import Decay
from .discrepancy_cases import batch_of

MASS, OMEGA, AMPLITUDE = 1.2, 2.0 * np.pi * 7.0, 0.008
STIFFNESS, DAMPING = MASS * OMEGA**2, 2.0 * 0.004 * MASS * OMEGA
FORCE = STIFFNESS * AMPLITUDE
TRUTHS = {
    "stribeck_friction": (0.0015 * FORCE, 1.0, 0.15 * AMPLITUDE * OMEGA),
    "power_damping": (0.02 * FORCE, 1.6, AMPLITUDE * OMEGA),
    "power_stiffness": (0.15 * FORCE, 2.2, AMPLITUDE),
    "offset_freeplay": (0.4 * STIFFNESS, 0.4 * AMPLITUDE, -0.4),
    "one_sided_stiffness": (0.4 * STIFFNESS, 0.25 * AMPLITUDE),
    "hertz_contact": (0.4 * STIFFNESS / AMPLITUDE**0.5, 0.2 * AMPLITUDE),
    "magnetic_stiffness": (0.01 * FORCE, 2.0 * AMPLITUDE, 4.0),
    "asymmetric_drag": (0.015 * MASS / AMPLITUDE, 0.7),
    "bilinear_damping": (0.03 * MASS * OMEGA,),
    "nonlinear_inertia": (0.2 * MASS / AMPLITUDE**2,),
    "absolute_displacement_damping": (0.04 * MASS * OMEGA / AMPLITUDE,),
    "power_displacement_damping": (0.04 * MASS * OMEGA, 0.6, AMPLITUDE),
    "damped_stop": (0.4 * STIFFNESS, 0.25 * AMPLITUDE, 0.2 / (AMPLITUDE * OMEGA)),
    "geometric_stiffness": (0.4 * STIFFNESS, 0.5 * AMPLITUDE),
    "dead_band_damping": (0.05 * MASS * OMEGA, 0.45 * AMPLITUDE),
    "mid_stroke_damping": (0.04 * MASS * OMEGA, 0.3 * AMPLITUDE),
    "speed_limited_damping": (0.04 * MASS * OMEGA, 0.4 * AMPLITUDE * OMEGA),
}
DAHL = {"dahl_friction": (0.1 * STIFFNESS, 0.01 * FORCE)}
"""A case of another effect, which is not looked for beside that one."""
OTHERS = ("structural_damping", "maxwell_element", "tabulated_stiffness", "tabulated_damping")


def records_of(name: str, values, *, specimens: int = 3, cycles: int = 30, noise: float = 1e-3) -> list[Record]:
    """Return noisy decays of specimens that differ by half a per cent, computed by SciPy."""
    rng = np.random.default_rng(abs(hash_of(name)))
    oscillator = Oscillator(MASS, name)
    time = np.arange(0.0, cycles * 2.0 * np.pi / OMEGA, 2.0 * np.pi / OMEGA / 40.0)
    records = []
    for number in range(specimens):
        spread = 1.0 + 0.005 * rng.standard_normal(2)
        decay = Decay(oscillator, [STIFFNESS * spread[0], DAMPING * spread[1], *values]).release(AMPLITUDE)
        while decay.t < time[-1]:
            if decay.half_cycle() is None:
                break
        x = decay.displacement(time)
        x = np.where(np.isfinite(x), x, decay.y[0])  # stuck
        x = x + noise * AMPLITUDE * rng.standard_normal(time.size)
        records.append(Record(f"specimen {number + 1}", time, x, "displacement", "m"))
    return records


def hash_of(name: str) -> int:
    return sum((place + 1) * ord(letter) for place, letter in enumerate(name))


def test_variants_and_what_one_mode_does_not_show_are_not_looked_for_by_themselves():
    assert set(LIBRARY) - set(looked_for("rad")) == {*BASE_EFFECTS, *TRUTHS, *DAHL, *OTHERS}
    assert set(TRUTHS) == {name for name, effect in LIBRARY.items() if effect.variant_of}
    assert {*DAHL, *OTHERS} == {name for name, effect in LIBRARY.items() if effect.only_if_named}


@pytest.mark.parametrize(
    ("loss", "effects"), [(0.03, ("structural_damping",)), (0.008, ("structural_damping",)), (0.002, ())]
)
def test_what_backbones_do_not_show_is_asked_where_nothing_else_explains_the_samples(loss, effects):
    """Its force jumps at the turning points; where the noise hides that, the viscous damper stands for it.

    However little that leaves: of the middle one a chi-square that is larger by 4 %, which is no noise all the same.
    """
    batch = batch_of(records_of("structural_damping", (loss * STIFFNESS,)), MASS)
    search = Search(
        batch, Oscillator(MASS), ("cubic_stiffness", "quadratic_damping"), 2,
        reserved=("structural_damping", "maxwell_element"),
    )  # fmt: skip
    search.run()
    assert search.best() == effects and search.explains(search.fits[effects])
    assert search.variants == effects
    assert all("structural_damping" not in names for names in search.fits if names != ("structural_damping",))


@pytest.mark.parametrize("is_far_off", [False, True])
def test_what_is_reserved_is_not_asked_beside_what_is_far_off_all_records(is_far_off, monkeypatch):
    batch = batch_of(records_of("structural_damping", (0.03 * STIFFNESS,)), MASS)
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness",), 2, reserved=("structural_damping",))
    search.fit_set(())
    search.fit_set(("cubic_stiffness",))
    asked = []
    monkeypatch.setattr(Search, "_is_far_off", lambda _: is_far_off)
    monkeypatch.setattr(Search, "best", lambda _: ("cubic_stiffness",))
    monkeypatch.setattr(Search, "fit_set", lambda _, names: asked.append(names))
    search._ask_reserved()
    beside = [("cubic_stiffness", "structural_damping")]
    assert asked == [("structural_damping",)] + (not is_far_off) * beside


def test_what_is_reserved_is_asked_unless_candidates_are_named():
    def asked(model, candidates):
        return ask(
            model, records_of("structural_damping", (0.002 * STIFFNESS,)), candidates=candidates, max_effects=1,
            tolerance=None, measuring=Measuring(),
        ).reserved  # fmt: skip

    assert asked(Oscillator(MASS), None) == ("dahl_friction", "maxwell_element", "structural_damping")
    assert asked(Oscillator(MASS, "structural_damping"), None) == ("dahl_friction", "maxwell_element")
    assert asked(Oscillator(MASS), ["cubic_stiffness"]) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "values"), [*TRUTHS.items(), *DAHL.items()])
def test_an_effect_is_found_where_it_is_named(name, values):
    study = find_missing_effect(Oscillator(MASS), records_of(name, values), candidates=[name], quick=True)
    assert (study.verdict, study.missing_effects) == ("found", (name,)), study.sentence
