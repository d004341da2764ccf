"""The two clocks of the daemon, and the one place where instants become epoch seconds.

``time_s`` is CLOCK_MONOTONIC: never set back, the clock of all that is computed. ``unix_s`` is what the
world reads: ``unix_s = time_s + offset_s``, added once, when a message is encoded.

The kernel slews both clocks together, so between steps of the wall clock the offset is a constant, and
measuring it anew for each message would only add the jitter of two system calls to instants that are
known better. So it is held, looked at once a second, and replaced only when the wall clock was stepped.
"""

import time
from collections.abc import Callable

_STEP_S = 1e-3  # ten times the error of one bracketed reading on a busy machine, a tenth of a scan at 100 Hz
_BRACKETS = 5  # readings to choose the tightest from: one in a few is interrupted by the scheduler
_TIGHT_S = 2e-4  # a bracket wider than this says less than the step that it should show


class EpochClock:
    """Offset between the monotonic and the wall clock, followed when the wall clock is stepped.

    Parameters
    ----------
    monotonic, wall : callable
        Seconds of either clock.
    """

    def __init__(
        self, monotonic: Callable[[], float] = time.monotonic, wall: Callable[[], float] = time.time
    ) -> None:
        self._monotonic = monotonic
        self._wall = wall
        self.offset_s = self._measure()[0]

    def follow(self) -> float:
        """Look at both clocks again.

        Returns
        -------
        float
            The step of the wall clock that was followed, in seconds; 0.0 when there was none.
        """
        offset_s, width_s = self._measure()
        step_s = offset_s - self.offset_s
        if width_s > _TIGHT_S or abs(step_s) < _STEP_S:
            return 0.0
        self.offset_s = offset_s
        return step_s

    def _measure(self) -> tuple[float, float]:
        """Offset from the tightest of a few bracketed readings, and how tight it was."""
        width_s, offset_s = min(self._bracket() for _ in range(_BRACKETS))
        return offset_s, width_s

    def _bracket(self) -> tuple[float, float]:
        before_s = self._monotonic()
        unix_s = self._wall()
        after_s = self._monotonic()
        return after_s - before_s, unix_s - (before_s + after_s) / 2
