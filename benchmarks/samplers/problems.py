"""The posteriors on which samplers are compared, and their log-density as a plain function of a vector.

Cases 1 to 5 are those of the source paper (`pymc_backbone.paper.cases`), each with a population of 200 specimens. The
beam is the paper's cantilever with nine magnet positions: Duffing pairs of its Table 6, frequency alone, viscous
damping known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pymc as pm
from scipy.special import expit

from pymc_backbone import Oscillator, build_model, fit_density, simulate_population
from pymc_backbone.inference.starts import StartFinder
from pymc_backbone.likelihood.density import Density
from pymc_backbone.paper.cases import CASES, get_case
from pymc_backbone.simulation.counts import read_counts

POPULATION_SEED = 1
BEAM_DAMPING = 0.07098  # N s/m
# Stiffness [N/m] and magnitude of the softening cubic stiffness [GN/m^3] of the nine specimens.
BEAM = np.array([
    (82.59, 9.16), (79.00, 16.30), (71.58, 25.60), (67.28, 38.10), (62.91, 49.30),
    (78.34, 15.86), (90.35, 5.72), (95.33, 0.75), (97.87, 0.05),
])  # fmt: skip
BEAM_LEVELS = np.geomspace(4e-6, 1e-5, 4)  # m; released at 1e-5
BEAM_BOUNDS = {"linear_stiffness": (50.0, 110.0), "cubic_stiffness": (-8e10, 0.0)}
PROBLEMS = (*(name for name in CASES if name.isdigit()), "beam")


@dataclass(frozen=True, eq=False)
class Problem:
    """A posterior: oscillator, fitted density, Uniform priors.

    ``bounds`` holds the priors by parameter, in the order of the oscillator, which is that of the
    columns of every array here; ``fixed`` the
    parameters that are known.
    """

    name: str
    title: str
    oscillator: Oscillator
    density: Density
    bounds: dict[str, tuple[float, float]]
    fixed: dict[str, float]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that are inferred."""
        return tuple(self.bounds)

    def build(self, blocked: bool = False) -> pm.Model:
        """Return a PyMC model of its own."""
        return build_model(self.oscillator, self.density, self.bounds, fixed=self.fixed, blocked=blocked)

    def log_likelihood(self, natural: np.ndarray) -> np.ndarray:
        """Return the log-likelihood (n,) at parameters (n, p), without PyMC: backbones, then their density."""
        columns = dict(zip(self.parameters, natural.T, strict=True))
        known = {name: np.full(len(natural), value) for name, value in self.fixed.items()}
        theta = np.column_stack([{**columns, **known}[name] for name in self.oscillator.parameter_names])
        backbones = simulate_population(
            self.oscillator, theta, self.density.levels, observables=self.density.observables
        )
        return self.density.log_density(np.asarray(backbones["value"]))


def make_problem(name: str, specimens: int = 200) -> Problem:
    """Return a problem by its name; the population is drawn with a fixed seed, the beam's is the measured one."""
    if name == "beam":
        oscillator = Oscillator(0.03842, ["cubic_stiffness"])
        columns = {
            "linear_stiffness": BEAM[:, 0],
            "viscous_damping": np.full(len(BEAM), BEAM_DAMPING),
            "cubic_stiffness": -1e9 * BEAM[:, 1],
        }
        drawn = np.column_stack([columns[parameter] for parameter in oscillator.parameter_names])
        backbones = simulate_population(oscillator, drawn, BEAM_LEVELS, observables=("frequency",))
        density = fit_density(backbones, kind="product")
        return Problem(name, "beam", oscillator, density, BEAM_BOUNDS, {"viscous_damping": BEAM_DAMPING})
    case = get_case(name)
    drawn = case.draw(specimens, np.random.default_rng(POPULATION_SEED))
    backbones = simulate_population(case.data, drawn, case.levels, observables=("frequency", "damping"))
    density = fit_density(backbones, kind="product")
    bounds = {name: case.prior_bounds[name] for name in case.model.parameter_names if name in case.prior}
    return Problem(name, case.title, case.model, density, bounds, case.model_fixed)


class LogDensity:
    """The compiled log-density of a PyMC model as a function of one unconstrained vector: what outside samplers see.

    ``calls`` counts how often it was asked, apart from what the likelihood counts itself. Without the Jacobian of the
    transform it is a wrong density, and a common mistake: the negative control.
    """

    def __init__(self, problem: Problem, jacobian: bool = True) -> None:
        self.model = problem.build()
        names = [variable.name for variable in self.model.free_RVs]
        assert names == list(problem.parameters)
        self.low, self.high = np.array(list(problem.bounds.values())).T
        self.function = self.model.compile_fn(
            self.model.logp(jacobian=jacobian), inputs=self.model.value_vars, point_fn=False
        )
        self.calls = 0

    def __call__(self, unconstrained: np.ndarray) -> float:
        """Return the log-density at an unconstrained vector (p,)."""
        self.calls += 1
        value = float(self.function(*unconstrained))
        return value if np.isfinite(value) else -np.inf

    def natural(self, unconstrained: np.ndarray) -> np.ndarray:
        """Undo PyMC's interval transform of a Uniform, over the last axis."""
        return self.low + (self.high - self.low) * expit(unconstrained)

    def unconstrained(self, natural: np.ndarray) -> np.ndarray:
        """Return what `natural` undoes."""
        return np.log(natural - self.low) - np.log(self.high - natural)

    def find_starts(self, count: int, seed: int) -> np.ndarray:
        """Return unconstrained starts (count, p) found as `pymc_backbone.sample` finds its own."""
        starts = StartFinder(self.model, seed).find(count)
        names = [variable.name for variable in self.model.free_RVs]
        return self.unconstrained(np.array([[float(start[name]) for name in names] for start in starts]))

    def counts(self) -> dict[str, int]:
        """Return what was counted in this process so far."""
        return read_counts()
