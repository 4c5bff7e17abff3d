"""Figures of merit of a tool over many batches: false alarms, detection, reliability, what is left of the gap."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from outcomes import OUTCOMES, Outcome, logistic_thresholds, wilson_interval

EDGES = (0.0, 1.0, 3.0, 5.0, 10.0, 20.0, 50.0, 200.0, math.inf)
TARGETS = {"one effect": 0.97, "base plus hidden": 0.95, "two effects": 0.90, "three effects": 0.75}
CLEAR_DISTANCE = 20.0
WRONG_TARGET = 0.02
LARGE_GAP = 30.0
"""Held-out reduced chi-square above which the gap between model and data counts as large."""


def share(outcomes: Iterable[Outcome], test: Callable[[Outcome], bool]) -> dict[str, Any]:
    """Return count, hits and share of the outcomes that pass a test, with its 95 % interval."""
    kept = list(outcomes)
    hits = sum(map(test, kept))
    low, high = wilson_interval(hits, len(kept))
    return {
        "count": len(kept),
        "hits": hits,
        "share": hits / len(kept) if kept else math.nan,
        "low": low,
        "high": high,
    }


def is_outcome(*names: str) -> Callable[[Outcome], bool]:
    """Return a test for outcomes."""
    return lambda outcome: outcome.outcome in names


def is_right_or_listed(outcome: Outcome) -> bool:
    """Return whether the law is named, or is among those that remain: of several, or of the mechanism that is named."""
    return outcome.outcome in ("right", "listed") or (outcome.outcome == "mechanism" and outcome.is_listed)


def measure_levels(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Any]]:
    """Return, of the batches that hide something, what is said of laws and of mechanisms, and what intervals hold."""
    hidden = [o for o in outcomes if o.hidden or not o.is_in_library]
    lawful = [o for o in hidden if o.hidden]
    covered = [item for o in hidden for item in o.covered]
    low, high = wilson_interval(sum(covered), len(covered))
    return {
        "law right or listed": share(lawful, is_right_or_listed),
        "law right, listed, or told among those of a named mechanism": share(
            lawful, lambda o: is_right_or_listed(o) or o.is_told
        ),
        "mechanism certain and right": share(hidden, lambda o: o.certain == "right"),
        "mechanism certain and wrong": share(hidden, lambda o: o.certain == "wrong"),
        "unexplained, or named as a mechanism": share(hidden, is_outcome("unexplained", "mechanism")),
        "95 % intervals that hold the parameter": {
            "count": len(covered),
            "hits": sum(covered),
            "share": sum(covered) / len(covered) if covered else math.nan,
            "low": low,
            "high": high,
        },
    }


def measure_groups(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Any]]:
    """Return by what is hidden, where the verdict is not that nothing is, how often its law and mechanism are told."""
    seen = [o for o in outcomes if o.hidden and o.outcome != "adequate"]
    groups = {group: [o for o in seen if o.group == group] for group in sorted({o.group for o in seen})}
    disturbed = sorted({kind for o in seen for kind in o.contaminations})
    groups |= {f"beside {kind}": [o for o in seen if kind in o.contaminations] for kind in disturbed}
    return {
        group: {
            "right or listed": share(kept, is_right_or_listed),
            "mechanism": share(kept, lambda o: o.certain == "right"),
        }
        for group, kept in groups.items()
    }


def count_tiers(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """Count outcomes per tier; the last row holds all."""
    rows = {tier: [o for o in outcomes if o.tier == tier] for tier in sorted({o.tier for o in outcomes})}
    rows["all"] = list(outcomes)
    return {tier: {name: sum(o.outcome == name for o in kept) for name in OUTCOMES} for tier, kept in rows.items()}


def count_outside(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """Count outcomes by the law that was drawn as one outside of the library, some of which it holds by now."""
    drawn = sorted({o.outside for o in outcomes if o.outside})
    return {law: _count_row([o for o in outcomes if o.outside == law]) for law in drawn}


def rate_false_alarms(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Any]]:
    """Return the share of batches with nothing missing in which an effect was named."""
    empty = [o for o in outcomes if o.has_empty_truth]
    groups = {
        "linear base": [o for o in empty if not o.base],
        "base holds an effect that is there": [o for o in empty if o.base and o.tier != "base_absent"],
        "base holds an effect that is not there": [o for o in empty if o.tier == "base_absent"],
        "all": empty,
    }
    return {name: share(kept, is_outcome("wrong")) for name, kept in groups.items()}


def bin_distances(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Count outcomes per distance; the last row holds batches of unknown distance."""
    rows = []
    for low, high in itertools.pairwise(EDGES):
        kept = [o for o in outcomes if low <= o.distance < high]
        label = f"{low:g} to {high:g}" if math.isfinite(high) else f"above {low:g}"
        rows.append({"distance": label, **_count_row(kept)})
    unknown = [o for o in outcomes if math.isnan(o.distance)]
    if unknown:
        rows.append({"distance": "unknown", **_count_row(unknown)})
    return rows


def _count_row(kept: Sequence[Outcome]) -> dict[str, Any]:
    counts = {name: sum(o.outcome == name for o in kept) for name in OUTCOMES}
    return {"count": len(kept), **counts}


def find_thresholds(outcomes: Sequence[Outcome], effect: str | None = None) -> dict[str, float]:
    """Return distance and strength at which half and nine tenths are named right."""
    known = [o for o in outcomes if o.outcome != "no result"]
    right = np.array([o.outcome == "right" for o in known], dtype=bool)
    distance = np.array([max(o.distance, 1e-3) if not math.isnan(o.distance) else math.nan for o in known])
    half, most = logistic_thresholds(distance, right, (0.5, 0.9))
    found = {"distance_50": half, "distance_90": most}
    if effect is not None:
        strength = np.array([o.strength.get(effect, math.nan) for o in known])
        found["strength_50"], found["strength_90"] = logistic_thresholds(strength, right, (0.5, 0.9))
    return found


def measure_detection(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return detection against distance, over all batches with hidden library effects and per effect."""
    hidden = [o for o in outcomes if o.hidden and o.is_in_library]
    effects = sorted({o.hidden[0] for o in hidden if len(o.hidden) == 1})
    per_effect = {}
    for effect in effects:
        kept = [o for o in hidden if o.hidden == (effect,)]
        per_effect[effect] = {"bins": bin_distances(kept), **find_thresholds(kept, effect)}
    clear = [o for o in hidden if o.distance >= CLEAR_DISTANCE]
    groups = {}
    for group, target in TARGETS.items():
        kept = [o for o in clear if o.group == group]
        groups[group] = {
            "target": target,
            "right": share(kept, is_outcome("right")),
            "right or listed": share(kept, is_right_or_listed),
            "wrong": share(kept, is_outcome("wrong")),
        }
    close = [o for o in hidden if o.distance < 3.0]
    return {
        "bins": bin_distances(hidden),
        **find_thresholds(hidden),
        "per_effect": per_effect,
        "clear": groups,
        "close_named": share(close, is_outcome("right", "wrong")),
        "close_right": share(close, is_outcome("right")),
    }


def chance_of_error(probability: np.ndarray, bins: int = 10, draws: int = 2000) -> tuple[float, float]:
    """Return the mean and the 95 % quantile of the calibration error of claims that hold exactly.

    Of a hundred batches a perfect tool has an error too: some ten fall into a bin, and the share of them that is right
    scatters.
    """
    place = np.minimum((probability * bins).astype(int), bins - 1)
    right = np.random.default_rng(0).random((draws, probability.size)) < probability
    missed = (right - probability) @ (place[:, None] == np.arange(bins))
    errors = np.abs(missed).sum(axis=1) / probability.size
    return float(errors.mean()), float(np.quantile(errors, 0.95))


def measure_reliability(outcomes: Sequence[Outcome], bins: int = 10) -> dict[str, Any]:
    """Return how often the most probable set is the truth, against its probability."""
    kept = [o for o in outcomes if not math.isnan(o.probability)]
    probability = np.clip([o.probability for o in kept], 0.0, 1.0)
    right = np.array([o.is_top_right for o in kept], dtype=float)
    place = np.minimum((probability * bins).astype(int), bins - 1)
    rows, error = [], 0.0
    for number in range(bins):
        inside = place == number
        count = int(inside.sum())
        row: dict[str, Any] = {"low": number / bins, "high": (number + 1) / bins, "count": count}
        if count:
            row |= {"probability": float(probability[inside].mean()), "right": float(right[inside].mean())}
            error += count / len(kept) * abs(row["probability"] - row["right"])
        rows.append(row)
    mean, high = chance_of_error(probability, bins) if kept else (math.nan, math.nan)
    return {
        "bins": rows,
        "count": len(kept),
        "probability": float(probability.mean()) if kept else math.nan,
        "right": float(right.mean()) if kept else math.nan,
        "expected_calibration_error": error if kept else math.nan,
        "error_when_calibrated": mean,
        "error_when_calibrated_95": high,
    }


def measure_gaps(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the held-out reduced chi-square after a right name, and by how much the gap shrank."""
    right = [o for o in outcomes if o.outcome == "right" and o.gap]
    report: dict[str, Any] = {}
    for kind in ("held_out_levels", "held_out_specimens"):
        pairs = [o.gap.get(kind) or {} for o in right]
        before, after = (np.array([_value(pair, key) for pair in pairs]) for key in ("before", "after"))
        report[kind] = {"before": _quantiles(before), "after": _quantiles(after)}
        finite = after[np.isfinite(after)]
        report[kind]["share_to_1.5"] = float(np.mean(finite <= 1.5)) if finite.size else math.nan
    report["shrink"] = _quantiles(np.array([_value(o.gap, "shrink") for o in right]))
    large = [o for o in right if _value(o.gap.get("held_out_levels") or {}, "before") >= LARGE_GAP]
    report["large"] = share(large, lambda o: _value(o.gap, "shrink") >= 10.0)
    return report


def _value(record: dict[str, Any], key: str) -> float:
    value = record.get(key)
    return float(value) if isinstance(value, int | float) else math.nan


def _quantiles(values: np.ndarray) -> dict[str, float]:
    kept = values[np.isfinite(values)]
    if not kept.size:
        return {"count": 0, "median": math.nan, "q90": math.nan, "largest": math.nan}
    median, q90, largest = np.quantile(kept, (0.5, 0.9, 1.0))
    return {"count": int(kept.size), "median": float(median), "q90": float(q90), "largest": float(largest)}


def score(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return all figures."""
    answered = [o for o in outcomes if o.outcome != "no result"]
    return {
        "tiers": count_tiers(outcomes),
        "levels": measure_levels(answered),
        "groups": measure_groups(answered),
        "outside": count_outside(answered),
        "false_alarms": rate_false_alarms(answered),
        "detection": measure_detection(answered),
        "wrong": share(answered, is_outcome("wrong")),
        "kindred": share([o for o in answered if o.outcome == "wrong"], lambda o: o.is_kindred),
        "wrong_in_library": share([o for o in answered if o.is_in_library], is_outcome("wrong")),
        "reliability": measure_reliability(answered),
        "reliability_of": {
            "the model as it is": measure_reliability([o for o in answered if o.is_top_empty]),
            "a set of effects": measure_reliability([o for o in answered if not o.is_top_empty]),
            "a set whose law is named": measure_reliability([o for o in answered if o.named]),
        },
        "gaps": measure_gaps(answered),
        "seconds": _quantiles(np.array([o.seconds for o in answered])),
        "wrong_batches": [
            {
                "batch": o.folder,
                "tier": o.tier,
                "hidden": o.hidden,
                "named": o.named,
                "distance": o.distance,
                "kindred": o.is_kindred,
            }
            for o in answered
            if o.outcome == "wrong"
        ],
    }
