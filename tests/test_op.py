"""The Ops: compiled against Python, gradients, caching, failures, processes."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.gradient import verify_grad

from pymc_backbone import (
    BackboneLogLikelihood,
    BackboneOp,
    Effect,
    InputError,
    Oscillator,
    Parameter,
    fit_density,
    simulate_backbone,
    simulate_population,
)
from pymc_backbone.likelihood import native
from pymc_backbone.likelihood.op import describe
from pymc_backbone.simulation.counts import read_counts
from pymc_backbone.simulation.machine_code import define
from pymc_backbone.simulation.response import make_response

LEVELS = np.geomspace(0.004, 0.03, 5)
DUFFING = np.array([6500.0, 1.1, 6.25e6])


@numba.njit
def _softening(x, v, direction, z, p):
    return p[0] * x * abs(x)


@numba.njit
def _side(x, v, direction, z, p):
    return 1 if x > 0.0 or (x == 0.0 and direction > 0.0) else -1


SOFTENING = Effect(
    name="softening",
    summary="a user's own effect, without a gradient",
    text="s x |x|",
    latex="s x |x|",
    parameters=(
        Parameter("softening", "N/m^2", "s", "strength", lambda m, a, w: (-m * w * w / a, m * w * w / a), -np.inf),
    ),
    force=_softening,
    regime=_side,
)
CASES = {
    "duffing": (Oscillator(1.0, ["cubic_stiffness"]), DUFFING),
    "friction": (Oscillator(1.0, ["coulomb_friction", "quadratic_damping"]), np.array([6500.0, 1.1, 0.2, 1.5])),
    "bouc_wen": (
        Oscillator(1.0, ["bouc_wen"]),
        np.array([6000.0, 1.0, 1500.0, 1.0, 0.4, 40.0, 30.0, 1.2]),
    ),
    "jenkins": (Oscillator(1.0, ["jenkins"]), np.array([6000.0, 1.0, 800.0, 6.0])),
    "user": (Oscillator(1.0, [SOFTENING]), np.array([6500.0, 1.1, -2e4])),
}


def population(oscillator: Oscillator, centre: np.ndarray, seed: int, marginal: str = "normal"):
    """Fit a density to twenty specimens around ``centre``."""
    rng = np.random.default_rng(seed)
    parameters = centre * (1.0 + 0.02 * rng.standard_normal((20, centre.size)))
    return fit_density(simulate_population(oscillator, parameters, LEVELS), kind="product", marginal=marginal)


def value_and_gradient(oscillator: Oscillator, density, theta: np.ndarray):
    vector = pt.dvector("theta")
    op = BackboneLogLikelihood(make_response(oscillator, LEVELS))
    value = op(vector, density.codes, density.table)[0]
    return pytensor.function([vector], [value, pt.grad(value, vector)])(theta)


@pytest.mark.parametrize("name", CASES)
def test_compiled_equals_python(name, random_seed):
    oscillator, theta = CASES[name]
    density = population(oscillator, theta, random_seed)
    op = BackboneLogLikelihood(make_response(oscillator, LEVELS))
    storage = [[None], [None]]
    op.perform(None, [theta, density.codes, density.table], storage)
    value, gradient = value_and_gradient(oscillator, density, theta)
    # The same machine code runs on both paths; only the order of the last sum differs.
    np.testing.assert_allclose(value, storage[0][0], rtol=1e-12)
    np.testing.assert_allclose(gradient, storage[1][0], rtol=1e-9, atol=1e-12 * np.abs(gradient).max())
    simulated = simulate_backbone(oscillator, theta, LEVELS).values[:2]
    assert value == pytest.approx(float(density.log_density(simulated)), rel=1e-5)


@pytest.mark.parametrize("name", ["duffing", "friction", "user"])
def test_gradient_of_the_likelihood(name, random_seed):
    oscillator, theta = CASES[name]
    density = population(oscillator, theta, random_seed)
    point = 1.003 * theta
    gradient = value_and_gradient(oscillator, density, point)[1]
    for j in range(theta.size):
        step = np.zeros(theta.size)
        step[j] = 1e-4 * point[j]
        above, below = (value_and_gradient(oscillator, density, point + sign * step)[0] for sign in (1.0, -1.0))
        # Values good to 1e-8 over a spread of 2 % leave 1e-8 / 0.02 / 1e-4 = 5e-3 of noise in relative parameters.
        assert gradient[j] * point[j] == pytest.approx((above - below) / 2e-4, rel=1e-3, abs=5e-3)


def test_gradient_of_the_simulated_backbone(random_seed):
    op = BackboneOp(make_response(Oscillator(1.0, ["cubic_stiffness"]), LEVELS, ("frequency", "damping", "offset")))
    verify_grad(lambda relative: op(relative * DUFFING)[0], [np.ones(3)], eps=1e-5, rel_tol=1e-4, abs_tol=1e-6,
                rng=np.random.default_rng(random_seed), mode="FAST_RUN")  # fmt: skip


def test_value_alone_uses_the_variant_without_gradient(random_seed):
    oscillator, theta = CASES["duffing"]
    density = population(oscillator, theta, random_seed)
    vector = pt.dvector("theta")
    op = BackboneLogLikelihood(make_response(oscillator, LEVELS))
    value = op(vector, density.codes, density.table)[0]

    def ops(function):
        return [n.op for n in function.maker.fgraph.apply_nodes if isinstance(n.op, BackboneLogLikelihood)]

    assert [o.with_gradient for o in ops(pytensor.function([vector], value))] == [False]
    assert [o.with_gradient for o in ops(pytensor.function([vector], [value, pt.grad(value, vector)]))] == [True]


@pytest.mark.parametrize(
    ("theta", "failures"),
    [([-6500.0, 1.1, 1.0], 1), ([6500.0, 1e4, 1.0], 1), ([np.nan, 1.1, 1.0], 1), ([6500.0, np.inf, 0.0], 1)],
)
@pytest.mark.parametrize("compiled", [True, False])
def test_failed_simulation_is_minus_infinity_and_counted(theta, failures, compiled, random_seed):
    oscillator, centre = CASES["duffing"]
    density = population(oscillator, centre, random_seed)
    op = BackboneLogLikelihood(make_response(oscillator, LEVELS), with_gradient=False)
    point = np.array(theta)
    before = read_counts()
    if compiled:
        vector = pt.dvector("theta")
        value = pytensor.function([vector], op(vector, density.codes, density.table)[0])(point)
    else:
        storage = [[None], [None]]
        op.perform(None, [point, density.codes, density.table], storage)
        value = storage[0][0]
    after = read_counts()
    assert value == -np.inf
    assert after["failures"] - before["failures"] == failures
    assert after["simulations"] - before["simulations"] == 1
    gradient = value_and_gradient(oscillator, density, point)[1]
    np.testing.assert_array_equal(gradient, 0.0)


def test_the_op_is_pure(random_seed):
    """The same inputs give the same outputs, whatever was asked before, and no input is written to."""
    oscillator, theta = CASES["duffing"]
    density = population(oscillator, theta, random_seed)
    op = BackboneLogLikelihood(make_response(oscillator, LEVELS))
    assert not op.destroy_map and not op.view_map
    vector, codes, table = pt.dvector(), pt.lvector(), pt.dvector()
    function = pytensor.function([vector, codes, table], op(vector, codes, table)[0])
    other = population(oscillator, theta, random_seed + 1)
    inputs = [theta.copy(), density.codes.copy(), density.table.copy()]
    before = read_counts()
    first = function(*inputs)
    assert function(1.01 * theta, *inputs[1:]) != first != function(theta, other.codes, other.table)
    assert function(*inputs) == first
    assert read_counts()["simulations"] - before["simulations"] == 4  # nothing is remembered behind its back
    for given, kept in zip(inputs, (theta, density.codes, density.table), strict=True):
        np.testing.assert_array_equal(given, kept)


def test_memory_is_no_input_any_more(random_seed):
    oscillator, theta = CASES["duffing"]
    density = population(oscillator, theta, random_seed)
    op = BackboneLogLikelihood(make_response(oscillator, LEVELS))
    with pytest.warns(FutureWarning, match="takes no `memory`"):
        old = op(pt.as_tensor(theta), density.codes, density.table, pytensor.shared(np.zeros(30)))[0]
    assert old.eval() == op(pt.as_tensor(theta), density.codes, density.table)[0].eval()


def test_threads_are_counted_exactly(random_seed):
    oscillator, theta = CASES["duffing"]
    integers, numbers = describe(make_response(oscillator, LEVELS))
    call = native.call_backbone

    @numba.njit(nogil=True)
    def simulate(times):
        values, status = np.empty((3, LEVELS.size)), np.zeros(LEVELS.size, np.int64)
        for _ in range(times):
            call(
                integers.ctypes, numbers.ctypes, theta.ctypes, values.ctypes, values.ctypes, status.ctypes, 0
            )  # fmt: skip

    simulate(1)
    before = read_counts()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(simulate, [500] * 4))
    assert read_counts()["simulations"] - before["simulations"] == 2000


def test_batched_inputs(random_seed):
    oscillator, theta = CASES["duffing"]
    density = population(oscillator, theta, random_seed)
    op = BackboneLogLikelihood(make_response(oscillator, LEVELS))
    thetas = theta * (1.0 + 0.01 * np.random.default_rng(random_seed).standard_normal((4, 3)))
    matrix = pt.dmatrix("thetas")
    values = pt.vectorize(lambda t: op(t, density.codes, density.table)[0], "(p)->()")(matrix)
    result, gradients = pytensor.function([matrix], [values, pt.grad(values.sum(), matrix)])(thetas)
    expected = [value_and_gradient(oscillator, density, row) for row in thetas]
    np.testing.assert_allclose(result, [e[0] for e in expected], rtol=1e-12)
    np.testing.assert_allclose(gradients, [e[1] for e in expected], rtol=1e-9)


def test_equality_hash_and_pickle():
    levels = tuple(LEVELS)
    one = BackboneLogLikelihood(make_response(Oscillator(1.0, ["cubic_stiffness"]), levels))
    same = BackboneLogLikelihood(make_response(Oscillator(1.0, ["cubic_stiffness"]), levels))
    assert one == same
    assert hash(one) == hash(same)
    for other in (
        make_response(Oscillator(2.0, ["cubic_stiffness"]), levels),
        make_response(Oscillator(1.0, ["quintic_stiffness"]), levels),
        make_response(Oscillator(1.0, ["cubic_stiffness"]), levels[1:]),
        make_response(Oscillator(1.0, ["cubic_stiffness"]), levels, ("frequency",)),
        make_response(Oscillator(1.0, ["cubic_stiffness"]), levels, release_amplitude=0.05),
    ):
        assert one != BackboneLogLikelihood(other)
        assert one.response.key != other.key
    copy = pickle.loads(pickle.dumps(one))
    assert copy == one
    assert copy.response.key == one.response.key


def test_edited_force_changes_key_and_numbers():
    @numba.njit
    def edited(x, v, direction, z, p):
        return 2.0 * p[0] * x * abs(x)

    other = Effect("softening", SOFTENING.summary, SOFTENING.text, SOFTENING.latex, SOFTENING.parameters, edited)
    theta = CASES["user"][1]
    responses = [make_response(Oscillator(1.0, [effect]), LEVELS) for effect in (SOFTENING, other)]
    assert responses[0].key != responses[1].key
    vector = pt.dvector()
    values = [pytensor.function([vector], BackboneOp(r)(vector)[0])(theta) for r in responses]
    assert np.abs(values[0][0] - values[1][0]).max() > 0.01


EDITED = """
import numba, numpy as np, pytensor, pytensor.tensor as pt
from pymc_backbone import Effect, Oscillator, Parameter, BackboneOp
from pymc_backbone.likelihood import native
from pymc_backbone.simulation.response import make_response

FACTOR = {factor}

@numba.njit
def helper(x):
    return FACTOR * x

@numba.njit
def force(x, v, direction, z, p):
    return p[0] * helper(x)

effect = Effect("spring", "s", "s x", "s x", (Parameter("spring", "N/m", "s", "s", lambda m, a, w: (0.0, 1.0)),), force)
vector = pt.dvector()
op = BackboneOp(make_response(Oscillator(1.0, [effect]), [0.01], ("frequency",)))
print(pytensor.function([vector], op(vector)[0])(np.array([100.0, 0.0, 100.0]))[0, 0])
"""


def test_new_process_sees_an_edited_helper(tmp_path):
    def run(factor: float) -> float:
        script = tmp_path / "script.py"
        script.write_text(EDITED.format(factor=factor))
        done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
        return float(done.stdout)

    assert run(0.0) == pytest.approx(np.sqrt(100.0) / (2.0 * np.pi), rel=1e-8)
    assert run(3.0) == pytest.approx(np.sqrt(400.0) / (2.0 * np.pi), rel=1e-8)


def test_second_process_finds_everything_compiled():
    script = textwrap.dedent(
        """
        import numpy as np, pytensor, pytensor.tensor as pt
        from pymc_backbone import Oscillator, BackboneOp
        from pymc_backbone.likelihood import native
        from pymc_backbone.simulation.response import make_response
        vector = pt.dvector()
        op = BackboneOp(make_response(Oscillator(1.0, ["cubic_stiffness"]), [0.01, 0.02]))
        pytensor.function([vector], op(vector)[0])(np.array([6500.0, 1.1, 6.25e6]))
        print([native.BACKBONE.is_from_disk, native.LOG_LIKELIHOOD.is_from_disk])
        """
    )
    runs = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True) for _ in range(2)
    ]
    assert runs[1].stdout.strip() == "[True, True]"


@pytest.mark.parametrize("is_fresh", [False, True])
def test_whether_the_integrator_is_on_disk_is_known_before_it_is_compiled(is_fresh, tmp_path):
    """So that who waits for minutes is told why."""
    define()
    script = "from pymc_backbone.simulation.machine_code import is_compiled; print(is_compiled())"
    where = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)} if is_fresh else None
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, env=where)
    assert done.stdout.strip() == str(not is_fresh)


def _evaluate_in_child(payload: bytes, queue) -> None:
    op, theta = pickle.loads(payload)
    vector = pt.dvector()
    queue.put(pytensor.function([vector], op(vector)[0])(theta))


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_pickled_op_works_in_another_process(method):
    op = BackboneOp(make_response(CASES["duffing"][0], LEVELS))
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    child = context.Process(target=_evaluate_in_child, args=(pickle.dumps((op, DUFFING)), queue))
    child.start()
    values = queue.get(timeout=300)
    child.join()
    np.testing.assert_array_equal(values, simulate_backbone(CASES["duffing"][0], DUFFING, LEVELS).values[:2])


def duffing_by_hand(parameters, levels):
    """Stand in for a finite-element code."""
    if parameters["viscous_damping"] > 50.0:
        raise RuntimeError("did not converge")
    return simulate_backbone(CASES["duffing"][0], parameters, levels).values[:2]


def test_a_function_stands_in_for_the_oscillator(random_seed):
    oscillator, theta = CASES["duffing"]
    density = population(oscillator, theta, random_seed)
    op = BackboneLogLikelihood(make_response(duffing_by_hand, LEVELS, parameter_names=oscillator.parameter_names))
    vector = pt.dvector()
    value = op(vector, density.codes, density.table)[0]
    function = pytensor.function([vector], value)
    reference = BackboneLogLikelihood(make_response(oscillator, LEVELS))
    expected = pytensor.function([vector], reference(vector, density.codes, density.table)[0])
    assert function(theta) == pytest.approx(float(expected(theta)), rel=1e-10)
    before = read_counts()
    assert function(np.array([6500.0, 60.0, 1.0])) == -np.inf
    assert read_counts()["failures"] - before["failures"] == 1
    with pytest.raises(NotImplementedError, match="no gradient"):
        pt.grad(value, vector)


def test_a_function_remembers_the_present_point_of_a_walk(random_seed):
    """Whoever asks: PyMC's own Metropolis wants the proposal, then the present point again."""
    calls = []

    def counted(parameters, levels):
        calls.append(tuple(parameters.values()))
        return duffing_by_hand(parameters, levels)

    oscillator, theta = CASES["duffing"]
    response = make_response(counted, LEVELS, parameter_names=oscillator.parameter_names)
    expected = {}
    for factor in (1.0, 1.01, 1.02, 1.03, 1.04):
        for point in (factor * theta, theta):
            values, _, completed = response.evaluate(point, False)
            assert completed
            np.testing.assert_array_equal(values, expected.setdefault(point.tobytes(), values.copy()))
            values[:] = 0.0  # whoever gets them may write to them
    assert len(calls) == len(set(calls)) == 5
    response.evaluate(1.01 * theta, False)  # long forgotten
    assert len(calls) == 6
    assert response == make_response(counted, LEVELS, parameter_names=oscillator.parameter_names)


def test_a_function_of_the_wrong_shape_is_named(random_seed):
    response = make_response(lambda parameters, levels: levels, LEVELS, parameter_names=("a",))
    with pytest.raises(InputError, match=r"shape \(2, 5\)"):
        response.evaluate(np.array([1.0]), False)
    with pytest.raises(InputError, match="parameter_names"):
        make_response(lambda parameters, levels: levels, LEVELS)


def test_generated_stepper_is_what_the_script_writes():
    script = Path(__file__).parents[1] / "scripts" / "generate_stepper.py"
    assert subprocess.run([sys.executable, str(script), "--check"], check=False).returncode == 0
