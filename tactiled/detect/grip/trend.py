"""Present value and rate of the shear that a contact bears, relative to its load.

The ratio (shear along x, along y, moment about the normal over an effective radius; all over the load) is
followed by a Kalman filter of value and rate. Load that falls raises the ratio just as shear that grows, so
that an easing grip needs no rule of its own.
"""

import collections
import math

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.elementary import length, sum_in_order

# Spectral density of the ratio's acceleration: a pull whose rate changes by 1/s (5 N/s on 5 N) about four
# times a second. A prior for hands; the rate is averaged again below.
_ACCELERATION_DENSITY = 4.0  # 1/s^3
# The rate is averaged over this time: an extrapolation of each swing takes hum and steps of a walk for slip.
RATE_AVERAGE_S = 0.08
_START_RATE_SD = 1.0  # 1/s: before the first scans nothing is known of the rate
_LEAST_NOISE, _LEAST_SIZE = 1e-6, 1e-9
_BEFORE_S = 0.3  # a growth that began within this time goes beyond what was borne before: the longest horizon


class Trend:
    """Kalman filter of three ratios that share their noise and dynamics."""

    def __init__(self) -> None:
        self.value = np.zeros(3)
        """Ratio (3,)."""
        self.rate = np.zeros(3)
        """Averaged rate of the ratio (3,), 1/s."""
        self.value_sd = math.inf
        self.rate_sd = _START_RATE_SD
        self._fast_rate = np.zeros(3)
        self._cov = (0.0, 0.0, _START_RATE_SD**2)  # value, value with rate, rate
        self._largest = 0.0
        self._recent: collections.deque[float] = collections.deque()
        self._is_new = True
        self.size = 0.0
        """Length of the ratio: by the ellipsoid of Howe and Cutkosky (1996), compared with friction."""

    @property
    def growth(self) -> float:
        """Rate at which the length of the ratio grows, 1/s."""
        return sum_in_order(self.value * self.rate) / max(self.size, self.value_sd, _LEAST_SIZE)

    @property
    def is_fresh(self) -> bool:
        """True where the ratio exceeds all that was borne until 0.3 s ago."""
        return self.size > self._recent[0] if self._recent else True

    def step(self, ratio: FloatArray, noise_sd: float, step_s: float) -> None:
        """Take the ratio (3,) of a scan, with the standard deviation of its noise."""
        noise = max(noise_sd, _LEAST_NOISE)
        noise *= noise
        if self._is_new:
            self.value = ratio.copy()
            self.size = length(self.value)
            self._cov = (noise, 0.0, _START_RATE_SD**2)
            self._is_new = False
            self.value_sd = math.sqrt(noise)
            return
        vv, vr, rr = self._cov
        q, h = _ACCELERATION_DENSITY, step_s
        vv, vr, rr = (
            vv + 2 * h * vr + h * h * rr + q * (h * h * h) / 3,
            vr + h * rr + q * h * h / 2,
            rr + q * h,
        )
        predicted = self.value + h * self._fast_rate
        gain, rate_gain = vv / (vv + noise), vr / (vv + noise)
        self.value = predicted + gain * (ratio - predicted)
        self.size = length(self.value)
        self._fast_rate = self._fast_rate + rate_gain * (ratio - predicted)
        self._cov = ((1 - gain) * vv, (1 - gain) * vr, rr - rate_gain * vr)
        part = 1.0 - math.exp(-h / RATE_AVERAGE_S)
        self.rate = self.rate + part * (self._fast_rate - self.rate)
        self.value_sd = math.sqrt(self._cov[0])
        # Averaging over n independent rates; they decorrelate within the filter's own memory, about h / gain.
        memory_s = h / max(gain, _LEAST_SIZE)
        self.rate_sd = math.sqrt(self._cov[2] * memory_s / (memory_s + RATE_AVERAGE_S))
        self._remember(h)

    def _remember(self, step_s: float) -> None:
        """Keep the largest ratio up to each of the scans of the last 0.3 s."""
        self._largest = max(self._largest, self.size)
        self._recent.append(self._largest)
        while len(self._recent) > round(_BEFORE_S / step_s) + 1:
            self._recent.popleft()


def trend_numbers() -> FloatArray:
    """Return the constants of `Trend` in the order of `struct trend_numbers`."""
    return np.array(
        [_ACCELERATION_DENSITY, RATE_AVERAGE_S, _START_RATE_SD, _BEFORE_S, _LEAST_NOISE, _LEAST_SIZE]
    )
