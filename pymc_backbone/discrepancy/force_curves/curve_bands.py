"""Force curves over what the motion visited, with bands that hold everywhere at once."""

from __future__ import annotations

import numpy as np

from ..._common.checks import FloatArray
from ..fitting.batch import Batch
from ..fitting.data_term import TOLERANCE
from ..fitting.waveform_term import WaveformTerm
from ..results.curve_records import Band, Bands
from .curve_fit import CurveFit
from .tabulated import DAMPING, STIFFNESS

POINTS = 41
"""Points of a curve between zero and the end of what was visited."""
_DRAWS = 4000
_COVERED = 0.95


def visited(batch: Batch, found: CurveFit) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ranges of displacement and of speed in the records, by what the fit says that the motion was."""
    reached = np.zeros((2, 2))
    for r, term in enumerate(batch.waveform):
        for order, ends in enumerate(_moved(term, found, r)):
            reached[order] = min(reached[order, 0], ends[0]), max(reached[order, 1], ends[1])
    (low, high), (slow, fast) = reached.tolist()
    return (low, high), (slow, fast)


def _moved(term: WaveformTerm, found: CurveFit, specimen: int) -> list[tuple[float, float]]:
    """Return least and largest displacement, and velocity, of a specimen within its record."""
    fit = found.fit
    vector = fit.parameters(specimen)
    release, release_time = fit.state.own[specimen, 2:4]
    duration = float(term.time[-1]) - release_time
    begin = max(float(term.time[0]) - release_time, 0.0)
    time = np.linspace(begin, duration, max(16 * int(term.cycles), 64))
    ends = []
    for order in (0, 1):
        values = fit.layout.simulator.waveform(
            vector, release, time, order, tolerance=TOLERANCE, maximum=term.most_turns
        )[0]
        known = values[np.isfinite(values)]
        ends.append((float(known.min()), float(known.max())))
    return ends


def bands_of(batch: Batch, found: CurveFit, seed: int) -> Bands:
    """Return the curves with their bands, over what was visited and nothing beyond it."""
    (low, high), (slow, fast) = visited(batch, found)
    rng = np.random.default_rng(seed)
    made = []
    for effect, first, last in ((STIFFNESS, low, high), (DAMPING, slow, fast)):
        whole = np.unique(np.concatenate([np.linspace(first, 0.0, POINTS), np.linspace(0.0, last, POINTS)]))
        half = np.linspace(0.0, min(-first, last), POINTS)
        made.append(_band(found, effect, whole, rng, 0.0))
        made += [_band(found, effect, half, rng, sign) for sign in (-1.0, 1.0)]
    return Bands(*made)


def rows_of(found: CurveFit, effect: str, at: FloatArray, mirrored: float = 0.0) -> FloatArray:
    """Return the matrix that takes the mean specimen's (k, c, shared coordinates) to forces at some places.

    With ``mirrored`` -1 or 1 to the odd or the even part.
    """
    rows = np.zeros((at.size, 2 + found.fit.layout.free.size))
    rows[:, 2:] = found.tabulated.forces(effect, at)
    if effect == DAMPING:
        rows[:, 1] = at
    if mirrored:
        # at rest the force of friction is that just beyond it
        other = rows_of(found, effect, np.where(at == 0.0, -1e-12 * max(float(np.abs(at).max()), 1e-300), -at))
        return 0.5 * (rows + mirrored * other)
    return rows


def mean_values(found: CurveFit) -> FloatArray:
    """Return the mean specimen's (k, c, shared coordinates)."""
    return np.concatenate([found.fit.state.own[:, :2].mean(axis=0), found.fit.state.eta])


def _band(found: CurveFit, effect: str, at: FloatArray, rng: np.random.Generator, mirrored: float) -> Band:
    if mirrored > 0.0 and not found.tabulated.has_even:
        return Band(at, *np.zeros((4, at.size)))
    rows = rows_of(found, effect, at, mirrored)
    force = rows @ mean_values(found) + _beyond(found, effect, at, mirrored)
    covariance = rows @ found.mean_covariance @ rows.T
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    factor = simultaneous(covariance, rng)
    return Band(at, force, force - factor * error, force + factor * error, error)


def _beyond(found: CurveFit, effect: str, at: FloatArray, mirrored: float) -> FloatArray:
    """Return what a curve has beyond the one of its nodes at some places; at rest, that just beyond it."""
    if effect not in found.beyond:
        return np.zeros(at.size)
    places, forces = found.beyond[effect]
    first = float(places[places > 0.0].min())
    here: FloatArray = np.interp(np.where(at == 0.0, first, at), places, forces)
    if mirrored:
        here = 0.5 * (here + mirrored * np.interp(np.where(at == 0.0, -first, -at), places, forces))
    return here


def simultaneous(covariance: FloatArray, rng: np.random.Generator) -> float:
    """Return the number of standard errors that all points stay within together, with a probability of 95 %."""
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    held = error > 1e-9 * max(float(error.max()), 1e-300)
    if not held.any():
        return 0.0
    correlation = (covariance / np.outer(error, error).clip(1e-300))[np.ix_(held, held)]
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    draws = rng.standard_normal((_DRAWS, values.size)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return float(np.quantile(np.abs(draws).max(axis=1), _COVERED))
