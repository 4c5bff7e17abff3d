"""What the evidence of a drift beside a set gains where it may be absent, alike in all records, or of each one."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from ..._common.checks import FloatArray
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import DRIFTS

_KINDS = ((0.25, 0.5, 0.25), (0.5, 0.25, 0.25))  # priors of none, common and own: of frequency, of damping
_SIZES = (1.0, 0.1, 0.01)  # of a drift that is common to all records, in units of drift: each as probable
_APART = (0.2, 0.06, 0.02)  # of a common drift, by which the records differ in it: each as probable


def drift_bonus(drifting: Fit, alone: Fit) -> float:
    """Return by how much the drift's evidence grows where it may be alike in all records, or of one kind only.

    The fit gives every record drifts of its own. Here, given these with their errors, each kind is absent, common to
    all records up to a scatter of 2 to 20 %, or independent; beforehand, a stiffness that follows the temperature is
    the most probable. No way to see drifts takes away more than they cost: a fit that ended far from the records, at
    drifts of no meaning, gains that.

    Drifts of each record its own take the place of differences between specimens. What the scatter of the effects gains
    by these drifts counts as far as they are of that kind; else it is that of the set ``alone``, if less.
    """
    bonus, is_none_own = 0.0, 1.0
    for column, prior in zip(DRIFTS, _KINDS, strict=True):
        value = drifting.state.own[:, column]
        variance = np.clip(np.nan_to_num(drifting.own_covariance[:, column], nan=1.0), 1e-12, 1.0 - 1e-9)
        noise = 1.0 / (1.0 / variance - 1.0)
        measured_drift = value * noise / variance
        weight = 1.0 / noise
        mean = float((weight * measured_drift).sum() / weight.sum())
        scatters = [(share * mean) ** 2 for share in _APART]
        common = [_log_normal(measured_drift, noise + apart, size**2) for size in _SIZES for apart in scatters]
        logs = [
            _log_normal(measured_drift, noise),
            float(logsumexp(common)) - float(np.log(len(common))),
            _log_normal(measured_drift, noise + 1.0),
        ]
        total = float(logsumexp(logs, b=prior))
        is_none_own *= max(1.0 - prior[-1] * float(np.exp(logs[-1] - total)), 0.0)  # rounding may make it less
        cost = 0.5 * float(value @ value) - 0.5 * float(np.log(variance).sum())
        bonus += min(total - logs[-1], cost)
    gained = drifting.scatter.log_evidence - alone.scatter.log_evidence
    if not gained > 0.0:
        return bonus
    return bonus + float(np.logaddexp(np.log(max(1.0 - is_none_own, 1e-300)), np.log(is_none_own + 1e-300) - gained))


def _log_normal(value: FloatArray, variance: FloatArray, common: float = 0.0) -> float:
    """Return the logarithm of a normal density at ``value``, up to a constant: with a variance that all share."""
    weight = 1.0 / variance
    shared = 1.0 + common * float(weight.sum())  # by Sherman, Morrison and Woodbury
    squares = float(weight @ value**2) - common * float(weight @ value) ** 2 / shared
    return -0.5 * squares - 0.5 * (float(np.log(variance).sum()) + float(np.log(shared)))


__all__ = ["drift_bonus"]
