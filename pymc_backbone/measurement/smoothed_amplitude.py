"""The amplitude of cycles, smoothed with the help of the damping that it implies: the regressor of backbones."""

from __future__ import annotations

import numpy as np

from .._common.checks import FloatArray
from .smoothing import smooth

LOOSENESS = 300.0
"""Undersmoothing of the amplitude: it is the regressor, where bias costs more than variance."""


WIDE = 10.0
"""Largest over smallest amplitude of an envelope from which friction bends its damping curve too much for two."""


def abscissas(amplitude: FloatArray, at: FloatArray, *, is_envelope: bool = False) -> list[FloatArray]:
    """Return amplitudes ``at`` on every abscissa that curves are smoothed on, averaged over by how well each does.

    The logarithm of the amplitude, and the amplitude; of an envelope over many decibels its inverse, too, in which the
    damping of dry friction is a straight line.
    """
    places = [np.log(at), at]
    if is_envelope and amplitude.max() > WIDE * amplitude.min():
        places.append(-1.0 / at)
    return places


def amplitude_from_damping(
    amplitude: FloatArray,
    amplitude_bands: FloatArray,
    damping: FloatArray,
    damping_bands: FloatArray,
    smoothed: FloatArray,
    end: int,
    apart: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the first ``end`` amplitudes, smoothed with the help of the damping they imply, and their covariance.

    The covariance is ``design @ spread @ design.T``, of the design (end, r) and the spread (r, r) that are returned.
    ``apart`` (end - 1,) are the cycles from one amplitude to the next, by default one.

    Damping is a much smoother function of amplitude than amplitude is of time (friction ends a decay with a corner,
    slip begins it with
    one). So the damping curve is integrated, and what the amplitudes say beyond it is smoothed over cycles and added.
    """

    def cut(bands: FloatArray) -> FloatArray:
        bands = bands[:, :end].copy()
        for b in range(1, bands.shape[0]):
            bands[b, max(end - b, 0) :] = 0.0
        return bands

    index = np.arange(end, dtype=np.float64)
    current, damping = smoothed[:end], damping[:end]
    for _ in range(2):
        place = abscissas(current, current, is_envelope=apart is not None)
        curve = smooth(place, damping, cut(damping_bands), place, orders=(2, 3), kinks=True)
        steps = (curve.value[1:] + curve.value[:-1]) / 2.0 * (1.0 if apart is None else apart)
        base = np.concatenate([[0.0], -np.cumsum(steps)])
        base -= np.mean(base - np.log(current))
        scaled = cut(amplitude_bands)
        for b in range(min(scaled.shape[0], end)):  # bands beyond the last cycle hold zeros
            scaled[b, : end - b] /= current[: end - b] * current[b:]
        # E[ln A] falls short of ln E[A]
        residual = np.log(np.maximum(amplitude[:end], 0.1 * current)) + 0.5 * scaled[0] - base
        rest = smooth([index], residual, scaled, [index], orders=(2,), undersmoothing=LOOSENESS, kinks=True)
        current = np.exp(base + rest.value)
    return current, rest.design * current[:, None], rest.spread
