"""The figures that a user may ask for: ``pb.plots``. Importing it loads matplotlib, so the package does it late."""

from __future__ import annotations

from .reporting.backbone_plots import plot_backbones, plot_densities, plot_predictive, plot_records
from .reporting.fit_plots import plot_fit
from .reporting.population_plots import plot_population
from .reporting.portrait_plots import plot_distortion, plot_force_sections, plot_time_frequency
from .reporting.posterior_plots import plot_pair, plot_prior_posterior, plot_rank, plot_trace
from .reporting.study_plots import study_figures

__all__ = [
    "plot_backbones",
    "plot_densities",
    "plot_distortion",
    "plot_fit",
    "plot_force_sections",
    "plot_pair",
    "plot_population",
    "plot_predictive",
    "plot_prior_posterior",
    "plot_rank",
    "plot_records",
    "plot_time_frequency",
    "plot_trace",
    "study_figures",
]
