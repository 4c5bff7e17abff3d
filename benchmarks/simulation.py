"""How fast and how exact the compiled free decay is: ratios within one run, CPU time, medians.

    python benchmarks/simulation.py

Ten levels of a Duffing oscillator against SciPy's DOP853 with turning-point events over the whole decay, at equal
accuracy; one cycle per level against the whole decay; with and without sensitivities; every effect of the library; what
remembers, a few cycles at each level against every cycle.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from pymc_backbone.effects import BASE_EFFECTS, LIBRARY
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import Simulator, simulate_backbone, simulate_waveform

MASS, K, C, K3 = 1.0, 6500.0, 1.1, 6.25e6
LEVELS = np.geomspace(0.003, 0.03, 10)
RELEASE = 0.035


def seconds(call: Callable[[], object], repeats: int = 15, inner: int = 1) -> float:
    """Return the median CPU time of one call."""
    times = []
    for _ in range(repeats):
        start = time.process_time_ns()
        for _ in range(inner):
            call()
        times.append((time.process_time_ns() - start) * 1e-9 / inner)
    return statistics.median(times)


def scipy_cycles(rtol: float) -> np.ndarray:
    """Return amplitude, frequency and decrement of the cycles of the whole decay."""

    def slope(t, y):
        return (y[1], -(K * y[0] + C * y[1] + K3 * y[0] ** 3) / MASS)

    def turning(t, y):
        return y[1]

    def gone(t, y):
        return abs(y[0]) + abs(y[1]) / 80.0 - 0.5 * LEVELS[0]

    gone.terminal = True
    run = solve_ivp(slope, (0.0, 100.0), (RELEASE, 0.0), "DOP853", events=(turning, gone), rtol=rtol, atol=rtol * 1e-3)
    t, x = run.t_events[0], run.y_events[0][:, 0]
    if t.size == 0 or t[0] > 1e-6:
        t, x = np.append(0.0, t), np.append(RELEASE, x)
    n = (t.size - 1) // 2
    p0, q, p1 = x[0 : 2 * n : 2], x[1 : 2 * n : 2], x[2 : 2 * n + 1 : 2]
    time_of_cycle = t[2 : 2 * n + 1 : 2] - t[0 : 2 * n : 2]
    return np.array([(p0 + p1 - 2 * q) / 4, 1 / time_of_cycle, 2 * np.log((p0 - q) / (p1 - q))])


def at_levels(cycles: np.ndarray) -> np.ndarray:
    """Return frequency and decrement at the levels, by a spline in log amplitude."""
    from scipy.interpolate import CubicSpline

    return np.array([CubicSpline(np.log(cycles[0, ::-1]), row[::-1])(np.log(LEVELS)) for row in cycles[1:]])


def runner(simulator: Simulator, p: np.ndarray, release: float, sensitivities: bool) -> Callable[[], None]:
    """Return a call of the compiled backbone without the checks around it, as the Ops make it."""
    values, status = np.empty((3, LEVELS.size)), np.zeros(LEVELS.size, dtype=np.int64)
    jacobian = np.empty((3, LEVELS.size, p.size) if sensitivities else (0, 0, 0))
    return lambda: simulator.backbone(p, LEVELS, release, True, values, jacobian, status)


def against_scipy() -> None:
    """Print speed and error of both on the Duffing oscillator."""
    oscillator = Oscillator(MASS, "cubic_stiffness")
    p = np.array([K, C, K3])
    simulator = Simulator(oscillator)
    exact = simulate_backbone(oscillator, p, LEVELS, sensitivities=True)  # cycles next to their levels
    with_tolerance = simulate_backbone(oscillator, p, LEVELS)
    reference = at_levels(scipy_cycles(1e-13))
    print("Duffing, ten levels               CPU time     frequency error   decrement error (largest, relative)")
    fast = seconds(runner(simulator, p, 0.0, False), 51, 20)

    def line(name, duration, values):
        f, d = np.abs(values[0] / exact.values[0] - 1).max(), np.abs(values[1] / exact.values[1] - 1).max()
        print(f"  {name:30s} {duration * 1e6:10.1f} us   {f:12.1e} {d:16.1e}   x {duration / fast:.0f}")

    line("one cycle per level", fast, with_tolerance.values)
    whole = simulate_backbone(oscillator, p, LEVELS, release_amplitude=RELEASE)
    line("whole decay, compiled", seconds(runner(simulator, p, RELEASE, False), 31, 5), whole.values)
    for rtol in (1e-12, 1e-11, 1e-10, 1e-9):
        duration = seconds(lambda rtol=rtol: scipy_cycles(rtol), 5)
        # At SciPy's own cycles, so that no interpolation is counted as its error.
        amplitude, frequency, decrement = scipy_cycles(rtol)[:, ::-1]
        own = simulate_backbone(oscillator, p, amplitude, sensitivities=True)
        f, d = np.abs(frequency / own.frequency - 1).max(), np.abs(decrement / own.damping - 1).max()
        print(f"  {f'whole decay, SciPy at {rtol:g}':30s} {duration * 1e6:10.1f} us   {f:12.1e} {d:16.1e}   "
              f"x {duration / fast:.0f}")  # fmt: skip
    f, d = np.abs(reference / exact.values[:2] - 1).max(axis=1)
    print(f"  SciPy at 1e-13, a spline between its cycles against one cycle per level: {f:.1e}, {d:.1e}")
    for release, name in ((0.0, "one cycle per level"), (RELEASE, "whole decay")):
        plain = seconds(runner(simulator, p, release, False), 51, 10)
        both = seconds(runner(simulator, p, release, True), 51, 10)
        print(f"  sensitivities, {name}: x {both / plain:.2f} ({both * 1e6:.0f} us)")


def per_effect() -> None:
    """Print the cost of ten levels for each effect, relative to the linear oscillator."""
    amplitude, omega = LEVELS[-1], np.sqrt(K / MASS)
    base = None
    print("Effect                             ten levels   to linear   with sensitivities   waveform (50 cycles x 40)")
    for name in ("linear", *(name for name in LIBRARY if name not in BASE_EFFECTS)):
        oscillator = Oscillator(MASS, () if name == "linear" else name)
        bounds = oscillator.default_bounds(amplitude, omega).values()
        p = np.array([low + (0.2 + 0.037 * i) * (high - low) for i, (low, high) in enumerate(bounds)])
        p[:2] = K, 0.02 * np.sqrt(K * MASS)
        simulator = Simulator(oscillator)
        plain = seconds(runner(simulator, p, 0.0, False), 21, 5)
        both = seconds(runner(simulator, p, 0.0, True), 21, 5)
        instants = np.arange(2000) * 2 * np.pi / omega / 40
        wave = seconds(lambda o=oscillator, p=p, t=instants: simulate_waveform(o, p, t, amplitude), 7)
        base = base or plain
        print(f"  {name:30s} {plain * 1e6:9.0f} us {plain / base:9.1f} {both / plain:15.2f} {wave * 1e6:17.0f} us")


REMEMBERING = {
    "bouc_wen": (65.0, 1.0, 0.0, 20.0, 8.0, 1.0),
    "bouc_wen, cubic_stiffness": (65.0, 1.0, 0.0, 60.0, 30.0, 1.5, -1e5),
    "bouc_wen, iwan": (65.0, 1.0, 0.0, 20.0, 8.0, 1.0, 100.0, 20.0, -0.5),
    "iwan": (300.0, 20.0, -0.5),
}


def jumps_against_whole_decay() -> None:
    """Print what leaving out cycles between ten levels over a factor of 50 saves and costs, from the same release."""
    global LEVELS
    LEVELS = np.geomspace(0.03 / 50.0, 0.03, 10)
    print("Ten levels over a factor of 50       whole decay   with derivatives   to jumps: values, derivatives   "
          "largest difference: frequency, damping (relative), derivatives (of their largest)")  # fmt: skip
    for names, own in REMEMBERING.items():
        oscillator = Oscillator(MASS, names.split(", "))
        p = np.array([K, 0.003 * np.sqrt(K * MASS), *own])
        simulator = Simulator(oscillator)
        release = 1.25 * LEVELS[-1]
        times = [seconds(runner(simulator, p, r, s), 7) for r in (release, 0.0) for s in (False, True)]
        whole = simulate_backbone(oscillator, p, LEVELS, release_amplitude=release, sensitivities=True)
        jumps = simulate_backbone(oscillator, p, LEVELS, sensitivities=True)
        f, d = (np.abs(jumps.values[o] / whole.values[o] - 1.0).max() for o in (0, 1))
        both = whole.jacobian[1], jumps.jacobian[1]
        size = np.maximum(np.abs(both[0]).max(axis=0), 1e-9 * np.abs(both[0] * p).max() / np.maximum(np.abs(p), 1e-30))
        slopes = (np.abs(both[1] - both[0]) / size).max()
        print(f"  {names:32s} {times[0] * 1e3:9.1f} ms {times[1] * 1e3:12.1f} ms   x {times[0] / times[2]:.1f}, "
              f"x {times[1] / times[3]:.1f}   {f:.1e}, {d:.1e}, {slopes:.1e}")  # fmt: skip


if __name__ == "__main__":
    start = time.process_time()
    simulate_backbone(Oscillator(MASS, ()), [K, C], LEVELS)
    print(f"first call: {time.process_time() - start:.2f} s CPU (compiling, or loading from disk)")
    against_scipy()
    per_effect()
    jumps_against_whole_decay()
