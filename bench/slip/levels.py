"""The coherent rule on coif1 levels: a comparison of its latency with that of ramps.

A causal undecimated coif1 bank on all channels. At every scan and level the pairs (R1 - R3, R2 - R4) of all
taxels are summed: a vector (x, y) a level, noise of unit variance each, and kept for as long as the level
changes little (`_LAGS` values, half its filter's step apart). A load that begins to grow `age` scans ago, and
evenly, leaves these values in proportions that are known (`kink_response`): a vector k(age), each entry with
its own sign, so that only what rises at several levels at once, in one direction, fits it. With C the
correlation of the noise in these values (their filters see the same scans), the likelihood ratio over unknown
slope and direction is

    max over age of |z' C^-1 k| / sqrt(k' C^-1 k),   z: (values, 2),

the Gaussian matched filter (Kay, Detection Theory, 1998, section 4.3) of the bank's outputs. It is told the
noise, which `detect.slip_coherent` has to learn, and nothing of pressure, size or contact. Of the newest
values alone (one lag) it is later: on tuning seeds 44 instead of 17 ms in the 95th percentile at 0.3 mV.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.signal.wavelet import WaveletCoefficients, kink_response, taps

FloatArray = NDArray[np.float64]

COHERENT_LEVELS = (1, 2, 3, 4, 5)
_LAGS = 4
# Scans since the kink; level 5 has forgotten it after 155. Steps as `slip_oracle.AGES`.
_AGES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 26, 32, 42, 56, 74, 98, 128)
_VALUES = tuple((row, lag << row) for row in range(len(COHERENT_LEVELS)) for lag in range(_LAGS))
_LONGEST = max(lag for _, lag in _VALUES)


class CoherentLevels:
    """The likelihood ratio of the coefficients of `COHERENT_LEVELS`, scan after scan.

    Parameters
    ----------
    array : Array
    sd_v : float
        Sigma of a reading.
    """

    def __init__(self, array: Array, sd_v: float) -> None:
        weights = array.shear_weights().sum(axis=1)
        self._weights = weights.T / np.linalg.norm(weights, axis=1)
        self._sd_v = np.array([sd_v * np.linalg.norm(taps(level)) for level in COHERENT_LEVELS])
        self._matched = _matched()
        self._before = np.zeros((_LONGEST, len(COHERENT_LEVELS), 2))

    def score(self, answer: WaveletCoefficients) -> FloatArray:
        """Statistic (n,) of a bank's answer whose first levels are these; 0 where any is not usable."""
        n = len(COHERENT_LEVELS)
        z = answer.volts[:, :n] @ self._weights / self._sd_v[:, np.newaxis]
        z[~answer.usable[:, :n].all(axis=(1, 2))] = 0.0
        z = np.concatenate([self._before, z])
        self._before = z[-_LONGEST:]
        values = np.stack([z[_LONGEST - lag : len(z) - lag, row] for row, lag in _VALUES])
        fits = np.tensordot(self._matched, values, axes=1)  # (ages, n, 2)
        return np.asarray(np.sqrt((fits**2).sum(axis=2).max(axis=0)))


def _matched() -> FloatArray:
    """Filter (ages, values) of unit noise for each age of a kink."""
    longest = _LONGEST + len(taps(COHERENT_LEVELS[-1]))
    filters, kinks = np.zeros((len(_VALUES), longest)), np.zeros((len(_VALUES), longest))
    for k, (row, lag) in enumerate(_VALUES):
        level = COHERENT_LEVELS[row]
        size = np.linalg.norm(taps(level))
        filters[k, lag : lag + len(taps(level))] = taps(level) / size
        response = kink_response(level) / size
        kinks[k, lag : lag + len(response)] = response
    shapes = kinks[:, _AGES].T
    fits = np.linalg.solve(filters @ filters.T, shapes.T).T
    return np.asarray(fits / np.sqrt((fits * shapes).sum(axis=1, keepdims=True)))
