"""What is inferred, from which likelihood, and how it is sampled and kept, each as one value."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

LIKELIHOODS = ("auto", "population", "specimen", "pooled")
HIERARCHICAL = "hierarchical"
POPULATIONS = ("correlated", "normal", "uniform")
STEPS = ("metropolis", "elementwise", "demetropolisz", "slice", "nuts", "nutpie")
GRADIENT_STEPS = ("nuts", "nutpie")


@dataclass(frozen=True)
class Modelling:
    """What model is updated.

    Attributes
    ----------
    mass : float
        Mass [kg], or inertia [kg m^2] for a rotation.
    effects : sequence of str
        Effects beside linear stiffness and viscous damping.
    priors : mapping of str to (float, float)
        Bounds of Uniform priors that replace the default ones.
    fixed : mapping of str to float
        Parameters that are not inferred.
    mass_error : float
        Standard deviation of the mass; 0: it is known.
    """

    mass: float
    effects: Sequence[str] = ()
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    mass_error: float = 0.0


@dataclass(frozen=True)
class Comparing:
    """What likelihood compares simulated backbones with the measured ones; as in `build_model`.

    Attributes
    ----------
    likelihood : {"auto", "population", "specimen", "pooled", "hierarchical"}
        "auto" takes "population" from 8 specimens that reach every level, else "specimen", and "pooled" for one;
        "hierarchical" is the model of `build_hierarchical_model`.
    density : {"product", "joint", "data_consistent"}
        Of the population.
    marginal : str
        Family of the density at each level.
    population : {"correlated", "normal", "uniform"}
        Family of the hierarchical model's population: Normal with correlated or independent parameters, or Uniform.
    """

    likelihood: str = "auto"
    density: str = "product"
    marginal: str = "best"
    population: str = "correlated"


@dataclass(frozen=True)
class Sampling:
    """How the posterior is sampled; as in `sample`.

    Attributes
    ----------
    draws, tune, chains : int
        Draws of a chain that are kept and that are dropped, and the number of chains.
    step : str
        Step method.
    random_seed : int or None
        None: one is drawn, and written to the result.
    """

    draws: int = 2000
    tune: int = 1000
    chains: int = 4
    step: str = "metropolis"
    random_seed: int | None = None


@dataclass(frozen=True)
class Keeping:
    """Whether a run is kept on disk as it is drawn; as in `sample`.

    Attributes
    ----------
    store : path-like or None
        Folder of the draws.
    resume : bool
        Whether to continue the run that is there.
    """

    store: str | os.PathLike[str] | None = None
    resume: bool = False
