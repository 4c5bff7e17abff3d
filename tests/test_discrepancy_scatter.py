"""The scatter of the effects over specimens: against a closed form, and from simulated backbones of known scatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares

from pymc_backbone._common.checks import OBSERVABLES
from pymc_backbone.discrepancy.fitting import joint_fit, normal_equations
from pymc_backbone.discrepancy.fitting.batch import Batch, batch_of_backbones
from pymc_backbone.discrepancy.fitting.estimates import estimates_of
from pymc_backbone.discrepancy.fitting.joint_fit import Fit, fit
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import start_state
from pymc_backbone.discrepancy.fitting.scatter import NARROWEST, SCATTER, WIDEST, infer_scatter
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.backbones import simulate_population

MASS, OMEGA, AMPLITUDE = 2.0, 30.0, 0.01
SPRING, DAMPER = MASS * OMEGA**2, 2.0 * 0.008 * MASS * OMEGA
CUBIC = 0.2 * SPRING / AMPLITUDE**2


def backbones(factors: np.ndarray) -> Batch:
    """Return backbones of specimens whose cubic springs differ by these factors, with errors of 1e-4 of frequency."""
    truth = Oscillator(MASS, ["cubic_stiffness"])
    rows = np.array([[SPRING, DAMPER, CUBIC * factor] for factor in factors])
    data = simulate_population(truth, rows, np.geomspace(0.12, 0.9, 8) * AMPLITUDE, OBSERVABLES)
    data = data.drop_vars("covariance")
    typical = np.abs(data["value"].values)
    error = np.stack([1e-4 * typical[:, 0], 5e-3 * typical[:, 1], np.full_like(typical[:, 0], 1e-3)], axis=1)
    noisy = data["value"].values + error * np.random.default_rng(5).standard_normal(error.shape)
    dims = data["value"].dims
    return batch_of_backbones(MASS, data.assign(value=(dims, noisy), standard_error=(dims, error)))


def fitted(batch: Batch, scatter: float = SCATTER) -> Fit:
    layout = make_layout(Oscillator(MASS, ["cubic_stiffness"]), batch.amplitude, batch.angular_frequency, scatter)
    found = fit(layout, batch.levels, start_state(layout, np.array([CUBIC]), batch.own), nuisances=(0, 1))
    assert found is not None
    return found


def factors_of(scatter: float, count: int = 10) -> np.ndarray:
    """Return factors whose mean is 1 and whose standard deviation is ``scatter``."""
    drawn = np.random.default_rng(3).standard_normal(count)
    return 1.0 + scatter * (drawn - drawn.mean()) / drawn.std()


def test_posterior_and_evidence_are_those_of_normal_values_that_are_known_with_an_error():
    """Of n values with error s the likelihood of a scatter is closed; quadrature integrates it over the prior."""
    values, error = factors_of(0.12, 7), 0.03

    def log_likelihood(scatter: float) -> float:
        variance = scatter**2 + error**2
        return float(-0.5 * ((values - 1.0) ** 2).sum() / variance - 0.5 * values.size * np.log(variance))

    found = infer_scatter(log_likelihood)
    low, high = np.log(NARROWEST), np.log(WIDEST)

    def weight(u: float) -> float:
        return float(np.exp(log_likelihood(float(np.exp(u))) - log_likelihood(SCATTER)))

    whole = quad(weight, low, high)[0]
    assert found.log_evidence == pytest.approx(np.log(whole / (high - low)), abs=0.02)
    for value, share in ((found.low, 0.05), (found.value, 0.5), (found.high, 0.95)):
        assert quad(weight, low, np.log(value))[0] / whole == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("scatter", [0.03, 0.1, 0.3])
def test_scatter_of_simulated_specimens_is_found(scatter):
    found = fitted(backbones(factors_of(scatter)))
    assert found.scatter.low < scatter < found.scatter.high
    # ten specimens tell a standard deviation to some 24 %
    assert found.scatter.value == pytest.approx(scatter, rel=0.5)
    # of nine degrees of freedom chi-square's 5 % and 95 % are 3.3 and 16.9; errors of the values widen that at 3 %
    assert found.scatter.high < (2.35 if scatter > 0.05 else 2.7) * found.scatter.low


def test_specimens_that_are_alike_are_more_probable_with_little_scatter():
    alike, unlike = fitted(backbones(np.ones(10))).scatter, fitted(backbones(factors_of(0.3))).scatter
    assert alike.high < 0.04
    assert alike.log_evidence > 3.0  # of a tenth, ten of them would not agree so well
    assert unlike.low > 0.15


def test_a_newton_step_stands_for_the_fit_with_another_scatter():
    """The evidence at twice the scatter, by a Newton step from one fit, against that of a fit made with it."""
    batch = backbones(factors_of(0.2, 6))
    found = fitted(batch)
    predicted = joint_fit._log_likelihood(found, 2.0) - joint_fit._log_likelihood(found, 1.0)
    again = fitted(batch, 2.0 * SCATTER)
    assert again.penalty < 0.5 * found.penalty  # negative control: it is another fit
    whole = joint_fit._log_likelihood(again, 1.0) - joint_fit._log_likelihood(found, 1.0)
    assert predicted == pytest.approx(whole, abs=0.1)


@pytest.mark.parametrize("scatter", [0.02, 0.25])
def test_a_value_over_the_batch_is_known_as_specimens_that_scatter_so_tell_it(scatter):
    """Intervals hold the value about which specimens were drawn, and are no wider than these tell it."""
    values, errors = [], []
    for seed in range(60):
        drawn = np.random.default_rng(700 + seed).standard_normal(5)
        value, error = estimates_of(fitted(backbones(1.0 + scatter * drawn)))["cubic_stiffness"]
        values.append(value / CUBIC - 1.0)
        errors.append(error / CUBIC)
    off = np.abs(values) / np.array(errors)
    assert 0.88 <= np.mean(off < 1.96) <= 1.0
    # the assumed scatter of a tenth had made that 0.045 for either
    assert 0.8 < np.mean(errors) / (scatter / np.sqrt(5.0)) < 1.8


def test_no_scatter_is_inferred_from_one_specimen_or_without_effects():
    single = fitted(backbones(np.ones(1)))
    assert np.isnan(single.scatter.value)
    assert single.scatter.log_evidence == 0.0


def test_nothing_is_inferred_away_from_a_minimum():
    """From far away a step promises a fall without end, which is no likelihood; at the minimum it promises nothing."""
    batch = backbones(factors_of(0.12))
    layout = make_layout(Oscillator(MASS, ["cubic_stiffness"]), batch.amplitude, batch.angular_frequency)
    far = fit(layout, batch.levels, start_state(layout, np.array([3.0 * CUBIC]), batch.own), iterations=1)
    near = fitted(batch)
    assert far is not None and far.cost > 100.0 * near.cost
    assert far.scatter.log_evidence == 0.0 and np.isnan(far.scatter.value)
    assert near.scatter.value == pytest.approx(0.12, rel=0.5)


def test_specimens_that_differ_by_a_third_are_fitted_to_the_minimum():
    """Wide scatter: the fit ends where SciPy's least squares do, with one specimen near the most it may differ."""
    batch = backbones(factors_of(0.3))
    found = fitted(batch)
    layout, terms = found.layout, batch.levels

    def residuals(x: np.ndarray) -> np.ndarray:
        own = found.state.own.copy()
        own[:, :2] = x[1:].reshape(-1, 3)[:, :2] * found.state.own[:, :2]
        own[:, -1] = x[1:].reshape(-1, 3)[:, 2]
        state = normal_equations.State(np.array([x[0] * CUBIC]), own)
        each = [
            term.compare(layout.simulator, joint_fit.parameters_of(layout, state, r), np.zeros(5))[0]
            for r, term in enumerate(terms)
        ]
        return np.concatenate([*each, own[:, -1]])

    start = np.concatenate([[1.0], np.tile([1.0, 1.0, 0.0], len(terms))])
    other = least_squares(residuals, start, x_scale="jac", xtol=1e-14, ftol=1e-14, max_nfev=60)
    assert found.cost == pytest.approx(2.0 * other.cost, abs=0.01)


def test_a_deviation_ends_where_its_parameter_has_its_limit():
    """Bouc-Wen hysteresis with the least exponent there is: no specimen pays for one that is below it.

    The minimum is that of SciPy's least squares with the deviations bounded as the parameters are.
    """
    truth = Oscillator(MASS, ["bouc_wen"])
    stiffness, slip = 0.25 * SPRING, 0.3 * AMPLITUDE
    factors = factors_of(0.2, 4)
    rows = np.array([[SPRING, DAMPER, stiffness * f, 1.0, 1.0, 0.5 / slip, 0.5 / slip, 1.0] for f in factors])
    data = simulate_population(truth, rows, np.geomspace(0.12, 0.9, 8) * AMPLITUDE, OBSERVABLES).drop_vars("covariance")
    typical = np.abs(data["value"].values)
    error = np.stack([1e-4 * typical[:, 0], 5e-3 * typical[:, 1], np.full_like(typical[:, 0], 1e-3)], axis=1)
    noisy = data["value"].values + error * np.random.default_rng(8).standard_normal(error.shape)
    dims = data["value"].dims
    batch = batch_of_backbones(MASS, data.assign(value=(dims, noisy), standard_error=(dims, error)))
    layout = make_layout(truth, batch.amplitude, batch.angular_frequency)
    exponent = layout.names.index("bouc_wen_exponent")
    eta = layout.coordinates(np.array([stiffness, 0.5 / slip, 0.5 / slip, 1.0]))
    found = fit(layout, batch.levels, start_state(layout, eta, batch.own), nuisances=(0, 1), iterations=80)
    assert found is not None and found.is_converged
    assert found.state.eta[exponent] == pytest.approx(1.0, abs=0.02)
    values = found.state.eta * (1.0 + SCATTER * found.state.own[:, normal_equations.NUISANCES :])
    assert np.all(values >= layout.low - 1e-9 * np.abs(layout.low))
    assert np.isfinite(found.scatter.value)  # at a minimum a step promises nothing

    count, q = len(batch.levels), layout.free.size
    terms = batch.levels
    scale = np.maximum(np.abs(found.state.eta), 1e-3)

    def state_of(x: np.ndarray) -> normal_equations.State:
        own = found.state.own.copy()
        each = x[q:].reshape(count, 2 + q)
        own[:, :2], own[:, -q:] = each[:, :2] * found.state.own[:, :2], each[:, 2:]
        shared = x[:q] * scale
        return normal_equations.State(shared, own)

    def residuals(x: np.ndarray) -> np.ndarray:
        state = state_of(x)
        parts = [
            term.compare(layout.simulator, joint_fit.parameters_of(layout, state, r), np.zeros(5))[0]
            for r, term in enumerate(terms)
        ]
        return np.concatenate([*parts, state.own[:, -q:].ravel()])

    start = np.concatenate([found.state.eta / scale, *(
        np.concatenate([np.ones(2), own[-q:]]) for own in found.state.own)])  # fmt: skip
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    low[:q], high[:q] = layout.low / scale - 1e-9, layout.high / scale + 1e-9
    other = least_squares(residuals, np.clip(start, low + 1e-9, high), bounds=(low, high), x_scale="jac", max_nfev=40)
    assert found.cost == pytest.approx(2.0 * other.cost, abs=0.1)


def test_a_specimen_that_leans_on_the_most_it_may_differ_promises_nothing_beyond():
    """One spring softens where the others harden: no scatter that is allowed reaches it, and none is believed to."""
    found = fitted(backbones(np.array([1.0, 1.05, 0.95, 1.0, -1.0])))
    assert np.abs(found.state.own[:, -1]).max() == pytest.approx(8.0)
    assert found.cost > 1000.0 * found.penalty  # negative control: beyond lies a fall of the cost by all that is left
    # a wider scatter makes the same deviations cheaper, and that is all that it can gain
    assert 0.0 < found.scatter.log_evidence < 0.5 * found.penalty


def test_parameters_at_their_limit_say_nothing_of_the_scatter():
    """Whatever the scatter, half of the specimens would be at the limit: as many deviations more change nothing."""
    batch = backbones(factors_of(0.2, 6))
    found = fitted(batch)
    layout = make_layout(Oscillator(MASS, ["cubic_stiffness"]), batch.amplitude, batch.angular_frequency)
    # the same with the lower limit at the value that is shared, towards which specimens are pulled
    low = replace(layout, low=found.state.eta.copy())
    own = found.state.own.copy()
    own[:, -1] = 0.0
    held = fit(low, batch.levels, normal_equations.State(found.state.eta.copy(), own), nuisances=(0, 1), iterations=40)
    assert held is not None
    at_limit = np.abs(held.state.own[:, -1]) < 1e-6
    assert 0 < at_limit.sum() < 6
    system = replace(held.system, own_gradient=np.where(at_limit[:, None], -np.ones(8), held.system.own_gradient))
    leaning = replace(held, system=system)
    rest = [r for r in range(6) if not at_limit[r]]
    each = [joint_fit._log_likelihood(leaning, width) for width in (0.3, 1.0)]
    free = replace(
        held,
        state=normal_equations.State(held.state.eta, held.state.own[rest]),
        system=replace(
            system, chi_square=system.chi_square[rest], mixed=system.mixed[rest], own=system.own[rest],
            own_gradient=system.own_gradient[rest], penalty=float((held.state.own[rest, -1] ** 2).sum()),
        ),
    )  # fmt: skip
    alone = [joint_fit._log_likelihood(free, width) for width in (0.3, 1.0)]
    assert each[1] - each[0] == pytest.approx(alone[1] - alone[0], abs=0.5)  # each of them would add 1.2
