"""Convolution by Fourier transform; `scipy.signal` has it too, but its import takes as long as all of reading."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft


def convolve_inside(values: NDArray[Any], kernel: NDArray[Any]) -> NDArray[Any]:
    """Return the convolution where the kernel lies within the values, as ``mode="valid"`` does elsewhere.

    Parameters
    ----------
    values : (n,) array
        Real or complex.
    kernel : (k,) array
        Real or complex, not longer than the values.

    Returns
    -------
    (n - k + 1,) array
        Complex where either is.

    Notes
    -----
    In one transform of all values: for pieces of some 1e5 samples, not for records of any length.
    """
    size = values.size + kernel.size - 1
    is_complex = np.iscomplexobj(values) or np.iscomplexobj(kernel)
    length = next_fast_len(size, real=not is_complex)
    if is_complex:
        product = ifft(fft(values, length) * fft(kernel, length))
    else:
        product = irfft(rfft(values, length) * rfft(kernel, length), length)
    return np.asarray(product[kernel.size - 1 : values.size])
