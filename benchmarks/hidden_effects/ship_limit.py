"""How often one roll decay can tell drag from damping that rises with the displacement, at best; prints one line each.

    python benchmarks/hidden_effects/ship_limit.py

A ship with exactly the published damping, B1 x' + B2 |x'| x' over an inertia A44, is solved by SciPy over as many
cycles as the record of ``known.md`` holds. Its decrements get the scatter from cycle to cycle that the record has, and
two lines are fitted to them: in the amplitude (drag with the square of the speed) and in its square (damping with x^2,
or cubic drag, whose decrement is the same). Both have the right noise and know of no other law.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

INERTIA, LINEAR, QUADRATIC = 135.0, 0.54, 14.95  # kg m^2, N m s, N m s^2
FREQUENCY, RELEASE, CYCLES = 0.39, np.radians(8.9), 25  # Hz, rad
SCATTER = 0.0018  # of the decrement, from one cycle to the next
COPIES, ODDS = 4000, 19.0


def decrements() -> tuple[np.ndarray, np.ndarray]:
    """Return amplitude [rad] and logarithmic decrement of each cycle."""
    square = (2.0 * np.pi * FREQUENCY) ** 2

    def rate(_: float, state: np.ndarray) -> list[float]:
        moment = (LINEAR + QUADRATIC * abs(state[1])) * state[1] / INERTIA
        return [state[1], -square * state[0] - moment]

    def turns(_: float, state: np.ndarray) -> float:
        return state[1]

    turns.direction = -1.0  # peaks
    span = (0.0, (CYCLES + 1.5) / FREQUENCY)
    solved = solve_ivp(rate, span, [RELEASE, 0.0], events=turns, rtol=1e-10, atol=1e-12, max_step=0.05 / FREQUENCY)
    later = solved.t_events[0] > 0.5 / FREQUENCY  # the release is a peak as well
    peaks = np.concatenate([[RELEASE], solved.y_events[0][later, 0]])[: CYCLES + 1]
    return np.sqrt(peaks[1:] * peaks[:-1]), np.log(peaks[:-1] / peaks[1:])


def residual(values: np.ndarray, abscissa: np.ndarray) -> np.ndarray:
    """Return the sum of squares (n,) of each row of values beside its best line."""
    basis = np.linalg.qr(np.column_stack([np.ones_like(abscissa), abscissa]))[0]
    return (values**2).sum(axis=1) - ((values @ basis) ** 2).sum(axis=1)


def main() -> None:
    """Print the shares for the scatter of the record and for half of it."""
    amplitude, decrement = decrements()
    print(
        f"decrement {decrement[0]:.4f} to {decrement[-1]:.4f}, amplitude {np.degrees(amplitude[[0, -1]]).round(1)} deg"
    )
    for scatter in (SCATTER, 0.5 * SCATTER):
        noise = np.random.default_rng(1).standard_normal((COPIES, CYCLES))
        values = decrement + scatter * noise
        gain = 0.5 * (residual(values, amplitude**2) - residual(values, amplitude)) / scatter**2
        share = float(np.mean(gain > np.log(ODDS)))
        print(f"scatter {scatter:g}: drag {ODDS:g} times likelier in {share:.0%} of {COPIES}")


if __name__ == "__main__":
    main()
