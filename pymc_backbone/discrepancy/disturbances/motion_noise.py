"""Noise that grows with the motion: a clock that jitters, a sensor whose noise is a share of its reading.

Samples of large motion then say less than their number, and what they scatter is taken for physics. What a set leaves
beside the slowly varying harmonics of the motion is noise whatever the set; how it grows with the motion is found from
that, and the samples count accordingly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from ..._common.checks import FloatArray
from ..fitting.batch import Batch
from ..fitting.record_term import orthogonal_to
from ..fitting.waveform_term import Subspace, WaveformTerm
from ..sets.search import Search
from ..weighing import evidence

_GAIN = 20.0  # of the log-likelihood of all records, from which the noise is said to grow
_ALIKE = 0.1  # correlation of neighbouring samples up to which what is beside the harmonics is noise
_HIGHEST = 0.1  # share of the bins that are highest
_IN_LINES = 0.5  # of the power in these, from which it stands in lines: noise has 0.33
_DECADES = (-2.0, 3.0)  # of the noise that moves with the motion, over that at rest


class _Found(NamedTuple):
    """How the noise of one record grows: with its rate or its envelope, by how much, and what that gains.

    ``factor`` is over the noise at rest, which the record need not show; ``times`` over that of its smallest motion.
    """

    is_of_rate: bool
    factor: float
    times: float
    gain: float


@dataclass(frozen=True, eq=False)
class MotionNoise:
    """How the noise of each record grows with its motion."""

    by_specimen: dict[str, _Found]

    def weighed(self, batch: Batch) -> Batch:
        """Return a batch whose samples count by the noise that they have."""
        terms = [
            _weighed(term, _course(term, self.by_specimen[name].is_of_rate), self.by_specimen[name].factor)
            if name in self.by_specimen
            else term
            for name, term in zip(batch.specimens, batch.waveform, strict=True)
        ]
        return replace(batch, waveform=tuple(terms))

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        low, high = (f"{pick(item.times for item in self.by_specimen.values()):.2g}" for pick in (min, max))
        times = low if low == high else f"{low} to {high}"
        how = "the clock jitters" if self._is_of_rate else "a sensor's noise is a share of its reading"
        return (
            f"warning: the noise grows with the motion, {times} times from the smallest to the largest of a record, "
            f"as where {how}; samples count by the noise that they have"
        )

    @property
    def _is_of_rate(self) -> bool:
        return sum(item.gain * (1.0 if item.is_of_rate else -1.0) for item in self.by_specimen.values()) > 0.0


def motion_noise(search: Search) -> MotionNoise | None:
    """Return how the noise beside the harmonics of the motion grows with it; None where it does not.

    Nor where neighbouring samples are alike, or most of the power stands in lines: a law that no set holds has
    harmonics beyond those that are looked at, and another mode has a line, which decays with the motion.
    """
    batch = search.batch
    if not batch.has_open_records:
        return None
    best = search.fits[search.best()]
    found = {}
    for r, (name, term) in enumerate(zip(batch.specimens, batch.waveform, strict=True)):
        if not term.subspace:
            return None
        left, share = _beside(evidence.residuals_of(term, best, r), term.subspace)
        if float(left[1:] @ left[:-1]) > _ALIKE * float(left @ left):
            return None  # no noise of samples, but something that moves
        if _stands_in_lines(left, float(share.mean())):
            return None
        found[name] = max((_grown(term, left, share, kind) for kind in (True, False)), key=_gain_of)
    return MotionNoise(found) if sum(item.gain for item in found.values()) > _GAIN else None


def _gain_of(found: _Found) -> float:
    return found.gain


def _beside(residuals: FloatArray, subspace: Subspace) -> tuple[FloatArray, FloatArray]:
    """Return what residuals hold beside what a model error looks like, and the share of each sample that is free."""
    left, share = np.zeros(residuals.size), np.zeros(residuals.size)
    for window, basis in subspace:
        left[window] = residuals[window] - basis @ (basis.T @ residuals[window])
        share[window] = 1.0 - basis.shape[1] / basis.shape[0]
    return left, share


def _stands_in_lines(left: FloatArray, share: float) -> bool:
    """Return whether a few bins of the spectrum hold most of the power; ``share`` of them is free to hold any."""
    power = np.sort(np.abs(np.fft.rfft(left)) ** 2)[::-1]
    highest = max(round(_HIGHEST * share * power.size), 1)
    return float(power[:highest].sum()) > _IN_LINES * float(power.sum())


def _course(term: WaveformTerm, is_of_rate: bool) -> FloatArray:
    """Return the square of the rate, or its mean over each cycle, at each value; one at the largest motion.

    From the values before and after: the noise of a value makes no rate of its own.
    """
    square = term.standing(np.gradient(term.means_of(term.values)) ** 2)
    smooth = _over_cycles(square, term)
    course: FloatArray = (square if is_of_rate else smooth) / smooth.max()
    return course


def _over_cycles(course: FloatArray, term: WaveformTerm) -> FloatArray:
    """Return the running mean over a cycle."""
    per_cycle = max(round(course.size / term.cycles), 1)
    padded = np.pad(course, per_cycle, mode="reflect")
    smooth: FloatArray = np.convolve(padded, np.full(per_cycle, 1.0 / per_cycle), mode="same")[per_cycle:-per_cycle]
    return smooth


def _grown(term: WaveformTerm, left: FloatArray, share: FloatArray, is_of_rate: bool) -> _Found:
    """Return by how much noise grows with the course of the motion: the most likely, its level at rest free."""
    course = _course(term, is_of_rate)
    squares, count = left**2, float(share.sum())

    def misfit(log_factor: float) -> float:
        variance = 1.0 + 10.0 ** (2.0 * log_factor) * course
        return 0.5 * float(share @ np.log(variance)) + 0.5 * count * float(np.log((squares / variance).sum()))

    solved = minimize_scalar(misfit, bounds=_DECADES, method="bounded")
    gain = 0.5 * count * float(np.log(squares.sum())) - float(solved.fun)
    if not gain > 0.0:
        return _Found(is_of_rate, 0.0, 1.0, 0.0)
    factor = 10.0 ** float(solved.x)
    mean = 1.0 + factor**2 * _over_cycles(course, term)
    return _Found(is_of_rate, factor, float(np.sqrt(mean.max() / mean.min())), gain)


def _weighed(term: WaveformTerm, course: FloatArray, factor: float) -> WaveformTerm:
    """Return a term whose standardised values have the variance that they are given."""
    weight = 1.0 / np.sqrt(1.0 + factor**2 * course)
    subspace, beside = [], []
    for window, basis in term.subspace:
        subspace.append((window, np.linalg.qr(weight[window, None] * basis)[0]))
    for (window, basis), (_, between) in zip(subspace, term.beside, strict=True):
        beside.append((window, orthogonal_to(basis, weight[window, None] * between)))
    return replace(term, whiten=_weighing(term.whiten, weight), subspace=subspace, beside=beside)


def _weighing(whiten: Callable[[FloatArray], FloatArray], weight: FloatArray) -> Callable[[FloatArray], FloatArray]:
    def weighed(columns: FloatArray) -> FloatArray:
        result: FloatArray = whiten(columns) * weight[:, None]
        return result

    return weighed


__all__ = ["MotionNoise", "motion_noise"]
