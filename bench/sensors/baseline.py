"""Baselines, in twenty lines of numpy each: the strongest line of a spectrum, and the rate of change."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
LEAST_HZ = 0.7
HALF_S = 0.5


def strongest_line_hz(time_s: FloatArray, readings: FloatArray) -> float:
    """Return the frequency of the largest bin of the channels' summed power, interpolated by a parabola."""
    n = len(readings)
    scaled = (readings - readings.mean(axis=0)) / np.maximum(readings.std(axis=0), 1e-12)
    power = (np.abs(np.fft.rfft(np.hanning(n)[:, np.newaxis] * scaled, axis=0)) ** 2).sum(axis=1)
    frequency_hz = np.fft.rfftfreq(n, (time_s[-1] - time_s[0]) / (n - 1))
    power[frequency_hz < LEAST_HZ] = 0.0
    peak = int(np.clip(np.argmax(power), 1, len(power) - 2))
    left, middle, right = np.log(power[peak - 1 : peak + 2] + 1e-300)
    bend = left - 2 * middle + right
    return float(frequency_hz[peak] + (0.5 * (left - right) / bend if bend < 0 else 0.0) * frequency_hz[1])


def rate_of_change_slides(
    time_s: FloatArray, readings: FloatArray, over_s: float, times: float
) -> FloatArray:
    """Return the instants at which readings begin to change so many times as fast as when quietest."""
    spacing_s = np.median(np.diff(time_s))
    lag, n = max(1, round(over_s / spacing_s)), max(2, round(HALF_S / spacing_s))
    change = np.sqrt(((readings[lag:] - readings[:-lag]) ** 2).mean(axis=1))
    smooth = np.convolve(change, np.ones(n) / n)[: len(change)] if lag == 1 else change
    quiet = smooth[2 * n :].min(initial=np.inf) if len(smooth) > 2 * n else np.inf
    fast = smooth > times * max(float(quiet), 1e-12)
    fast[:n] = False
    begins = np.flatnonzero(fast[1:] & ~fast[:-1]) + 1
    begins = begins[np.diff(begins, prepend=-n) >= n]  # one for each half second
    return np.asarray(time_s[lag:][begins])
