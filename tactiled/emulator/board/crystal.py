"""The board's own clock.

=============  ==========================================================
``now_s``      true time, the host's monotonic clock (simulated or real)
``board_s``    seconds since power-up by the board's crystal, not wrapped
ticks          what goes on the wire: counts of the crystal, wrapping
=============  ==========================================================
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Seconds = TypeVar("Seconds", float, NDArray[np.float64])
# A board time that is a whole number of ticks must not read one tick early for the last bit of a float.
_TICK_SLACK = 1e-3


@dataclass(frozen=True)
class Crystal:
    """Linear clock: started at `power_up_s`, too fast by `drift_ppm`.

    Attributes
    ----------
    tick_s : seconds of one tick, as the board believes
    bits : width of the tick counter
    start_ticks : what the counter holds at power-up
    """

    power_up_s: float
    drift_ppm: float
    tick_s: float
    bits: int
    start_ticks: int = 0

    def board_s(self, now_s: Seconds) -> Seconds:
        return (now_s - self.power_up_s) * (1.0 + self.drift_ppm * 1e-6)

    def true_s(self, board_s: Seconds) -> Seconds:
        return self.power_up_s + board_s / (1.0 + self.drift_ppm * 1e-6)

    def ticks(self, board_s: float) -> int:
        """Counter at a board time, wrapped."""
        return (self.start_ticks + math.floor(board_s / self.tick_s + _TICK_SLACK)) % (1 << self.bits)
