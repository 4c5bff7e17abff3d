"""The systems of the source paper, with its published numbers, and every choice that it leaves open.

Reference: Pandey, Haddad Khodaparast, Friswell, Chatterjee, Madinei, Deighan (2024), arXiv:2410.11902, Tables 1 to 5, 8
and 9. A Uniform with mean mu and standard deviation s spans mu +- sqrt(3) s; that is how its columns become bounds.

What the paper does not give, and what was chosen:

- Mass of cases 1 to 3: 1 kg, which puts them at 12.8 Hz.
- Levels of cases 1 to 3: up to three times the 0.032 m at which the cubic force equals that of the linear spring; far
  below, backbones do not see the cubic spring. Dry friction (case 2) stops the motion at 0.17 mm, far below all levels.
- Case 4 gives A, alpha, beta and gamma only. The linear spring has 115 N/m and the hysteretic one 95 N/m: so the total
  stiffness at small amplitude, 115 + (1 - alpha) 95 A, has mean and standard deviation 156.6 and 18 N/m, those of the
  "true" k1 of Table 5 (156.5, 18.17). With 1.3 kg it begins at 1.75 Hz and falls towards 1.50 Hz where the hysteretic
  force is saturated, the range of the frequencies published for case 5. (The paper lists the lowest of these as that of
  the low amplitude; with its beta + gamma > 0 a Bouc-Wen element softens, so it is that of the high one.) The exponent
  is 1, viscous damping that of Table 5. The levels reach 0.8 m, twice the 0.42 m at which the force saturates.
- Case 5 has the data of case 4 at levels up to 0.04 m: beyond, a cubic spring of 33.5 kN/m^3 is above 1.9 Hz, which no
  Bouc-Wen specimen is. Table 5 gives c2 in kN s^2/m^2, which would overdamp the system at a millimetre: N s^2/m^2
  is meant.
- Observables: frequency and damping. The paper's likelihood holds frequency alone, which does not see damping. The beam
  has frequency alone: its damping is given.
- Single value: one specimen of case 1 with the target's parameters, released 24 times; its frequencies and damping
  scatter by a thousandth and by 3 %, as measurement does. The paper gives neither scatter nor numbers for the result.
- Beam: levels 1 to 9 micrometres, below the release at 10. The prior is a little wider than the rectangle of the nine
  pairs (the paper's bounds are not given; with the rectangle itself its posterior would be its prior). The published
  standard deviation of k_n, 143.7 GN/m^3, cannot be that of values between 0.05 and 49.3; 14.37 is meant
  (docs/beam.md). The model's cubic stiffness is -k_n.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from .._common.checks import FloatArray, check_choice
from ..oscillator import Oscillator
from ..simulation.backbones import simulate_population
from .beam import PAPER_BEAM

Pair = tuple[float, float]


@dataclass(frozen=True)
class Case:
    """One system of the source paper.

    Attributes
    ----------
    name : str
        As on the command line.
    title : str
        In words.
    data : Oscillator
        The system that the population is drawn from.
    model : Oscillator
        The one that is fitted.
    true : mapping of str to (float, float)
        Mean and standard deviation of the population's Uniform distributions, in SI units, by parameter of ``data``.
    fixed : mapping of str to float
        Parameters of ``data`` that do not vary, known to the model where it has them.
    prior : mapping of str to (float, float)
        Mean and standard deviation of the Uniform priors, by parameter of ``model``.
    published : mapping of str to (float, float)
        Mean and standard deviation that the paper reports.
    published_acceptance : float
        Acceptance rate that the paper reports.
    levels : (l,) array
        Amplitudes [m].
    observables : tuple of str
        What is compared.
    population : (n, p) array, optional
        The population itself, where the paper lists it.
    scatter : mapping of str to float
        Relative standard deviation of repeated measurements, by observable.
    count : int, optional
        How many specimens or repetitions there are, where this is not the user's choice.
    comparison : {"gev", "uniform"}
        What is fitted to both sides at low, middle and high amplitude.
    published_fits : mapping of str to (tuple, tuple)
        The paper's fits to measured and simulated frequencies [Hz], by its name of the amplitude.

    See Also
    --------
    paper.CASES : all of them by name.
    paper.run_case : runs one.
    """

    name: str
    title: str
    data: Oscillator
    model: Oscillator
    true: Mapping[str, Pair]
    prior: Mapping[str, Pair]
    published: Mapping[str, Pair]
    published_acceptance: float
    levels: FloatArray
    fixed: Mapping[str, float] = field(default_factory=dict)
    observables: tuple[str, ...] = ("frequency", "damping")
    population: FloatArray | None = None
    scatter: Mapping[str, float] = field(default_factory=dict)
    count: int | None = None
    comparison: str = "gev"
    published_fits: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]] = field(default_factory=dict)

    @property
    def prior_bounds(self) -> dict[str, Pair]:
        """Bounds of the Uniform priors."""
        return {name: uniform_bounds(*pair) for name, pair in self.prior.items()}

    @property
    def model_fixed(self) -> dict[str, float]:
        """Parameters of the model that are not inferred."""
        names = set(self.model.parameter_names) - set(self.prior)
        return {name: value for name, value in self.fixed.items() if name in names}

    def measure(
        self, vectors: FloatArray, rng: np.random.Generator, observables: Sequence[str] | None = None
    ) -> xr.Dataset:
        """Return the measured backbones (`simulate_population`) of these specimens, with the case's scatter if any."""
        names = self.observables if observables is None else tuple(observables)
        backbones = simulate_population(self.data, vectors, self.levels, names)
        for name, relative in self.scatter.items():
            if name in names:
                value = backbones["value"].sel(observable=name)
                error = rng.standard_normal(value.shape) * relative
                backbones["value"].loc[{"observable": name}] = value * (1.0 + error)
        return backbones

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return parameter vectors (n, p) of ``data`` for ``count`` specimens, or as many as the case has."""
        if self.population is not None:
            return np.array(self.population)
        count = self.count or count
        columns = []
        for name in self.data.parameter_names:
            if name in self.fixed:
                columns.append(np.full(count, self.fixed[name]))
            else:
                columns.append(rng.uniform(*uniform_bounds(*self.true[name]), count))
        return np.column_stack(columns)


def uniform_bounds(mean: float, sd: float) -> Pair:
    """Return the bounds of the Uniform distribution with a mean and a standard deviation."""
    return float(mean - np.sqrt(3.0) * sd), float(mean + np.sqrt(3.0) * sd)


_BOUC_WEN = Oscillator(1.3, ["bouc_wen"])
_BOUC_WEN_TRUE = {
    "bouc_wen_amplitude": (1.25, 0.43),
    "bouc_wen_alpha": (0.65, 0.09),
    "bouc_wen_beta": (1.5, 0.29),
    "bouc_wen_gamma": (1.5, 0.29),
}
_BOUC_WEN_FIXED = {
    "linear_stiffness": 115.0, "viscous_damping": 0.0465, "bouc_wen_stiffness": 95.0, "bouc_wen_exponent": 1.0,
}  # fmt: skip

_DUFFING = Oscillator(1.0, ["cubic_stiffness"])
_DUFFING_PRIOR = {
    "linear_stiffness": (6550.0, 664.56), "cubic_stiffness": (6.2e6, 0.46e6), "viscous_damping": (1.55, 0.85),
}  # fmt: skip
_PAIRS = PAPER_BEAM.population[:, [0, 2]]

CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case(
            name="1",
            title="Duffing oscillator",
            data=_DUFFING,
            model=_DUFFING,
            true={
                "linear_stiffness": (6500.0, 288.68), "cubic_stiffness": (6.25e6, 0.14e6),
                "viscous_damping": (1.1, 0.52),
            },
            prior=_DUFFING_PRIOR,
            published={
                "linear_stiffness": (6507.74, 245.15), "cubic_stiffness": (6.25e6, 0.14e6),
                "viscous_damping": (1.10, 0.5),
            },
            published_acceptance=0.33,
            levels=np.geomspace(0.01, 0.1, 6),
        ),
        Case(
            name="2",
            title="dry friction",
            data=Oscillator(1.0, ["coulomb_friction"]),
            model=Oscillator(1.0, ["coulomb_friction"]),
            true={
                "linear_stiffness": (6500.0, 288.68), "viscous_damping": (0.5, 0.23), "friction_force": (1.1, 0.52),
            },
            prior={
                "linear_stiffness": (6550.0, 664.56), "viscous_damping": (2.55, 1.41), "friction_force": (5.05, 2.85),
            },
            published={
                "linear_stiffness": (6507.75, 280.13), "viscous_damping": (0.49, 0.23), "friction_force": (1.09, 0.51),
            },
            published_acceptance=0.34,
            levels=np.geomspace(0.01, 0.1, 6),
        ),
        Case(
            name="3",
            title="quadratic damping and cubic stiffness",
            data=Oscillator(1.0, ["quadratic_damping", "cubic_stiffness"]),
            model=Oscillator(1.0, ["quadratic_damping", "cubic_stiffness"]),
            true={
                "linear_stiffness": (6500.0, 288.68), "cubic_stiffness": (6.25e6, 0.14e6),
                "viscous_damping": (1.1, 0.52), "quadratic_damping": (6.0, 2.31),
            },
            prior={
                "linear_stiffness": (6550.0, 664.56), "cubic_stiffness": (6.275e6, 0.50e6),
                "viscous_damping": (5.05, 2.85), "quadratic_damping": (10.5, 5.48),
            },
            published={
                "linear_stiffness": (6511.17, 281.26), "cubic_stiffness": (6.25e6, 0.144e6),
                "viscous_damping": (1.08, 0.52), "quadratic_damping": (5.98, 2.27),
            },
            published_acceptance=0.23,
            levels=np.geomspace(0.01, 0.1, 6),
        ),
        Case(
            name="4",
            title="Bouc-Wen hysteresis",
            data=_BOUC_WEN,
            model=_BOUC_WEN,
            true=_BOUC_WEN_TRUE,
            fixed=_BOUC_WEN_FIXED,
            prior={
                "bouc_wen_amplitude": (2.05, 1.13), "bouc_wen_alpha": (0.45, 0.20), "bouc_wen_beta": (1.25, 0.43),
                "bouc_wen_gamma": (1.75, 0.72),
            },
            published={
                "bouc_wen_amplitude": (1.25, 0.38), "bouc_wen_alpha": (0.65, 0.08), "bouc_wen_beta": (1.52, 0.28),
                "bouc_wen_gamma": (1.52, 0.27),
            },
            published_acceptance=0.50,
            levels=np.geomspace(0.05, 0.8, 6),
        ),
        Case(
            name="5",
            title="Bouc-Wen data, empirical polynomial model",
            data=_BOUC_WEN,
            model=Oscillator(1.3, ["quadratic_stiffness", "quadratic_damping", "cubic_stiffness", "cubic_damping"]),
            true=_BOUC_WEN_TRUE,
            fixed=_BOUC_WEN_FIXED,
            prior={
                "linear_stiffness": (150.0, 11.55), "viscous_damping": (0.048, 0.0046),
                "quadratic_stiffness": (285.0, 37.53), "quadratic_damping": (1.3, 0.17),
                "cubic_stiffness": (32.5e3, 4.33e3), "cubic_damping": (0.06, 0.0058),
            },
            published={
                "linear_stiffness": (137.28, 8.26), "viscous_damping": (0.05, 0.01),
                "quadratic_stiffness": (279.33, 31.57), "quadratic_damping": (1.34, 0.15),
                "cubic_stiffness": (34.66e3, 3.65e3), "cubic_damping": (0.06, 0.01),
            },
            published_acceptance=0.02,
            levels=np.geomspace(0.005, 0.04, 6),
            published_fits={
                "low": ((-0.372, 0.076, 1.521), (-0.919, 0.042, 1.610)),
                "mid": ((0.292, 0.085, 1.635), (0.038, 0.042, 1.723)),
                "high": ((-0.285, 0.114, 1.744), (0.072, 0.044, 1.837)),
            },
        ),
        Case(
            name="single",
            title="one target: Duffing oscillator measured repeatedly",
            data=_DUFFING,
            model=_DUFFING,
            true={"linear_stiffness": (6000.0, 0.0), "cubic_stiffness": (6.0e6, 0.0), "viscous_damping": (0.8, 0.0)},
            prior=_DUFFING_PRIOR,
            published={},
            published_acceptance=float("nan"),
            levels=np.geomspace(0.01, 0.1, 6),
            scatter={"frequency": 0.001, "damping": 0.03},
            count=24,
        ),
        Case(
            name="beam",
            title="cantilever between electromagnets, nine settings",
            data=PAPER_BEAM.oscillator,
            model=PAPER_BEAM.oscillator,
            true={
                "linear_stiffness": (float(_PAIRS[:, 0].mean()), float(_PAIRS[:, 0].std())),
                "cubic_stiffness": (float(_PAIRS[:, 1].mean()), float(_PAIRS[:, 1].std())),
            },
            fixed={"viscous_damping": PAPER_BEAM.damping},
            prior={
                "linear_stiffness": (80.0, 20.0 / np.sqrt(3.0)), "cubic_stiffness": (-27.5e9, 27.45e9 / np.sqrt(3.0)),
            },
            published={"linear_stiffness": (80.5, 10.1), "cubic_stiffness": (-25e9, 143.7e9)},
            published_acceptance=PAPER_BEAM.acceptance_rate,
            levels=np.linspace(1e-6, 9e-6, 5),
            observables=("frequency",),
            population=PAPER_BEAM.population,
            comparison="uniform",
            published_fits={
                place: (PAPER_BEAM.measured_bounds[place], PAPER_BEAM.sampled_bounds[place])
                for place in ("low", "mid", "high")
            },
        ),
    )
}  # fmt: skip
"""The cases by name: 1 to 5, single, beam."""


def get_case(name: str) -> Case:
    """Return a case by its name.

    Parameters
    ----------
    name : str
        As on the command line.

    Returns
    -------
    Case

    Raises
    ------
    InputError
        For a name that is none of `CASES`.

    See Also
    --------
    paper.CASES : all of them.
    paper.run_case : runs one.
    """
    return CASES[check_choice("case", str(name), CASES)]


__all__ = ["CASES", "Case", "get_case", "uniform_bounds"]
