"""What a run prints: measured backbones, inferred parameters, measured against simulated spread, findings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from .._common.checks import OBSERVABLE_UNITS
from .._common.text import amplitude

MOST_NOTES = 8
POPULATION_WORDS = {"mean": "mean over the batch", "sd": "spread (sd) over the batch"}
_COLUMNS = ("unit", "mean", "sd", "95 % HDI", "R-hat", "effective draws")
FOUND_NOTHING = "the model fits, the chains agree, and no parameter leans on its prior"


def compare(measured: xr.Dataset, simulated: xr.Dataset) -> list[dict[str, Any]]:
    """Compare the spread over the specimens with the posterior's, at each level of each observable.

    Parameters
    ----------
    measured, simulated : xarray.Dataset
        Measured backbones, and those simulated from posterior draws at the same levels.

    Returns
    -------
    list of dict
        ``observable``, ``unit``, ``level``, then mean and sd of both (with n - 1), and the median standard error
        of the measured values, in the observable's unit. The measured sd holds the standard error too, the simulated
        one does not.
    """
    rows = []
    for observable in measured["observable"].values:
        pairs = [np.asarray(dataset["value"].sel(observable=observable)) for dataset in (measured, simulated)]
        for k, level in enumerate(np.asarray(measured["level"], dtype=float)):
            row: dict[str, Any] = {
                "observable": str(observable),
                "unit": OBSERVABLE_UNITS.get(str(observable), "1"),
                "level": float(level),
            }
            for name, values in zip(("measured", "simulated"), pairs, strict=True):
                here = values[:, k][np.isfinite(values[:, k])]
                row[f"{name}_mean"] = float(here.mean()) if here.size else float("nan")
                row[f"{name}_sd"] = float(here.std(ddof=1)) if here.size > 1 else float("nan")
            error = np.asarray(measured["standard_error"].sel(observable=observable))[:, k]
            error = error[np.isfinite(error)]
            row["measured_standard_error"] = float(np.median(error)) if error.size else float("nan")
            rows.append(row)
    return rows


def describe_batch(backbones: xr.Dataset) -> str:
    """Say in one line how many specimens, levels and observables there are."""
    levels = np.asarray(backbones["level"], dtype=float)
    unit = str(backbones.attrs.get("amplitude_unit", "m"))
    count = backbones.sizes["specimen"]
    return (
        f"{count} {'specimen' if count == 1 else 'specimens'}, {levels.size} levels from {levels[0]:.4g} to "
        f"{levels[-1]:.4g} {unit}, observables {', '.join(map(str, backbones['observable'].values))}."
    )


def describe_reading(records: Sequence[Any]) -> str:
    """Say what was read, and what was assumed and converted meanwhile, each once; empty if nothing was."""
    counts = Counter(note for record in records for note in dict.fromkeys(record.notes))
    if not counts:
        return ""
    lines = ["Reading the records:", f"- {_extent(records)}"]
    for note, number in list(counts.items())[:MOST_NOTES]:
        share = "" if number == len(records) else f" ({number} of {len(records)} records)"
        lines.append(f"- {note}{share}")
    if len(counts) > MOST_NOTES:
        lines.append(f"- and {len(counts) - MOST_NOTES} more, in the notes of the result")
    return "\n".join(lines)


def _extent(records: Sequence[Any]) -> str:
    """Return how many records of which quantity there are, their length, sampling and size."""
    quantities = ", ".join(dict.fromkeys(f"{record.quantity} [{record.unit}]" for record in records))
    seconds = [float(record.time[-1] - record.time[0]) for record in records]
    rates = [(record.time.size - 1) / span for record, span in zip(records, seconds, strict=True)]
    peaks = [float(np.max(np.abs(record.values))) for record in records]

    def spread(values: Sequence[float]) -> str:
        low, high = (f"{value:.0f}" if 1e3 <= value < 1e9 else f"{value:.4g}" for value in (min(values), max(values)))
        return low if low == high else f"{low} to {high}"

    count = f"{len(records)} {'record' if len(records) == 1 else 'records'}"
    return (
        f"{count} of {quantities}: {spread(seconds)} s at {spread(rates)} samples per second, largest value "
        f"{spread(peaks)}"
    )


def describe_measured(backbones: xr.Dataset) -> str:
    """Say what was measured: numbers of specimens and levels, and mean and scatter at three levels."""
    unit = str(backbones.attrs.get("amplitude_unit", "m"))
    levels = np.asarray(backbones["level"], dtype=float)
    rows = [(f"level [{unit}]", "observable", "mean", "scatter (sd)", "standard error", "specimens")]
    for observable in backbones["observable"].values:
        for k in _three(levels.size):
            value = np.asarray(backbones["value"].sel(observable=observable))[:, k]
            error = np.asarray(backbones["standard_error"].sel(observable=observable))[:, k]
            here = np.isfinite(value)
            rows.append(
                (
                    f"{levels[k]:.4g}",
                    _with_unit(str(observable)),
                    short(value[here].mean() if here.any() else np.nan),
                    short(value[here].std(ddof=1) if here.sum() > 1 else np.nan),
                    short(np.median(error[here]) if here.any() else np.nan),
                    str(int(here.sum())),
                )
            )
    table = f"{describe_batch(backbones)}\n\n{aligned(rows)}"
    ratio = measured_damping_words(backbones)
    return f"{table}\n\n{ratio}" if ratio else table


def measured_damping_words(backbones: xr.Dataset) -> str:
    """Say the measured damping, averaged over the specimens, as `damping_ratio_words` does; empty without any."""
    if "damping" not in backbones["observable"].values:
        return ""
    values = backbones["value"].sel(observable="damping").transpose("specimen", "level").values
    # of levels that few specimens reach, the mean would tell these from the others, and not what the amplitude does
    reached = np.isfinite(values).sum(axis=0)
    mean = np.where(2 * reached > values.shape[0], np.nansum(values, axis=0) / np.maximum(reached, 1), np.nan)
    return damping_ratio_words(
        mean.tolist(), backbones["level"].values.tolist(), str(backbones.attrs.get("amplitude_unit", "m"))
    )


def damping_ratio_words(decrements: Sequence[float], levels: Sequence[float], unit: str) -> str:
    """Say a damping, which is the logarithmic decrement of a cycle, as damping ratio and quality factor.

    Parameters
    ----------
    decrements : sequence of float
        Logarithmic decrement per cycle at each level; NaN where there is none.
    levels : sequence of float
        Amplitudes, increasing.
    unit : str
        Theirs.

    Returns
    -------
    str
        A sentence on the lowest and the highest level, empty without a positive decrement.

    Examples
    --------
    >>> damping_ratio_words([0.0628], [0.001], "m")
    'Damping is the logarithmic decrement per cycle: a damping ratio of 0.999 % (Q = 50) at 1 mm.'
    """
    known = [(delta, level) for delta, level in zip(decrements, levels, strict=True) if delta > 0.0]
    if not known:
        return ""
    said: list[str] = []
    for delta, level in known if len(known) == 1 else (known[0], known[-1]):
        ratio = delta / np.hypot(2.0 * np.pi, delta)
        quality = f"{0.5 / ratio:.3g}"
        said.append(f"{100.0 * ratio:.3g} % ({quality if said else f'Q = {quality}'}) at {amplitude(level, unit)}")
    return f"Damping is the logarithmic decrement per cycle: a damping ratio of {', '.join(said)}."


def describe_result(result: Mapping[str, Any]) -> str:
    """Say what was inferred: parameters, measured against simulated spread, findings."""
    rows: list[tuple[str, ...]] = [("parameter", *_COLUMNS)]
    rows += [(name, *_row(entry, entry["unit"])) for name, entry in result["parameters"].items()]
    spread: list[tuple[str, ...]] = [
        (
            f"level [{result['amplitude_unit']}]",
            "observable",
            "measured mean",
            "sd",
            "standard error",
            "simulated mean",
            "sd",
        )
    ]
    columns = ("measured_mean", "measured_sd", "measured_standard_error", "simulated_mean", "simulated_sd")
    for observable in result["observables"]:
        entries = [row for row in result["comparison"] if row["observable"] == observable]
        for k in _three(len(entries)):
            row = entries[k]
            numbers = [short(row[key]) for key in columns]
            spread.append((f"{row['level']:.4g}", _with_unit(observable), *numbers))
    found = result["findings"] or [f"Nothing wrong was found: {FOUND_NOTHING}."]
    fit = [str(result["fit"]["sentence"]), ""] if result.get("fit") else []
    population = _describe_population(result)
    damping = [row for row in result["comparison"] if row["observable"] == "damping"]
    ratio = damping_ratio_words(
        [row["measured_mean"] for row in damping], [row["level"] for row in damping], str(result["amplitude_unit"])
    )
    lines = [*fit, *population, aligned(rows), "", aligned(spread), "", *([ratio, ""] if ratio else [])]
    return "\n".join([*lines, "Findings:", *(f"- {one}" for one in found)])


def _describe_population(result: Mapping[str, Any]) -> list[str]:
    """Return the lines on the population of a hierarchical model, none for another."""
    population = result.get("population")
    if not population:
        return []
    units = {name.partition("[")[0]: entry["unit"] for name, entry in result["parameters"].items()}
    rows: list[tuple[str, ...]] = [("population", *_COLUMNS)]
    for name, of in population["parameters"].items():
        rows += [(f"{name}, {what}", *_row(of[key], units[name])) for key, what in POPULATION_WORDS.items()]
    for entry in population["correlations"]:
        rows.append((f"correlation of {' and '.join(entry['between'])}", *_row(entry, "1")))
    return [aligned(rows), "", "The specimens:"]


def _row(entry: Mapping[str, float], unit: str) -> tuple[str, ...]:
    """Return unit, mean, sd, interval, R-hat and effective draws of one number, as `_COLUMNS` names them."""
    digits = meaningful_digits(entry["hdi_low"], entry["hdi_high"], entry["sd"])
    return (
        "-" if unit == "1" else unit,
        short(entry["mean"], digits),
        short(entry["sd"], 2),
        f"{short(entry['hdi_low'], digits)} to {short(entry['hdi_high'], digits)}",
        f"{entry['r_hat']:.3f}",
        f"{entry['ess_bulk']:.0f}",
    )


def _three(size: int) -> list[int]:
    return sorted({0, size // 2, size - 1})


def _with_unit(observable: str) -> str:
    unit = OBSERVABLE_UNITS.get(observable, "1")
    return f"{observable} [{'-' if unit == '1' else unit}]"


def short(value: float, digits: int = 4) -> str:
    """Write a number with so many significant digits."""
    return "-" if not np.isfinite(value) else f"{value:.{digits}g}"


def meaningful_digits(low: float, high: float, sd: float) -> int:
    """Return how many digits of a value its standard deviation leaves meaningful, two uncertain ones included.

    Examples
    --------
    >>> meaningful_digits(29717.0, 29725.0, 1.885), meaningful_digits(0.55, 0.65, 0.025)
    (6, 3)
    """
    largest = max(abs(low), abs(high))
    if not (sd > 0.0 and np.isfinite(largest) and largest > 0.0):
        return 4
    return int(np.clip(np.floor(np.log10(largest)) - np.floor(np.log10(sd)) + 2, 2, 9))


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Lay out rows in columns: the first two to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if i < 2 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  " + "  ".join(cells).rstrip())
    return "\n".join(lines)
