"""Medians over the seeds, and the tables in Markdown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agreement import Figures, Reference  # isort: skip
from algorithms import BASE, Run  # isort: skip

HEADER = (
    "sampler", "effective samples/s, worst", "ratio", "effective samples/s, mean", "ratio", "simulations",
    "gradients", "in simulations", "R-hat", "acceptance", "gap [sd]", "gap [errors]", "s", "wall [s]", "verdict",
)  # fmt: skip
LEGEND = """\
*Effective samples/s*: bulk effective sample size of the worst parameter, and its mean over the parameters, for each
second that the processor worked on sampling, tuning included, starts and compilation not; *ratio*: to `pm.Metropolis`
on scalars in the same seed. *Simulations*, *gradients*: log-densities simulated alone and with gradient, tuning
included, for each effective sample of the worst parameter; *in simulations*: both together, a gradient at its own cost.
*Gap*: largest difference of a mean or sd from the reference, in posterior sds and in combined standard errors. *s*:
processor, sampling; *wall*: clock, with starts and compilation. Medians over the seeds. A verdict of *not converged*
(R-hat above 1.05, or fewer than 100 effective samples, in at least half of the seeds) hides what an effective sample
size would only pretend; *disagrees*: a gap of more than 4 standard errors in at least half of them."""


@dataclass(frozen=True)
class Result:
    """One sampler on one problem with one seed; ``failure`` instead of a run where it raised."""

    sampler: str
    seed: int
    run: Run | None = None
    figures: Figures | None = None
    failure: str = ""


def values(result: Result, gradient_cost: float) -> dict[str, float]:
    """Return the numbers of one result, by column."""
    run, figures = result.run, result.figures
    assert run is not None and figures is not None
    worst = max(figures.effective_worst, 1e-300)
    return {
        "worst": worst / run.seconds,
        "mean": figures.effective_mean / run.seconds,
        "simulations": run.simulations / worst,
        "gradients": run.gradients / worst,
        "equivalent": (run.simulations + gradient_cost * run.gradients) / worst,
        "rhat": figures.rhat,
        "acceptance": run.acceptance,
        "gap_in_sd": figures.gap_in_sd,
        "gap_in_errors": figures.gap_in_errors,
        "seconds": run.seconds,
        "wall": run.wall,
    }


def verdict(results: list[Result]) -> str:
    """Return what half of the seeds or more say: "converged", "not converged", "disagrees", "failed"."""
    half = 0.5 * len(results)
    if sum(result.run is None for result in results) >= half:
        return "failed: " + next(result.failure for result in results if result.run is None)
    done = [result.figures for result in results if result.figures is not None]
    words = []
    if sum(figures.is_flagged for figures in done) >= half:
        words.append("disagrees")
    if sum(not figures.is_converged for figures in done) >= half:
        words.append("not converged")
    return ", ".join(words) or "converged"


def summarise(results: list[Result], gradient_cost: float) -> dict[str, dict]:
    """Return, by sampler, the medians over seeds, the ratios to the base in the same seed, and the verdict."""
    samplers = list(dict.fromkeys(result.sampler for result in results))
    base = {
        result.seed: values(result, gradient_cost)
        for result in results
        if result.sampler == BASE and result.run is not None
    }
    summary = {}
    for sampler in samplers:
        mine = [result for result in results if result.sampler == sampler]
        numbers = [(result.seed, values(result, gradient_cost)) for result in mine if result.run is not None]
        row: dict = {"verdict": verdict(mine)}
        for name in numbers[0][1] if numbers else ():
            row[name] = float(np.median([number[name] for _, number in numbers]))
        for name in ("worst", "mean") if numbers else ():
            ratios = [number[name] / base[seed][name] for seed, number in numbers if seed in base]
            row[f"{name}_ratio"] = float(np.median(ratios)) if ratios else np.nan
        summary[sampler] = row
    return summary


def write_table(summary: dict[str, dict]) -> str:
    """Return the table of one problem; effective samples only of samplers that converged to the reference."""
    is_base_good = summary.get(BASE, {}).get("verdict") == "converged"
    lines = ["| " + " | ".join(HEADER) + " |", "|" + "---|" * len(HEADER)]
    for sampler, row in summary.items():
        if "rhat" not in row:
            lines.append(f"| {sampler} |" + " |" * (len(HEADER) - 2) + f" {row['verdict']} |")
            continue
        good = row["verdict"] == "converged"

        def shown(name: str, pattern: str, visible: bool = True, row: dict = row) -> str:
            return format(row[name], pattern) if visible and np.isfinite(row[name]) else "-"

        cells = [
            sampler,
            shown("worst", ".0f", good),
            shown("worst_ratio", ".2f", good and is_base_good),
            shown("mean", ".0f", good),
            shown("mean_ratio", ".2f", good and is_base_good),
            shown("simulations", ".0f", good),
            shown("gradients", ".0f", good),
            shown("equivalent", ".0f", good),
            shown("rhat", ".3f"),
            shown("acceptance", ".2f"),
            shown("gap_in_sd", ".2f"),
            shown("gap_in_errors", ".1f"),
            shown("seconds", ".1f"),
            shown("wall", ".1f"),
            row["verdict"],
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_evidence(results: list[Result], reference: Reference, grid: Reference | None) -> str:
    """Return one line per seed: the log evidence of each population of SMC beside that of the reference."""
    lines = []
    for result in results:
        if result.run is None or result.run.log_evidence is None:
            continue
        chains = result.run.log_evidence
        together = float(np.logaddexp.reduce(chains) - np.log(chains.size))
        listed = ", ".join(f"{value:.2f}" for value in chains)
        lines.append(
            f"- SMC, seed {result.seed}: {listed}; together {together:.3f}, sd over populations "
            f"{chains.std(ddof=1):.3f}, standard error {chains.std(ddof=1) / np.sqrt(chains.size):.3f}"
        )
    lines.append(f"- importance sampling: {reference.log_evidence:.3f} +- {reference.log_evidence_error:.3f}")
    if grid is not None:
        lines.append(f"- integration on a grid, without PyMC: {grid.log_evidence:.3f}")
    return "\n".join(lines)
