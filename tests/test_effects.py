"""Effects: every test over `LIBRARY` runs on a new effect by itself; the sliders meet brute-force beds."""

from __future__ import annotations

import ast
import itertools
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pymc_backbone.effects as effects_package
from pymc_backbone._common.checks import InputError
from pymc_backbone.effects import BASE_EFFECTS, LIBRARY, MECHANISMS, Effect, Parameter, Signature, get_effect
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_backbone

ALL = pytest.mark.parametrize("effect", LIBRARY.values(), ids=LIBRARY.keys())


def having(label: str) -> pytest.MarkDecorator:
    """Run over the effects that have a function of their own called ``label``."""
    chosen = [effect for effect in LIBRARY.values() if getattr(effect, label) is not None]
    return pytest.mark.parametrize("effect", chosen, ids=[effect.name for effect in chosen])


# An unround mass, amplitude and frequency, far from one, so that a missing factor shows.
MASS, AMPLITUDE, OMEGA = 0.37, 0.23, 41.0
FORCE = MASS * OMEGA**2 * AMPLITUDE
NO_STATE = np.zeros(0)


def draw_parameters(effect: Effect, rng: np.random.Generator) -> np.ndarray:
    """Draw inside the default bounds, away from their ends."""
    bounds = np.array([parameter.bounds(MASS, AMPLITUDE, OMEGA) for parameter in effect.parameters])
    return bounds[:, 0] + rng.uniform(0.1, 0.9, len(bounds)) * (bounds[:, 1] - bounds[:, 0])


def kept_of(effect: Effect):
    """Return what an effect with memory keeps of a turning point: its force there, unless it says otherwise."""
    return effect.remembered or effect.force


def draw_state(effect: Effect, p: np.ndarray, rng: np.random.Generator) -> tuple[float, float, float, np.ndarray]:
    """Draw x, v, direction and z that belong together."""
    direction = float(rng.choice([-1.0, 1.0]))
    v = direction * AMPLITUDE * OMEGA * rng.uniform(0.05, 1.0)
    if not effect.has_memory:
        return AMPLITUDE * rng.uniform(-1.0, 1.0), v, direction, AMPLITUDE * rng.uniform(-1.0, 1.0, effect.n_states)
    z = np.zeros(3)
    if rng.random() < 0.5:
        # After a reversal: the slider was loaded from its virgin state to x_r, where the motion turned round.
        x_r = -direction * AMPLITUDE * rng.uniform(0.2, 1.0)
        z = np.array([x_r, kept_of(effect)(x_r, 0.0, -direction, z, effect.with_room(p)), 1.0])
    # At least a fifth of the amplitude away from the turning point, where a bed of sliders has a vertical tangent.
    return z[0] + direction * AMPLITUDE * rng.uniform(0.2, 1.8), v, direction, z


def differentiate(function, at: float, step: float) -> np.ndarray:
    """Differentiate by central differences at three steps, extrapolated to an error of order step^6 (Richardson)."""
    table = [(function(at + h) - function(at - h)) / (2.0 * h) for h in (step, step / 2, step / 4)]
    for factor in (4.0, 16.0):
        table = [(factor * fine - coarse) / (factor - 1.0) for coarse, fine in itertools.pairwise(table)]
    return table[0]


TABULATED = ("tabulated_stiffness", "tabulated_damping")


def label_of(effect: Effect, x, v, direction, z, p) -> int:
    arguments = (x, v, direction, z, effect.with_room(p))
    if effect.name in TABULATED:  # smooth to the second derivative only where pieces of a spline meet
        place = abs(x if effect.name == "tabulated_stiffness" else v) / p[-1]
        nodes = effect.force.py_func.__globals__["NODES"]
        return int(np.searchsorted(nodes, place)) * (1 if (x if "stiff" in effect.name else v) > 0.0 else -1)
    return 0 if effect.regime is None else effect.regime(*arguments)


def columns(effect: Effect, p: np.ndarray, n_z: int) -> list[tuple[str, int, float]]:
    """Return (kind, index, scale) of each column of a gradient: x, v, parameters, states."""
    scales = [max(abs(b) for b in parameter.bounds(MASS, AMPLITUDE, OMEGA)) for parameter in effect.parameters]
    kept = AMPLITUDE if effect.remembered else FORCE
    states = [("z", 0, AMPLITUDE), ("z", 1, kept)] if effect.has_memory else [("z", i, AMPLITUDE) for i in range(n_z)]
    return [("x", 0, AMPLITUDE), ("v", 0, AMPLITUDE * OMEGA), *(("p", i, s) for i, s in enumerate(scales)), *states]


def check_against_differences(effect: Effect, evaluate, gradient, output_scale: float, rng) -> None:
    """Compare each column of ``gradient`` with differences of ``evaluate`` at points away from kinks."""
    compared = 0
    is_lagging = not effect.has_memory or effect.remembered is not None  # a power of a state that is zero
    for _ in range(60):
        p = draw_parameters(effect, rng)
        x, v, direction, z = draw_state(effect, p, rng)
        exact = gradient(x, v, direction, z, p)
        for column, (kind, index, scale) in enumerate(columns(effect, p, effect.n_states)):

            def shifted(value, kind=kind, index=index, x=x, v=v, direction=direction, z=z, p=p):
                z_new, p_new = z.copy(), p.copy()
                if kind in "zp":
                    (z_new if kind == "z" else p_new)[index] = value
                return value if kind == "x" else x, value if kind == "v" else v, direction, z_new, p_new

            at = {"x": x, "v": v, "p": p[index] if kind == "p" else 0.0, "z": z[index] if kind == "z" else 0.0}[kind]
            step = 3e-3 * scale
            # Well away from a kink, where the higher derivatives of a power law are out of bounds.
            labels = {label_of(effect, *shifted(at + i * step / 4)) for i in range(-24, 25)}
            if len(labels) > 1 or (kind == "z" and abs(at) < 2 * step and is_lagging):
                continue
            difference = differentiate(lambda value, shifted=shifted: evaluate(*shifted(value)), at, step)
            # Truncation (3e-3)^6 ~ 1e-15 times a growth of the higher derivatives of the power laws of up to ~1e5,
            # rounding 2e-16 / (3e-3 / 4) ~ 3e-13: 1e-9 of the natural size holds both.
            np.testing.assert_allclose(
                exact[..., column] * scale, difference * scale, rtol=1e-9, atol=1e-9 * output_scale
            )
            compared += 1
    assert compared > 30 * (2 + len(effect.parameters))


@having("gradient")
def test_gradient_matches_differences(effect, rng):
    def gradient(x, v, direction, z, p):
        out = np.full(2 + len(p) + len(z), np.nan)
        effect.gradient(x, v, direction, z, effect.with_room(p), out)
        assert np.all(np.isfinite(out))
        return out

    def force(x, v, direction, z, p):
        return effect.force(x, v, direction, z, effect.with_room(p))

    check_against_differences(effect, force, gradient, FORCE, rng)


@having("remembered")
def test_gradient_of_what_is_remembered_matches_differences(effect, rng):
    def gradient(x, v, direction, z, p):
        out = np.full(2 + len(p) + len(z), np.nan)
        effect.remembered_gradient(x, v, direction, z, effect.with_room(p), out)
        return out

    def remembered(x, v, direction, z, p):
        return effect.remembered(x, v, direction, z, effect.with_room(p))

    check_against_differences(effect, remembered, gradient, AMPLITUDE, rng)


@pytest.mark.parametrize("effect", [effect for effect in LIBRARY.values() if effect.n_room], ids=lambda e: e.name)
def test_room_changes_no_number_and_its_lack_gives_none(effect, rng):
    """What was worked out for other parameters or another turning point before leaves nothing behind."""
    used = effect.with_room(draw_parameters(effect, rng))
    for _ in range(100):
        p = draw_parameters(effect, rng)
        x, v, direction, z = draw_state(effect, p, rng)
        if rng.random() < 0.5:  # the same parameters again, elsewhere
            p = used[: p.size].copy()
        used[: p.size] = p
        slopes = np.full((2, 2 + p.size + z.size), np.nan)
        effect.gradient(x, v, direction, z, used, slopes[0])
        effect.gradient(x, v, direction, z, effect.with_room(p), slopes[1])
        np.testing.assert_array_equal(*slopes)
        expected = effect.force(x, v, direction, z, effect.with_room(p))
        assert effect.force(x, v, direction, z, used) == pytest.approx(expected, rel=1e-15)
        assert np.isnan(effect.force(x, v, direction, z, p))
        effect.gradient(x, v, direction, z, p, slopes[0])
        assert np.isnan(slopes[0]).all()


@having("state_rate_gradient")
def test_state_rate_gradient_matches_differences(effect, rng):
    def rate(x, v, direction, z, p):
        out = np.full(len(z), np.nan)
        effect.state_rate(x, v, direction, z, p, out)
        return out

    def gradient(x, v, direction, z, p):
        out = np.full((len(z), 2 + len(p) + len(z)), np.nan)
        effect.state_rate_gradient(x, v, direction, z, p, out)
        assert np.all(np.isfinite(out))
        return out

    check_against_differences(effect, rate, gradient, AMPLITUDE * OMEGA, rng)


@ALL
def test_force_is_zero_at_zero_parameters(effect, rng):
    zeros = np.zeros(len(effect.parameters))
    for _ in range(20):
        x, v, direction, z = draw_state(effect, zeros, rng)
        assert effect.force(x, v, direction, z, effect.with_room(zeros)) == 0.0
        out = np.full(2 + len(zeros) + len(z), np.nan)
        if effect.gradient is not None:
            effect.gradient(x, v, direction, z, effect.with_room(zeros), out)
            assert np.all(np.isfinite(out))
            assert out[0] == out[1] == 0.0
        if effect.state_rate is not None:
            rate = np.full(len(z), np.nan)
            effect.state_rate(x, v, direction, z, zeros, rate)
            assert np.all(np.isfinite(rate))


@having("regime")
def test_force_is_continuous_where_the_regime_changes(effect, rng):
    crossings = 0
    for _ in range(40):
        p = draw_parameters(effect, rng)
        _, v, direction, z = draw_state(effect, p, rng)
        start = z[0] if effect.has_memory else -2.0 * AMPLITUDE * direction

        def at(s, v=v, direction=direction, z=z, p=p, start=start):
            """Move along x in the direction of motion or, for an internal state, along z."""
            if effect.n_states and not effect.has_memory:
                return 0.0, v, direction, np.full(effect.n_states, s - AMPLITUDE), p
            return start + direction * s, v, direction, z, p

        grid = np.linspace(0.0, 4.0 * AMPLITUDE, 401)
        labels = [label_of(effect, *at(s)) for s in grid]
        for i in np.flatnonzero(np.diff(labels)):
            low, high = grid[i], grid[i + 1]
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if label_of(effect, *at(middle)) == labels[i] else (low, middle)
            before, behind = (effect.force(*at(s)[:-1], effect.with_room(p)) for s in (low, high))
            # The two points are one rounding apart.
            assert abs(behind - before) < 1e-12 * max(FORCE, abs(behind))
            if effect.state_rate is not None:
                rates = np.zeros((2, effect.n_states))
                effect.state_rate(*at(low), rates[0])
                effect.state_rate(*at(high), rates[1])
                assert np.all(np.abs(rates[1] - rates[0]) < 1e-12 * AMPLITUDE * OMEGA)
            crossings += 1
    assert crossings >= 10


ASYMMETRIC = (
    *("quadratic_stiffness", "bilinear_stiffness", "bilinear_damping", "asymmetric_drag"),
    *("offset_freeplay", "one_sided_stiffness", "hertz_contact", "damped_stop", *TABULATED),
)


@pytest.mark.parametrize("name", [name for name in LIBRARY if name not in ASYMMETRIC])
def test_symmetric_effect_has_an_odd_force(name, rng):
    effect = LIBRARY[name]
    for _ in range(20):
        p = draw_parameters(effect, rng)
        x, v, direction, z = draw_state(effect, p, rng)
        mirrored = z * np.array([-1.0, -1.0, 1.0]) if effect.has_memory else -z
        room = effect.with_room(p)
        assert effect.force(-x, -v, -direction, mirrored, room) == -effect.force(x, v, direction, z, room)


def dimension(unit: str) -> np.ndarray:
    """Return the exponents of mass, length and time of a unit; 1/m^n counts as an exponent n of 1."""
    if "rad" in unit:  # a rotation: the moment is the force and the angle the length
        unit = unit.replace("N m", "N").replace("rad", "m")
    base = {"N": (1, 1, -2), "m": (0, 1, 0), "s": (0, 0, 1), "kg": (1, 0, 0)}
    total = np.zeros(3)
    numerator, _, denominator = unit.partition("/")
    for sign, part in ((1, numerator), (-1, denominator)):
        for token in part.split():
            if token not in ("-", "1"):
                symbol, _, power = token.partition("^")
                total += sign * np.array(base[symbol]) * (1 if power in ("", "n") else float(power))
    return total


@ALL
def test_default_bounds_do_not_depend_on_units(effect):
    mass, length, time = 1e3, 1e-3, 60.0
    for parameter in effect.parameters:
        low, high = parameter.bounds(MASS, AMPLITUDE, OMEGA)
        assert parameter.minimum <= low < high <= parameter.maximum
        factor = np.prod(np.array([mass, length, time]) ** dimension(parameter.unit))
        rescaled = parameter.bounds(MASS * mass, AMPLITUDE * length, OMEGA / time)
        # Only the rounding of a few powers.
        np.testing.assert_allclose(rescaled, [low * factor, high * factor], rtol=1e-13)


@ALL
def test_text_and_latex_mention_every_parameter(effect):
    for parameter in effect.parameters:
        assert re.search(rf"\b{parameter.name}\b", effect.text)
        assert parameter.latex in effect.latex
        assert parameter.summary and "\n" not in parameter.summary
    assert effect.summary and "\n" not in effect.summary
    assert effect.references


@ALL
def test_functions_compile_for_scalars_and_contiguous_arrays(effect):
    number, vector, matrix = numba.float64, numba.float64[::1], numba.float64[:, ::1]
    state = (number, number, number, vector, vector)
    wanted = {
        "force": (state, number),
        "gradient": ((*state, vector), numba.none),
        "regime": (state, numba.int64),
        "remembered": (state, number),
        "remembered_gradient": ((*state, vector), numba.none),
        "state_rate": ((*state, vector), numba.none),
        "state_rate_gradient": ((*state, matrix), numba.none),
    }
    for label, (signature, returned) in wanted.items():
        function = getattr(effect, label)
        if function is not None:
            function.compile(signature)
            assert function.overloads[signature].signature.return_type == returned, label


def test_library_is_ordered_and_names_are_unique():
    names = list(LIBRARY)
    assert tuple(names[:2]) == BASE_EFFECTS
    assert names[2:] == sorted(names[2:])
    parameters = [parameter for effect in LIBRARY.values() for parameter in effect.parameters]
    assert len({parameter.name for parameter in parameters}) == len(parameters)
    assert len({parameter.latex for parameter in parameters}) == len(parameters)
    with pytest.raises(TypeError):
        LIBRARY["mine"] = LIBRARY["iwan"]


def test_unknown_effect_is_named_with_its_nearest():
    with pytest.raises(InputError, match=r"iwan.*got 'cubic_stifness'. Did you mean 'cubic_stiffness'"):
        get_effect("cubic_stifness")


SHARED = ("_contact", "_hysteresis", "_saturation", "_sides", "_spline")  # what several effects' files have in common


def test_effect_files_import_nothing_but_the_allowed():
    folder = Path(effects_package.__file__).parent
    allowed = {"__future__", "math", "numba", "numpy", "_base", *SHARED, "_common.checks"}
    for path in folder.glob("*.py"):
        if path.stem in ("__init__", "_base", *SHARED):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                assert {alias.name for alias in node.names} <= allowed, path.name
            elif isinstance(node, ast.ImportFrom):
                assert node.module in allowed, path.name


UNITS_OF_ROLES = {
    "slip_force": {"N"},
    "gap": {"m"},
    "exponent": {"-"},
    "shape": {"-", "m", "m/s", "s", "s/m"},
}


@ALL
def test_roles_agree_with_units_and_limits(effect):
    """Roles are declared, units are for people: where the library states both, they say the same."""
    (strength,) = effect.with_role("strength")
    assert strength == effect.parameter_names[0] and strength not in dict(effect.redundant)
    for parameter in effect.parameters:
        assert parameter.role != "plain", "the library says what each of its parameters is"
        assert parameter.unit in UNITS_OF_ROLES.get(parameter.role, {parameter.unit})
        if parameter.role == "power_coefficient":
            (exponent,) = (q for q in effect.parameters if q.role == "exponent")
            assert parameter.unit == f"1/m^{exponent.latex}"
        else:
            assert "^" not in parameter.unit or parameter.role == "strength"
    by_role = {parameter.role: parameter for parameter in effect.parameters}
    if "slip_force" in by_role:
        assert by_role["strength"].unit == "N/m"
    assert effect.needs_rotation == any("rad" in parameter.unit for parameter in effect.parameters)


@pytest.mark.parametrize(
    "effect", [e for e in LIBRARY.values() if e.has_memory and e.remembered is None], ids=lambda e: e.name
)
def test_sliders_declare_their_slip_force(effect):
    """A full slip has exactly this force, whatever the path: found by pushing, not by name."""
    (name,) = effect.with_role("slip_force")
    p = np.array(effect.signature.typical(1.0, 1.0, 1.0))
    far = effect.force(1e3, 1.0, 1.0, np.array([0.0, 0.0, 0.0]), p)
    assert far == pytest.approx(p[effect.parameter_names.index(name)], rel=1e-12)


def number(name: str, role: str = "plain") -> Parameter:
    return Parameter(name, "N", "q", "a number", lambda mass, amplitude, omega: (0.0, 1.0), role=role)  # type: ignore


def mine(*parameters: Parameter, **more) -> Effect:
    return Effect("mine", "", "", "", parameters, LIBRARY["freeplay"].force, **more)


@pytest.mark.parametrize(
    ("roles", "expected"),
    [
        (("plain", "plain"), ("strength", "plain")),
        (("shape", "plain", "plain"), ("shape", "strength", "plain")),
        (("plain", "strength"), ("plain", "strength")),
        ((), ()),
    ],
)
def test_first_plain_parameter_is_the_strength_unless_another_is(roles, expected):
    effect = mine(*(number(f"q{i}", role) for i, role in enumerate(roles)))
    assert tuple(parameter.role for parameter in effect.parameters) == expected


def test_a_redundant_parameter_does_not_become_the_strength():
    effect = mine(number("one"), number("two"), redundant=(("one", 1.0),))
    assert effect.with_role("strength") == ("two",)


@pytest.mark.parametrize(
    ("roles", "redundant", "message"),
    [
        (("shape", "exponent"), (), "exactly one parameter with the role 'strength', not redundant; got none"),
        (("strength", "strength"), (), "got q0, q1"),
        (("strength", "plain"), (("q0", 1.0),), "got q0"),
        (("plain", "slip_force", "slip_force"), (), "one parameter with the role 'slip_force'"),
        (("plain", "power_coefficient"), (), "give the role 'exponent'"),
    ],
)
def test_roles_that_do_not_fit_are_refused(roles, redundant, message):
    with pytest.raises(InputError, match=message):
        mine(*(number(f"q{i}", role) for i, role in enumerate(roles)), redundant=redundant)


def test_redundant_parameters_are_held_at_what_the_record_scales():
    named = (("one", 1.5), ("two", lambda mass, amplitude, angular_frequency: mass * amplitude * angular_frequency))
    effect = mine(number("one"), number("two"), number("three"), redundant=named)
    assert effect.held(2.0, 3.0, 5.0) == {"one": 1.5, "two": 30.0}
    assert mine(number("one")).held(2.0, 3.0, 5.0) == {}


@pytest.mark.parametrize("original", ["coulomb_frction", "linear_stiffness", "stribeck_friction", "maxwell_element"])
def test_a_variant_is_one_of_an_effect_that_is_looked_for_by_itself(original):
    library = dict(LIBRARY)
    effects_package._check_variants(library)
    library["mine"] = mine(number("one"), variant_of=("coulomb_friction", original))
    with pytest.raises(InputError, match=rf"effects/mine.py: `variant_of` must name.*got '{original}'"):
        effects_package._check_variants(library)
    library["mine"] = mine(number("one"), variant_of=("coulomb_friction", "quadratic_damping"))
    effects_package._check_variants(library)


def test_a_variant_is_not_looked_for_when_named_only():
    with pytest.raises(InputError, match="leave out `variant_of` or `only_if_named`"):
        mine(number("one"), variant_of=("coulomb_friction",), only_if_named=True)


def test_a_variant_is_given_as_names():
    with pytest.raises(InputError, match="must be a tuple of names, got 'coulomb_friction'"):
        mine(number("one"), variant_of="coulomb_friction")


@pytest.mark.parametrize("simpler", ["coulomb_friction", "one_sided_stifness"])
def test_a_variant_reduces_to_other_variants(simpler):
    library = dict(LIBRARY)
    library["mine"] = mine(number("one"), variant_of=("freeplay",), reduces_to=("hertz_contact",))
    effects_package._check_variants(library)
    library["mine"] = mine(number("one"), variant_of=("freeplay",), reduces_to=(simpler,))
    with pytest.raises(InputError, match=rf"`reduces_to` must name other variants, for a variant, got '{simpler}'"):
        effects_package._check_variants(library)
    library["mine"] = mine(number("one"), reduces_to=("hertz_contact",))
    with pytest.raises(InputError, match="`reduces_to` must name other variants"):
        effects_package._check_variants(library)
    with pytest.raises(InputError, match=r"`reduces_to` .*must be a tuple of names, got 'hertz_contact'"):
        mine(number("one"), reduces_to="hertz_contact")


def test_what_a_variant_reduces_to_has_its_force():
    """A stop that loses nothing, and a play whose other side is out of reach."""
    stop = LIBRARY["one_sided_stiffness"].force.py_func
    lossy, play = LIBRARY["damped_stop"].force.py_func, LIBRARY["offset_freeplay"].force.py_func
    assert {name for name, effect in LIBRARY.items() if effect.reduces_to} == {"damped_stop", "offset_freeplay"}
    for x in np.linspace(-1.0, 1.0, 21):
        expected = stop(x, 0.3, 1.0, np.empty(0), np.array([2.0, 0.4]))
        assert lossy(x, 0.3, 1.0, np.empty(0), np.array([2.0, 0.4, 0.0])) == pytest.approx(expected, abs=1e-12)
        # its sides at 0.4 and -1.2
        assert play(x, 0.3, 1.0, np.empty(0), np.array([2.0, 0.8, -0.5])) == pytest.approx(expected, abs=1e-12)


def test_a_variant_does_what_its_first_original_does():
    for effect in LIBRARY.values():
        if effect.variant_of:
            original = LIBRARY[effect.variant_of[0]]
            assert effect.mechanism == original.mechanism or {effect.mechanism, original.mechanism} == {
                "clearance", "asymmetry"
            } or effect.mechanism in ("damping_asymmetry", "falling_damping", "inertia")  # fmt: skip
            # the mid-line of a bilinear spring is that of a bilinear damper, whose force is another; the backbones of
            # a spring are those of an inertia; damping falls as that of dry friction does


def test_an_unknown_role_is_named_with_its_nearest():
    with pytest.raises(InputError, match="Did you mean 'exponent'"):
        number("one", "exponents")


def _damper(x, slow, fast, back):
    """Return the mechanism of a damper from its coefficients over displacement, at two speeds and backwards."""
    if np.allclose(slow, slow[0]):
        if np.allclose(fast, slow):
            assert not np.allclose(slow, back)  # else it would be the viscous damper
            return "damping_asymmetry"
        return "drag" if np.any(fast > slow) else "falling_damping"
    return "displacement_damping" if slow[np.abs(x).argmax()] > slow[np.abs(x).argmin()] else "falling_damping"


@ALL
def test_mechanism_is_what_the_force_does(effect, rng):
    """Each mechanism is told by the force itself: what it depends on, where it is zero, whether it is odd."""
    if effect.name in (*BASE_EFFECTS, *TABULATED):
        assert effect.mechanism is None  # every oscillator has it, or it holds any force: it is never named
        return
    p = draw_parameters(effect, rng)
    x, v = AMPLITUDE * np.linspace(-1.0, 1.0, 41), OMEGA * AMPLITUDE * np.linspace(0.1, 1.0, 8)

    def force(place, speed, direction):
        z = np.zeros(effect.n_states)
        return np.array([effect.force(a, direction * speed, direction, z, p) for a in place])

    if effect.n_states:  # remembers: hysteresis where the loop is the same however slowly it is gone round
        rates = np.zeros((2, effect.n_states))
        if effect.state_rate is not None:
            for share, rate in zip((1.0, 0.5), rates, strict=True):
                effect.state_rate(0.3 * AMPLITUDE, share * v[-1], 1.0, np.full(effect.n_states, 0.01), p, rate)
        is_rate_independent = np.allclose(rates[1], 0.5 * rates[0], rtol=1e-12)
        assert effect.mechanism == ("hysteresis" if is_rate_independent else None)
        assert is_rate_independent or not effect.has_memory
        return
    assert effect.mechanism in MECHANISMS and effect.mechanism != "other"
    assert (effect.mechanism == "inertia") == (effect.added_mass is not None)
    if effect.added_mass is not None:  # of its kinetic energy m(x) v^2 / 2: half the slope of the mass, times v^2
        slopes = np.zeros(1 + p.size)
        for place in x:
            effect.added_mass_gradient(place, p, slopes)
            assert effect.force(place, v[-1], 1.0, np.zeros(0), p) == pytest.approx(0.5 * slopes[0] * v[-1] ** 2)
        return
    slow, fast, back = force(x, v[0], 1.0), force(x, v[-1], 1.0), force(x, v[0], -1.0)
    is_elastic = np.array_equal(slow, fast) and np.array_equal(slow, back)
    is_odd = np.allclose(slow, -slow[::-1], atol=1e-12 * FORCE)
    rests = np.count_nonzero(slow == 0.0) > 1 or np.count_nonzero(force(1e-3 * x, v[0], 1.0) == 0.0) > 1
    if is_elastic and effect.with_role("gap"):  # a contact that is closed or open, somewhere within the motion
        far = AMPLITUDE * np.linspace(-3.0, 3.0, 601)
        bends = np.abs(np.diff(force(far, v[0], 1.0), n=2)) > 1e-9 * FORCE
        assert bends.any() and np.count_nonzero(bends) < 400  # and straight over a third of the way at least
        expected = "clearance"
    elif is_elastic:
        expected = "asymmetry" if not is_odd else "clearance" if rests else "spring"
    elif (
        effect.with_role("gap") and force(x, 0.0, 1.0).any() and np.array_equal(force(x, 0.0, 1.0), force(x, 0.0, -1.0))
    ):
        expected = "clearance"  # a contact with loss: elastic where it is at rest
    elif np.abs(force(x, 0.0, 1.0)).max() > 0.0:
        expected = "hysteresis"  # opposes the motion however slow it is
    else:
        assert np.allclose(force(x, 0.0, 1.0), 0.0)
        expected = _damper(x, slow / v[0], fast / v[-1], -back / v[0])
    values = dict(zip(effect.parameter_names, p, strict=True))
    falls = effect.mechanism == "falling_damping"  # as long as its coefficient is positive
    assert (effect.mechanism_at(values.__getitem__, AMPLITUDE) if falls else effect.mechanism) == expected


def test_an_unknown_mechanism_is_named_with_its_nearest():
    with pytest.raises(InputError, match="hysteresis"):
        Effect("mine", "", "", "", (), force=LIBRARY["freeplay"].force, mechanism="histeresis")
    assert Effect("mine", "", "", "", (), force=LIBRARY["freeplay"].force).mechanism is None


def test_a_mass_without_its_gradient_is_refused():
    inertia = LIBRARY["nonlinear_inertia"]
    with pytest.raises(InputError, match="needs both added_mass and added_mass_gradient"):
        Effect("mine", "", "", "", inertia.parameters, force=inertia.force, added_mass=inertia.added_mass)


def test_uncompiled_force_is_refused():
    with pytest.raises(InputError, match=r"numba\.njit"):
        Effect("mine", "", "", "", (), force=lambda x, v, direction, z, p: 0.0)


def test_parameter_limits_in_the_wrong_order_are_refused():
    with pytest.raises(InputError, match="minimum < maximum"):
        Parameter("mine", "N", "m", "", bounds=lambda m, a, w: (0.0, 1.0), minimum=2.0, maximum=1.0)


# --- sliders against brute force --------------------------------------------------------------------------------------


def decaying_turning_points(rng: np.random.Generator, first: float, count: int = 12) -> np.ndarray:
    """Draw turning points of a free decay: each one between the two before it, not about a fixed centre."""
    points = [first, first * rng.uniform(-0.95, -0.5)]
    for _ in range(count - 2):
        before, last = points[-2:]
        points.append(last + (before - last) * rng.uniform(0.75, 0.98))
    return np.array(points)


class Bed:
    """Sliders in parallel, pushed from one displacement to the next; one clip per straight stretch is exact."""

    def __init__(self, stiffness: np.ndarray, strength: np.ndarray):
        self.stiffness, self.strength = stiffness, strength
        self.x, self.forces = 0.0, np.zeros_like(strength)

    def push(self, x: float) -> float:
        trial = self.forces + self.stiffness * (x - self.x)
        self.x, self.forces = x, np.clip(trial, -self.strength, self.strength)
        return float(self.forces.sum())


def largest_difference(
    effect: Effect, p: np.ndarray, bed: Bed, turning_points: np.ndarray, start: float = 0.0
) -> float:
    """Follow the turning points with the effect's memory of one and with the bed; return the largest difference."""
    z = np.array([start, 0.0, 0.0])
    bed.x = start
    largest = 0.0
    for turning_point in turning_points:
        direction = float(np.sign(turning_point - z[0]))
        for x in np.linspace(z[0], turning_point, 24)[1:]:
            largest = max(largest, abs(effect.force(x, direction, direction, z, p) - bed.push(x)))
        z = np.array([turning_point, effect.force(turning_point, 0.0, direction, z, p), 1.0])
    return largest


def power_law_bed(stiffness: float, slip_force: float, exponent: float, n_sliders: int = 20_000) -> Bed:
    """Draw slider strengths at the midpoints of equal shares of stiffness of the power-law density."""
    phi_max = slip_force * (exponent + 2.0) / (stiffness * (exponent + 1.0))
    quantiles = (np.arange(n_sliders) + 0.5) / n_sliders
    share = stiffness / n_sliders
    return Bed(np.full(n_sliders, share), share * phi_max * quantiles ** (1.0 / (exponent + 1.0)))


def test_jenkins_is_an_incremental_slider_for_any_history(rng):
    for _ in range(10):
        stiffness, slip_force = rng.uniform(0.5, 2.0), rng.uniform(0.1, 1.0)
        bed = Bed(np.array([stiffness]), np.array([slip_force]))
        turning_points = rng.uniform(-1.0, 1.0, 30)
        # The same arithmetic in another order: rounding only.
        assert largest_difference(LIBRARY["jenkins"], np.array([stiffness, slip_force]), bed, turning_points) < 1e-13


@pytest.mark.parametrize("first", [0.3, 0.9, 1.6], ids=lambda reach: f"reach-{reach}")
@pytest.mark.parametrize("exponent", [-0.8, -0.4, 0.0])
def test_iwan_is_a_bed_of_sliders_in_a_free_decay(exponent, first, rng):
    stiffness, slip_force = 3.0, 2.0
    phi_max = slip_force * (exponent + 2.0) / (stiffness * (exponent + 1.0))
    p = np.array([stiffness, slip_force, exponent])
    for start in (0.0, first * phi_max):  # loaded from the centre before release, and unstressed at release
        points = decaying_turning_points(rng, first * phi_max)[0 if start == 0.0 else 1 :]
        # Midpoints of 20 000 shares: the sum is the midpoint rule of the integral, whose error is at most a few
        # kinks of one share each (1/20 000 of the slip force, squared in the smooth part).
        bed = power_law_bed(*p)
        assert largest_difference(LIBRARY["iwan"], p, bed, points, start) < 2e-5 * slip_force


def test_iwan_differs_from_the_bed_when_loops_grow(rng):
    # Negative control: outward loops need the memory that a free decay does not.
    p = np.array([3.0, 2.0, -0.4])
    growing = decaying_turning_points(rng, 1.0)[::-1]
    assert largest_difference(LIBRARY["iwan"], p, power_law_bed(*p), growing) > 1e-2 * p[1]


@pytest.mark.parametrize("name, zeroed", [("jenkins", 0), ("jenkins", 1), ("iwan", 0), ("iwan", 1)])
def test_slider_without_stiffness_or_strength_is_exactly_nothing(name, zeroed, rng):
    effect = LIBRARY[name]
    p = draw_parameters(effect, rng)
    p[zeroed] = 0.0
    for branch in (0.0, 1.0):
        for x in (-0.3, -1e-17, 0.0, 1e-17, 0.3):
            for direction in (-1.0, 1.0):
                z = np.array([0.0, 0.0, branch])
                out = np.full(2 + len(p) + 3, np.nan)
                effect.gradient(x, 0.0, direction, z, p, out)
                assert effect.force(x, 0.0, direction, z, p) == 0.0
                assert out[0] == out[1] == 0.0
                assert np.all(np.isfinite(out))


@pytest.mark.parametrize("name", ["jenkins", "iwan"])
def test_slider_is_smooth_across_its_turning_point(name, rng):
    effect = LIBRARY[name]
    for _ in range(20):
        p = draw_parameters(effect, rng)
        x_r = AMPLITUDE * rng.uniform(0.1, 3.0)
        z = np.array([x_r, effect.force(x_r, 0.0, 1.0, np.zeros(3), p), 1.0])
        eps = 1e-9 * AMPLITUDE
        forces = [effect.force(x_r + step, 0.0, -1.0, z, p) for step in (-eps, 0.0, eps)]
        assert {effect.regime(x_r + step, 0.0, -1.0, z, p) for step in (-eps, 0.0, eps)} == {0}
        assert forces[1] == z[1]
        # Equal slopes on both sides, to the rounding of a difference of 1e-9 (2e-16 / 1e-9 = 2e-7 of the force).
        assert abs((forces[2] - forces[1]) - (forces[1] - forces[0])) < 1e-15 * FORCE


def test_iwan_stays_finite_at_its_lowest_exponent():
    p, z, out = np.array([3.0, 2.0, -1.0]), np.array([0.1, 0.0, 1.0]), np.full(8, np.nan)
    for x in (0.1, 0.5):
        LIBRARY["iwan"].gradient(x, 0.0, 1.0, z, p, out)
        assert np.all(np.isfinite(out)) and LIBRARY["iwan"].force(x, 0.0, 1.0, z, p) == 0.0


def test_iwan_damping_follows_the_power_law():
    # Segalman (2005): the energy of a closed loop of amplitude u grows with u^(chi + 3).
    stiffness, slip_force, exponent = 3.0, 2.0, -0.4
    p = np.array([stiffness, slip_force, exponent])
    phi_max = slip_force * (exponent + 2.0) / (stiffness * (exponent + 1.0))
    nodes, weights = np.polynomial.legendre.leggauss(200)
    energies = []
    for amplitude in (0.1 * phi_max, 0.2 * phi_max):
        top = LIBRARY["iwan"].force(amplitude, 1.0, 1.0, np.zeros(3), p)
        z = np.array([amplitude, top, 1.0])
        down = np.array([LIBRARY["iwan"].force(amplitude * s, -1.0, -1.0, z, p) for s in nodes])
        # Masing: the upper branch mirrors the lower one.
        energies.append(-2.0 * amplitude * np.sum(weights * down))
    # Exact for a pure power law; the quadrature sees one end point of order u^1.6 (error ~ 200^-5.2).
    assert np.log2(energies[1] / energies[0]) == pytest.approx(exponent + 3.0, abs=1e-9)


# --- other effects against what is known of them ----------------------------------------------------------------------


def test_what_remembers_and_what_has_room_says_all_that_it_needs():
    effect = LIBRARY["bouc_wen"]
    for change in ({"remembered": None}, {"remembered_gradient": None}):
        with pytest.raises(InputError, match="needs remembered, remembered_gradient and has_memory, or none"):
            replace(effect, **change)
    with pytest.raises(InputError, match="needs remembered, remembered_gradient and has_memory, or none"):
        replace(effect, has_memory=False, n_states=0)
    with pytest.raises(InputError, match="has room behind its parameters, where differences are not taken"):
        replace(effect, gradient=None)


def published_rate(s, z, direction, p):
    """Return dz/dx times the direction of motion as it was published, with a speed of one."""
    _, amplitude, _, beta, gamma, n = p
    return amplitude * direction - beta * abs(z) ** (n - 1) * z - gamma * direction * abs(z) ** n


def crossing(s, z, direction, p):
    return z[0]


crossing.terminal = True


@pytest.mark.parametrize("exponent", [1.0, 1.1, 1.5, 2.0, 3.0, 10.0])
def test_bouc_wen_follows_its_published_rate(exponent, rng):
    """SciPy integrates the law along the way, on either side of z = 0 by itself, where it has a kink."""
    effect = LIBRARY["bouc_wen"]
    for _ in range(30):
        amplitude, slip = rng.uniform(0.3, 2.0), AMPLITUDE * 10.0 ** rng.uniform(-2.0, 1.0)
        beta = amplitude / slip**exponent * rng.uniform(0.2, 1.0)
        p = np.array([100.0, amplitude, 0.4, beta, beta * rng.uniform(-0.9, 2.0), exponent])
        direction = float(rng.choice([-1.0, 1.0]))
        x_r = -direction * AMPLITUDE * rng.uniform(0.1, 1.0)
        room = effect.with_room(p)
        z = effect.remembered(x_r, 0.0, -direction, np.zeros(3), room)
        way = AMPLITUDE * rng.uniform(0.1, 2.0)
        found = effect.remembered(x_r + direction * way, 0.0, direction, np.array([x_r, z, 1.0]), room)
        options = {"method": "DOP853", "args": (direction, p), "rtol": 1e-12, "atol": 1e-14 * AMPLITUDE}
        first = solve_ivp(published_rate, (0.0, way), [z], events=crossing, **options)
        expected = first.y[0, -1]
        if first.status == 1:
            expected = solve_ivp(published_rate, (first.t[-1], way), [0.0], **options).y[0, -1]
        assert found == pytest.approx(expected, abs=1e-9 * max(abs(z), abs(expected)))
        assert effect.force(x_r + direction * way, 0.0, direction, np.array([x_r, z, 1.0]), room) == pytest.approx(
            0.6 * 100.0 * found, rel=1e-12
        )
        label = effect.regime(x_r + direction * way, 0.0, direction, np.array([x_r, z, 1.0]), room)
        assert label == (np.sign(found) or direction)


@pytest.mark.parametrize(
    ("exponent", "curve"),
    [
        (1.0, lambda t: -np.expm1(-t)),
        (2.0, np.tanh),
    ],
)
def test_bouc_wen_has_its_closed_forms(exponent, curve):
    """From rest z is 1 - exp(-t) and tanh t, of t from far below to far beyond the saturation."""
    effect, slip = LIBRARY["bouc_wen"], 0.3 * AMPLITUDE
    p = effect.with_room(np.array([100.0, 1.0, 0.0, 0.3 / slip**exponent, 0.7 / slip**exponent, exponent]))
    for t in np.geomspace(1e-6, 1e4, 81):
        for direction in (-1.0, 1.0):
            z = effect.remembered(direction * t * slip, 0.0, direction, np.zeros(3), p)
            assert z == pytest.approx(direction * slip * curve(t), rel=1e-12)
    out = np.full(11, np.nan)
    effect.gradient(1e4 * slip, 0.0, 1.0, np.array([-AMPLITUDE, -0.5 * slip, 1.0]), p, out)
    assert np.all(np.isfinite(out)) and out[0] > 0.0 and out[9] > 0.0  # no past is forgotten altogether
    assert out[5] == pytest.approx(100.0 * -(slip ** (1 + exponent)) / exponent, rel=1e-9)  # the slip itself, to beta


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
@pytest.mark.parametrize(("beta", "gamma"), [(1.5, -0.3), (0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (0.0, 1.0)])
def test_bouc_wen_is_finite_at_rest_of_its_state(exponent, beta, gamma):
    """Also where nothing dissipates, or one side is straight."""
    effect = LIBRARY["bouc_wen"]
    p = effect.with_room(np.array([100.0, 1.2, 0.4, beta, gamma, exponent]))
    for direction in (-1.0, 1.0):
        for size in (0.0, 1e-300, 0.1):
            out, z = np.full(11, np.nan), np.array([0.0, direction * size, 1.0])
            effect.gradient(0.0, 2.0 * direction, direction, z, p, out)
            assert np.all(np.isfinite(out))
            rate = published_rate(0.0, z[1], direction, p[:6]) * direction
            assert out[0] == pytest.approx(0.6 * 100.0 * rate, rel=1e-9)
            assert out[2] == pytest.approx(0.6 * z[1], rel=1e-12) and out[9] == pytest.approx(60.0, rel=1e-12)


def test_an_elastic_bouc_wen_unloads_as_it_was_loaded(rng):
    """With beta of zero z is a function of the displacement, however far it was driven."""
    effect = LIBRARY["bouc_wen"]
    for exponent in (1.0, 1.7, 2.0):
        p = effect.with_room(np.array([100.0, 1.0, 0.0, 0.0, 2.0, exponent]))
        for x in (0.05, 0.4, 3.0):
            top = effect.remembered(x, 0.0, 1.0, np.zeros(3), p)
            for back in rng.uniform(0.0, 1.0, 5) * x:
                down = effect.remembered(back, 0.0, -1.0, np.array([x, top, 1.0]), p)
                assert down == pytest.approx(effect.remembered(back, 0.0, 1.0, np.zeros(3), p), abs=1e-11)


def test_dahl_friction_is_bouc_wen_of_exponent_one(rng):
    dahl, effect = LIBRARY["dahl_friction"], LIBRARY["bouc_wen"]
    for _ in range(50):
        stiffness, friction = draw_parameters(dahl, rng)
        p = np.array([stiffness, friction])
        x, v, direction, z = draw_state(dahl, p, rng)
        same = effect.with_room(np.array([stiffness, 1.0, 0.0, stiffness / friction, 0.0, 1.0]))
        lag = np.array([z[0], z[1] / stiffness, z[2]])
        assert dahl.force(x, v, direction, z, p) == pytest.approx(
            effect.force(x, v, direction, lag, same), rel=1e-9, abs=1e-12 * FORCE
        )
    out = np.full(7, np.nan)
    dahl.gradient(0.1, 1.0, 1.0, np.array([0.0, 0.0, 0.0]), np.array([100.0, 0.0]), out)
    assert np.all(np.isfinite(out)) and dahl.force(0.1, 1.0, 1.0, np.zeros(3), np.array([100.0, 0.0])) == 0.0


def test_regime_at_a_kink_is_the_branch_being_entered():
    p = np.array([100.0, 0.1])
    freeplay = LIBRARY["freeplay"].regime
    assert [freeplay(0.1, 1.0, 1.0, NO_STATE, p), freeplay(0.1, -1.0, -1.0, NO_STATE, p)] == [1, 0]
    assert [freeplay(-0.1, 1.0, 1.0, NO_STATE, p), freeplay(-0.1, -1.0, -1.0, NO_STATE, p)] == [0, -1]
    bilinear = LIBRARY["bilinear_stiffness"].regime
    assert [bilinear(0.0, 1.0, 1.0, NO_STATE, p), bilinear(0.0, -1.0, -1.0, NO_STATE, p)] == [1, -1]


FORMULAS = {
    "linear_stiffness": lambda x, v, p: p[0] * x,
    "viscous_damping": lambda x, v, p: p[0] * v,
    "cubic_stiffness": lambda x, v, p: p[0] * x**3,
    "quintic_stiffness": lambda x, v, p: p[0] * x**5,
    "quadratic_stiffness": lambda x, v, p: p[0] * x**2,
    "bilinear_stiffness": lambda x, v, p: p[0] * x if x > 0 else 0.0,
    "freeplay": lambda x, v, p: p[0] * np.sign(x) * max(abs(x) - p[1], 0.0),
    "pendulum_stiffness": lambda x, v, p: p[0] * (np.sin(x) - x),
    "coulomb_friction": lambda x, v, p: p[0] * np.sign(v),
    "quadratic_damping": lambda x, v, p: p[0] * v * abs(v),
    "asymmetric_drag": lambda x, v, p: p[0] * v * abs(v) + p[0] * p[1] * v**2,
    "bilinear_damping": lambda x, v, p: p[0] * v if v > 0 else 0.0,
    "nonlinear_inertia": lambda x, v, p: p[0] * x * v**2,
    "cubic_damping": lambda x, v, p: p[0] * v**3,
    "displacement_dependent_damping": lambda x, v, p: p[0] * x**2 * v,
    "absolute_displacement_damping": lambda x, v, p: p[0] * abs(x) * v,
    "dead_band_damping": lambda x, v, p: (
        p[0] * v * np.polyval([-2, 3, 0, 0], np.clip((abs(x) / p[1] - 0.98) / 0.04, 0, 1))
    ),
    "mid_stroke_damping": lambda x, v, p: p[0] * np.exp(-(x**2) / p[1] ** 2) * v,
    "speed_limited_damping": lambda x, v, p: p[0] * p[1] ** 2 * v / (p[1] ** 2 + v**2),
    "structural_damping": lambda x, v, p: p[0] * abs(x) * np.sign(v),
    "stribeck_friction": lambda x, v, p: np.sign(v) * (p[0] + p[0] * p[1] * np.exp(-abs(v) / p[2])),
    "power_stiffness": lambda x, v, p: p[0] / p[2] ** p[1] * abs(x) ** p[1] * np.sign(x),
    "offset_freeplay": lambda x, v, p: p[0] * (x - np.clip(x, p[1] * (p[2] - 1), p[1] * (p[2] + 1))),
    "one_sided_stiffness": lambda x, v, p: p[0] * (max(x, p[1]) - max(0.0, p[1])),
    "geometric_stiffness": lambda x, v, p: p[0] * x - p[0] * x / np.sqrt(1.0 + (x / p[1]) ** 2),
    "damped_stop": lambda x, v, p: (
        p[0] * (max(np.sign(p[0]) * x - p[1], 0.0) * (1.0 + p[2] * np.sign(p[0]) * v) - max(-p[1], 0.0))
    ),
    "hertz_contact": lambda x, v, p: p[0] * (max(np.sign(p[0]) * x - p[1], 0.0) ** 1.5 - max(-p[1], 0.0) ** 1.5),
    "magnetic_stiffness": lambda x, v, p: (
        p[0] * ((1 - x / p[1]) ** -p[2] - (1 + x / p[1]) ** -p[2] - 2 * p[2] * x / p[1])
    ),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_force_is_the_textbook_formula(name, rng):
    for _ in range(20):
        p = draw_parameters(LIBRARY[name], rng)
        x, v, direction, z = draw_state(LIBRARY[name], p, rng)
        # Another order of the same few operations; the terms have the size of FORCE.
        assert LIBRARY[name].force(x, v, direction, z, p) == pytest.approx(FORMULAS[name](x, v, p), abs=1e-13 * FORCE)


def test_power_damping_is_the_power_law_but_close_to_rest(rng):
    """Of the force what the rounding changes at a twentieth of the reference speed; of the loss of a cycle less."""
    effect = LIBRARY["power_damping"]
    for exponent in (0.0, 0.5, 1.0, 2.0, 3.5):
        p = np.array([2.0, exponent, 3.0])
        for v in 3.0 * rng.uniform(0.05, 1.0, 20):
            law = 2.0 * (v / 3.0) ** exponent
            # (1 + (0.001 / 0.05)^2)^((exponent - 1) / 2)
            assert effect.force(0.0, v, 1.0, NO_STATE, p) == pytest.approx(law, rel=6e-4)
            assert effect.force(0.0, -v, -1.0, NO_STATE, p) == pytest.approx(-law, rel=6e-4)
        speed = np.sin((np.arange(20000) + 0.5) * np.pi / 20000)
        loss = np.mean([s * effect.force(0.0, 3.0 * s, 1.0, NO_STATE, p) for s in speed])
        assert loss == pytest.approx(np.mean(2.0 * speed ** (1.0 + exponent)), rel=1e-5)
    assert effect.force(0.0, 0.2, 1.0, NO_STATE, np.array([2.0, 1.0, 3.0])) == pytest.approx(0.4 / 3.0, rel=1e-15)


def test_power_displacement_damping_is_the_power_law_but_in_the_middle():
    """Of the force what the rounding changes at a tenth of the reference displacement; of the work what that adds."""
    effect = LIBRARY["power_displacement_damping"]
    angle = (np.arange(20000) + 0.5) * 2.0 * np.pi / 20000
    for exponent in (0.2, 0.5, 1.0, 2.0, 4.0):
        p = np.array([2.0, exponent, 3.0])
        for x in (-3.0, -0.3, 0.4, 1.5):
            law = 2.0 * (abs(x) / 3.0) ** exponent * 0.7
            rounded = (1.0 + (0.01 * 3.0 / x) ** 2) ** (0.5 * exponent)  # 2 % at a tenth of the reference, at most
            assert effect.force(x, 0.7, 1.0, NO_STATE, p) == pytest.approx(law * rounded, rel=1e-13)
            assert effect.force(x, -0.7, -1.0, NO_STATE, p) == -effect.force(x, 0.7, 1.0, NO_STATE, p)
        work = np.mean([-np.sin(t) * effect.force(3.0 * np.cos(t), -np.sin(t), 1.0, NO_STATE, p) for t in angle])
        closed = 2.0 * math.gamma(0.5 * (exponent + 1)) * math.gamma(1.5) / (math.pi * math.gamma(0.5 * exponent + 2))
        if exponent < 1.0:  # (u^2 + e^2)^(r/2) - |u|^r integrated over all u; beyond 1 the whole way adds about e^2
            added = math.sqrt(math.pi) * math.gamma(-0.5 * (1.0 + exponent)) / math.gamma(-0.5 * exponent)
            closed += 2.0 / math.pi * added * 0.01 ** (1.0 + exponent)
        assert work == pytest.approx(closed, rel=1e-3)


# What the signatures say, against the simulation.


@ALL
def test_signature_is_what_the_simulation_shows(effect):
    """Beside a linear spring and 0.5 % of critical damping, each curve does what its first words say."""
    signature = effect.signature
    assert signature is not None, f"effects/{effect.name}.py has no signature: the catalogue needs one"
    assert set(signature.resembles) <= set(LIBRARY) - {effect.name}
    amplitude = 1.0 if "rad" in effect.parameters[0].unit else AMPLITUDE
    stiffness = MASS * OMEGA**2
    values = {"linear_stiffness": stiffness, "viscous_damping": 0.01 * MASS * OMEGA}
    values |= dict(zip(effect.parameter_names, signature.typical(MASS, amplitude, OMEGA), strict=True))
    own = () if effect.name in BASE_EFFECTS else effect.name
    result = simulate_backbone(Oscillator(MASS, own), values, amplitude * np.linspace(0.05, 1.0, 39))
    assert not result.status.any()
    for curve, words in zip(result.values, (signature.frequency, signature.damping, signature.offset), strict=True):
        steps = np.diff(curve)
        if words.startswith("Zero"):
            # a decrement of 0.3, the largest here, moves the mid-line of a cycle by a hundredth of its amplitude
            assert np.all(np.abs(curve) < 0.015), words
        elif words.startswith("Constant"):
            assert np.ptp(curve) < 1e-3 * np.abs(curve).max(), words  # side effects of damping stay below
        elif words.startswith("Rises, then falls"):
            peak = int(np.argmax(curve))
            assert 0 < peak < curve.size - 1 and curve[peak] > 1.1 * max(curve[0], curve[-1]), words
        else:
            sign = 1.0 if words.startswith("Rises") else -1.0
            # freeplay and sliders are flat up to where they begin; integration noise must not count as a turn
            assert np.all(sign * steps > -1e-3 * np.ptp(curve)), words
            assert abs(curve[-1] - curve[0]) > 2e-3 * np.abs(curve).max(), words


def test_a_signature_begins_with_a_trend():
    with pytest.raises(InputError, match="must begin with"):
        Signature("Goes up.", "Constant.", "Zero.", "nothing", lambda mass, amplitude, angular_frequency: ())


def test_a_second_process_compiles_no_force_of_the_library():
    script = (
        "import numpy as np; from pymc_backbone.effects import LIBRARY; e = LIBRARY['tabulated_stiffness']; "
        "p = np.ones(len(e.parameters)); e.force(0.1, 0.2, 1.0, np.zeros(0), p); "
        "e.gradient(0.1, 0.2, 1.0, np.zeros(0), p, np.empty(2 + p.size)); "
        "print(sum(e.force.stats.cache_hits.values()), sum(e.gradient.stats.cache_hits.values()))"
    )
    runs = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True) for _ in range(2)
    ]
    assert runs[1].stdout.split() == ["1", "1"]
