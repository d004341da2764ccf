"""Zero of the channels: follows drift while surely nothing touches, and stands still in contact."""

from collections import deque

import numpy as np

from tactiled.array import Array, FloatArray

# A scan without contact has every channel nearer to its zero than this: five standard deviations of its
# noise, which one of 36 channels exceeds by chance once in 50,000 scans, and at least this part of the range.
_QUIET_NOISES = 5.0
_LEAST_QUIET = 1 / 2048
# Fastest drift that is followed, as a part of the largest calibrated reading per second: 1 % in 50 s. A press
# that grows more slowly cannot be told from drift; every faster one is left alone.
_FASTEST_DRIFT_PER_S = 2e-4
_FOLLOW_S = 2.0  # averaging time of the zero: noise falls to a twentieth at 100 Hz
_HOLD_BACK_S = 1.0  # a contact begins before it is noticed: the zero of so long ago is used from then on
_SNAPSHOTS = 4  # within the time above
# A contact is over where all channels stay below this part of its largest reading, and below what drift can
# have made of the zero meanwhile. A touch that goes on with less than that is taken for drift.
_LEFT = 0.02
# Random walk of the zero while it cannot be followed, part of the largest calibrated reading per root second:
# 0.1 % in an hour, as of a divider with resistors of 100 ppm/K in a room that changes by 10 K.
_WALK_PER_ROOT_S = 1.7e-5


class DriftZero:
    """Offset of each channel from the zero that was set, and its standard deviation.

    Parameters
    ----------
    largest : (channels,) float64
        Largest reading of each channel in the calibration; the scale of drift.
    noise, sd : float
        Standard deviations of a reading, and of the zero after a tare, in the unit of the array.

    Attributes
    ----------
    offset : (channels,) float64
        To be subtracted from readings that are relative to the zero that was set.
    touching : bool
        True while contact cannot be excluded.
    touched_s : float
        Time since the zero was last followed.
    """

    def __init__(self, array: Array, largest: FloatArray, noise: float, sd: float) -> None:
        self._scale = float(np.median(largest)) or array.full_scale
        self._level = max(_QUIET_NOISES * noise, _LEAST_QUIET * self._scale)
        self._sd = sd
        self._n = array.n_channels
        self.reset()

    def reset(self) -> None:
        """Forget all drift, as after a tare."""
        self.offset = np.zeros(self._n)
        self.touching = False
        self.touched_s = 0.0
        self._snapshots = deque([self.offset.copy()], maxlen=_SNAPSHOTS)
        self._since_s = 0.0
        self._margin = 0.0
        self._peak = self._calm_s = 0.0

    def step(self, readings: FloatArray, step_s: float, *, is_complete: bool) -> FloatArray:
        """Return the readings (channels,) of a scan relative to the drifted zero, and follow the drift."""
        relative = readings - self.offset
        size = max(float(relative.max()), -float(relative.min()))
        if not (is_complete and size < self._level + self._margin):
            if not self.touching:  # the beginning of the contact may have moved the zero
                self.offset = self._snapshots[0].copy()
                self.touching = True
                relative = readings - self.offset
            self.touched_s += step_s
            self._look_for_release(size, step_s, is_complete=is_complete)
            return relative
        most = _FASTEST_DRIFT_PER_S * self._scale * step_s
        self.touching = False
        self.touched_s = self._peak = self._calm_s = 0.0
        self._margin = max(self._margin - most, 0.0)
        self.offset += np.minimum(np.maximum(relative * min(1.0, step_s / _FOLLOW_S), -most), most)
        self._since_s += step_s
        if self._since_s >= _HOLD_BACK_S / _SNAPSHOTS:
            self._since_s = 0.0
            self._snapshots.append(self.offset.copy())
        return relative

    def _look_for_release(self, size: float, step_s: float, *, is_complete: bool) -> None:
        """Notice the end of a contact in which the zero has drifted beyond the level of a free array."""
        self._peak = max(self._peak, size)
        left = min(_LEFT * self._peak, _FASTEST_DRIFT_PER_S * self._scale * self.touched_s)
        self._calm_s = self._calm_s + step_s if is_complete and size < self._level + left else 0.0
        if self._calm_s >= _HOLD_BACK_S:
            self._margin = left

    def variance(self, touched_s: float) -> float:
        """Return the variance of the zero at a value of `touched_s`, in the unit of the array squared."""
        walk = _WALK_PER_ROOT_S * self._scale
        return self._sd**2 + walk * walk * touched_s
