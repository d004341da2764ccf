"""One level of the stationary wavelet transform over all channels; `wavelet` of the core has the filters."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.fast import Bank
from tactiled.detect.signal.quantise import HeldReadings, Quantiser
from tactiled.detect.signal.wavelet import border_scans, taps


def kink_response(level: int) -> FloatArray:
    """Coefficient in the scans after a kink of one volt per scan; entry 0 is the scan of the kink itself."""
    response: FloatArray = np.concatenate([[0.0], np.cumsum(np.cumsum(taps(level)))[:-1]])
    return response


class SwtBank:
    """One level of the transform, causal, over all channels."""

    def __init__(self, array: Array, level: int) -> None:
        self._border = border_scans(level)
        volts_per_step = Quantiser(array).volts_per_step  # a power of two: products with it do not round
        self._bank = Bank(array.n_channels, [taps(level) * volts_per_step])
        # (scans + border, channels): held readings, in grid steps, behind the outputs of the last `filter`
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
