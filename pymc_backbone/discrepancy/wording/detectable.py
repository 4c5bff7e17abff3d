"""What would have been seen: the smallest strength of each effect that the data would have shown."""

from __future__ import annotations

import numpy as np

from ..._common.text import unit_of
from ..fitting import starts
from ..fitting.curves import curve
from ..fitting.joint_fit import parameters_of
from ..fitting.normal_equations import State
from ..results.entries import Detectable
from ..sets.search import Search
from ..weighing.evidence import DETECTED
from .words import largest


def detectable(search: Search) -> tuple[Detectable, ...]:
    """Return the smallest strength of each single effect that these data would have shown."""
    batch, rows = search.batch, []
    levels = np.asarray(batch.backbones["level"])
    for name in search.candidates:
        found = search.fits.get((name,))
        if found is None or not np.isfinite(found.covariance).all():
            continue
        where = starts.positions(found.layout, name)
        error = float(np.sqrt(max(found.covariance[where[0], where[0]], 0.0)))
        if not error > 0.0 or error > 2.0 * found.layout.width[where[0]]:
            rows.append(Detectable(name, found.layout.names[where[0]], float("nan"), "", float("nan"), float("nan")))
            continue
        eta = found.state.eta.copy()
        eta[where[0]] = DETECTED * error
        strong = State(eta, found.state.own)
        values, _ = found.layout.physical(eta, np.zeros(eta.size), 0.0)
        release = search.batch.levels[search.reference].release
        on = curve(found, parameters_of(found.layout, strong, search.reference), levels, release)
        eta_off = eta.copy()
        eta_off[where[0]] = 0.0
        weak = State(eta_off, found.state.own)
        off = curve(found, parameters_of(found.layout, weak, search.reference), levels, release)
        with np.errstate(invalid="ignore", divide="ignore"):
            change = np.abs(on / off - 1.0)
        place = where[0]
        for stiffness, force in found.layout.slips:
            place = force if stiffness == where[0] else place
        parameter = search.layout((name,)).oscillator.parameters[int(found.layout.free[place])]
        rows.append(
            Detectable(
                effect=name,
                parameter=parameter.name,
                value=float(values[place]),
                unit=unit_of(parameter.unit, search.batch.amplitude_unit),
                frequency=largest(change[0]),
                damping=largest(change[1]),
            )
        )
    return tuple(rows)


__all__ = ["detectable"]
