"""Clock of a client, mapped to the daemon's by the least delay of its commands. Pure: time is an argument.

A command states when it was sent, in the sender's own clock. Its arrival in the daemon's clock, minus that,
is the offset of the clocks plus the delay of the command, which is never negative. The smallest such
difference of the last seconds is therefore the best estimate, as in the clock filter of NTP (RFC 5905,
section 10).
"""

import math

# Differences of the last one to two windows count: long enough that a command without much delay is among
# them, short enough that a clock that was set, or stood still, is followed.
WINDOW_S = 5.0
# Two crystals of 100 ppm each. A difference is worth that much less with each second of its age, so that an
# old one never maps an instant to before it was.
DRIFT = 200e-6


class SenderClock:
    """Offset of a sender's clock from the daemon's.

    While the clocks drift by at most `DRIFT`, instants are never mapped too early. They are too late by at
    most the least of ``delay + 2 * DRIFT * age`` over the commands of the last `WINDOW_S`, this one included.

    Examples
    --------
    A clock 100 s behind, and delays of 3, 1 and 20 ms:

    >>> clock = SenderClock()
    >>> [f"{clock.offset_s(sent_s, 100 + sent_s + delay_s):.4f}"
    ...  for sent_s, delay_s in ((1.0, 0.003), (1.1, 0.001), (1.2, 0.020))]
    ['100.0030', '100.0010', '100.0010']
    """

    def __init__(self) -> None:
        # Smallest differences of this window and the one before, less the drift since the daemon's zero.
        self._least, self._least_before = math.inf, math.inf
        self._until_s = -math.inf

    def offset_s(self, sent_s: float, now_s: float) -> float:
        """Take the instant at which a command was sent, and return what to add to the sender's instants.

        Parameters
        ----------
        sent_s : float
            In the sender's clock.
        now_s : float
            Arrival of the command in the daemon's clock.
        """
        if now_s >= self._until_s:
            is_next = now_s < self._until_s + WINDOW_S
            self._least_before = self._least if is_next else math.inf
            self._least, self._until_s = math.inf, now_s + WINDOW_S
        self._least = min(self._least, now_s - sent_s - DRIFT * now_s)
        return min(self._least, self._least_before) + DRIFT * now_s
