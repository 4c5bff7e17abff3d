"""Evidence by importance sampling: against closed forms, quadrature, and fits that know nothing of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.optimize import least_squares
from scipy.special import logsumexp

from pymc_backbone.discrepancy.fitting.joint_fit import Fit, fit
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import NUISANCES, State, log_of_release, start_state
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import corrected_evidence, evidence
from pymc_backbone.discrepancy.weighing.conditional import Conditional
from pymc_backbone.discrepancy.weighing.corrected_evidence import Corrected, corrections
from pymc_backbone.discrepancy.weighing.evidence import Evidence, laplace, noise_scale
from pymc_backbone.discrepancy.weighing.importance import LARGEST_K, Integral, integrate
from pymc_backbone.oscillator import Oscillator

from .discrepancy_cases import AMPLITUDE, DAMPING, MASS, OMEGA, STIFFNESS, batch_of, make_records, truth_of

COVARIANCE = np.array([[2.0, 0.9], [0.9, 1.0]])
EFFORT = 1.5e7


def gaussian(points):
    return -0.5 * np.einsum("ni,ij,nj->n", points, np.linalg.inv(COVARIANCE), points)


def banana(bend, width):
    """A ridge along a parabola; its volume is that of two normal densities whatever the bend."""
    return lambda x: -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] - bend * x[:, 0] ** 2) / width) ** 2


@pytest.mark.parametrize("seed", range(3))
def test_a_gaussian_has_its_closed_volume(seed):
    found = integrate(gaussian, np.zeros(2), COVARIANCE, 128, random_seed=seed)
    exact = np.log(2.0 * np.pi) + 0.5 * np.log(np.linalg.det(COVARIANCE))
    assert found.log_value == pytest.approx(exact, abs=3.0 * found.error)
    assert found.error < 0.1 and found.pareto_k < 0.5 and found.draws == 128


@pytest.mark.parametrize("seed", range(3))
def test_a_gaussian_cut_off_at_a_corner_is_what_quadrature_says(seed):
    exact = dblquad(lambda y, x: np.exp(gaussian(np.array([[x, y]]))[0]), 0.0, 20.0, 0.0, 20.0)[0]
    found = integrate(
        lambda x: np.where((x < 0.0).any(axis=1), -np.inf, gaussian(x)), np.zeros(2), COVARIANCE, 128,
        low=np.zeros(2), high=np.full(2, 100.0), random_seed=seed,
    )  # fmt: skip
    assert found.log_value == pytest.approx(np.log(exact), abs=max(3.0 * found.error, 0.02))
    assert found.pareto_k < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_a_bent_ridge_is_followed_by_the_mixtures(seed):
    """The curvature at the mode sees a third of it only where the ridge bends by three widths."""
    exact = np.log(2.0 * np.pi * 0.3)
    first = integrate(banana(1.0, 0.3), np.zeros(2), np.diag([1.0, 0.09]), 128, rounds=0, walks=0, random_seed=seed)
    found = integrate(banana(1.0, 0.3), np.zeros(2), np.diag([1.0, 0.09]), 128, random_seed=seed)
    assert found.draws > first.draws
    assert abs(found.log_value - exact) < 0.45  # what no draw has reached is in no weight, and in no error either
    mild = integrate(banana(0.5, 1.0), np.zeros(2), np.eye(2), 128, random_seed=seed)
    assert mild.log_value == pytest.approx(np.log(2.0 * np.pi), abs=0.12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("width", "length", "missed"), [(0.01, 0.1, 0.2), (0.02, 0.2, 0.35), (0.01, 0.3, 1.0)])
def test_two_that_nearly_stand_for_each_other_are_followed_along_their_ridge(seed, width, length, missed):
    """A product known to a hundredth, each factor much less: as a gap and the stiffness of its contact are.

    A ridge that bends by nine times its width is not followed to its ends: something of it is missed, and not told.
    """

    def ridge(x):
        first, second = np.maximum(x, 1e-300).T
        inside = -0.5 * ((first * second - 1.0) / width) ** 2 - 0.5 * (np.log(first) / length) ** 2
        return np.where((x > 0.0).all(axis=1), inside, -np.inf)

    exact = np.log(2.0 * np.pi * width * length)  # in product and logarithm it is Gaussian, and the volume the same
    steep = width**-2.0
    covariance = np.linalg.inv(np.array([[steep + length**-2.0, steep], [steep, steep]]))
    found = integrate(ridge, np.ones(2), covariance, 128, low=np.zeros(2), random_seed=seed)
    assert exact - missed < found.log_value < exact + 0.1
    assert found.draws > 128 and found.pareto_k < LARGEST_K


def test_a_second_mode_that_draws_reach_is_seen_or_told():
    """Negative control: nine tenths of the volume lie in a mode eight standard deviations off."""
    exact = np.log(np.sqrt(2.0 * np.pi) * (1.0 + 0.5 * np.exp(3.0)))

    def two(x):
        return np.logaddexp(-0.5 * x[:, 0] ** 2, -2.0 * (x[:, 0] - 8.0) ** 2 + 3.0)

    told = []
    for seed in range(8):
        found = integrate(two, np.zeros(1), np.eye(1), 128, random_seed=seed)
        told.append(not found.is_trusted or abs(found.log_value - exact) < 0.3)
    assert sum(told) >= 4  # which of the few draws that far come near it is chance


def test_a_second_mode_far_away_is_missed():
    """What the method cannot do: of a mode forty standard deviations off no draw says anything."""
    exact = np.log(np.sqrt(2.0 * np.pi) * (1.0 + 0.5 * np.exp(3.0)))
    found = integrate(
        lambda x: np.logaddexp(-0.5 * x[:, 0] ** 2, -2.0 * (x[:, 0] - 40.0) ** 2 + 3.0), np.zeros(1), np.eye(1), 128
    )
    assert found.log_value < exact - 2.0


def test_nothing_to_draw_and_nowhere_to_go():
    one = integrate(lambda x: np.full(len(x), 3.0), np.zeros(0), np.zeros((0, 0)), 128)
    assert one.log_value == 3.0 and one.draws == 1 and np.isnan(one.pareto_k)
    none = integrate(lambda x: np.full(len(x), -np.inf), np.zeros(1), np.eye(1), 64)
    assert none.log_value == -np.inf and none.pareto_k == np.inf


@dataclass(frozen=True)
class Linear:
    """A data term whose values are linear in everything: then Laplace's method is exact."""

    matrix: np.ndarray
    values: np.ndarray
    cycles: float = 10.0

    @property
    def size(self) -> int:
        return self.values.size

    def residuals(self, simulator, parameters, nuisances):
        return self.values - self.matrix @ np.concatenate([parameters, nuisances])

    def compare(self, simulator, parameters, nuisances, *, drifts=True):
        return self.residuals(simulator, parameters, nuisances), self.matrix


def linear_fit(truth: float = 0.4, samples: int = 40) -> tuple[Fit, Linear]:
    """A fit of stiffness, damping and a cubic spring to one specimen's linear data with unit noise."""
    layout = make_layout(Oscillator(MASS, ["cubic_stiffness"]), AMPLITUDE, OMEGA)
    rng = np.random.default_rng(11)
    cubic = truth * STIFFNESS / AMPLITUDE**2
    vector = np.array([STIFFNESS, DAMPING, cubic])
    matrix = rng.standard_normal((samples, 8)) / np.array([*(0.03 * vector), 1.0, 1.0, 1.0, 1.0, 1.0])
    values = matrix @ np.concatenate([vector, np.zeros(5)]) + rng.standard_normal(samples)
    own = np.array([[STIFFNESS, DAMPING, 0.0, 0.0, 0.0]])
    term = Linear(matrix, values)
    found = fit(layout, [term], start_state(layout, np.array([cubic]), own), nuisances=(0, 1))
    assert found is not None
    return found, term


def test_where_everything_is_linear_laplace_is_exact():
    found, term = linear_fit()
    conditional = Conditional(found, [term], np.array([np.inf]), found.chi_square)
    middle, covariance = conditional.proposal
    integral = integrate(conditional.log_densities, middle, covariance, 128)
    scale = evidence.NoiseScale(np.array([np.inf]), found.chi_square, 1.0)
    assert integral.log_value == pytest.approx(laplace(found, scale), abs=0.05)
    assert integral.pareto_k < 0.5
    # negative control: of a proposal that is far off, the weights say so
    far = integrate(
        conditional.log_densities,
        middle + 30.0 * np.sqrt(np.diag(covariance)),
        0.01 * covariance,
        128,
        rounds=0,
        walks=0,
    )
    assert far.pareto_k > LARGEST_K


def test_a_motion_that_overflows_is_lost_without_a_warning():
    """A drift far off in the tail of the draws: what it leaves is finite, and its square is not."""
    found, term = linear_fit()

    class Overflowing(Linear):
        def residuals(self, simulator, parameters, nuisances):
            left = super().residuals(simulator, parameters, nuisances)
            return left * 1e200 if parameters[2] > 2.0 * found.state.eta[0] else left

    conditional = Conditional(
        found, [Overflowing(term.matrix, term.values)], np.array([np.inf]), found.chi_square
    )  # fmt: skip
    near, far = conditional.log_densities(np.array([found.state.eta, 3.0 * found.state.eta]))
    assert np.isfinite(near) and far == -np.inf


@pytest.fixture(scope="module")
def weak():
    """One specimen whose friction is known to some half of itself: its likelihood ends at zero."""
    rng = np.random.default_rng(5)
    batch = batch_of(make_records(rng, ("coulomb_friction",), specimens=1, share=0.06, decibels=38.0))
    fits = {}
    for names in ((), ("coulomb_friction",), ("quadratic_damping",)):
        layout = make_layout(Oscillator(MASS, list(names)), batch.amplitude, batch.angular_frequency)
        eta = np.array([1e-4 * STIFFNESS * AMPLITUDE if names == ("coulomb_friction",) else 0.05][: layout.free.size])
        fits[names] = fit(layout, batch.waveform, start_state(layout, eta, batch.own), iterations=100)
    return batch, fits


def by_quadrature(batch, found, scale):
    """The logarithm of the evidence: quadrature over the strength, the rest by Laplace's method from SciPy's fits."""
    (term,), layout = batch.waveform, found.layout
    size, floor = float(scale.sizes[0]), float(scale.floor[0])
    start = found.state.own[0, :5].copy()
    start[4] = start[4] or 1e-9
    unit = np.array([STIFFNESS, DAMPING, AMPLITUDE, 1.0 / OMEGA, AMPLITUDE])

    def residuals(own, eta):
        vector = layout.template.copy()
        vector[:2] = own[:2] * unit[:2]
        vector[layout.free] = layout.physical(eta, np.zeros(eta.size), 0.0)[0]
        return term.compare(layout.simulator, vector, np.array([*(own[2:] * unit[2:]), 0.0, 0.0]))[0]

    def log_likelihood(eta):
        low = np.array([0.0, 0.0, -np.inf, -np.inf, -np.inf])
        solved = least_squares(
            residuals, start / unit, args=(eta,), jac="3-point", x_scale=np.sqrt(np.diag(spread)), bounds=(low, np.inf),
            xtol=1e-12, ftol=1e-12, gtol=1e-12,
        )  # fmt: skip
        noise = float(found.chi_square[0]) / size
        determinant = np.linalg.slogdet(solved.jac.T @ solved.jac / noise)[1] - 2.0 * np.log(unit).sum()
        return -0.5 * size * np.log(2.0 * solved.cost / floor) - 0.5 * determinant

    at_fit = least_squares(residuals, start / unit, args=(found.state.eta,), jac="3-point", max_nfev=1)
    spread = np.linalg.inv(at_fit.jac.T @ at_fit.jac)
    if not layout.free.size:
        return log_likelihood(np.zeros(0))
    conditional = Conditional(found, batch.waveform, scale.sizes, scale.floor)
    width, middle = float(conditional.widths[0]), float(found.state.eta[0])
    error = float(np.sqrt(conditional.proposal.covariance[0, 0]))
    grid = np.linspace(max(middle - 7.0 * error, float(layout.low[0])), middle + 7.0 * error, 61)
    logs = np.array([log_likelihood(np.array([eta])) for eta in grid])
    logs += -0.5 * ((grid - middle) / width) ** 2 - np.log(width * np.sqrt(2.0 * np.pi))
    weights = np.full(grid.size, grid[1] - grid[0])
    weights[[0, -1]] *= 0.5
    return float(logsumexp(logs, b=weights))


@pytest.mark.parametrize("names", [("coulomb_friction",), ("quadratic_damping",)])
def test_evidence_over_the_base_is_that_of_quadrature(weak, names):
    batch, fits = weak
    scale = noise_scale(fits, batch)
    exact = by_quadrature(batch, fits[names], scale) - by_quadrature(batch, fits[()], scale)
    plain = laplace(fits[names], scale) - laplace(fits[()], scale)
    known = {key: Evidence(0.0, 0.0, 0.4) for key in fits}
    found = corrections(fits, known, batch, EFFORT)
    corrected = plain + found.sets[names].log_value - found.sets[()].log_value
    assert found.sets[names].is_trusted
    assert corrected == pytest.approx(exact, abs=0.05 + 2.0 * found.sets[names].error)
    if names == ("coulomb_friction",):
        assert abs(plain - exact) > 0.15  # negative control: here Laplace's method is off, by what lies below zero


def test_derivatives_are_not_needed_for_the_conditional_likelihood(weak):
    """What chord steps find is what a fit with the strength held finds, although specimens move by many errors."""
    batch, fits = weak
    found, scale = fits[("coulomb_friction",)], noise_scale(fits, batch)
    conditional = Conditional(found, batch.waveform, scale.sizes, scale.floor)
    error = float(np.sqrt(conditional.proposal.covariance[0, 0]))
    base = float(conditional.log_densities(found.state.eta[None])[0])
    for shift in (0.5, 1.0, 3.0):
        eta = found.state.eta + shift * error
        layout = replace(found.layout, low=eta, high=eta)
        held = fit(layout, batch.waveform, start_state(layout, eta, found.state.own[:, :NUISANCES]), iterations=50)
        place = (eta[0] - found.state.eta[0]) / conditional.widths[0]
        fall = -0.5 * float(scale.sizes @ np.log(held.chi_square / found.chi_square)) - 0.5 * place**2
        assert float(conditional.log_densities(eta[None])[0]) - base == pytest.approx(fall, abs=0.03)
    assert conditional.simulated > 0.0


def test_what_is_asked_rests_on_probability_and_effort_and_nothing_else(weak, monkeypatch):
    batch, fits = weak
    sets = list(fits)
    known = {names: Evidence(0.0, -k, p) for k, (names, p) in enumerate(zip(sets, (0.6, 0.397, 0.003), strict=True))}
    found = corrections(fits, known, batch, EFFORT)
    assert list(found.sets) == sets[:2]
    assert repr(found) == repr(corrections(fits, known, batch, EFFORT))  # to the last digit
    assert found.cycles > 0.0 and "2 leading sets" in found.reason
    settled = {names: Evidence(0.0, -k, p) for k, (names, p) in enumerate(zip(sets, (0.9995, 4e-4, 1e-4), strict=True))}
    assert not corrections(fits, settled, batch, EFFORT).sets
    assert "99.95%" in corrections(fits, settled, batch, EFFORT).reason
    poor = corrections(fits, known, batch, 1e3)
    assert not poor.sets and "cost more than it may" in poor.reason and poor.cycles == 0.0
    # what a limit on the effort leaves of the draws is said
    monkeypatch.setattr(corrected_evidence, "_MOST_DRAWS", 2**16)
    assert "instead of" in corrections(fits, known, batch, EFFORT).reason


def test_shifts_move_differences_only_and_what_fails_moves_nothing():
    asked = {
        ("a",): Integral(-1.0, 0.1, 0.1, 128),
        ("b",): Integral(-1.5, 0.1, 0.1, 128),
        ("c",): Integral(-9.0, 0.1, 0.9, 128),
    }
    shifts = Corrected(asked, "").shifts(("a",))
    assert shifts == {("a",): 0.0, ("b",): -0.5}
    # one that fails keeps Laplace's evidence, so those beside it keep theirs on average: none gains by failing
    assert Corrected(asked, "").shifts(("c",)) == {("a",): 0.25, ("b",): -0.25}
    assert Corrected({("c",): asked[("c",)]}, "").shifts(("c",)) == {}


@pytest.mark.parametrize(
    ("error", "found", "expected"),
    [
        (1e-5, 0.0, 0.05),  # nearly everything would have been seen
        (2e-4, 0.0, 0.25),  # five of these are three decades below the bound
        (2e-2, 0.0, 0.75),
        (0.5, 1.0, 0.95),  # hardly anything
        (2e-4, 1.0, evidence.UNSEEN),  # it is there
        (np.nan, 0.0, evidence.UNSEEN),
    ],
)
def test_what_is_too_small_to_be_seen_goes_with_what_the_records_show(error, found, expected):
    layout = make_layout(Oscillator(1.0, ["cubic_stiffness"]), 0.01, 30.0)
    bound = layout.width[0] * np.sqrt(12.0)
    fit = SimpleNamespace(
        layout=layout,
        covariance=np.array([[(error * bound) ** 2]]),
        state=SimpleNamespace(eta=np.array([found * bound])),
    )
    assert evidence.unseen(fit, "cubic_stiffness") == pytest.approx(expected, abs=1e-9)
    assert evidence.unseen(fit, "quadratic_damping") == evidence.UNSEEN  # of what was not fitted nothing is known


def test_quiet_records_say_more_of_nothing_being_missing():
    """The same structure with 60 and with 30 dB, each single effect fitted."""
    chances = []
    for noise in (60.0, 30.0):
        batch = batch_of(make_records(np.random.default_rng(11), decibels=noise))
        search = Search(batch, Oscillator(MASS), ("cubic_stiffness", "quadratic_damping"), 1)
        for names in ((), ("cubic_stiffness",), ("quadratic_damping",)):
            search.fit_set(names)
        chances.append(evidence.probabilities(search.fits, batch, 2)[()].probability)
    assert chances[0] > chances[1] + 0.05


def test_corrections_enter_the_probabilities(weak):
    batch, fits = weak
    plain = evidence.probabilities(fits, batch, 2, bonus={("coulomb_friction",): 0.0})
    moved = evidence.probabilities(
        fits, batch, 2, bonus={("coulomb_friction",): 0.0}, corrections={("coulomb_friction",): -2.0}
    )
    gain = moved[("coulomb_friction",)].log_posterior - plain[("coulomb_friction",)].log_posterior
    assert gain == pytest.approx(-2.0)
    assert sum(item.probability for item in moved.values()) == pytest.approx(1.0)


def test_a_slider_that_slips_once_at_the_release_gains_nothing_by_releases_that_are_alike():
    """Beyond its slip every release gives the same motion: to densities that are flat, that was no coincidence."""
    batch = batch_of(make_records(np.random.default_rng(4), ["quadratic_damping"], specimens=6, decibels=30.0))
    alone, both = (
        make_layout(Oscillator(MASS, names), batch.amplitude, batch.angular_frequency)
        for names in (["quadratic_damping"], ["quadratic_damping", "jenkins"])
    )
    drag = np.array([truth_of(["quadratic_damping"])["quadratic_damping"]])
    plain = fit(alone, batch.waveform, start_state(alone, drag, batch.own), nuisances=batch.nuisances)
    own = np.hstack([plain.state.own, np.zeros((6, 2))])
    slider = 0.97 * own[:, 0].mean()  # next to all of the stiffness
    own[:, 4] -= 0.2 * own[:, 2] * slider / own[:, 0]  # the slider rests where it slipped to, and holds the mid-line
    own[:, 2] *= 1.2
    own[:, 0] -= slider
    eta = np.array([plain.state.eta[0], slider * 1.04 * batch.amplitude, 1.04])
    slipping = fit(both, batch.waveform, State(eta, own), nuisances=batch.nuisances)
    scale = noise_scale({("quadratic_damping",): plain, ("jenkins", "quadratic_damping"): slipping}, batch)
    assert slipping.cost == pytest.approx(plain.cost, abs=3.0)  # it draws the same motion
    assert laplace(slipping, scale) < laplace(plain, scale)


@pytest.mark.parametrize("kept", [(0, 1, 2, 3, 4), (0, 2, 3)])
def test_evidence_does_not_hang_on_what_a_release_is_measured_by(kept):
    """Whether a millimetre or the square of the release is what densities are flat in."""
    rng = np.random.default_rng(2)
    jacobian = rng.standard_normal((40, 5))
    changed = jacobian * np.array([1.0, 1.0, 0.02, 7.0, 300.0])
    active, index = np.isin(np.arange(7), kept), np.array(kept)
    of_release, others = [k for k in kept if k > 1], [k for k in kept if k < 2]
    left = []
    for columns in (jacobian, changed):
        own = (columns.T @ columns)[np.ix_(kept, kept)]
        left.append(np.linalg.slogdet(own)[1] - log_of_release(own, index, active))
    assert left[0] == pytest.approx(left[1], abs=1e-9)
    # what remains is the information on the rest, the release eliminated
    basis = np.linalg.qr(jacobian[:, of_release])[0]
    rest = jacobian[:, others] - basis @ (basis.T @ jacobian[:, others])
    assert left[0] == pytest.approx(np.linalg.slogdet(rest.T @ rest)[1], abs=1e-9)
    assert log_of_release(np.eye(2), np.array([0, 1]), np.isin(np.arange(7), (0, 1))) == 0.0
