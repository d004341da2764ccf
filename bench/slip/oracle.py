"""The bound of ``./run bench slip``: a generalised likelihood ratio that knows the shape of the onset.

For noise-free channels s(t) from where the load grows on (`TrueInstants.grows_s`), readings ``y = level +
a s(t - onset) + noise``, white of known sigma, and unknown amplitude a > 0 and onset, the statistic of scan n
is the largest over onsets of

    sum_c,i s_c(i) (y_c(i) - level_c) / (sigma sqrt(sum_c,i s_c(i)^2)),

a matched filter on what has been seen of the onset so far (Basseville, Nikiforov, Detection of Abrupt
Changes, 1993, section 2.4.3; Kay, Detection Theory, 1998, section 6.4.2, with a one-sided amplitude). No test
that does not know the onset beats it by much at the same rate of false alarms in white noise.

It knows what no detector can: how this very contact will answer (friction, load, speed, direction, every
taxel's share, the bend of the response), the level before to no error, and the noise. A detector must allow
for any of these, pays for it in its threshold, and must tell slip from presses and taps beside; the oracle is
given only slips. It says the first scan with evidence of shear, whether or not anything slips by then.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from bench.slip.scenes import RATE_HZ, SCAN_SPAN_S, Played, read_sd_v
from tactiled.errors import ContractError
from tactiled.samples.block import ScanBlock

FloatArray = NDArray[np.float64]

# Scans since the onset that are tried: every one is more than a tenth longer than the one before, so that
# between two of them little of the statistic is lost; to 5 s, the slowest load's way to a noise of 10 mV.
AGES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 26, 32, 42, 56, 74, 98, 128, 170, 224, 296, 384, 500)
# Of the shape's energy, kept in fewer combinations of channels for speed: the statistic changes by less.
_KEPT = 1 - 1e-10


class Oracle:
    """Test for the first gross slip of a scene.

    Parameters
    ----------
    played : Played
        With a slip.

    Attributes
    ----------
    first : int
        First scan of which any channel is sampled after the load grows.
    """

    def __init__(self, played: Played) -> None:
        if played.slip is None:
            raise ContractError("an oracle knows a slip, and this scene has none")
        self.first = int(np.ceil((played.slip.grows_s - SCAN_SPAN_S) * RATE_HZ))
        self._level = played.volts[self.first - 1]
        shape = (played.volts[self.first :] - self._level)[: AGES[-1]]
        # White noise stays white under a rotation of the channels; few combinations hold the whole shape.
        _, sizes, turn = np.linalg.svd(shape, full_matrices=False)
        energy = np.cumsum(sizes**2) / (sizes**2).sum()
        self._turn = turn[: int(np.searchsorted(energy, _KEPT)) + 1].T
        self._shape = shape @ self._turn
        self._ages = [age for age in AGES if age <= len(shape) and np.any(self._shape[:age])]

    def trace(self, block: ScanBlock, noise_v: float) -> FloatArray:
        """Statistic of each scan from `first` on: (n - first,), in units of sigma."""
        before = AGES[-1]  # an onset may be thought to lie before the true one
        seen = (block.volts - self._level) @ self._turn / read_sd_v(noise_v)
        best = np.zeros(len(seen) - self.first)
        start = max(self.first - before, 0)
        for age in self._ages:
            shape = self._shape[:age]
            windows = sliding_window_view(seen[max(start, self.first - age + 1) :], age, axis=0)
            value = np.tensordot(windows, shape, axes=([2, 1], [0, 1])) / np.linalg.norm(shape)
            best[len(best) - len(value) :] = np.maximum(best[len(best) - len(value) :], value[-len(best) :])
        return best

    def noise_trace(self, noise: FloatArray) -> FloatArray:
        """Statistic of pure noise of unit sigma, given as (n, combinations): `n_combinations` of them."""
        best = np.zeros(len(noise))
        for age in self._ages:
            shape = self._shape[:age] / np.linalg.norm(self._shape[:age])
            value = oaconvolve(noise, shape[::-1], mode="valid", axes=0).sum(axis=1)
            best[len(best) - len(value) :] = np.maximum(best[len(best) - len(value) :], value)
        return best

    @property
    def n_combinations(self) -> int:
        """Combinations of channels in which the shape lives."""
        return int(self._shape.shape[1])
