"""Decision at a plateau of shear: gross slip, steady load, or wait for more scans."""

import math
from collections.abc import Callable

# Log odds of gross slip. Between two to one either way, the decision waits for `_WAIT_S`; then odds
# slightly below even suffice. On the seeds that `slip.friction_limit` names, at 0.3 and 3 mV, 97 % of the
# slips are then called gross (at even odds 94 %), and none of 46 loads below 0.8 of the limit. `./run bench
# slip` counts both on other seeds.
_SURE, _WAIT_S, _UNSURE = math.log(2), 0.08, -0.3
# A shear that only stays is looked at anew when it has grown by more than this and noise: the last tenth of a
# slow slip adds 0.03.
_GROWN_PART, _GROWN_SDS = 0.015, 3.0
# A rest of less than such odds may be a slip, and its end is not said: slips that were taken for rests had
# -0.6 to -1.3, most true rests -3 to -10.
_DOUBTFUL = -2.0


class PlateauTracker:
    """Follow a shear that may have stopped growing.

    Parameters
    ----------
    rate_hz : float

    Attributes
    ----------
    doubtful_at : float
        Shear at which it rests and may slip; infinite where it is known to rest, or nothing is known.
    """

    def __init__(self, rate_hz: float) -> None:
        self._wait_scans = _WAIT_S * rate_hz
        self._stays_at = -math.inf
        self.doubtful_at = math.inf  # shear of a rest that may be a slip

    def goes_on(self) -> None:
        """Record that the shear grows again."""
        self._stays_at = -math.inf

    def shift(self, by: float) -> None:
        """Correct for a change of the taxel set, by which the shear jumps."""
        self._stays_at += by
        self.doubtful_at += by

    def is_gross(self, n_flat: int, shear: float, noise: float, odds: Callable[[], float]) -> bool:
        """Return True for gross slip, after `n_flat` scans of steady shear.

        Parameters
        ----------
        n_flat : int
        shear, noise : float
            Shear of the newest scan, and its standard deviation.
        odds : callable
            Gives the logarithm of the odds that all slips; asked for only where it is not known.
        """
        # What is known of a rest is known: noise may not ask again.
        if shear <= self._stays_at + max(_GROWN_PART * abs(self._stays_at), _GROWN_SDS * noise):
            return False
        found = odds()
        is_over = n_flat >= self._wait_scans
        if found > (_UNSURE if is_over else _SURE):
            return True
        if is_over or found < -_SURE:
            self._stays_at = shear
            self.doubtful_at = shear if found > _DOUBTFUL else math.inf
        return False
