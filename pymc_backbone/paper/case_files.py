"""What a run of the source paper's systems leaves behind: a table in words, figures, ``cases.json``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .._common.checks import OBSERVABLE_UNITS
from ..reporting.output_folder import write_files
from ..reporting.portable import plain
from .case_comparison import Comparison, describe_gap
from .case_study import CaseResult
from .cases import Case


def describe_case(result: CaseResult) -> str:
    """Return a case as Markdown: true, prior, published and ours for every parameter, then what is to be said of it."""
    case, records = result.case, result.records
    first = records[0]
    lines = [
        f"{_heading(case, result.likelihood)} of {' and '.join(first['observables'])}",
        "",
        "| parameter | unit | true | drawn | prior | published | ours | 95 % HDI | R-hat | ESS |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in records:
        cells = (
            row["parameter"], row["unit"], _pair(row["true_mean"], row["true_sd"]),
            _pair(row["drawn_mean"], row["drawn_sd"]), f"{row['prior_low']:.5g} to {row['prior_high']:.5g}",
            _pair(row["published_mean"], row["published_sd"]), _pair(row["mean"], row["sd"]),
            f"{row['hdi_low']:.5g} to {row['hdi_high']:.5g}", f"{row['r_hat']:.4f}", f"{row['ess_bulk']:.0f}",
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    acceptance = "" if first["acceptance_rate"] is None else f"acceptance rate {first['acceptance_rate']:.2f}"
    if acceptance and np.isfinite(case.published_acceptance):
        acceptance += f" (published {case.published_acceptance:.2f})"
    facts = [
        f"{result.vectors.shape[0]} {'repetitions' if case.scatter else 'specimens'}", acceptance,
        f"{first['seconds']:.1f} s", f"seed {first['seed']}",
    ]  # fmt: skip
    lines += ["", "; ".join(fact for fact in facts if fact) + "."]
    lines += [f"- {sentence}" for sentence in _sentences(result)]
    if result.comparisons and not case.scatter and (case.model != case.data or case.comparison == "uniform"):
        lines += ["", *_comparison_table(result.comparisons)]
        lines += _published_fits(case)
    return "\n".join(lines) + "\n"


def describe_refusal(case: Case, likelihood: str, reason: str) -> str:
    """Return a case that came to no posterior as Markdown."""
    return f"{_heading(case, likelihood)}\n\nNo posterior: {reason}\n"


def _heading(case: Case, likelihood: str) -> str:
    name = f"Case {case.name}" if case.name.isdigit() else case.name.capitalize()
    return f"## {name} ({case.title}), {likelihood} likelihood"


def _sentences(result: CaseResult) -> list[str]:
    """Say how the spread was recovered, what the data do not identify, and what the model cannot do."""
    sentences = []
    ratios = [(row["parameter"], row["sd"] / row["drawn_sd"]) for row in result.records if row["true_sd"]]
    if ratios:
        spread = ", ".join(f"{parameter} {ratio:.2f}" for parameter, ratio in ratios)
        sentences.append(f"Recovered over true standard deviation: {spread}.")
    if result.undetermined:
        sentences.append(
            f"The data do not identify {', '.join(result.undetermined)}: the posterior is the prior; its numbers are "
            "no knowledge."
        )
    diagnostics = result.density.diagnostics
    if diagnostics:
        weak = [name for name in diagnostics["undetermined"] if name not in result.undetermined]
        if weak:
            sentences.append(
                f"The backbones determine {', '.join(weak)} in part or in combination only; there, the posterior keeps "
                "the prior's shape."
            )
        sentences.append(f"Mean ratio of observed to predicted density {diagnostics['mean_ratio']:.2f} (ideally 1).")
    worst = max(row["r_hat"] for row in result.records)
    if not worst <= 1.01:
        sentences.append(f"R-hat is {worst:.3f}: draw more, or choose another step.")
    observables = [] if result.case.scatter else [str(name) for name in result.backbones["observable"].values]
    for observable in observables:
        sentence = describe_gap(result.comparisons, observable)
        if sentence:
            sentences.append(sentence)
    return sentences


def _comparison_table(comparisons: Sequence[Comparison]) -> list[str]:
    """Return the rows of measured and simulated distributions."""
    is_gev = comparisons[0].family == "gev"
    words = "GEV (k, sigma, mu)" if is_gev else "Uniform (low, high)"
    lines = [
        f"| observable | amplitude | measured {words} | simulated {words} | overlap | Wasserstein distance |",
        "|---|---|---|---|---|---|",
    ]
    for item in comparisons:
        unit = "" if OBSERVABLE_UNITS[item.observable] == "1" else f" {OBSERVABLE_UNITS[item.observable]}"
        fits = [", ".join(f"{number:.4g}" for number in fit) for fit in (item.measured_fit, item.simulated_fit)]
        lines.append(
            f"| {item.observable} | {item.place}, {item.level:.3g} | {fits[0]} | {fits[1]} | {item.overlap:.2f} | "
            f"{item.wasserstein:.3g}{unit} |"
        )
    return lines


def _published_fits(case: Case) -> list[str]:
    """Return what the paper fitted to both sides, at its amplitudes."""
    if not case.published_fits:
        return []
    lines = ["", "| published, frequency | measured | simulated |", "|---|---|---|"]
    for place, sides in case.published_fits.items():
        lines.append(f"| {place} | {' | '.join(', '.join(f'{number:g}' for number in side) for side in sides)} |")
    return lines


def _pair(mean: float | None, sd: float | None) -> str:
    return "-" if mean is None or sd is None else f"{mean:.5g} ± {sd:.3g}"


def write_figures(folder: Path, result: CaseResult) -> list[str]:
    """Write the figures of one run; return the names of the files."""
    from .. import plots
    from . import case_plots

    case = result.case
    units = {item.name: item.unit for item in case.model.parameters}
    names = list(case.prior)
    true = {name: result.vectors[:, case.data.parameter_names.index(name)] for name in names if name in case.true}
    figures = {
        "backbones": plots.plot_backbones(result.backbones),
        "likelihood": case_plots.plot_likelihood(result.backbones, result.density),
        "densities": plots.plot_densities(result.backbones, result.density.population, simulated=result.predicted),
        "pairs": plots.plot_pair(result.posterior, names, units=units),
        "trace": plots.plot_trace(result.posterior, names, units=units),
        "prior_posterior": plots.plot_prior_posterior(
            result.posterior, case.prior_bounds, units=units, true_values=true
        ),
        "predictive": plots.plot_predictive(result.backbones, result.predicted),
    }
    if result.comparisons:
        figures["comparison"] = case_plots.plot_comparison(result.comparisons)
    stem = f"case_{case.name}_{result.likelihood}"
    return write_files(
        folder,
        {
            f"figures/{stem}_{name}.png": partial(figure.savefig, dpi=120, format="png")
            for name, figure in figures.items()
        },
    )


def write_cases(folder: Path, records: Sequence[dict[str, Any]], texts: Sequence[str]) -> list[str]:
    """Write ``cases.json`` and the tables as ``cases.md``."""
    content = json.dumps(plain(list(records)), indent=1, allow_nan=False) + "\n"
    head = "# The source paper's systems\n\nMean ± standard deviation; *drawn*: of the specimens themselves.\n\n"
    return write_files(
        folder,
        {
            "cases.md": lambda path: path.write_text(head + "\n".join(texts), encoding="utf-8"),
            "cases.json": lambda path: path.write_text(content, encoding="utf-8"),
        },
    )


__all__ = ["describe_case", "describe_refusal", "write_cases", "write_figures"]
