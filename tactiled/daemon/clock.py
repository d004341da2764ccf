"""Offset between the monotonic and the wall clock, by which instants become epoch seconds.

``time_s`` is CLOCK_MONOTONIC, which is never set back; all computations use it. ``unix_s = time_s +
offset_s`` is made once, when a message is encoded.

The kernel slews both clocks together, so the offset is constant between steps of the wall clock. Measuring it
for each message would add the jitter of two system calls. It is therefore kept, checked once a second, and
replaced only when the wall clock was stepped.
"""

import time
from collections.abc import Callable

_STEP_S = 1e-3  # least step: ten times the error of a bracketed reading on a busy machine, 0.1 scan at 100 Hz
_BRACKETS = 5  # readings of which the tightest is used: one in a few is interrupted by the scheduler
_TIGHT_S = 2e-4  # a wider bracket cannot resolve a step of `_STEP_S`
_FIRST_TRIES = 10  # of a busy host, on which all brackets of the first measurement may be wide


class EpochClock:
    """Keep the offset between monotonic and wall clock, and follow steps of the wall clock."""

    def __init__(
        self, monotonic: Callable[[], float] = time.monotonic, wall: Callable[[], float] = time.time
    ) -> None:
        self._monotonic = monotonic
        self._wall = wall
        self.offset_s, width_s = self._measure()
        for _ in range(_FIRST_TRIES):
            if width_s > _TIGHT_S:
                self.offset_s, width_s = self._measure()

    def follow(self) -> float:
        """Compare both clocks again; return the step of the wall clock in seconds, 0.0 for none."""
        offset_s, width_s = self._measure()
        step_s = offset_s - self.offset_s
        if width_s > _TIGHT_S or abs(step_s) < _STEP_S:
            return 0.0
        self.offset_s = offset_s
        return step_s

    def _measure(self) -> tuple[float, float]:
        """Offset from the tightest of a few bracketed readings, and its width, both in seconds."""
        width_s, offset_s = min(self._bracket() for _ in range(_BRACKETS))
        return offset_s, width_s

    def _bracket(self) -> tuple[float, float]:
        before_s = self._monotonic()
        unix_s = self._wall()
        after_s = self._monotonic()
        return after_s - before_s, unix_s - (before_s + after_s) / 2
