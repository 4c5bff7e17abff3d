"""Simulation-based calibration of the probabilities of sets; prints Markdown.

    python benchmarks/hidden_effects/sbc.py DIR [DIR ...] [--json FILE]

Reads ``truth.json`` and ``result.json`` of every batch in the folders, which may be parts of one run; batches without a
result are left aside. The batches are those of `prior_batches.py`: hidden sets from the package's own prior. If its
probabilities are right, the hidden set is a draw from them, batch by batch. Then

- of all sets that were given a probability p, over all batches, the share p is the truth;
- with the sets ordered by falling probability, what stands before the truth plus a uniform share of the truth's own
  probability is uniform between 0 and 1 (randomised probability integral transform, PIT [1]_).

What the listed sets leave of the probability is that of none of them, and stands last. The wrong priors of the negative
control change the probabilities by a factor for each effect in a set; the test must reject them.

References
----------
.. [1] Czado C., Gneiting T., Held L. (2009) Predictive model assessment for count data. Biometrics 65(4), 1254-1261.
   doi:10.1111/j.1541-0420.2009.01191.x
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from meanings import Meaning, meaning_of
from outcomes import ALWAYS_THERE, wilson_interval
from scipy.stats import chisquare, kstest

EDGES = (0.0, 0.01, 0.05, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Of the bins of probability in the table of reliability."""
WRONG_PRIORS = {"each effect 30 times more probable": 30.0, "each effect 30 times less probable": 1.0 / 30.0}
LEVEL = 0.01
"""p-value below which uniformity is rejected."""
_BINS = 10
_REPEATS = 25


class Sets(NamedTuple):
    """Probabilities of the sets of one batch, falling, and which of them is the truth.

    Attributes
    ----------
    name : str
        Of the batch.
    probability : ndarray, shape (n + 1,)
        The last is that of none of the sets.
    size : ndarray of int, shape (n,)
        Number of effects of each set.
    truth : int or None
        Place of the truth, ``n`` where it is none of what the package holds; None where it is a set that was given
        no probability.
    """

    name: str
    probability: np.ndarray
    size: np.ndarray
    truth: int | None


def sets_of(name: str, candidates: Sequence[tuple[frozenset[str], float]], meaning: Meaning) -> Sets:
    """Return the probabilities of a batch; sets whose name is right as well count together with the truth."""
    shares: dict[frozenset[str], float] = {}
    own = min(meaning.accepted, key=sorted) if meaning.accepted else None
    for names, value in candidates:
        key = own if own is not None and names in meaning.accepted else names
        shares[key] = shares.get(key, 0.0) + value
    ranked = sorted((item for item in shares.items() if item[1] > 0.0), key=lambda item: -item[1])
    listed = [names for names, _ in ranked]
    values = np.array([value for _, value in ranked])
    total = max(float(values.sum()), 1.0)  # rounding of what was written
    none = max(1.0 - float(values.sum()), 0.0)
    place = len(listed) if own is None else listed.index(own) if own in listed else None
    return Sets(name, np.append(values, none) / total, np.array([len(names) for names in listed], dtype=int), place)


def read_sets(folders: Sequence[Path]) -> tuple[list[Sets], dict[str, int]]:
    """Return the probabilities of all batches, and how many had none, by the reason.

    Raises
    ------
    FileNotFoundError
        If there is no batch in one of the folders.
    """
    found, left = [], {"without a result": 0, "refused or failed": 0}
    for folder in folders:
        paths = sorted(folder.glob("batch_*/truth.json"))
        if not paths:
            raise FileNotFoundError(f"{folder} holds no batch_*/truth.json. Run prior_batches.py first.")
        for path in paths:
            result = path.with_name("result.json")
            if not result.is_file():
                left["without a result"] += 1
                continue
            said = json.loads(result.read_text(encoding="utf-8"))
            if not said.get("candidates"):
                left["refused or failed"] += 1
                continue
            truth = json.loads(path.read_text(encoding="utf-8"))
            held = ALWAYS_THERE | frozenset(truth["base"])
            rows = [(frozenset(c["effects"]) - held, c["probability"] or 0.0) for c in said["candidates"]]
            found.append(sets_of(f"{folder.name}/{path.parent.name}", rows, meaning_of(truth)))
    return found, left


def pit(sets: Sets, share: float) -> float:
    """Return what stands before the truth plus ``share`` of its own probability; of an unlisted set, all listed."""
    place = sets.probability.size - 1 if sets.truth is None else sets.truth
    own = 0.0 if sets.truth is None else float(sets.probability[place])
    return float(sets.probability[:place].sum()) + share * own


def reweighted(sets: Sets, factor: float) -> Sets:
    """Return the probabilities under a prior that is wrong by a factor for each effect of a set."""
    values = sets.probability.copy()
    values[:-1] *= factor**sets.size
    values /= values.sum()
    order = np.argsort(-values[:-1], kind="stable")
    count = order.size
    place = sets.truth if sets.truth in (None, count) else int(np.flatnonzero(order == sets.truth)[0])
    return Sets(sets.name, np.append(values[order], values[-1]), sets.size[order], place)


def uniformity(rows: Sequence[Sets], seed: int = 0) -> dict[str, float]:
    """Return p-values of the PIT being uniform, Kolmogorov-Smirnov's and chi-square's over ten bins.

    The uniform shares are drawn `_REPEATS` times, and the median of the p-values is given: one draw in each is exact,
    and none of them is picked.
    """
    rng = np.random.default_rng(seed)
    p_values = np.empty((_REPEATS, 2))
    for k in range(_REPEATS):
        values = np.clip([pit(row, rng.random()) for row in rows], 0.0, 1.0)
        counts = np.histogram(values, _BINS, (0.0, 1.0))[0]
        p_values[k] = kstest(values, "uniform").pvalue, chisquare(counts).pvalue
    smirnov, bins = np.median(p_values, axis=0)
    return {"kolmogorov_smirnov": float(smirnov), "chi_square": float(bins)}


def reliability(rows: Sequence[Sets]) -> dict[str, Any]:
    """Return how often sets are the truth against their probability, over all sets of all batches."""
    probability = np.concatenate([row.probability for row in rows])
    right = np.concatenate([np.arange(row.probability.size) == row.truth for row in rows])
    place = np.clip(np.searchsorted(EDGES, probability, side="right") - 1, 0, len(EDGES) - 2)
    table, error = [], 0.0
    for k in range(len(EDGES) - 1):
        inside = place == k
        count, hits = int(inside.sum()), int(right[inside].sum())
        row: dict[str, Any] = {"low": EDGES[k], "high": EDGES[k + 1], "count": count, "hits": hits}
        if count:
            expected = float(probability[inside].sum())
            row |= {"expected": expected, "interval": wilson_interval(hits, count)}
            error += abs(expected - hits)
        table.append(row)
    tops = np.array([row.probability.max() for row in rows])
    is_top = np.array([row.truth is not None and int(np.argmax(row.probability)) == row.truth for row in rows])
    spread = math.sqrt(float((tops * (1.0 - tops)).sum()))
    truths = [0.0 if row.truth is None else float(row.probability[row.truth]) for row in rows]
    return {
        "bins": table,
        "expected_calibration_error": error / len(rows),
        "top": {
            "mean_probability": float(tops.mean()),
            "right": float(is_top.mean()),
            "standard_errors": float((is_top - tops).sum()) / spread if spread > 0.0 else math.nan,
        },
        "log_score": float(np.mean(np.log(np.maximum(truths, 1e-6)))),
        "unlisted": sum(row.truth is None for row in rows),
    }


def calibration(rows: Sequence[Sets]) -> dict[str, Any]:
    """Return all figures, those under wrong priors among them."""
    return {
        "batches": len(rows),
        "uniformity": uniformity(rows),
        "reliability": reliability(rows),
        "wrong_priors": {
            words: {"uniformity": uniformity(wrong), **_brief(reliability(wrong))}
            for words, factor in WRONG_PRIORS.items()
            for wrong in ([reweighted(row, factor) for row in rows],)
        },
    }


def _brief(figures: dict[str, Any]) -> dict[str, float]:
    return {name: figures[name] for name in ("expected_calibration_error", "log_score")}


def render(figures: dict[str, Any], left: dict[str, int]) -> str:
    """Return the figures as Markdown."""
    reliable = figures["reliability"]
    top = reliable["top"]
    lines = [
        f"{figures['batches']} batches ({', '.join(f'{count} {reason}' for reason, count in left.items())}); in "
        f"{reliable['unlisted']} the truth is a set that was given no probability.",
        "",
        "| probability | sets | expected to be the truth | are | 95 % interval of the share |",
        "|---|---|---|---|---|",
    ]
    for row in reliable["bins"]:
        cells = [f"{row['low']:g} to {row['high']:g}", f"{row['count']}"]
        if row["count"]:
            low, high = row["interval"]
            cells += [f"{row['expected']:.1f}", f"{row['hits']}", f"{low:.3f} to {high:.3f}"]
        lines.append(f"| {' | '.join((*cells, *['-'] * (5 - len(cells))))} |")
    lines += [
        "",
        f"The most probable set: mean probability {top['mean_probability']:.3f}, right {top['right']:.3f} "
        f"({top['standard_errors']:+.1f} standard errors).",
        "",
        "| prior | calibration error, sets a batch | mean log score | Kolmogorov-Smirnov p | chi-square p | uniform |",
        "|---|---|---|---|---|---|",
    ]
    priors = {"of the package": {"uniformity": figures["uniformity"], **_brief(reliable)}, **figures["wrong_priors"]}
    for words, found in priors.items():
        tests = found["uniformity"]
        verdict = "not rejected" if min(tests.values()) >= LEVEL / 2.0 else "rejected"  # the smaller of two
        lines.append(
            f"| {words} | {found['expected_calibration_error']:.3f} | {found['log_score']:.3f} | "
            f"{tests['kolmogorov_smirnov']:.2g} | {tests['chi_square']:.2g} | {verdict} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="folders of batches, parts of one run")
    parser.add_argument("--json", type=Path, help="file for all figures")
    given = parser.parse_args(arguments)
    rows, left = read_sets(given.folders)
    if not rows:
        print("No batch has probabilities yet: run diagnose.py on the folders first.")
        return 2
    figures = calibration(rows)
    print(render(figures, left), end="")
    if given.json:
        given.json.write_text(json.dumps(figures | {"left": left}, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
