"""When a running board is pinged. No I/O."""

import math

# Mean time between two pings. Ping and answer take 20 octets, 0.2 % of a line at 115200 baud; 120 s of the
# clock's fit hold some 120 of them, of which the fastest counts.
PING_S = 1.0
FIRST_S = 0.3  # the first comes sooner: before it, a bunched line is known to some milliseconds only
# The golden ratio spreads the intervals evenly between half and one and a half of `PING_S`. So pings keep no
# phase with scans, adapter timers or the daemon's own ticks, and some meet the line and the adapter when they
# are free.
_GOLDEN = (math.sqrt(5) - 1) / 2


class Pinging:
    """When the next ping is due.

    Parameters
    ----------
    is_possible : bool
        The protocol has pings whose answers carry ticks.
    """

    def __init__(self, is_possible: bool) -> None:
        self._is_possible = is_possible
        self._count = 0
        self.reset(0.0)

    def reset(self, now_s: float) -> None:
        """A board begins to run, of which it is not known whether it answers."""
        self._is_refused = False
        self._next_s = now_s + FIRST_S

    def refuse(self) -> None:
        """The board does not know the command: leave it in peace until `reset`."""
        self._is_refused = True

    @property
    def due_s(self) -> float:
        """When the next ping may go; infinity where there is none."""
        return self._next_s if self._is_possible and not self._is_refused else math.inf

    def sent(self, now_s: float) -> None:
        """A ping goes now. Whether it is answered or not, the next one comes when it would have come."""
        self._next_s = now_s + self._interval_s()

    def _interval_s(self) -> float:
        self._count += 1
        return PING_S * (0.5 + self._count * _GOLDEN % 1.0)
