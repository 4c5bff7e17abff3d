"""A whole decay, turning point by turning point, and what it has in common with the other ways to a backbone."""

from __future__ import annotations

import math

import numpy as np

from .._common.checks import FloatArray
from .counts import HALF_CYCLES
from .counts import count as note
from .curves import compiled
from .halfcycle import COMPLETED, RUNAWAY, STUCK, half_cycle
from .instants import DISPLACEMENT
from .memory import AMPLITUDE, CURSOR, N_SAMPLES, QUANTITY, SAMPLE_SLOPES, STEP, TIME, Turns, Waveform
from .pointers import address
from .run import Run

LARGEST_STEP_OF_DECAY = 1.5  # radians; between larger steps the error estimate is not to be trusted
_CHECK_PROGRESS = 400  # after so many turning points, and then each time so many


@compiled
def all_finite(p: FloatArray) -> bool:
    """Return whether all parameters are finite: a comparison with nan may take a force past it unnoticed."""
    for value in p:
        if not math.isfinite(value):
            return False
    return True


@compiled
def no_answer(k: int, values: FloatArray, jacobian: FloatArray) -> None:
    """Mark level ``k`` as not answered; ``jacobian`` may be empty."""
    for i in range(3):
        values[i, k] = np.nan
    for i in range(jacobian.shape[0]):
        for j in range(jacobian.shape[2]):
            jacobian[i, k, j] = np.nan


@compiled
def run_decay(run: Run, stop: float, more: int, maximum: int, turns: Turns, waveform: Waveform) -> tuple[int, int]:
    """Run on from a turning point, one by one, until a cycle is smaller than ``stop``, then ``more`` of them.

    Writes `Turns` and, at the instants of the `Waveform`, what it has room for. Returns how many turning points there
    are and the status that ended the decay.
    """
    n_samples = waveform.times.size
    run.integers[N_SAMPLES] = n_samples
    run.integers[SAMPLE_SLOPES] = 1 if waveform.slopes.shape[1] > 0 else 0
    run.integers[CURSOR] = 0
    run.integers[QUANTITY] = waveform.quantity
    memory = run.memory
    memory[STEP] = 0.0
    direction = -1.0 if run.y[0] > 0.0 else 1.0
    values = turns.values
    values[0] = run.y[0]
    turns.times[0] = memory[TIME]
    for c in range(run.columns):
        turns.slopes[0, c] = run.slopes[c]
        turns.time_slopes[0, c] = run.dt[c]
    count = 1
    code = COMPLETED if all_finite(run.p) else RUNAWAY
    while count < maximum and code == COMPLETED:
        code = half_cycle(
            address(run.integers), address(memory), address(run.p), direction,
            address(waveform.times), address(waveform.values), address(waveform.slopes),
        )  # fmt: skip
        if code != COMPLETED:
            break
        values[count] = run.y[0]
        turns.times[count] = memory[TIME]
        for c in range(run.columns):
            turns.slopes[count, c] = run.slopes[c]
            turns.time_slopes[count, c] = run.dt[c]
        count += 1
        direction = -direction
        if n_samples > 0 and run.integers[CURSOR] >= n_samples:
            break
        amplitude = np.inf
        if count > 2:
            amplitude = 0.25 * abs(values[count - 3] + values[count - 1] - 2.0 * values[count - 2])
        if amplitude < stop:
            maximum = min(maximum, count + more)
            stop = 0.0
        if stop > 0.0 and count % _CHECK_PROGRESS == 1:
            before = abs(values[count - _CHECK_PROGRESS] - values[count - _CHECK_PROGRESS + 1]) * 0.5
            # At ten times this pace of decay it would still take more turning points than there may be.
            pace = math.log(before / memory[AMPLITUDE]) / _CHECK_PROGRESS
            if not 10.0 * pace * (maximum - count) > math.log(memory[AMPLITUDE] / stop):
                break
    note(HALF_CYCLES, count)
    # What sticks stays where it is; after any other end there is no answer.
    held = 0.0 if code == STUCK else np.nan
    is_displacement = waveform.quantity == DISPLACEMENT
    for i in range(run.integers[CURSOR], n_samples):
        waveform.values[i] = held + (run.y[0] if is_displacement else 0.0)
        for c in range(waveform.slopes.shape[1]):
            waveform.slopes[i, c] = held + (run.slopes[c] if is_displacement and c < run.columns else 0.0)
    return count, code
