"""Records behind a band-pass: the same filter for simulation and samples, and residuals that hold what it passes.

A band-pass leaves noise that has no power outside its band, so that whitening sample by sample would divide by nothing.
The passed record is known from fewer numbers: in steps of one over the width of the band, the passed record and the
same a quarter of a cycle later. These are taken straight from the samples, their covariance follows from the noise that
entered the filter, and its Cholesky factor makes them independent.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded
from scipy.sparse import csr_array

from ..._common.checks import FloatArray
from ...measurement.conditioning.filters import BandPass

_NUGGET = 1e-6  # keeps the factor real where the edges of the band meet in a gap


def passed_values(
    band_pass: BandPass, autocovariance: FloatArray, size: int
) -> tuple[Callable[[FloatArray], FloatArray], int, int]:
    """Return what takes samples to independent standard normal values of the passed record.

    Parameters
    ----------
    band_pass : BandPass
        The filter.
    autocovariance : (l,) array
        Of the noise that enters it.
    size : int
        Number of samples.

    Returns
    -------
    reduce : callable
        Takes (size, c) columns to (m, c), in the order of time, two values an instant.
    count : int
        m.
    step : int
        Samples from one instant to the next.
    """
    half = band_pass.half
    step = max(1, int(band_pass.sampling_rate / (band_pass.high - band_pass.low)))
    instants = (size - 2 * half - 1) // step + 1
    taps = np.array([band_pass.taps, band_pass.quadrature])
    rows = np.tile(taps, (instants, 1)).ravel()
    at = (step * np.repeat(np.arange(instants), 2)[:, None] + np.arange(taps.shape[1])).ravel()
    ends = taps.shape[1] * np.arange(2 * instants + 1)
    filters = csr_array((rows, at, ends), shape=(2 * instants, size))
    factor = cholesky_banded(_covariance(taps, autocovariance, step, instants), lower=True)
    width = factor.shape[0] - 1

    def reduce(columns: FloatArray) -> FloatArray:
        return np.asarray(solve_banded((width, 0), factor, filters @ columns))

    return reduce, 2 * instants, step


def _covariance(taps: FloatArray, autocovariance: FloatArray, step: int, instants: int) -> FloatArray:
    """Return the covariance of the values, as the diagonals of a banded matrix, from the main one down."""
    from scipy.signal import correlate

    used = np.flatnonzero(autocovariance)
    lags = int(used[-1]) if used.size else 0
    around = np.concatenate([autocovariance[lags:0:-1], autocovariance[: lags + 1]])
    length = taps.shape[1]
    zero = length - 1 + lags
    spread = [np.convolve(row, around) for row in taps]
    shifts = min((zero) // step, instants - 1)
    bands = np.zeros((2 * shifts + 2, 2 * instants))
    pairs = {(a, b): correlate(spread[b], taps[a]) for a in range(2) for b in range(2)}
    for below in range(bands.shape[0]):
        for b in range(2):
            later, a = divmod(b + below, 2)
            at = zero + step * later
            if later <= shifts and at < pairs[a, b].size:
                bands[below, b::2] = pairs[a, b][at]
    bands[0] *= 1.0 + _NUGGET
    return bands
