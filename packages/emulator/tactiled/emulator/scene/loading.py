"""Effects of past load on the rubber: the lag of creep and the peak of hysteresis.

The load includes disturbances and a controller's grip; it is linear between grid points.
"""

import math
from itertools import accumulate, islice

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics import lumped
from tactiled.emulator.scene.motion import SceneMotion


class LoadMemory:
    """Creep lag and peak of a load, fed in order with any number of steps.

    The lag solves ``tau dc/dt = F - c`` exactly for a load that is linear between grid points.
    """

    def __init__(self, step_s: float, time_constant_s: float) -> None:
        left = math.exp(-step_s / time_constant_s)
        mean = time_constant_s / step_s * -math.expm1(-step_s / time_constant_s)
        self._now, self._before, self._left = 1 - mean, mean - left, left
        self.reset()

    def reset(self) -> None:
        """Return to no load in the past."""
        self._rest = 0.0
        self._peak_n = 0.0

    def feed(self, load_n: FloatArray) -> FloatArray:
        """Rows (n, 2) of the next n steps: load through the lag, and largest load since contact; both N."""
        relaxed_n, rest, left = [], self._rest, self._left
        # A filter of one pole, without scipy.signal, whose import takes half a second.
        for now, before in zip((self._now * load_n).tolist(), (self._before * load_n).tolist(), strict=True):
            relaxed_n.append(relaxed := rest + now)
            rest = before + left * relaxed
        self._rest = rest
        peaks = accumulate(load_n.tolist(), _peak, initial=self._peak_n)
        peak_n = np.fromiter(islice(peaks, 1, None), dtype=np.float64, count=len(load_n))
        self._peak_n = float(peak_n[-1])
        return np.stack([relaxed_n, peak_n], axis=-1)


def _peak(before_n: float, load_n: float) -> float:
    return max(before_n, load_n) if load_n > 0 else 0.0


class PrescribedLoad:
    """Rows of load, lagged load and peak of a scene without controller; a `stepper.GridSource`."""

    def __init__(self, motion: SceneMotion) -> None:
        self._motion = motion
        self._memory = LoadMemory(lumped.STEP_S, motion.scene.electronics.creep_time_s)
        self.reset()

    def reset(self) -> None:
        self._k = 0
        self._memory.reset()

    def advance(self, n: int) -> FloatArray:
        time_s: FloatArray = np.arange(self._k, self._k + n) * np.float64(lumped.STEP_S)
        load_n = self._motion.at(time_s).load_n
        self._k += n
        return np.concatenate([load_n[:, None], self._memory.feed(load_n)], axis=1)
