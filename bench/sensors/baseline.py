"""The baseline: the strongest line of the summed spectrum, in twenty lines of numpy."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
LEAST_HZ = 0.7


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
