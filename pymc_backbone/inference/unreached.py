"""Why no point of the prior reaches what was measured, in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._common.checks import OBSERVABLE_UNITS, FloatArray
from ..simulation.decay import simulate_backbone
from ..simulation.response import OscillatorResponse
from ..simulation.results import Status
from .targets import Target


def sentence(targets: Sequence[Target], values: Sequence[list[FloatArray]]) -> str:
    """Say which observable and level no prior point reaches.

    ``values`` holds the parameters of each target at every point drawn from the prior.
    """
    for target, thetas in zip(targets, values, strict=True):
        simulated = np.array([target.simulated(theta) for theta in thetas])
        failed = np.isnan(simulated).any(axis=2).mean(axis=(0, 1))
        if failed.max() > 0.98:
            return _explain_failure(target, thetas, int(np.argmax(failed)))
        worst: tuple[float, str] = (0.0, "")
        for o, observable in enumerate(target.response.observables):
            for k, level in enumerate(target.response.levels):
                reached = simulated[:, :, o, k]
                low, high = np.nanmin(reached), np.nanmax(reached)
                wanted_low, wanted_high = _range(target, o, k)
                gap = max(wanted_low - high, low - wanted_high) / max(wanted_high - wanted_low, 1e-300)
                if gap > worst[0]:
                    unit = "" if OBSERVABLE_UNITS[observable] == "1" else f" {OBSERVABLE_UNITS[observable]}"
                    worst = (gap, (
                        f"no prior point reaches the measured {observable} at amplitude {level:.4g}: measured "
                        f"{wanted_low:.5g} to {wanted_high:.5g}{unit}, simulated {low:.5g} to {high:.5g}{unit}; "
                        "widen the priors, check mass and units, or add the effect that is missing."
                    ))  # fmt: skip
        if worst[1]:
            return worst[1]
    return (
        "no prior point reaches all levels together although each level is reached by some; the model cannot "
        "follow the measured backbones: add an effect, widen the priors, or use a density without hard edges "
        "(`marginal='normal'`)."
    )


def _range(target: Target, o: int, k: int) -> tuple[float, float]:
    """Return the range of measured values at one observable and level."""
    if target.density is not None:
        draws = target.density.sample(2000, random_seed=0)[:, o, k]
        return float(draws.min()), float(draws.max())
    centre, spread = target.centre[:, o, k], target.spread[:, o, k]
    return float(np.nanmin(centre - 4.0 * spread)), float(np.nanmax(centre + 4.0 * spread))


def _explain_failure(target: Target, thetas: list[FloatArray], k: int) -> str:
    """Say why nearly no prior point can be simulated at level ``k``."""
    level = target.response.levels[k]
    reason = "the function returned no finite values"
    if isinstance(target.response, OscillatorResponse):
        codes = [
            int(simulate_backbone(target.response.oscillator, np.atleast_2d(theta)[0], [level]).status[0])
            for theta in thetas
        ]
        failures = [code for code in codes if code]
        if failures:
            reason = Status(max(set(failures), key=failures.count)).meaning
    return f"nearly no prior point can be simulated at amplitude {level:.4g}: {reason}."


__all__ = ["sentence"]
