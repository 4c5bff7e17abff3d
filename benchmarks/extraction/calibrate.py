"""Calibrate backbone extraction: bias over standard error, coverage, error ratio against two published ways.

For every effect a noise-free decay is integrated once by SciPy (`truth.py`); white noise is drawn many times; level
values by `backbones_at_levels`
are compared with the true backbone. Signal-to-noise ratio: release amplitude over standard deviation of the noise, 20
log10.

Rivals, on the same noisy samples: (a) bare picking: largest sample of each swing, frequency from its time, decrement
from successive peaks;
(b) published recipe: period from zero crossings by linear interpolation, amplitude by a three-point parabola,
decrement from successive amplitudes.
Their cycle values are brought to the levels in two ways, straight interpolation and a local line in log amplitude
(Gaussian kernel, one level
spacing); the one with the smaller error counts.

Run: ``python benchmarks/extraction/calibrate.py --quick`` (two minutes) or without (recorded run).
"""

from __future__ import annotations

import argparse
import json
import sys
import time as clock
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import truth as oracle  # noqa: E402

from pymc_backbone.measurement.cycles import extract_cycles_from_arrays  # noqa: E402
from pymc_backbone.measurement.levels import backbones_at_levels, default_levels  # noqa: E402

OBSERVABLES = ("frequency", "damping", "offset")


def rival_cycles(t, x, period):
    """Return amplitude, frequency, decrement of (a) bare picking and (b) the published recipe."""
    step = t[1] - t[0]
    distance = max(int(0.7 * period / step), 1)
    peaks = []
    at = 0
    # largest sample of each swing, guided by the true period: kinder to the rivals than an unguided search
    first = int(np.argmax(x[: max(distance // 2, 2)]))
    while True:
        peaks.append(first)
        lo, hi = first + distance, first + int(1.35 * period / step) + 1
        if hi >= x.size:
            break
        first = lo + int(np.argmax(x[lo:hi]))
        at += 1
    peaks = np.array(peaks)
    values, times = x[peaks], t[peaks]
    inner = (peaks > 0) & (peaks < x.size - 1)
    left, mid, right = x[np.maximum(peaks - 1, 0)], x[peaks], x[np.minimum(peaks + 1, x.size - 1)]
    bend = left - 2 * mid + right
    safe = inner & (bend < 0)
    parabola = np.where(safe, mid - (right - left) ** 2 / np.where(safe, 8 * bend, 1.0), mid)
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossings = t[up] - x[up] * step / (x[up + 1] - x[up])
    zero_times = np.full(peaks.size, np.nan)
    for k in range(1, peaks.size):
        inside = crossings[(crossings > times[k - 1]) & (crossings < times[k])]
        if inside.size:
            zero_times[k] = inside.mean()
    with np.errstate(all="ignore"):
        bare = ((values[:-1] + values[1:]) / 2, 1 / np.diff(times), np.log(values[:-1] / values[1:]))
        published = (
            (parabola[1:-1] + parabola[2:]) / 2,
            1 / np.diff(zero_times[1:]),
            np.log(parabola[1:-1] / parabola[2:]),
        )
    return bare, published


def to_levels(amplitude, values, levels):
    """Return values at levels by straight interpolation and by a local line."""
    good = np.isfinite(amplitude) & np.isfinite(values) & (amplitude > 0)
    a, v = np.log(amplitude[good]), values[good]
    at = np.log(levels)
    if a.size < 4:
        return np.full(levels.size, np.nan), np.full(levels.size, np.nan)
    order = np.argsort(a)
    straight = np.interp(at, a[order], v[order])
    width = (at[-1] - at[0]) / (at.size - 1)
    local = np.empty(at.size)
    for i, u in enumerate(at):
        w = np.exp(-0.5 * ((a - u) / width) ** 2) + 1e-12
        mean = np.average(a, weights=w)
        spread = np.average((a - mean) ** 2, weights=w)
        slope = np.average((a - mean) * v, weights=w) / max(spread, 1e-12)
        local[i] = np.average(v, weights=w) + slope * (u - mean)
    return straight, local


def calibrate(task, halved=False):
    """Run one configuration; return a dict of numbers. With ``halved`` standard errors are halved: it must show."""
    effect, ratio, n_cycles, samples, snr, draws, wrong_noise = task
    decay = _truth(effect, ratio, n_cycles)
    step = 1.0 / samples * 1.0137
    end = decay.stop_time + (8.0 if effect == "coulomb_friction" else 0.0)
    t = np.arange(0.0, end, step)
    x = decay.sample(t)
    t, x = t[np.isfinite(x)], x[np.isfinite(x)]
    noise = 10 ** (-snr / 20)
    rng = np.random.default_rng([samples, int(snr), n_cycles, sum(map(ord, effect))])
    z, ours, bare, published, errors = [], [], [], [], []
    levels, seconds, failures = None, [], 0
    top = decay.cycles["amplitude"][1]
    for _ in range(draws):
        noisy = x + noise * rng.standard_normal(x.size)
        began = clock.perf_counter()
        try:
            cycles = extract_cycles_from_arrays(t, noisy, noise=noise * wrong_noise, specimen="s")
            if levels is None:
                levels = default_levels([cycles])
                # the lowest level of one draw may lie below the floor of another
                levels = np.geomspace(levels[0] * (1.1 if cycles.notes else 1.0), min(levels[-1], top), levels.size)
                true = np.array([decay.at(name, levels) for name in OBSERVABLES])
            result = backbones_at_levels(cycles, levels, OBSERVABLES)
        except ValueError as error:
            failures += 1
            print("failed:", task, error, file=sys.stderr)
            continue
        seconds.append(clock.perf_counter() - began)
        value, error = result.value.values[0], result.standard_error.values[0] * (0.5 if halved else 1.0)
        z.append((value - true) / error)
        ours.append(value - true)
        errors.append(error)
        for rival, store in zip(
            rival_cycles(t, noisy, 1 / decay.cycles["frequency"].mean()), (bare, published), strict=True
        ):
            store.append([[way - true[i] for way in to_levels(rival[0], rival[i + 1], levels)] for i in range(2)])
    z, ours = np.array(z), np.array(ours)
    n = z.shape[0]
    mean = np.nanmean(z, axis=0)
    row = {
        "effect": effect, "snr": snr, "samples": samples, "cycles": n_cycles, "draws": n, "failures": failures,
        "levels": int(z.shape[2]), "milliseconds": 1e3 * float(np.median(seconds)),
    }  # fmt: skip
    for i, name in enumerate(OBSERVABLES):
        good = np.isfinite(z[:, i])
        row[name] = {
            "coverage": float(np.mean(np.abs(z[:, i][good]) < 1.96)),
            "bias": float(np.sign(np.nanmean(mean[i])) * np.sqrt(max(np.nanmean(mean[i] ** 2) - 1.0 / n, 0.0))),
            "rms_z": float(np.sqrt(np.nanmean(z[:, i] ** 2))),
            "relative_error": float(np.sqrt(np.nanmean((ours[:, i] / true[i]) ** 2))) if i < 2 else None,
        }
        if i < 2:
            own = np.sqrt(np.nanmean(ours[:, i] ** 2, axis=0))
            for label, store in (("bare", bare), ("published", published)):
                other = np.sqrt(np.nanmean(np.array(store)[:, i] ** 2, axis=0)).min(axis=0)
                row[name][label] = float(np.exp(np.mean(np.log(own / other))))
    return row


_CACHE: dict = {}


def _truth(effect, ratio, n_cycles):
    key = (effect, ratio, n_cycles)
    if key not in _CACHE:
        _CACHE[key] = oracle.make_dense_truth(effect, damping_ratio=ratio, n_cycles=n_cycles)
    return _CACHE[key]


def run_effect(tasks):
    """Run all configurations of one effect in one process (the truth is made once)."""
    return [calibrate(task) for task in tasks]


def table(rows, key):
    """Return a Markdown table of rows grouped by ``key``."""
    lines = [
        f"| {key} | "
        + " | ".join(f"{o} bias/se | cover | rms z" for o in OBSERVABLES)
        + " | error / (a): f, d | error / (b): f, d | fail |",
        "|" + "---|" * (2 + 3 * 3 + 2),
    ]
    for group in dict.fromkeys(row[key] for row in rows):
        own = [row for row in rows if row[key] == group]
        cells = []
        for name in OBSERVABLES:
            bias = np.sqrt(np.mean([row[name]["bias"] ** 2 for row in own]))
            cells.append(
                f"{bias:.2f} | {100 * np.mean([row[name]['coverage'] for row in own]):.1f} | "
                f"{np.mean([row[name]['rms_z'] for row in own]):.2f}"
            )
        for label in ("bare", "published"):
            means = (np.exp(np.mean([np.log(row[o][label]) for row in own])) for o in OBSERVABLES[:2])
            cells.append(", ".join(f"{mean:.3f}" for mean in means))
        lines.append(
            f"| {group} | "
            + " | ".join(cells)
            + f" | {sum(row['failures'] for row in own)}/{sum(row['draws'] + row['failures'] for row in own)} |"
        )
    return "\n".join(lines)


def main():
    """Run the calibration and write results.md and results.json (not with --quick)."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer draws and configurations; prints only")
    parser.add_argument("--effects", nargs="*", default=list(oracle.EFFECTS))
    parser.add_argument("--draws", type=int)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    snrs = (20, 40, 60) if options.quick else (20, 30, 40, 50, 60)
    samples = (10, 50) if options.quick else (10, 25, 60, 200)
    draws = options.draws or (6 if options.quick else 12)
    jobs = []
    for effect in options.effects:
        tasks = [(effect, 0.005, 40, s, snr, draws, 1.0) for s in samples for snr in snrs]
        # a dozen cycles, heavily damped
        tasks += [(effect, 0.02, 12, s, snr, draws, 1.0) for s in samples[:2] for snr in snrs[1:]]
        jobs.append(tasks)
    began = clock.perf_counter()
    if options.workers > 1:
        with ProcessPoolExecutor(options.workers) as pool:
            rows = [row for rows in pool.map(run_effect, jobs) for row in rows]
    else:
        rows = [row for rows in map(run_effect, jobs) for row in rows]
    control = calibrate(("linear", 0.005, 40, 50, 40, draws, 1.0), halved=True)
    seconds = clock.perf_counter() - began
    parts = ["# Extraction, calibrated", ""]
    arguments = " ".join(sys.argv[1:])
    parts += [
        f"`python benchmarks/extraction/calibrate.py {arguments}`".replace(" `", "`")
        + f", {seconds:.0f} s, {draws} draws a configuration.",
        "",
    ]
    parts += [__doc__.split("\n\n", 1)[1].split("\n\nRun:")[0], ""]
    parts += ["bias/se: root mean square over levels and configurations of the mean z, its sampling error subtracted. "
              "cover: per cent of level values whose 95 % interval holds the truth. Error ratios: "
              "below 1 ours is better.", ""]  # fmt: skip
    for key in ("effect", "snr", "samples", "cycles"):
        parts += [f"## By {key}", "", table(rows, key), ""]
    parts += ["## Negative control", "", "Standard errors halved: coverage of "
              f"frequency {100 * control['frequency']['coverage']:.0f} %, "
              f"damping {100 * control['damping']['coverage']:.0f} %.", ""]  # fmt: skip
    text = "\n".join(parts)
    print(text)
    if not options.quick:
        (HERE / "results.md").write_text(text)
        (HERE / "results.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
