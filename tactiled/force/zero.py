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
# Random walk of the zero while it cannot be followed, part of the largest calibrated reading per root second:
# 0.1 % in an hour, as of a divider with resistors of 100 ppm/K in a room that changes by 10 K.
_WALK_PER_ROOT_S = 1.7e-5


class DriftZero:
    """Offset of each channel from the zero that was set, and its standard deviation.

    Parameters
    ----------
    array : Array
    largest : (channels,) float64
        Largest reading of each channel in the calibration; the scale of drift.
    sd : float
        Standard deviation of the zero after a tare, in the unit of the array.

    Attributes
    ----------
    offset : (channels,) float64
        To be subtracted from readings that are relative to the zero that was set.
    touching : bool
        True while contact cannot be excluded.
    touched_s : float
        Time since the zero was last followed.
    """

    def __init__(self, array: Array, largest: FloatArray, sd: float) -> None:
        self._scale = float(np.median(largest)) or array.full_scale
        self._level = max(_QUIET_NOISES * sd * np.sqrt(2), _LEAST_QUIET * self._scale)
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

    def step(self, readings: FloatArray, step_s: float, *, is_complete: bool) -> FloatArray:
        """Return the readings (channels,) of a scan relative to the drifted zero, and follow the drift."""
        relative = readings - self.offset
        is_quiet = is_complete and float(np.abs(relative).max()) < self._level
        if not is_quiet:
            if not self.touching:  # the beginning of the contact may have moved the zero
                self.offset = self._snapshots[0].copy()
                self.touching = True
                relative = readings - self.offset
            self.touched_s += step_s
            return relative
        self.touching = False
        self.touched_s = 0.0
        most = _FASTEST_DRIFT_PER_S * self._scale * step_s
        self.offset += np.clip(relative * min(1.0, step_s / _FOLLOW_S), -most, most)
        self._since_s += step_s
        if self._since_s >= _HOLD_BACK_S / _SNAPSHOTS:
            self._since_s = 0.0
            self._snapshots.append(self.offset.copy())
        return relative

    def sd(self) -> float:
        """Return the standard deviation of the zero, in the unit of the array."""
        walk = _WALK_PER_ROOT_S * self._scale
        return float(np.sqrt(self._sd**2 + walk * walk * self.touched_s))
