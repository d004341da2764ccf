"""The coif1 stationary wavelet transform as a causal streaming filter bank.

Level j of the undecimated transform is one FIR filter: the cascade of j - 1 low-pass filters and a
high-pass filter, each dilated by the powers of two before it (Mallat, "A Wavelet Tour of Signal
Processing", 3rd ed., section 5.5, algorithme a trous; `pywt.swt`). It has 5 (2^j - 1) + 1 taps. The bank's
output at scan n is pywt's coefficient of index n - 3 (2^j - 1), provided the last 5 (2^j - 1) + 1 scans
were good readings.

Exactness. Readings are whole steps within 2^23 (see `quantise`); taps are whole multiples of 2^-24. The sum
of a filter's absolute taps is at most 9.14 (level 6), so no partial sum exceeds 9.14 * 2^47 < 2^50.2 <
2^53: the sum, in any order and any chunking, has the same bits. Rounded taps are adjusted so
that they and their first moment sum to zero exactly: a constant and a steady ramp give exactly 0, for ever.
The error from rounding is below 1 uV rms.
"""

import functools

import numpy as np
import pywt

from tactiled.array import FloatArray

_TAP_SCALE = 2.0**24  # derived


def border_scans(level: int) -> int:
    """Scans at the start (or after a gap or a bad reading) whose output is not the transform yet."""
    return 5 * ((1 << level) - 1)


@functools.cache
def taps(level: int) -> FloatArray:
    """Return the filter of a level as the bank applies it, newest scan first.

    Returns
    -------
    (5 (2^level - 1) + 1,) float64
        Multiples of 2^-24; they and their first moment sum to zero.
    """
    exact = np.array(exact_taps(level)) * _TAP_SCALE
    whole = np.rint(exact)
    # Rounding leaves a few units over; give them back one by one where rounding had moved a tap furthest.
    surplus = int(whole.sum())
    moved = (whole - exact) * np.sign(surplus)
    whole[np.argsort(-moved, kind="stable")[: abs(surplus)]] -= np.sign(surplus)
    # Correct the first moment, by pairs that leave the sum unchanged.
    while moment := int(whole @ np.arange(len(whole))):
        reach = min(abs(moment), len(whole) - 1)
        whole[0] += np.sign(moment)
        whole[reach] -= np.sign(moment)
    filtered: FloatArray = whole / _TAP_SCALE
    filtered.flags.writeable = False
    return filtered


@functools.cache
def exact_taps(level: int, divisor: float = 1.0) -> list[float]:
    """Return the causal filter of a level, newest sample first; each stage is divided by a number."""
    wavelet = pywt.Wavelet("coif1")
    cascade = [1.0]
    for j in range(level):
        one = wavelet.dec_hi if j == level - 1 else wavelet.dec_lo
        product = [0.0] * (len(cascade) + (len(one) - 1) * 2**j)
        for i, before in enumerate(cascade):
            for k, tap in enumerate(one):
                product[i + k * 2**j] += before * (tap / divisor)
        cascade = product
    return cascade
