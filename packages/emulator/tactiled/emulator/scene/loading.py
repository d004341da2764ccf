"""Lag of the rubber's creep behind the load, disturbances and a controller's grip included."""

import math

import numpy as np

from tactiled.array import FloatArray


class CreepLag:
    """Lag c with ``tau dc/dt = F - c``, exact for a load F that is linear between grid points.

    It is fed in order with any number of steps.
    """

    def __init__(self, step_s: float, time_constant_s: float) -> None:
        left = math.exp(-step_s / time_constant_s)
        mean = time_constant_s / step_s * -math.expm1(-step_s / time_constant_s)
        self._now, self._before, self._left = 1 - mean, mean - left, left
        self.reset()

    def reset(self) -> None:
        """Return to no load in the past."""
        self._rest = 0.0

    def feed(self, load_n: FloatArray) -> FloatArray:
        """Load (n,) through the lag at the next n steps."""
        relaxed_n, rest, left = [], self._rest, self._left
        # A filter of one pole, without scipy.signal, whose import takes half a second.
        for now, before in zip((self._now * load_n).tolist(), (self._before * load_n).tolist(), strict=True):
            relaxed_n.append(relaxed := rest + now)
            rest = before + left * relaxed
        self._rest = rest
        return np.array(relaxed_n)
