"""Noise-free free decays of every effect, integrated by SciPy half cycle by half cycle: an oracle of its own.

The direction of motion is constant inside a half cycle, so friction is exact; sliders (Jenkins, Iwan) are algebraic
inside a half cycle given
their force at the last turning point. Natural period about 1 s, mass 1, release amplitude 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

STIFFNESS = (2 * np.pi) ** 2
SLIDERS = 300


@dataclass(frozen=True)
class Truth:
    """One noise-free decay: samples on demand, and its exact cycles."""

    name: str
    half_cycles: tuple
    stop_time: float
    stop_value: float
    turning_times: np.ndarray
    turning_values: np.ndarray
    cycles: dict[str, np.ndarray]
    dense: dict[str, np.ndarray] | None = None

    def sample(self, time: np.ndarray) -> np.ndarray:
        """Return the displacement at ``time``; constant after the motion has stopped."""
        values = np.full(time.shape, self.stop_value)
        for start, end, dense in self.half_cycles:
            inside = (time >= start) & (time < end)
            if inside.any():
                values[inside] = dense(time[inside])[0]
        return values

    def at(self, observable: str, levels: np.ndarray) -> np.ndarray:
        """Return the true backbone at amplitude ``levels``, from the noise-free cycles."""
        table = self.cycles if self.dense is None else self.dense
        order = np.argsort(table["amplitude"])
        x = np.log(table["amplitude"][order])
        return PchipInterpolator(x, table[observable][order])(np.log(levels))


# name: (force added to k x + c v, viscous damping ratio); a force takes (x, v, direction, memory)
def _force_terms(name: str, scale: float = 1.0):
    k = STIFFNESS
    s = scale
    return {
        "linear": lambda x, v, d: 0.0,
        "cubic_stiffness": lambda x, v, d: s * 0.3 * k * x**3,
        "quintic_stiffness": lambda x, v, d: s * 0.3 * k * x**5,
        "quadratic_stiffness": lambda x, v, d: s * 0.25 * k * x**2,
        "bilinear_stiffness": lambda x, v, d: s * 0.3 * k * max(x, 0.0),
        "pendulum_stiffness": lambda x, v, d: s * k * (np.sin(x) - x),
        "freeplay": lambda x, v, d: s * 0.4 * k * (np.sign(x) * max(abs(x) - 0.3, 0.0)),
        "coulomb_friction": lambda x, v, d: s * 0.006 * k * d,
        "quadratic_damping": lambda x, v, d: s * 0.04 * v * v * d,
        "cubic_damping": lambda x, v, d: s * 0.008 * v**3,
        "displacement_dependent_damping": lambda x, v, d: s * 1.0 * x * x * v,
    }.get(name)


EFFECTS = (
    "linear",
    "cubic_stiffness",
    "quintic_stiffness",
    "quadratic_stiffness",
    "bilinear_stiffness",
    "pendulum_stiffness",
    "freeplay",
    "coulomb_friction",
    "quadratic_damping",
    "cubic_damping",
    "displacement_dependent_damping",
    "bouc_wen",
    "jenkins",
    "iwan",
)


def make_truth(name: str, *, damping_ratio: float = 0.005, n_cycles: int = 60, release: float = 1.0) -> Truth:
    """Integrate the decay of one effect from ``release`` at time 0 over at most ``n_cycles`` cycles."""
    k, c = STIFFNESS, 2 * damping_ratio * 2 * np.pi
    force = _force_terms(name)
    bouc_wen = name == "bouc_wen"
    sliders = None
    if name == "jenkins":
        sliders = (np.array([0.15 * k]), np.array([0.15 * k * 0.35]))
    elif name == "iwan":
        slip = (np.arange(SLIDERS) + 0.5) / SLIDERS * 1.5
        sliders = (np.full(SLIDERS, 0.2 * k / SLIDERS), 0.2 * k / SLIDERS * slip)
    # pulled from rest to the release: the states are loaded along the virgin curve
    memory = None if sliders is None else np.minimum(sliders[0] * release, sliders[1])
    x_turn = release

    def slider_force(x: float) -> np.ndarray:
        return np.clip(memory + sliders[0] * (x - x_turn), -sliders[1], sliders[1])

    def rates(t, y, direction):
        x, v = y[0], y[1]
        total = k * x + c * v
        if force is not None:
            total += force(x, v, direction)
        if sliders is not None:
            total += slider_force(x).sum()
        if bouc_wen:
            z = y[2]
            total += 0.15 * k * z
            return [v, -total, v - 1.5 * abs(v) * z - 0.5 * v * abs(z)]
        return [v, -total]

    def turning(t, y, direction):
        return y[1]

    turning.terminal = True
    half_cycles, times, values = [], [0.0], [release]
    state = np.array([release, 0.0, 0.5 * (1.0 - np.exp(-2.0 * release))] if bouc_wen else [release, 0.0])
    now, direction, stop = 0.0, -1.0, None
    for _ in range(2 * n_cycles + 2):
        acceleration = rates(now, state, direction)[1]
        if acceleration * direction <= 0.0:
            stop = (now, state[0])
            break
        turning.direction = -direction
        # leave the turning point by its Taylor series, so that the event is not found at once
        solution = solve_ivp(
            rates, (now, now + 2.0), state, method="DOP853", rtol=1e-11, atol=1e-13, dense_output=True, events=turning,
            args=(direction,), max_step=0.02, first_step=1e-4,
        )  # fmt: skip
        end = solution.t_events[0][0]
        half_cycles.append((now, end, solution.sol))
        new_state = solution.y_events[0][0].copy()
        new_state[1] = 0.0
        if sliders is not None:
            memory = slider_force(new_state[0])
            x_turn = new_state[0]
        now, state, direction = end, new_state, -direction
        times.append(now)
        values.append(state[0])
        if abs(state[0]) < 1e-3:
            break
    if stop is None:
        stop = (now, np.nan)
    times, values = np.array(times), np.array(values)
    t0, t1, p0, q, p1 = times[:-2:2], times[2::2], values[:-2:2], values[1:-1:2], values[2::2]
    amplitude = (p0 + p1 - 2 * q) / 4
    cycles = {
        "time": (t0 + t1) / 2,
        "amplitude": amplitude,
        "frequency": 1 / (t1 - t0),
        "damping": 2 * np.log((p0 - q) / (p1 - q)),
        "offset": ((p0 + p1) / 2 + q) / 2 / amplitude,
    }
    return Truth(name, tuple(half_cycles), stop[0], stop[1], times, values, cycles)


MEMORY = ("bouc_wen", "jenkins", "iwan")


def make_dense_truth(name: str, **options) -> Truth:
    """Add decays from other releases, so that the backbone between two cycles is known (not with memory)."""
    truth = make_truth(name, **options)
    if name in MEMORY:
        return truth
    ratio = truth.turning_values[2] / truth.turning_values[0]
    shares = (0.2, 0.4, 0.6, 0.8)
    tables = [truth.cycles, *(make_truth(name, **options, release=ratio**share).cycles for share in shares)]
    dense = {key: np.concatenate([table[key] for table in tables]) for key in truth.cycles}
    return replace(truth, dense=dense)


if __name__ == "__main__":
    for effect in EFFECTS:
        truth = make_truth(effect)
        show = {
            key: np.round(value[[0, 1, len(value) // 2, -1]], 5) for key, value in truth.cycles.items() if key != "time"
        }
        print(effect, len(truth.cycles["time"]), show, np.round((truth.stop_time, truth.stop_value), 4))
