"""The bound of ``./run bench slip``: a generalised likelihood ratio that knows the shape of the onset.

For noise-free channels s(t) since the load grows (`FirstSlip.load_grows_s`), readings ``y = level +
a s(t - onset) + noise``, white of known sigma, and unknown amplitude a > 0 and onset, the statistic of scan n
is the largest over onsets of

    sum_c,i s_c(i) (y_c(i) - level_c) / (sigma sqrt(sum_c,i s_c(i)^2)),

a matched filter on the part of the onset that has been sampled (Basseville, Nikiforov, Detection of Abrupt
Changes, 1993, section 2.4.3; Kay, Detection Theory, 1998, section 6.4.2, with a one-sided amplitude). No test
without knowledge of the onset is much faster at the same rate of false alarms in white noise.

No detector can be as fast: the oracle knows the response of this contact (friction, load, speed, direction,
every taxel's share, the shape of the curve), the exact level before, and the noise. A detector must allow for
any of these, needs a higher threshold for that, and must tell slip from presses and taps. The oracle sees
scenes with slip only; its event is the first scan with evidence of shear, whether the contact slips then or
not.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import oaconvolve

from bench.slip.scenes import RATE_HZ, SCAN_SPAN_S, PlayedScene, read_sd_v
from tactiled.array import FloatArray
from tactiled.errors import ContractError
from tactiled.samples.block import ScanBlock

# Scans since the onset that are tried, in steps of more than a tenth: little of the statistic is lost between
# two of them. The last is 5 s, in which the slowest load exceeds a noise of 10 mV.
AGES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 26, 32, 42, 56, 74, 98, 128, 170, 224, 296, 384, 500)
# Part of the shape's energy that is kept, in fewer combinations of channels: this costs less time, and the
# statistic changes by less than it states.
_KEPT = 1 - 1e-10


class Oracle:
    """Test for the first gross slip of a scene.

    Attributes
    ----------
    first : int
        First scan with a channel that is sampled after the load grows.
    n_combinations : int
        Combinations of channels that contain the shape.
    """

    def __init__(self, played: PlayedScene) -> None:
        if played.slip is None:
            raise ContractError("the oracle needs a scene with slip, and this scene has none")
        self.first = int(np.ceil((played.slip.load_grows_s - SCAN_SPAN_S) * RATE_HZ))
        self._level = played.volts[self.first - 1]
        shape = (played.volts[self.first :] - self._level)[: AGES[-1]]
        # White noise stays white under a rotation of the channels; few combinations contain the whole shape.
        _, sizes, turn = np.linalg.svd(shape, full_matrices=False)
        energy = np.cumsum(sizes**2) / (sizes**2).sum()
        self._turn = turn[: int(np.searchsorted(energy, _KEPT)) + 1].T
        self._shape = shape @ self._turn
        self._ages = [age for age in AGES if age <= len(shape) and np.any(self._shape[:age])]
        self.n_combinations = int(self._shape.shape[1])

    def trace(self, block: ScanBlock, noise_v: float) -> FloatArray:
        """Statistic of each scan from `first` on: (n - first,), in units of sigma."""
        scaled = (block.volts - self._level) @ self._turn / read_sd_v(noise_v)
        best = np.zeros(len(scaled) - self.first)
        start = max(self.first - AGES[-1], 0)  # the estimated onset may lie before the true one
        for age in self._ages:
            shape = self._shape[:age]
            windows = sliding_window_view(scaled[max(start, self.first - age + 1) :], age, axis=0)
            value = np.tensordot(windows, shape, axes=([2, 1], [0, 1])) / np.linalg.norm(shape)
            best[len(best) - len(value) :] = np.maximum(best[len(best) - len(value) :], value[-len(best) :])
        return best

    def noise_trace(self, noise: FloatArray) -> FloatArray:
        """Statistic of noise of unit sigma, given as (n, n_combinations)."""
        best = np.zeros(len(noise))
        for age in self._ages:
            shape = self._shape[:age] / np.linalg.norm(self._shape[:age])
            value = oaconvolve(noise, shape[::-1], mode="valid", axes=0).sum(axis=1)
            best[len(best) - len(value) :] = np.maximum(best[len(best) - len(value) :], value)
        return best
