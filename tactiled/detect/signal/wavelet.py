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
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.fast import Bank
from tactiled.detect.signal.quantise import HeldReadings, Quantiser

MAX_LEVEL = 6  # choice
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
    whole = np.rint(_exact_taps(level) * _TAP_SCALE)
    # Rounding leaves a few units over; give them back one by one where rounding had moved a tap furthest.
    surplus = int(whole.sum())
    moved = (whole - _exact_taps(level) * _TAP_SCALE) * np.sign(surplus)
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
def _exact_taps(level: int) -> FloatArray:
    coif1 = pywt.Wavelet("coif1")
    cascade = np.ones(1)
    for j in range(level - 1):
        cascade = np.convolve(cascade, _dilated(coif1.dec_lo, 2**j))
    return np.convolve(cascade, _dilated(coif1.dec_hi, 2 ** (level - 1)))


def _dilated(filter_taps: list[float], step: int) -> FloatArray:
    spread = np.zeros((len(filter_taps) - 1) * step + 1)
    spread[::step] = filter_taps
    return spread


def kink_response(level: int) -> FloatArray:
    """Coefficient in the scans after a kink of one volt per scan; entry 0 is the scan of the kink itself."""
    response: FloatArray = np.concatenate([[0.0], np.cumsum(np.cumsum(taps(level)))[:-1]])
    return response


class SwtBank:
    """One level of the transform, causal, over all channels.

    Attributes
    ----------
    steps : (scans + border, channels) float64
        Held readings, in grid steps, behind the outputs of the last `filter`.
    """

    def __init__(self, array: Array, level: int) -> None:
        self._border = border_scans(level)
        volts_per_step = Quantiser(array).volts_per_step  # a power of two: products with it do not round
        self._bank = Bank(array.n_channels, [taps(level) * volts_per_step])
        self.steps = np.zeros((0, array.n_channels))
        self._n_scans = 0
        # Before the start stand copies of the first scan, which are not readings.
        self._newest_bad = np.full(array.n_channels, -1, dtype=np.int64)

    def filter(self, held: HeldReadings) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the coefficients (n, channels) of scans in volts, and which of them are usable.

        Those are not usable whose filter still sees the start or a reading that is held.
        """
        n = len(held.steps)
        is_begun = len(self.steps) > 0
        before = self.steps[-self._border :] if is_begun else np.repeat(held.steps[:1], self._border, axis=0)
        self.steps = np.concatenate([before, held.steps])
        volts = np.empty(held.steps.shape)
        self._bank.take(n, self._border, self.steps.reshape(-1), volts.reshape(-1))
        scans = np.arange(self._n_scans, self._n_scans + n)[:, np.newaxis]
        self._n_scans += n
        newest_bad = self._newest_bad
        if not held.all_ok:
            newest_bad = np.maximum.accumulate(np.where(held.ok, newest_bad, scans), axis=0)
            self._newest_bad = newest_bad[-1].copy()
        return volts, scans - newest_bad > self._border
