"""What importance sampling changes of the evidence and of what is named; prints one line for each batch, and a table.

    python benchmarks/hidden_effects/importance.py --batches 45 --seed 881101 [--tiers close_pairs] [--workers 2]

Each batch is searched once and decided twice: with evidence as it is, and with that of Laplace's method alone (no
effort allowed for anything else). Only batches whose verdict lies between sets are asked; the others are counted.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from batches import make_batch
from plans import collected, records_of
from threadpoolctl import threadpool_limits

from pymc_backbone import InputError, Oscillator
from pymc_backbone.discrepancy.checks import rivals
from pymc_backbone.discrepancy.deciding.decide import decide
from pymc_backbone.discrepancy.deciding.decision import Decision
from pymc_backbone.discrepancy.sets.question import ask
from pymc_backbone.discrepancy.workflow import _searched
from pymc_backbone.measurement.options import Measuring

_LEAST = 1e-6  # probability that the true set is given at least, for the logarithm of its score


def judge(task: tuple[int, int, str]) -> dict[str, Any] | None:
    """Return one batch decided with and without correction; None where no evidence was corrected."""
    seed, index, tier = task
    batch = make_batch(seed, index, tier)
    hidden = tuple(sorted(batch.truth["hidden"]))
    measuring = Measuring(None, None, None, None, strict=False, floor=None)
    base = Oscillator(batch.truth["mass"], batch.truth["base"])
    with threadpool_limits(1):
        try:
            question = ask(base, records_of(batch), candidates=None, max_effects=3, tolerance=0.0, measuring=measuring)
        except InputError:
            return None
        search = _searched(question, True, lambda _stage, _share: None)
        drifting = rivals.drifting_sets(search)
        before = dict(search.fits)
        decide(search, drifting, question.tolerance)  # fits what is lacking, and puts sets that drift in others' place
        fits = {**search.fits, **before}
        decided, seconds = [], []
        for budget in (search.budget, 0.0):
            search.fits, search.budget = (
                dict(fits),
                budget,
            )
            begin = time.perf_counter()
            decided.append(decide(search, drifting, question.tolerance))
            seconds.append(time.perf_counter() - begin)
        corrected, plain = decided
    if not corrected.corrected.sets:
        return None
    sets = [
        {"effects": names, "shift": item.log_value, "error": item.error, "k": item.pareto_k, "draws": item.draws}
        for names, item in corrected.corrected.sets.items()
    ]
    return {
        "index": index, "tier": tier, "hidden": hidden, "sets": sets, "reason": corrected.corrected.reason,
        "cycles": corrected.corrected.cycles, "seconds": seconds[0] - seconds[1],
        "with": _told(corrected, hidden), "without": _told(plain, hidden),
    }  # fmt: skip


def _told(decision: Decision, hidden: tuple[str, ...]) -> dict[str, Any]:
    """Return what a decision says, and what it gives the true set."""
    outcome = str(decision.verdict)
    if outcome == "found":
        outcome = "right" if decision.best == hidden else "wrong"
    squares = sum((chance - (names == hidden)) ** 2 for names, chance in decision.probabilities.items()) + (
        hidden not in decision.probabilities
    )
    truth = decision.probabilities.get(hidden, 0.0)
    return {"outcome": outcome, "best": decision.best, "probability": decision.probability, "truth": truth,
            "brier": float(squares)}  # fmt: skip


def table(rows: list[dict[str, Any]], looked_at: int) -> str:
    """Return what the rows say together, as Markdown."""
    lines = [
        f"{len(rows)} batches of {looked_at} were asked; {sum(len(row['sets']) for row in rows)} sets.", "",
        "| | Laplace | corrected |", "|---|---|---|",
    ]  # fmt: skip
    both = [[row["without"] for row in rows], [row["with"] for row in rows]]
    for outcome in ("right", "wrong", "ambiguous", "unexplained", "adequate"):
        counts = [sum(item["outcome"] == outcome for item in each) for each in both]
        lines.append(f"| {outcome} | {counts[0]} | {counts[1]} |")
    scores = [np.array([np.log(max(item["truth"], _LEAST)) for item in each]) for each in both]
    briers = [np.array([item["brier"] for item in each]) for each in both]
    for name, pair in (("logarithm of the true set's probability, mean", scores), ("Brier score, mean", briers)):
        lines.append(f"| {name} | {pair[0].mean():.4f} | {pair[1].mean():.4f} |")
    for name, pair in (("logarithm", scores), ("Brier score", briers)):
        change = pair[1] - pair[0]
        error = float(change.std(ddof=1) / np.sqrt(change.size)) if change.size > 1 else float("nan")
        lines.append(f"\nChange of the {name}: {change.mean():+.4f} with a standard error of {error:.4f}.")
    shifts = np.array([abs(item["shift"] - row["sets"][0]["shift"]) for row in rows for item in row["sets"][1:]])
    k = np.array([item["k"] for row in rows for item in row["sets"] if not np.isnan(item["k"])])
    lines.append(f"\nShifts against the leading set: {_spread(shifts)}. Pareto k: {_spread(k)}; "
                 f"{int((k > 0.7).sum())} of {k.size} above 0.7, {int((k > 0.5).sum())} above 0.5.")  # fmt: skip
    leading = np.array([row["sets"][0]["k"] for row in rows])
    lines.append(f"Of the leading sets {int((leading > 0.7).sum())} of {leading.size} have k above 0.7.")
    moved = np.array([abs(row["with"]["probability"] - row["without"]["probability"]) for row in rows])
    lines.append(f"Probability of the most probable set moves by {_spread(moved)}.")
    lines.append(f"It takes {_spread(np.array([row['seconds'] for row in rows]))} s.")
    return "\n".join(lines)


def _spread(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "none"
    return f"median {np.median(finite):.2g}, nine tenths within {np.quantile(finite, 0.9):.2g}, most {finite.max():.2g}"


def main() -> None:
    """Look at batches until so many were asked."""
    rows, looked_at = collected(judge, __doc__, 30)
    print(f"\n{table(rows, looked_at)}")


if __name__ == "__main__":
    main()
