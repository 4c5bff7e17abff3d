"""What a record is: the motion of a released specimen, and what a sensor and a converter make of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from motion import Decay, simulate
from strengths import log_uniform
from systems import pack

QUANTITIES = ("displacement", "velocity", "acceleration")
"""What can be measured, by how often the displacement is differentiated."""


@dataclass
class Record:
    """One record: what was measured and what it would have been without noise.

    ``exact`` is the measured quantity without noise and ``offset``; ``measured`` holds both and is rounded to the
    converter's steps. ``noise_sd`` is the standard deviation of noise and rounding together.
    """

    time: np.ndarray
    measured: np.ndarray
    exact: np.ndarray
    offset: float
    noise_sd: float
    release_amplitude: float
    release_time: float


@dataclass
class Batch:
    """Records of one batch and the truth about them, ready for JSON."""

    records: list[Record]
    truth: dict[str, Any] = field(default_factory=dict)


def draw_release_time(start: str, frequency: float, sampling: float, rng: np.random.Generator) -> float:
    """Return when a record's release happens [s]; negative where the record begins after it."""
    if start == "hold":
        return log_uniform(rng, 0.2, 3.0) / frequency + rng.uniform(0.0, 1.0) / sampling
    if start == "release":
        return 0.0
    return -rng.uniform(0.0, 1.0) / (sampling if rng.random() < 0.5 else frequency)


def respond(
    parameters: dict[str, float],
    release: float,
    time: np.ndarray,
    second: dict[str, float] | None,
    quantity: str = "displacement",
) -> tuple[np.ndarray, Decay]:
    """Return displacement, velocity or acceleration at ``time`` after the release, without noise."""
    share = second["share"] if second else 0.0
    decay = simulate(pack(parameters), (1.0 - share) * release, time)
    order = QUANTITIES.index(quantity)
    motion = np.vstack([decay.displacement, decay.rates])[order]
    if second:
        other = linear_decay(np.maximum(time, 0.0), second["frequency"], second["damping_ratio"], order)
        motion = motion + share * release * (other if order == 0 else np.where(time > 0.0, other, 0.0))
    return motion, decay


def linear_decay(time: np.ndarray, frequency: float, ratio: float, order: int = 0) -> np.ndarray:
    """Return the decay of a linear oscillator released from rest at one; ``frequency`` is the undamped one [Hz].

    Its displacement, or the derivative of that of ``order`` 1 or 2.
    """
    omega = 2.0 * math.pi * frequency
    root = -ratio * omega + 1j * omega * math.sqrt(1.0 - ratio**2)
    # x = Re(c exp(root t)) with x = 1 and x' = 0 at the release
    start = 1.0 + 1j * root.real / root.imag
    return np.real(start * root**order * np.exp(root * time))


def measure(
    time: np.ndarray,
    exact: np.ndarray,
    offset: float,
    noise_db: float,
    bits: int,
    release: float,
    scale: float,
    release_time: float,
    rng: np.random.Generator,
) -> Record:
    """Add offset and noise and round to the converter's steps; ``scale`` is the quantity at a displacement of one."""
    noise = scale * release / math.sqrt(2.0) * 10.0 ** (-noise_db / 20.0)
    step = 2.0 * 1.2 * scale * release / 2.0**bits
    measured = step * np.round((exact + offset + noise * rng.standard_normal(time.size)) / step)
    total = math.hypot(noise, step / math.sqrt(12.0))
    return Record(time, measured, exact, offset, total, release, release_time)
