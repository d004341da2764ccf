"""Schedule of the pings to a running board. No I/O."""

import math

# Mean time between two pings. Ping and answer take 20 octets, 0.2 % of a line at 115200 baud; 120 s of the
# clock's fit hold some 120 of them, of which the fastest bounds the fit.
PING_S = 1.0
# The first comes as soon as some scans have arrived: until it is answered, instants on a bunched line are
# known to some ms only, and a board that was switched off and on may look like one with a backlog.
FIRST_S = 0.05
# The golden ratio spreads the intervals evenly between 0.5 and 1.5 times `PING_S`. So pings are not in step
# with scans, adapter timers or the daemon's own ticks, and some find the line and the adapter idle.
_GOLDEN = (math.sqrt(5) - 1) / 2


class Pinging:
    """Time of the next ping.

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
        """Begin with a board that has just begun to run; whether it answers pings is not known."""
        self._is_refused = False
        self._next_s = now_s + FIRST_S

    def refuse(self) -> None:
        """Send no ping until `reset`: the board does not know the command."""
        self._is_refused = True

    @property
    def due_s(self) -> float:
        """Time of the next ping; inf where there is none."""
        return self._next_s if self._is_possible and not self._is_refused else math.inf

    def sent(self, now_s: float) -> None:
        """Set the time of the next ping; it does not depend on an answer to this one."""
        self._next_s = now_s + self._interval_s()

    def _interval_s(self) -> float:
        self._count += 1
        return PING_S * (0.5 + self._count * _GOLDEN % 1.0)
