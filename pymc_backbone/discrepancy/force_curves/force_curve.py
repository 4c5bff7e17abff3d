"""What the named part leaves, as forces: fitted from afar, judged, verified on specimens left out, put into words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._common.checks import FloatArray
from ...effects import BASE_EFFECTS
from ...oscillator import Oscillator
from ..checks.verify import held_out_specimens
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..fitting.normal_equations import DRIFTS, NUISANCES, ZERO, State
from ..fitting.scatter import SCATTER
from ..results.curve_records import ForceCurves
from ..weighing.evidence import UNEXPLAINED, lack_of_fit
from .curve_bands import bands_of, mean_values
from .curve_fit import CurveFit, fit_curves
from .curve_laws import with_laws
from .curve_words import Judgement, sentence
from .families import judged
from .tabulated import DAMPING, STIFFNESS, Tabulated, tabulate

_NUISANCES = (0, 1, 2, 3, 4)
_RELEASE = (2, 3, 4)
_WINDOW, _GROWTH, _SLOW_GROWTH = 12, 3, 1.5  # turning points of the first window, and by which factor it grows
_NEAR_NOISE = 1.3  # of the turning points' reduced chi-square, from which the samples take over
_LEAST_REACH = 0.3  # of the amplitude: over less the line is not known
_AMONG = 3  # last turning points of a record, whose amplitude it reaches
_MOST_LEFT = 0.15  # of the gap, up to which forces of displacement and speed can be what is missing
_HALF = 0.5  # of what the curves leave: what explains as much is named as the reason
_CLOSE = 0.05  # of what the model leaves, that curves leave at most which have found their way
_AS_WELL = 20.0  # chi-square by which a drift with time may leave more than the curves, and explain as much
_AGAIN, _WITH_DRIFT = 8, 12  # iterations
_ROUGHER = 10.0  # factor by which bends may be larger in square than inferred, in the errors


def force_curves(
    batch: Batch,
    start: Fit,
    rivals: Sequence[Fit],
    drifting: Fit | None,
    held_out_before: float,
    most: int,
    seed: int,
) -> ForceCurves | None:
    """Return what a model leaves of the records as forces; None without records, or where nothing can be simulated.

    Parameters
    ----------
    batch : Batch
        The data.
    start : Fit
        The model beside which the curves stand, as it was fitted.
    rivals : sequence of Fit
        Models with hysteresis: where one of them leaves far less, the force depends on the way as well.
    drifting : Fit or None
        The base with a drift in time: where all releases are alike, it may explain as much.
    held_out_before : float
        Reduced chi-square of the model on specimens left out.
    most : int
        Specimens that are left out in turn, at most.
    seed : int
        Of the bands.
    """
    if not batch.has_records:
        return None
    found = fit_remainder(batch, start.layout.oscillator, start)
    if found is None:
        return None
    judgement = _judgement(batch, start, found, rivals, drifting)
    told, shapes = judged(found)
    after = held_out_curves(batch, found, most) if most > 0 else float("nan")
    bands = bands_of(batch, found, seed)
    if judgement.p_value >= UNEXPLAINED:  # what leaves more than noise follows no law
        found = with_laws(found, told, shapes, bands)
        bands = bands_of(batch, found, seed)
    beside = tuple(effect.name for effect in start.layout.oscillator.effects if effect.name not in BASE_EFFECTS)
    return ForceCurves(
        is_possible=judgement.is_possible,
        sentence=sentence(judgement, told, batch.amplitude_unit, beside, found.tabulated.has_even),
        beside=beside,
        bands=bands,
        has_even=found.tabulated.has_even,
        proposals=told,
        share_left=judgement.share_left,
        p_value=judgement.p_value,
        held_out_before=held_out_before,
        held_out_after=after,
        oscillator=found.fit.layout.oscillator,
        parameters=_parameters(found),
    )


def fit_remainder(batch: Batch, oscillator: Oscillator, start: Fit | None = None) -> CurveFit | None:
    """Return the curves of a batch beside a model; ``start`` is the model's own fit, where its effects are known.

    From afar as other fits come: backbones, release, a growing window of turning points, samples. Where that leaves
    more than noise, the window grows again, slowly and with the smoothness inferred in each: friction that is taken too
    large at first ends the motion too early, from where no fit comes back. Damping may bend as fast anywhere, or
    faster close to rest: whichever the evidence asks for, with what the other says added to the errors.
    """
    scatter = SCATTER if start is None else start.layout.scatter
    lowest = min(float(np.abs(term.values[-_AMONG:]).max()) for term in batch.turning)
    reach, has_even = max(lowest, _LEAST_REACH * batch.amplitude), is_even_measured(batch)
    tabulated = tabulate(oscillator, batch, reach, scatter=scatter, has_even=has_even)
    begun = fit_curves(tabulated, batch.levels, _began(tabulated, batch, start), nuisances=(0, 1), iterations=15)
    if begun is None:
        return None
    state = _released(tabulated, batch, begun.fit.state)
    found = _approached(tabulated, batch, state, begun.precisions)
    if found is None or _has_lost_its_way(batch, found, start):
        patient = _approached(tabulated, batch, state, begun.precisions, is_patient=True)
        found = min((each for each in (found, patient) if each is not None), key=_left, default=None)
    if found is None:
        return None
    sharp = tabulate(oscillator, batch, reach, is_sharp=True, scatter=scatter, has_even=has_even)
    other = fit_curves(sharp, batch.waveform, found.fit.state, nuisances=_seen(batch), precisions=found.precisions)
    if other is None:
        return _widened(batch, found)
    best, rest = (found, other) if found.log_evidence >= other.log_evidence else (other, found)
    return _either(_widened(batch, best), rest)


def is_even_measured(batch: Batch) -> bool:
    """Return whether a record holds what an even force makes, a mid-line or a second harmonic: a band may lose both."""
    second = 2.0 * batch.angular_frequency / (2.0 * np.pi)
    return any(record.band is None or record.band[1] > second for record in batch.records)


def _seen(batch: Batch) -> tuple[int, ...]:
    """Return which of a specimen's own values the samples tell: behind a band no offset is left."""
    has_offset = any(record.band is None for record in batch.records)
    return _NUISANCES if has_offset else tuple(n for n in _NUISANCES if n != ZERO)


def _has_lost_its_way(batch: Batch, found: CurveFit, start: Fit | None) -> bool:
    """Return whether curves leave more than noise, and more than the small share of it that no force explains."""
    if lack_of_fit(batch, found.fit).p_value >= UNEXPLAINED:
        return False
    return start is None or _share_left(batch, start, found) > _CLOSE


def _share_left(batch: Batch, start: Fit, found: CurveFit) -> float:
    """Return what curves leave beyond noise over what the model leaves, as sizes; NaN where that is noise already."""
    count = float(sum(term.size for term in batch.waveform))
    before, after = float(start.chi_square.sum()) - count, max(_left(found) - count, 0.0)
    return float(np.sqrt(after / before)) if before > 0.0 else float("nan")


def _left(found: CurveFit) -> float:
    """Return the chi-square that curves leave."""
    return float(found.fit.chi_square.sum())


def _approached(
    tabulated: Tabulated, batch: Batch, state: State, precisions: FloatArray, *, is_patient: bool = False
) -> CurveFit | None:
    """Return the curves fitted to the samples by way of a growing window of turning points."""
    most, window = max(term.times.size for term in batch.turning), _WINDOW
    while True:
        terms = [term.first(window) for term in batch.turning]
        is_last = window >= most
        reached = fit_curves(
            tabulated, terms, state, nuisances=_NUISANCES, precisions=precisions, is_learning=is_last or is_patient,
            iterations=12 if is_last else 8 if is_patient else 5,
            goal=_NEAR_NOISE * sum(term.size for term in terms),
        )  # fmt: skip
        if reached is not None:
            state, precisions = reached.fit.state, reached.precisions
        if is_last:
            break
        window = int(window * (_SLOW_GROWTH if is_patient else _GROWTH))
    return fit_curves(tabulated, batch.waveform, state, nuisances=_seen(batch), precisions=precisions)


def _began(tabulated: Tabulated, batch: Batch, start: Fit | None) -> State:
    """Return a state without curves: the effects as they were fitted, all else from the records."""
    layout = tabulated.layout
    state = State(np.zeros(layout.free.size), np.zeros((len(batch.specimens), NUISANCES + layout.free.size)))
    state.own[:, :5] = batch.own
    if start is not None and start.layout.free.size:
        state.own[:, :2] = start.state.own[:, :2]
        for there, name in enumerate(start.layout.names):
            here = layout.names.index(name)
            state.eta[here] = start.state.eta[there]
            state.own[:, NUISANCES + here] = start.state.own[:, NUISANCES + there]
    return state


def _released(tabulated: Tabulated, batch: Batch, state: State) -> State:
    """Return a state with each specimen's release brought to the turning points."""
    own = state.own.copy()
    own[:, 2:5] = batch.own[:, 2:5]
    held = replace(tabulated.layout, low=state.eta.copy(), high=state.eta.copy())
    found = fit(
        held, batch.turning, State(state.eta, own), iterations=8, tolerance=1.0, nuisances=_RELEASE, has_scatter=False
    )
    if found is not None:
        own[:, 2:5] = found.state.own[:, 2:5]
    return State(state.eta, own)


def _widened(batch: Batch, found: CurveFit) -> CurveFit:
    """Return a fit whose errors are those with bends that may be larger, what these would change added.

    The inferred size of bends is that of the mean along a curve; where it bends most, at a kink, it is larger, and the
    smoothed curve is off there by more than its errors say.
    """
    rough = fit_curves(
        found.tabulated, batch.waveform, found.fit.state, nuisances=_seen(batch),
        precisions=found.precisions / _ROUGHER, is_learning=False, iterations=_AGAIN,
    )  # fmt: skip
    if rough is None:
        return found
    apart = mean_values(rough) - mean_values(found)
    covariance = rough.mean_covariance + np.outer(apart, apart)
    return replace(found, mean_covariance=covariance, fit=replace(found.fit, covariance=covariance[2:, 2:]))


def _either(best: CurveFit, rest: CurveFit) -> CurveFit:
    """Return a fit with what a less probable one says, as far as it is probable, added to its errors."""
    share = 1.0 / (1.0 + np.exp(min(best.log_evidence - rest.log_evidence, 700.0)))
    apart = mean_values(rest) - mean_values(best)
    covariance = (1.0 - share) * best.mean_covariance + share * (rest.mean_covariance + np.outer(apart, apart))
    return replace(best, mean_covariance=covariance, fit=replace(best.fit, covariance=covariance[2:, 2:]))


def _judgement(batch: Batch, start: Fit, found: CurveFit, rivals: Sequence[Fit], drifting: Fit | None) -> Judgement:
    """Return whether forces of displacement and speed can be what is missing and, where not, what speaks against it."""
    count = float(sum(term.size for term in batch.waveform))
    lack = lack_of_fit(batch, found.fit)
    after, share = max(_left(found) - count, 0.0), _share_left(batch, start, found)
    is_possible = lack.p_value >= UNEXPLAINED or share <= _MOST_LEFT
    why = ""
    if is_possible and drifting is not None and drifting.cost < found.fit.cost + _AS_WELL:
        why = "drift"
    if not is_possible:
        with_drift = fit_curves(
            found.tabulated, batch.waveform, found.fit.state, nuisances=(*_seen(batch), *DRIFTS),
            precisions=found.precisions, is_learning=False, iterations=_WITH_DRIFT,
        )  # fmt: skip
        if with_drift is not None and float(with_drift.fit.chi_square.sum()) - count < _HALF * after:
            why = "drift"
        elif any(float(rival.chi_square.sum()) - count < _HALF * after for rival in rivals):
            why = "hysteresis"
    return Judgement(is_possible, share, lack.p_value, why)


def held_out_curves(batch: Batch, found: CurveFit, most: int) -> float:
    """Return the reduced chi-square of specimens left out in turn, the curves from the others."""

    def refit(_model: Fit, others: Batch, state: State) -> Fit | None:
        solved = fit_curves(
            found.tabulated, others.waveform, _centred(found, state), nuisances=_seen(others),
            precisions=found.precisions, is_learning=False, iterations=_AGAIN,
        )  # fmt: skip
        return None if solved is None else _with_sizes(solved)

    held_out = held_out_specimens(batch, found.fit, None, most, refit)
    return float("nan") if held_out is None else held_out.before


def _centred(found: CurveFit, state: State) -> State:
    """Return a state in which the sizes of the curves add up to nothing."""
    eta, own = state.eta.copy(), state.own.copy()
    for effect in (STIFFNESS, DAMPING):
        places = found.tabulated.places(effect)
        mean = float(own[:, NUISANCES + places[0]].mean())
        eta[places] *= 1.0 + found.fit.layout.scatter * mean
        own[:, NUISANCES + places] -= mean
    return State(eta, own)


def _with_sizes(solved: CurveFit) -> Fit:
    """Return a fit whose covariance holds how much the sizes of the curves differ between specimens."""
    covariance, own = solved.fit.covariance.copy(), solved.fit.state.own.copy()
    for effect in (STIFFNESS, DAMPING):
        places = solved.tabulated.places(effect)
        sizes = solved.fit.layout.scatter * own[:, NUISANCES + places[0]]
        values = solved.fit.state.eta[places]
        covariance[np.ix_(places, places)] += float((sizes**2).mean()) * np.outer(values, values)
        own[:, NUISANCES + places] = 0.0
    return replace(solved.fit, covariance=covariance, state=State(solved.fit.state.eta, own))


def _parameters(found: CurveFit) -> dict[str, tuple[float, float]]:
    """Return value and standard error of every parameter of the mean specimen."""
    layout = found.fit.layout
    mean = mean_values(found)
    physical, slopes = layout.physical(mean[2:], np.zeros(layout.free.size), 0.0)
    errors = np.sqrt(np.maximum(np.diag(slopes @ found.mean_covariance[2:, 2:] @ slopes.T), 0.0))
    own = np.sqrt(np.maximum(np.diag(found.mean_covariance)[:2], 0.0))
    told = dict.fromkeys(layout.oscillator.parameter_names, (0.0, 0.0))
    told |= {name: (value, 0.0) for name, value in layout.held.items()}
    told |= {name: (float(mean[i]), float(own[i])) for i, name in enumerate(layout.oscillator.parameter_names[:2])}
    return told | {
        name: (float(value), float(error)) for name, value, error in zip(layout.names, physical, errors, strict=True)
    }
