"""Whether specimens are alike, and whether backbones agree with what the samples name."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr

from ..._common.checks import FloatArray
from ..._common.text import per_cent
from ..fitting.batch import Batch
from ..fitting.curves import measured
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import NUISANCES
from ..results.entries import Check
from ..weighing.evidence import leaves_noise

_ALIKE = 4.0  # scatters as expected, that a specimen is off at least which is not alike
_EXPECTED = 8  # specimens that would have told that scatter as well as it is known beforehand
_RARE = 0.01  # how often the worst specimen of a batch is told where all are alike
_LITTLE, _LITTLE_OF_INEXACT = 0.01, 0.1  # of what the base leaves of the backbones, that sets may leave


def alike_check(batch: Batch, best: Fit, *, is_exact: bool = True) -> Check:
    """Say whether the specimens share one curve once each has its own stiffness and damping.

    Where no law is exact (``is_exact``), what it cannot follow would be taken for differences.
    """
    name = "specimens alike"
    if len(batch.specimens) < 2:
        return Check(name, True, "one specimen only: nothing to compare")
    delta, width = best.state.own[:, NUISANCES:], best.layout.scatter
    if delta.size and not is_exact:
        return Check(name, True, "not compared: what no law follows exactly would be taken for differences")
    if delta.size:
        with np.errstate(divide="ignore", invalid="ignore"):  # relative to the middle of the specimens
            apart = np.nan_to_num(best.state.eta * (1.0 + width * delta) / best.centre - 1.0)
        worst, parameter = np.unravel_index(int(np.argmax(np.abs(apart))), apart.shape)
        size = float(np.abs(apart[worst, parameter]))
        if size > _ALIKE * width and _is_outlier(apart[:, parameter], int(worst), width):
            return Check(
                name,
                False,
                f"{batch.specimens[worst]} needs an effect {per_cent(size)} off that of the batch; look at its "
                "record, or treat it apart",
            )
        inferred = best.scatter.value  # what each specimen was found at is drawn to the middle
        spread = inferred if np.isfinite(inferred) else float(np.sqrt((apart**2).mean()))
        return Check(name, True, f"the effects of the specimens scatter by {per_cent(spread)}")
    observables = [str(item) for item in batch.backbones["observable"].values]
    which = "frequency" if "frequency" in observables else observables[0]
    values = measured(batch)[0][:, observables.index(which)]
    shared = values[:, np.isfinite(values).all(axis=0)]
    if shared.shape[1] < 2:
        return Check(name, True, "the specimens share no range of amplitude: nothing to compare")
    scatter = float((shared / shared.mean(axis=1, keepdims=True)).std(axis=0).max())
    return Check(name, True, f"the {which} curves agree in shape within {per_cent(scatter)}")


def _is_outlier(values: FloatArray, at: int, width: float) -> bool:
    """Return whether one of some values is off by more than they scatter.

    Of a normal population whose scatter was expected to be ``width``, as so many other specimens would have shown it,
    each value is off its others' mean by a variable of Student's.
    """
    others = np.delete(values, at)
    freedom = _EXPECTED + others.size - 1
    scatter = np.sqrt((_EXPECTED * width**2 + ((others - others.mean()) ** 2).sum()) / freedom)
    apart = abs(values[at] - others.mean()) / (scatter * np.sqrt(1.0 + 1.0 / others.size))
    return bool(2.0 * stdtr(freedom, -apart) * values.size < _RARE)


def one_decay_check(batch: Batch, best: Fit, *, is_exact: bool = True, is_moved: bool = False) -> Check:
    """Say whether most records grow again after what was used of them, and that is no free decay of one mode.

    What is used of two modes that beat is a piece of the beat, and its change of amplitude no law. Where the best set
    leaves noise (``is_exact``: of the samples), what was used is the decay of one mode, whatever follows. What goes on
    moving the structures (``is_moved``) makes records grow again, too.
    """
    name = "one decay in each record"
    growing = [record.grows_again for record in batch.records]
    if not growing or 2 * sum(growing) <= len(growing) or (is_exact and leaves_noise(batch, best)):
        return Check(name, True, "what was used of the records is the decay of one mode, or nothing says otherwise")
    said = f"{sum(growing)} of {len(growing)} records grow again after what was used of them"
    if is_moved:
        return Check(name, True, f"{said}, as what goes on moving the structure makes them")
    return Check(
        name,
        False,
        f"{said}, and no set leaves noise there: where two modes beat, what was used is a piece of the beat, and no "
        "law is in it; keep one mode with `band`, or choose one decay with `start` and `stop`",
    )


def data_terms_check(
    batch: Batch,
    reduced: float,
    limit: float,
    *,
    before: float = 0.0,
    is_exact: bool = True,
    is_explained: bool = True,
    is_drifting: bool = False,
    is_of_two_sides: bool = False,
) -> Check:
    """Say whether the backbones agree with what the waveform names.

    They do up to a ``limit`` of the reduced chi-square, or a small share of what the model as it is leaves
    (``before``): their errors do not know the last thousandth. Where no law is exact (``is_exact``), none is there.
    ``is_explained`` says whether it names anything, ``is_drifting`` whether that is a drift with time alone: backbones
    take what goes with the time for what goes with the amplitude. ``is_of_two_sides``: what is named moves the
    mid-line, which is not measured where velocities or accelerations are, or restored and not known well enough.
    """
    name = "samples and backbones agree"
    if not batch.has_records:
        return Check(name, True, "backbones only: there is one data term")
    if not is_explained:
        return Check(name, True, "not compared: nothing known explains the records")
    if is_drifting:
        return Check(name, True, "not compared: backbones take a drift with time for a change with amplitude")
    if batch.is_behind_filter:
        said = "not compared: the backbones are those of records behind a filter, as the samples are compared"
        return Check(name, True, said)
    if is_of_two_sides and any(term.order for term in batch.waveform):
        said = "not compared: no displacement was measured, and without its mid-line backbones of two sides are off"
        return Check(name, True, said)
    if np.isfinite(reduced) and reduced < limit:
        said = f"the set that the samples want fits the backbones too (reduced chi-square {reduced:.2f})"
        return Check(name, True, said)
    if not are_far_off(reduced, limit, before, is_exact=is_exact):
        share = per_cent(np.sqrt(reduced / before))
        said = f"the set that the samples want leaves {share} of what the model as it is leaves of the backbones"
        return Check(name, True, said)
    law = "" if is_exact else "a law that is none of the library, "
    wanted = "the samples want this set" if is_exact else "of all sets this one is the most probable"
    said = (
        f"{wanted}, but it leaves the backbones at a reduced chi-square of {reduced:.3g}: {law}"
        "another mode, a drift with time or a release that is not free bends these; `band` and `start` leave out modes "
        "and releases"
    )
    return Check(name, False, said)


def are_far_off(reduced: float, limit: float, before: float, *, is_exact: bool) -> bool:
    """Return whether a set leaves more of the backbones than a ``limit``, and than a little of what the base leaves."""
    little = _LITTLE if is_exact else _LITTLE_OF_INEXACT
    return not (np.isfinite(reduced) and reduced < max(limit, little**2 * before))


__all__ = ["alike_check", "are_far_off", "data_terms_check", "one_decay_check"]
