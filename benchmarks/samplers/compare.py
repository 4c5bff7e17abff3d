"""Compare samplers on the source paper's systems: what an effective sample costs, and whether it can be believed.

    python benchmarks/samplers/compare.py [--problems 1 beam] [--budget 24000] [--seeds 2] [--quick] [--output FILE]

Every sampler gets about the same number of simulations (those with a gradient what their tuning needs), chains one
after another in one process, the same search for starts. Only ratios within one run are comparable. Writes
``results.md`` beside this file, again after every problem; what follows from it is in ``README.md``.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from pathlib import Path

import arviz as az
import numpy as np
import pymc as pm

sys.path.insert(0, str(Path(__file__).resolve().parent))

from agreement import Reference, find_reference, integrate_grid, judge
from algorithms import BASE, CONTROL, DEFAULT, SAMPLERS, quiet, run_control
from problems import PROBLEMS, LogDensity, Problem, make_problem
from table import LEGEND, Result, summarise, verdict, write_evidence, write_table

QUICK = {"problems": ["beam"], "budget": 800, "seeds": 1, "reference": 2000, "grid": 60}


def find_gradient_cost(problem: Problem, points: np.ndarray, repeats: int = 3) -> float:
    """Return the time of log-density and gradient over that of the log-density alone; smallest of the repeats."""
    target = LogDensity(problem)
    both = target.model.compile_fn(
        [target.model.logp(), target.model.dlogp()], inputs=target.model.value_vars, point_fn=False
    )
    spots = target.unconstrained(points)
    seconds = []
    for function in (target.function, both):
        function(*spots[0])
        taken = []
        for _ in range(repeats):
            begin = time.perf_counter()
            for spot in spots:
                function(*spot)
            taken.append(time.perf_counter() - begin)
        seconds.append(min(taken))
    return seconds[1] / seconds[0]


def compare_on(
    problem: Problem, samplers: list[str], budget: int, seeds: list[int], reference_draws: int
) -> tuple[list[Result], Reference, float]:
    """Run all samplers and the negative control with all seeds; return their results, the reference, gradient cost."""
    pilot = SAMPLERS[DEFAULT](problem, min(8000, 2 * budget), 10_000).draws.reshape(-1, len(problem.parameters))
    reference = find_reference(problem, pilot, reference_draws, 10_001)
    distinct = np.unique(pilot, axis=0)
    cost = find_gradient_cost(problem, distinct[:: max(len(distinct) // 100, 1)])
    results = []
    for seed in seeds:
        for sampler in [*samplers, CONTROL]:
            try:
                run = SAMPLERS.get(sampler, run_control)(problem, budget, seed)
            except Exception as error:  # one sampler that gives up is a finding, and the others go on
                results.append(Result(sampler, seed, failure=f"{type(error).__name__}: {str(error)[:100]}"))
                continue
            results.append(Result(sampler, seed, run, judge(run, reference)))
            done = results[-1]
            print(
                f"{problem.name} {sampler} seed {seed}: {run.wall:.1f} s, {done.figures}", file=sys.stderr, flush=True
            )
    return results, reference, cost


def describe(problem: Problem, results: list[Result], reference: Reference, grid: Reference | None, cost: float) -> str:
    """Return the section of one problem."""
    control = [result for result in results if result.sampler == CONTROL]
    gaps = ", ".join(f"{result.figures.gap_in_errors:.1f}" for result in control if result.figures is not None)
    flagged = sum(result.figures is not None and result.figures.is_flagged for result in control)
    posterior = "; ".join(
        f"{name} {mean:.4g} +- {sd:.4g}"
        for name, mean, sd in zip(problem.parameters, reference.mean, reference.sd, strict=True)
    )
    lines = [
        f"## {problem.name}: {problem.title}",
        "",
        f"{len(problem.parameters)} parameters, {len(problem.density.observables)} observable(s) at "
        f"{problem.density.levels.size} levels, marginals "
        f"{', '.join(sorted({row['family'] for row in problem.density.summary()}))}. A gradient costs {cost:.1f} "
        f"simulations. Reference: {posterior} ({reference.effective:.0f} effective independent draws).",
        "",
        write_table(summarise([result for result in results if result.sampler != CONTROL], cost)),
        "",
        f"Negative control, PINTS on the density without the Jacobian: flagged in {flagged} of {len(control)} "
        f"(gaps of {gaps or 'no run'} standard errors; verdict: {verdict(control)}).",
        "",
        "Log evidence:",
        "",
        write_evidence(results, reference, grid),
    ]
    if grid is not None:
        gap = np.abs(np.array([grid.mean - reference.mean, grid.sd - reference.sd])) / reference.sd
        errors = np.array([reference.mean_error, reference.sd_error]) / reference.sd
        lines += [
            "",
            f"Reference against the grid: largest gap {gap.max():.4f} sd, standard error {errors.max():.4f} sd.",
        ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> str:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--samplers", nargs="+", choices=SAMPLERS, default=list(SAMPLERS))
    parser.add_argument("--budget", type=int, default=24_000, help="simulations for each sampler, about")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--reference", type=int, default=40_000, help="independent draws of the reference")
    parser.add_argument("--grid", type=int, default=400, help="points on each axis, where there are two parameters")
    parser.add_argument("--quick", action="store_true", help="one problem, tiny: whether it runs, not what it costs")
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parent / "results.md")
    options = parser.parse_args(arguments)
    if options.quick:
        for name, value in QUICK.items():
            setattr(options, name, value)
    quiet()
    samplers = list(dict.fromkeys([BASE, *options.samplers]))
    begin = time.perf_counter()
    sections: dict[str, str] = {}
    text = ""
    for name in options.problems:
        problem = make_problem(name)
        results, reference, cost = compare_on(
            problem, samplers, options.budget, list(range(1, options.seeds + 1)), options.reference
        )
        grid = integrate_grid(problem, options.grid) if len(problem.parameters) == 2 else None
        sections[name] = describe(problem, results, reference, grid, cost)
        minutes = (time.perf_counter() - begin) / 60.0
        head = (
            f"# Samplers compared\n\nPrinted by `python benchmarks/samplers/compare.py --budget {options.budget} "
            f"--seeds {options.seeds} --reference {options.reference}` in {minutes:.0f} min on a shared machine, with "
            f"PyMC {pm.__version__}, ArviZ {az.__version__}, Python {platform.python_version()}: ratios within this "
            "run are the result, seconds are not."
        )
        text = "\n\n".join([head, LEGEND, *(sections[name] for name in PROBLEMS if name in sections)]) + "\n"
        options.output.write_text(text, encoding="utf-8")
    return text


if __name__ == "__main__":
    main()
