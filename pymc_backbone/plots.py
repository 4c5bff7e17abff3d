"""The figures that a user may ask for: ``pb.plots``. Importing it loads matplotlib, so the package does it late."""

from __future__ import annotations

from .reporting.backbone_plots import plot_backbones, plot_densities, plot_predictive, plot_records
from .reporting.fit_plots import plot_fit
from .reporting.population_plots import plot_population
from .reporting.posterior_plots import plot_pair, plot_prior_posterior, plot_rank, plot_trace
from .reporting.study_plots import study_figures

__all__ = [
    "plot_backbones",
    "plot_densities",
    "plot_fit",
    "plot_pair",
    "plot_population",
    "plot_predictive",
    "plot_prior_posterior",
    "plot_rank",
    "plot_records",
    "plot_trace",
    "study_figures",
]
