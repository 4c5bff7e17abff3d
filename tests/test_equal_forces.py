"""Other laws of the same mechanism: each is fitted from where it has the force of what is known, and to its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pymc_backbone.discrepancy.fitting import equal_forces, starts
from pymc_backbone.discrepancy.fitting.joint_fit import fit
from pymc_backbone.discrepancy.fitting.normal_equations import start_state
from pymc_backbone.discrepancy.sets.fitted_sets import FittedSets
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.oscillator import Oscillator

from .discrepancy_cases import (
    AMPLITUDE,
    DAMPING,
    MASS,
    OMEGA,
    RELEASE_TIME,
    STIFFNESS,
    TIME,
    batch_of,
    free_decay,
    noisy,
)

GAP, STOPS, PUSH = 0.55 * AMPLITUDE, 0.01 * STIFFNESS, 0.5 * STIFFNESS / AMPLITUDE**0.5
HERTZ, STOP, PLAY = ("hertz_contact",), ("one_sided_stiffness",), ("damped_stop",)
POWER, SPRINGS = ("power_stiffness",), ("cubic_stiffness", "quintic_stiffness")


def decays(extra, decibels=60.0):
    """A batch of two specimens with a force beside spring and damper."""
    rng = np.random.default_rng(51)
    records = []
    for r, release in enumerate((AMPLITUDE, 0.8 * AMPLITUDE)):
        stiffness = (1.0 + 0.01 * r) * STIFFNESS

        def force(x, v, direction, stiffness=stiffness):
            return stiffness * x + DAMPING * v + extra(x, v, direction)

        exact = free_decay(force, release, TIME - RELEASE_TIME)
        records.append(noisy(rng, f"specimen {r + 1}", TIME, exact, decibels))
    return batch_of(records)


@pytest.fixture(scope="module")
def contact():
    """A contact on one side by Hertz's law; a stiff stop behind a larger gap is nearly the same."""
    return decays(lambda x, v, direction: PUSH * max(x - GAP, 0.0) ** 1.5, 42.0)


def known_at(search, names, values):
    """A set at values of its parameters, not fitted."""
    layout, batch = search.layout(names), search.batch
    eta = layout.coordinates(np.array([values[name] for name in layout.names]))
    state = start_state(layout, eta, batch.own)
    return replace(fit(layout, batch.deciding, state, iterations=1), state=state)


def test_one_law_stands_for_two_with_the_shape_that_has_most_nearly_their_force(contact):
    search = Search(contact, Oscillator(MASS), SPRINGS, 2, variants=POWER)
    strengths = {
        "cubic_stiffness": 0.1 * STIFFNESS / AMPLITUDE**2,
        "quintic_stiffness": 0.15 * STIFFNESS / AMPLITUDE**4,
    }
    known, layout = known_at(search, SPRINGS, strengths), search.layout(POWER)
    state = equal_forces.in_place_of(layout, known, OMEGA)
    motion = equal_forces.typical_motion(layout, OMEGA)
    x = motion[0]
    wanted = strengths["cubic_stiffness"] * x**3 + strengths["quintic_stiffness"] * x**5
    (power,) = [effect for effect in layout.oscillator.effects if effect.name == POWER[0]]
    found = starts.forces(layout, power, starts.parameters_at(layout, state.eta), *motion)
    left = wanted - found - (state.own[0, 0] - known.state.own[0, 0]) * x
    straight = wanted - np.polyfit(x, wanted, 1)[0] * x  # what no spring alone can do
    assert np.abs(left).max() < 0.2 * np.abs(straight).max()
    exponents = [p[layout.names.index("power_stiffness_exponent")] for p in starts.grid(layout, POWER[0], (1.0,))]
    assert state.eta[layout.names.index("power_stiffness_exponent")] in exponents


def test_a_contact_is_found_from_the_force_of_another_where_its_backbones_led_to_the_wrong_side(contact, monkeypatch):
    search = Search(contact, Oscillator(MASS), ("bilinear_stiffness", "freeplay"), 1, variants=(*STOP, *HERTZ))
    for names in ((), STOP):
        search.fit_set(names)
    looks = search._proposal(HERTZ)
    moved = [(cost, eta * np.array([-1.0, 1.0]), own) for cost, eta, own in looks.starts]
    astray = replace(looks, starts=moved, is_exact=False)
    asked = Search._proposal
    monkeypatch.setattr(Search, "_proposal", lambda self, names: astray if names == HERTZ else asked(self, names))
    assert search.best() == STOP and search.explains(search.fits[STOP])
    with monkeypatch.context() as without:
        without.setattr(FittedSets, "_of_equal_force", lambda *_: [])
        assert not any(item.cost < search.fits[STOP].cost for item in search._beside(HERTZ, None))
    search.asked.clear()
    search._ask_kindred()
    assert search.best() == HERTZ
    assert search.fits[HERTZ].value_of("hertz_gap") == pytest.approx(GAP, rel=0.02)
    assert search.fits[HERTZ].value_of("hertz_stiffness") == pytest.approx(PUSH, rel=0.05)


def test_a_variant_gives_way_to_the_plain_law_while_others_are_still_asked():
    def force(x, v, direction):
        return 0.1 * STIFFNESS / AMPLITUDE**2 * x**3 + 0.8 * DAMPING / (OMEGA * AMPLITUDE) * v * v * direction

    search = Search(
        decays(force, 50.0), Oscillator(MASS), (*SPRINGS, "quadratic_damping", "cubic_damping"), 2, variants=POWER
    )
    varied, plain = ("power_stiffness", "quadratic_damping"), ("cubic_stiffness", "quadratic_damping")
    for names in ((), varied):
        search.fit_set(names)
    assert search.best() == varied and search.explains(search.fits[varied])
    search._ask_kindred()
    assert search.best() == plain and varied not in search.fits
    assert ("cubic_damping", "cubic_stiffness") in search.fits


@pytest.fixture(scope="module")
def powered():
    """A spring of an exponent that no two plain ones have together, but nearly."""
    return decays(lambda x, v, direction: 0.25 * STIFFNESS * AMPLITUDE * abs(x / AMPLITUDE) ** 4.2 * np.sign(x), 52.0)


def test_a_free_exponent_is_asked_in_the_place_of_two_springs(powered):
    search = Search(powered, Oscillator(MASS), SPRINGS, 2, variants=POWER)
    for names in ((), *((name,) for name in SPRINGS), SPRINGS):
        search.fit_set(names)
    assert search.best() == SPRINGS and search.explains(search.fits[SPRINGS])
    search._vary_two(SPRINGS)
    assert search.best() == POWER
    assert search.fits[POWER].value_of("power_stiffness_exponent") == pytest.approx(4.2, abs=0.05)


def test_what_was_noted_with_one_step_is_carried_to_its_end(powered):
    both = ("cubic_stiffness", "power_stiffness")
    search = Search(powered, Oscillator(MASS), SPRINGS, 2, variants=POWER)
    for names in ((), POWER, both):
        search.fit_set(names)
    rested = search.fits[both]
    near = replace(rested.state, eta=rested.state.eta * np.where(rested.layout.is_strength, 1.0001, 1.0))
    noted = replace(search.descent.fit(rested.layout, powered.deciding, near, iterations=0), is_converged=False)
    assert search.best() == POWER and 1.0 < noted.cost - rested.cost < 20.0
    search.fits[both] = noted
    search._settle()
    assert search.fits[both].cost == pytest.approx(rested.cost, abs=0.05)


def test_single_effects_are_carried_to_their_end_before_nothing_is_said_to_be_missing(monkeypatch):
    """A gap that closes in few cycles had been noted 4 above its minimum, for a linear step promised nothing."""
    search = Search(decays(lambda x, v, direction: 0.0, 40.0), Oscillator(MASS), ("cubic_stiffness",), 1)
    settled = []
    monkeypatch.setattr(Search, "_settle", lambda self: settled.append((set(self.fits), self._is_answered())))
    search.run()
    assert settled == [({(), ("cubic_stiffness",)}, True)]


def test_a_set_that_lost_its_way_begins_small_beside_the_lower_one_within_it(powered, monkeypatch):
    """A joint beside a clearance ended 910 000 above its minimum, for the turning points had refuted a lost start."""
    both = ("cubic_stiffness", "quintic_stiffness")
    search = Search(powered, Oscillator(MASS), SPRINGS, 2)
    for names in ((), *((name,) for name in SPRINGS), both):
        search.fit_set(names)
    found = search.fits[both]
    assert search.fits[("cubic_stiffness",)].cost > search.fits[("quintic_stiffness",)].cost > 14.0 * search.count
    eta = found.state.eta * np.array([0.91, 1.09])
    lost = search.descent.fit(found.layout, powered.deciding, replace(found.state, eta=eta), iterations=0)
    assert 10.0 * search.count < lost.cost < search.fits[("quintic_stiffness",)].cost
    search.fits[both] = lost
    search.refuted.add(both)
    begun = []
    near = search.descent.from_near
    monkeypatch.setattr(search.descent, "from_near", lambda *given, **more: begun.append(given) or near(*given, **more))
    search._begin_from_smaller()
    assert search.fits[both].cost == pytest.approx(found.cost, abs=0.1) and not search.is_refuted(both)
    asked = len(begun)
    search._begin_from_smaller()  # nothing is lost any more
    assert asked == len(begun) >= 1


def test_the_last_looks_have_effort_of_their_own(powered):
    search = Search(powered, Oscillator(MASS), SPRINGS, 2)
    search.descent.effort = search.descent.limit
    search._keep_reserve()
    assert search.descent.limit == search.descent.effort + 2.0 * search.budget
    search.descent.effort /= 4.0
    search._keep_reserve()  # what is left is not made less
    assert search.descent.limit == 4.0 * search.descent.effort + 2.0 * search.budget


def test_a_variant_is_added_to_what_is_near_where_nothing_leaves_noise():
    batch = decays(
        lambda x, v, direction: 0.5 * DAMPING / (OMEGA * AMPLITUDE) * v * v * direction + STOPS * max(x - GAP, 0.0),
        54.0,
    )
    drag, both = ("quadratic_damping",), ("one_sided_stiffness", "quadratic_damping")
    search = Search(batch, Oscillator(MASS), (*drag, "bilinear_stiffness"), 2, variants=STOP)
    for names in ((), drag, ("bilinear_stiffness", *drag)):
        search.fit_set(names)
    assert not search.explains(search.fits[search.best()])
    search._add_variants()
    assert search.best() == both and search.explains(search.fits[both])
    fitted = len(search.fits)
    search._add_variants()  # nothing is left to explain
    assert len(search.fits) == fitted


@pytest.mark.parametrize(("second", "n_asked"), [(4.6, 2), (3.0, 1)])
def test_another_start_that_promises_nearly_as_much_is_asked_too(second, n_asked, powered, monkeypatch):
    """Of two shapes of hysteresis the one that promised a little less led to the minimum."""
    search = Search(powered, Oscillator(MASS), SPRINGS, 2)
    search.fit_set(())
    monkeypatch.setattr(Search, "explains", lambda _self, _found: True)
    parent, layout = search.fits[()], search.layout(("cubic_stiffness",))
    best = starts.by_score(layout, "cubic_stiffness", parent, powered)[0]
    monkeypatch.setattr(starts, "by_score", lambda *_: [best._replace(gain=gain) for gain in (5.0, second)])
    asked = []
    monkeypatch.setattr(type(search.descent), "from_near", lambda _self, _layout, states, **_: asked.append(states))
    search._extended(("cubic_stiffness", "quintic_stiffness"), layout, parent, None)
    assert len(asked[0]) == n_asked
