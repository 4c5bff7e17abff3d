"""Score what a tool said about batches with hidden effects; prints Markdown.

    python benchmarks/hidden_effects/score.py DIR [MORE ...] [--json FILE] [--rows FILE]

Reads ``truth.json``, ``distance.json`` and ``result.json`` of every batch; several folders are parts of one run. A name
is right when the set of named effects equals the set of hidden ones, or one that is the same at their parameters
(`meanings.py`). ``--rows`` writes a line of CSV for each batch.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from figures import CLEAR_DISTANCE, LARGE_GAP, WRONG_TARGET, score
from outcomes import OUTCOMES, Outcome, read_outcomes
from strengths import STIFFNESS_KINDS


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.3g}"
    return ", ".join(value) or "nothing" if isinstance(value, tuple) else str(value)


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join(lines)


def _percent(rate: dict[str, Any]) -> str:
    if not rate["count"]:
        return "- (no batch)"
    low, high = 100.0 * rate["low"], 100.0 * rate["high"]
    return f"{100.0 * rate['share']:.1f} % ({rate['hits']} of {rate['count']}; {low:.1f} to {high:.1f} %)"


def _bins(rows: Sequence[dict[str, Any]]) -> str:
    shown = ("right", "listed", "wrong", "adequate", "unexplained", "ambiguous")
    cells = ([row["distance"], row["count"], *map(row.get, shown)] for row in rows)
    return _table(("distance", "batches", *shown), cells)


def _render_detection(detection: dict[str, Any]) -> list[str]:
    """Return detection against distance: overall, where it is clear, and per effect."""
    clear = []
    for group, row in detection["clear"].items():
        rates = (_percent(row[name]) for name in ("right", "right or listed", "wrong"))
        clear.append([group, f"{100.0 * row['target']:.0f} %", *rates])
    effects = []
    for effect, row in detection["per_effect"].items():
        kind = "share of the spring's force" if effect in STIFFNESS_KINDS else "damping ratio"
        effects.append(
            [effect, kind, *(row[name] for name in ("distance_50", "distance_90", "strength_50", "strength_90"))]
        )
    return [
        "## Detection against distance",
        _bins(detection["bins"]),
        f"Half are named at a distance of {_cell(detection['distance_50'])}, "
        f"nine tenths at {_cell(detection['distance_90'])}.",
        f"### At a distance of {CLEAR_DISTANCE:g} and more",
        _table(("group", "target", "right", "right or listed", "wrong"), clear),
        f"Below a distance of 3 a name was given in {_percent(detection['close_named'])}, "
        f"the right one in {_percent(detection['close_right'])}.",
        "### Per effect: where half and nine tenths are named",
        _table(("effect", "strength is", "distance 50 %", "90 %", "strength 50 %", "90 %"), effects),
        *(f"#### {effect}\n\n{_bins(row['bins'])}" for effect, row in detection["per_effect"].items()),
    ]


def _render_outside(outside: dict[str, dict[str, int]]) -> list[str]:
    """Return outcomes by the law that was drawn as one outside of the library; nothing where none was."""
    rows = [[law, *row.values()] for law, row in outside.items()]
    return ["### By the law that was drawn as outside", _table(("law", "batches", *OUTCOMES), rows)] if rows else []


def _render_gaps(gaps: dict[str, Any]) -> list[str]:
    """Return what is left of the gap after a right name."""
    rows = []
    for kind in ("held_out_levels", "held_out_specimens"):
        before, after = gaps[kind]["before"], gaps[kind]["after"]
        rows.append(
            [kind[9:], after["count"], before["median"], after["median"], after["q90"], gaps[kind]["share_to_1.5"]]
        )
    head = ("held-out reduced chi-square", "batches", "before: median", "after: median", "90 %", "share to 1.5")
    return [
        "## The gap between model and data after a right name",
        _table(head, rows),
        f"The gap shrank {_cell(gaps['shrink']['median'])} fold (median); where it was large (at least "
        f"{LARGE_GAP:g} at held-out levels) at least tenfold in {_percent(gaps['large'])}.",
    ]


def render(figures: dict[str, Any]) -> str:
    """Return the figures as Markdown; intervals are Wilson's, 95 %."""
    reliability, seconds = figures["reliability"], figures["seconds"]
    wrong = [[*list(row.values())[:-1], "yes" if row["kindred"] else "no"] for row in figures["wrong_batches"]]
    curve = []
    for row in reliability["bins"]:
        means = (row.get(name, math.nan) for name in ("probability", "right"))
        curve.append([f"{row['low']:.1f} to {row['high']:.1f}", row["count"], *means])
    most_probable = [
        [name, row["count"], row["probability"], row["right"], row["expected_calibration_error"],
         row["error_when_calibrated"]]
        for name, row in figures["reliability_of"].items()
    ]  # fmt: skip
    parts = [
        "## Outcomes per tier",
        _table(("tier", *OUTCOMES), ([tier, *row.values()] for tier, row in figures["tiers"].items())),
        "## Laws and mechanisms, where something is hidden",
        _table(("of these batches", "share"), ([name, _percent(rate)] for name, rate in figures["levels"].items())),
        "### By what is hidden, where the verdict is not `adequate`",
        _table(
            ("hidden", "law right or listed", "mechanism certain and right"),
            ([group, *map(_percent, row.values())] for group, row in figures["groups"].items()),
        ),
        *_render_outside(figures["outside"]),
        "## An effect named where nothing is missing",
        _table(("batches", "named"), ([name, _percent(rate)] for name, rate in figures["false_alarms"].items())),
        *_render_detection(figures["detection"]),
        "## Confident wrong names",
        f"Over all batches {_percent(figures['wrong'])}, target {100.0 * WRONG_TARGET:.0f} %; "
        f"without what lies outside of the library {_percent(figures['wrong_in_library'])}.",
        f"In {_percent(figures['kindred'])} of the wrong answers the law named is another one of the right mechanism.",
        _table(("batch", "tier", "hidden", "named", "distance", "right mechanism"), wrong),
        "## Reliability of the probability of the most probable set",
        _table(("probability", "batches", "mean probability", "right"), curve),
        f"Expected calibration error {_cell(reliability['expected_calibration_error'])} "
        f"over {reliability['count']} batches; claims that hold exactly would have "
        f"{_cell(reliability['error_when_calibrated'])} (mean) and up to "
        f"{_cell(reliability['error_when_calibrated_95'])} (95 %) by chance.",
        _table(
            ("the most probable set is", "batches", "mean probability", "right", "error", "by chance"), most_probable
        ),
        *_render_gaps(figures["gaps"]),
        "## Run time",
        f"Median {_cell(seconds['median'])} s, 90 % within {_cell(seconds['q90'])} s, "
        f"longest {_cell(seconds['largest'])} s ({seconds['count']} batches).",
    ]
    return "\n\n".join(parts) + "\n"


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold: NaN becomes null."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_rows(outcomes: Iterable[Outcome], path: Path) -> None:
    """Write what was hidden and said in each batch as CSV, effects with a plus between them."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            ("batch", "tier", "base", "hidden", "outcome", "named", "probability", "is_top_right", "seconds")
        )
        for item in outcomes:
            effects = ["+".join(names) for names in (item.base, item.hidden, item.named)]
            numbers = f"{item.probability:.4f}", int(item.is_top_right), f"{item.seconds:.1f}"
            writer.writerow((item.folder, item.tier, *effects[:2], item.outcome, effects[2], *numbers))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="folders of batches")
    parser.add_argument("--json", type=Path, help="file for all figures")
    parser.add_argument("--rows", type=Path, help="CSV file for the batches")
    given = parser.parse_args(arguments)
    outcomes = [item for folder in given.folders for item in read_outcomes(folder)]
    figures = score(outcomes)
    print(render(figures), end="")
    if given.rows:
        write_rows(outcomes, given.rows)
    if given.json:
        given.json.write_text(json.dumps(_plain(figures), indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
