"""Oscillator: layout, checks, equation of motion, identity, pickles, and the digest of the compiled forces."""

from __future__ import annotations

import importlib
import itertools
import pickle
import subprocess
import sys
from dataclasses import replace

import numba
import numpy as np
import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone.effects import LIBRARY, Effect, Parameter
from pymc_backbone.oscillator import Oscillator

USER_EFFECT = '''
import enum
import math
import numba
import numpy as np
import {helpers} as helpers
from {helpers} import helper
from pymc_backbone.effects import Effect, Parameter

SCALE = 1.0
TABLE = np.array([1.0, 2.0])
UNUSED = 3.0


class Kind(enum.IntEnum):
    ODD = 3


@numba.njit
def force(x, v, direction, z, p):
    """Return the force."""
    return SCALE * p[0] * helper(x) * TABLE[0] + helpers.by_module(x) * 0.0 + Kind.ODD * 0.0


@numba.njit
def gradient(x, v, direction, z, p, out):
    out[0] = 3.0 * p[0] * x * x
    out[1] = 0.0
    out[2] = x * x * x


def make_force(factor):
    @numba.njit
    def force(x, v, direction, z, p):
        return factor * p[0] * x

    return force


PARAMETER = Parameter("my_stiffness", "N/m^3", "k_m", "a spring", bounds=lambda m, a, w: (0.0, 1.0))
EFFECT = Effect("mine", "A spring.", "my_stiffness x^3", "k_m x^3", (PARAMETER,), force, gradient)
CLOSURE = Effect("mine", "A spring.", "my_stiffness x", "k_m x", (PARAMETER,), make_force(2.0))
'''
HELPERS = """
import math
import numba

INNER = 1.0

@numba.njit
def deeper(x):
    return math.sin(x)

@numba.njit
def helper(x):
    return INNER * x * x * x + 0.0 * deeper(x)

@numba.njit
def by_module(x):
    return 2.0 * x

@numba.njit
def unused(x):
    return 5.0 * x
"""
_NUMBERS = itertools.count()


@pytest.fixture
def user_module(tmp_path, monkeypatch):
    """Write a user's effect and its helpers, edited or not, as new modules, and import them."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(edit=lambda text: text, edit_helpers=lambda text: text):
        number = next(_NUMBERS)
        helpers, main = f"backbone_test_helpers_{number}", f"backbone_test_effect_{number}"
        (tmp_path / f"{helpers}.py").write_text(edit_helpers(HELPERS))
        (tmp_path / f"{main}.py").write_text(edit(USER_EFFECT.replace("{helpers}", helpers)))
        importlib.invalidate_caches()
        return importlib.import_module(main)

    return write


def total_force(oscillator, values, x, v, direction):
    vector = oscillator.pack(values)
    return sum(
        effect.force(x, v, direction, np.zeros(effect.n_states), vector[oscillator.slices[effect.name]])
        for effect in oscillator.effects
    )


def test_linear_spring_and_damper_are_always_there():
    assert [e.name for e in Oscillator(1.0).effects] == ["linear_stiffness", "viscous_damping"]
    assert Oscillator(1.0, ["cubic_stiffness", "viscous_damping"]).parameter_names == (
        "linear_stiffness",
        "cubic_stiffness",
        "viscous_damping",
    )
    assert Oscillator(1.0, LIBRARY["freeplay"]) == Oscillator(1.0, "freeplay") == Oscillator(1.0, ("freeplay",))


def test_layout_of_the_parameter_vector():
    oscillator = Oscillator(2.0, ("freeplay", "bouc_wen"))
    assert oscillator.slices == {
        "linear_stiffness": slice(0, 1),
        "viscous_damping": slice(1, 2),
        "freeplay": slice(2, 4),
        "bouc_wen": slice(4, 10),
    }
    assert [oscillator.index(name) for name in oscillator.parameter_names] == list(range(10))
    assert [parameter.name for parameter in oscillator.parameters] == list(oscillator.parameter_names)
    assert oscillator.units["gap"] == "m"
    bounds = oscillator.default_bounds(0.1, 20.0)
    assert tuple(bounds) == oscillator.parameter_names
    assert bounds["gap"] == (0.0, 0.1)
    with pytest.raises(InputError, match=r"got 'gapp' \(did you mean 'gap'\?\)"):
        oscillator.index("gapp")
    with pytest.raises(InputError, match="`amplitude` must be positive"):
        oscillator.default_bounds(-0.1, 20.0)


def test_adding_an_effect_returns_a_new_oscillator():
    base = Oscillator(1.5)
    added = base + "cubic_stiffness" + LIBRARY["coulomb_friction"] + ("iwan", LIBRARY["freeplay"])
    assert len(base.effects) == 2
    assert added.mass == 1.5
    assert [effect.name for effect in added.effects[2:]] == ["cubic_stiffness", "coulomb_friction", "iwan", "freeplay"]
    for there in ("cubic_stiffness", "linear_stiffness", ("jenkins", "jenkins")):
        with pytest.raises(InputError, match="is there already"):
            added + there
    with pytest.raises(TypeError):
        added + 1.0


@pytest.mark.parametrize(
    "mass, effects, message",
    [
        (0.0, (), "`mass` must be positive"),
        (float("nan"), (), "`mass` must be positive"),
        ("heavy", (), "`mass` must be a number"),
        (1.0, "cubic_stifness", "Did you mean 'cubic_stiffness'"),
        (1.0, 3.0, "must be a name, an `Effect` or several"),
        (1.0, [3.0], "must hold names or `Effect`s, got 3.0"),
        (1.0, ["linear_stiffness", "linear_stiffness"], "is there already"),
    ],
)
def test_wrong_arguments_are_refused(mass, effects, message):
    with pytest.raises(InputError, match=message):
        Oscillator(mass, effects)


def test_shared_parameter_names_are_refused():
    parameter = Parameter("gap", "m", "g", "another gap", bounds=lambda m, a, w: (0.0, a))
    clash = Effect("mine", "A clash.", "gap", "g", (parameter,), LIBRARY["coulomb_friction"].force)
    with pytest.raises(InputError, match="'gap' belongs to both 'freeplay' and 'mine'"):
        Oscillator(1.0, ("freeplay", clash))


def test_pack_and_unpack_are_inverse():
    oscillator = Oscillator(1.0, "cubic_stiffness")
    values = {"cubic_stiffness": -3.0, "viscous_damping": 0.2, "linear_stiffness": 100.0}
    vector = oscillator.pack(values)
    assert vector.dtype == np.float64
    np.testing.assert_array_equal(vector, [100.0, 0.2, -3.0])
    assert oscillator.unpack(vector) == values
    again = oscillator.pack(vector)
    again[0] = 0.0
    assert vector[0] == 100.0


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"linear_stiffness": 1.0}, "lacks viscous_damping, cubic_stiffness"),
        (
            {"linear_stiffness": 1.0, "viscous_damping": 1.0, "cubic_stifness": 1.0},
            r"got 'cubic_stifness' \(did you mean 'cubic_stiffness'\?\)",
        ),
        ([1.0, 2.0], r"must hold 3 values \(linear_stiffness, viscous_damping, cubic_stiffness\), got 2"),
        ([[1.0, 2.0, 3.0]], "1 dimension"),
        ([1.0, np.nan, 3.0], "must be finite"),
        ([1.0, -0.1, 3.0], r"`viscous_damping` must lie between 0 and inf N s/m, got -0\.1"),
        ("abc", "must hold numbers"),
    ],
)
def test_pack_refuses(parameters, message):
    with pytest.raises(InputError, match=message):
        Oscillator(1.0, "cubic_stiffness").pack(parameters)


def test_order_of_effects_does_not_change_the_force(rng):
    names = ["cubic_stiffness", "coulomb_friction", "freeplay", "linear_stiffness"]
    first, second = Oscillator(1.0, names), Oscillator(1.0, names[::-1])
    bounds = first.default_bounds(0.1, 20.0)
    values = {name: rng.uniform(low, high) for name, (low, high) in bounds.items()}
    assert first.parameter_names != second.parameter_names
    for x in rng.uniform(-0.1, 0.1, 10):
        # The same terms summed in another order.
        assert total_force(first, values, x, -1.0, -1.0) == pytest.approx(
            total_force(second, values, x, -1.0, -1.0), rel=1e-13
        )


def test_equation_of_motion_in_words():
    oscillator = Oscillator(2.5, ("cubic_stiffness", "bouc_wen"))
    assert oscillator.equation.splitlines() == [
        "m x'' + c x' + k x + k3 x^3 + (1 - alpha) kz z = 0",
        "  z' = A x' - beta |x'| |z|^(n - 1) z - gamma x' |z|^n",
        "  m: mass = 2.5 [kg; kg m^2 for a rotation]",
        "  k: linear_stiffness [N/m]",
        "  c: viscous_damping [N s/m]",
        "  k3: cubic_stiffness [N/m^3]",
        "  kz: bouc_wen_stiffness [N/m]",
        "  A: bouc_wen_amplitude [-]",
        "  alpha: bouc_wen_alpha [-]",
        "  beta: bouc_wen_beta [1/m^n]",
        "  gamma: bouc_wen_gamma [1/m^n]",
        "  n: bouc_wen_exponent [-]",
    ]
    assert Oscillator(2.5, "cubic_stiffness").latex == r"m \ddot{x} + c \dot{x} + k x + k_3 x^3 = 0"
    assert oscillator._repr_latex_() == rf"$\displaystyle {oscillator.latex}$"
    assert oscillator.latex.count(r",\quad \dot{z} = ") == 1
    everything = Oscillator(1.0, LIBRARY)
    for parameter in everything.parameters:
        assert f": {parameter.name} [{parameter.unit}]" in everything.equation
        assert parameter.latex in everything.latex


def test_equation_falls_back_to_names_where_symbols_are_alike():
    parameter = Parameter("my_spring", "N/m^3", "k_{3}", "another one", bounds=lambda m, a, w: (0.0, 1.0))
    mine = Effect("mine", "", "-my_spring x^3", "-k_{3} x^3", (parameter,), LIBRARY["cubic_stiffness"].force)
    lines = Oscillator(1.0, ("cubic_stiffness", mine)).equation.splitlines()
    assert lines[0] == "m x'' + c x' + k x + cubic_stiffness x^3 - my_spring x^3 = 0"


def test_representation():
    assert repr(Oscillator(2, "freeplay")) == (
        "Oscillator(mass=2.0, effects=('linear_stiffness', 'viscous_damping', 'freeplay'))"
    )


def test_equality_and_hash():
    first, second = Oscillator(1, "freeplay"), Oscillator(1.0) + "freeplay"
    assert first == second and hash(first) == hash(second)
    others = [Oscillator(2.0, "freeplay"), Oscillator(1.0), Oscillator(1.0, "iwan"), "freeplay"]
    assert all(first != other for other in others)
    with pytest.raises(AttributeError):
        first.mass = 3.0


def test_pickle_in_the_same_process(user_module):
    module = user_module()
    for effects in (tuple(LIBRARY), "freeplay", module.EFFECT):
        oscillator = Oscillator(1.5, effects)
        data = pickle.dumps(oscillator)
        assert pickle.loads(data) == oscillator
        # Names only: a compiled function would take kilobytes.
        assert len(data) < 1000


def test_pickle_and_digest_in_another_process(user_module, tmp_path):
    oscillator = Oscillator(1.5, ("iwan", "bouc_wen", user_module().EFFECT))
    path = tmp_path / "oscillator.pickle"
    path.write_bytes(pickle.dumps(oscillator))
    script = f"import pickle; print(pickle.load(open({str(path)!r}, 'rb')).source_digest())"
    result = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": f"{tmp_path}:{':'.join(sys.path)}", "PYTHONHASHSEED": "7"},
    )
    assert result.stdout.strip() == oscillator.source_digest()


def test_effect_from_inside_a_function_is_pickled_whole():
    cloudpickle = pytest.importorskip("cloudpickle")  # comes with PyMC

    @numba.njit
    def force(x, v, direction, z, p):
        return 7.0 * x

    local = Effect("local", "A spring.", "7 x", "7 x", (), force)
    copy = pickle.loads(cloudpickle.dumps(Oscillator(1.5, local)))
    assert copy.effects[-1].force(2.0, 0.0, 1.0, np.zeros(0), np.zeros(0)) == 14.0
    assert copy.source_digest() == Oscillator(1.5, local).source_digest()


def digest(module, attribute="EFFECT"):
    return Oscillator(1.0, getattr(module, attribute)).source_digest()


EDITS = {
    "force": ("SCALE * p[0]", "2.0 * SCALE * p[0]"),
    "gradient": ("3.0 * p[0] * x * x", "2.0 * p[0] * x * x"),
    "global constant": ("SCALE = 1.0", "SCALE = 1.5"),
    "global array": ("[1.0, 2.0]", "[1.0, 3.0]"),
    "enumeration": ("ODD = 3", "ODD = 5"),
    "compiler option": ("@numba.njit\ndef force", "@numba.njit(fastmath=True)\ndef force"),
}
HELPER_EDITS = {
    "helper": ("INNER * x * x * x", "INNER * x * x"),
    "constant of the helper": ("INNER = 1.0", "INNER = 2.0"),
    "helper of the helper": ("math.sin(x)", "math.cos(x)"),
    "helper reached through its module": ("2.0 * x", "4.0 * x"),
}


def replacing(old, new):
    def edit(text):
        assert text.count(old) == 1
        return text.replace(old, new)

    return edit


@pytest.mark.parametrize("what", EDITS)
def test_digest_changes_with_an_edit(what, user_module):
    assert digest(user_module()) != digest(user_module(edit=replacing(*EDITS[what])))


@pytest.mark.parametrize("what", HELPER_EDITS)
def test_digest_changes_with_an_edit_of_a_helper(what, user_module):
    assert digest(user_module()) != digest(user_module(edit_helpers=replacing(*HELPER_EDITS[what])))


def test_digest_changes_with_a_closure_variable(user_module):
    first = user_module()
    assert digest(first, "CLOSURE") != digest(first)
    edited = user_module(edit=replacing("make_force(2.0)", "make_force(3.0)"))
    assert digest(first, "CLOSURE") != digest(edited, "CLOSURE")


def test_digest_changes_when_a_global_is_set_anew(user_module, monkeypatch):
    module = user_module()
    before = digest(module)
    monkeypatch.setattr(module, "SCALE", 4.0)
    assert digest(module) != before


def test_digest_ignores_what_the_forces_do_not_use(user_module, rng):
    # Copies that differ in names of modules, comments, line numbers, and functions that no force refers to.
    module = user_module()
    before = digest(module)
    assert before == digest(
        user_module(
            edit=lambda text: "# A comment.\n\n" + text.replace("UNUSED = 3.0", "UNUSED = 4.0"),
            edit_helpers=replacing("5.0 * x", "6.0 * x"),
        )
    )
    for x in rng.uniform(-1.0, 1.0, 100):
        # Running a function lets Python rewrite its byte code for speed; the digest must not see that.
        module.force.py_func(x, 0.0, 1.0, np.zeros(0), np.ones(1))
    assert digest(module) == before


def test_digest_depends_on_the_effects_in_order():
    digests = {
        Oscillator(1.0, effects).source_digest()
        for effects in [(), *((name,) for name in list(LIBRARY)[2:]), ("iwan", "jenkins"), ("jenkins", "iwan")]
    }
    assert len(digests) == 1 + len(LIBRARY) - 2 + 2


def test_digest_works_without_source():
    namespace: dict = {"numba": numba}

    def effect(constant):
        exec(f"@numba.njit\ndef force(x, v, direction, z, p):\n    return {constant} * x", namespace)
        return Effect("typed", "", "x", "x", (), namespace["force"])

    assert digest_of(effect(2.0)) == digest_of(effect(2.0)) != digest_of(effect(3.0))


def digest_of(effect):
    return Oscillator(1.0, effect).source_digest()


def test_a_force_that_is_not_zero_at_zero_parameters_is_refused():
    def effect(function):
        parameter = Parameter("own", "N", "q", "own", bounds=lambda m, a, w: (0.0, m * a * w * w))
        return Effect("own", "Own.", "own", "q", (parameter,), numba.njit(function))

    with pytest.raises(InputError, match=r"of effect 'own' must be zero where all its parameters are, got 1 N"):
        Oscillator(1.0, effect(lambda x, v, direction, z, p: p[0] * direction + 1.0))
    with pytest.raises(InputError, match="must be zero where all its parameters are"):
        Oscillator(1.0) + effect(lambda x, v, direction, z, p: x**3)
    kept = Oscillator(1.0, effect(lambda x, v, direction, z, p: p[0] * x / abs(p[0])))  # 0 / 0 there: nothing to say
    assert kept.parameter_names[-1] == "own"
    for name, found in LIBRARY.items():  # a copy of the library's is one's own, and is looked at
        if name not in ("linear_stiffness", "viscous_damping"):
            copied = replace(found, name=f"my_{name}", signature=None)
            assert Oscillator(1.0, copied).effects[-1] is copied


def test_a_random_mass_is_refused_with_what_to_do_instead():
    pymc = pytest.importorskip("pymc")
    with pymc.Model(), pytest.raises(InputError, match=r"deviation as `mass_error` to build_model; in a model of your"):
        Oscillator(pymc.Normal("m", 1.0, 0.1))
