"""A board in real time on a host that may be too slow: when it leaves out scans, and where its scene is then.

A real board samples at its instants or not at all. An emulated one must compute each scan first, so it can
fall behind. A short delay is caught up with: the scans go out late, as from an adapter that buffers. Beyond
that the board does what ``protocols/board.md`` asks of firmware that is held up: it misses scan instants,
their sequence numbers are used up, and the next scan carries the flag ``overrun``.
"""

import math
from bisect import bisect_right

# A busy scheduler takes the processor away for so long and gives it back; an adapter's buffer holds as much.
HICCUP_S = 0.5
# On a host that computes too slowly: two scans at 100 Hz. What is sent is then fresh (the daemon calls 0.1 s
# late), and a gap stays under the 50 ms of silence that the daemon calls a stall.
BEHIND_S = 0.02
RECOVERED_S = 5.0  # without an overrun: then a hiccup is caught up with again
_ONE_PAUSE = 0.8  # of the delay: so much of it in one pause, and the host was away and not slow
REPORT_PERIOD_S = 5.0  # between two reports of overruns that go on


class OverrunPolicy:
    """Decide when overdue scans are left out, and when that is reported. No clock is read here."""

    def __init__(self) -> None:
        self._slow_s = self._looked_s = self._report_s = -math.inf
        self._n = self._n_reported = 0

    @property
    def missed(self) -> int:
        """Scan instants that the host missed so far."""
        return self._n

    def is_behind(self, due_s: float, now_s: float) -> bool:
        """Whether a scan that was due at `due_s` is so late that it and its like are to be left out.

        Ask after each scan: a delay that grew from scan to scan is that of a host that computes too slowly.
        """
        pause_s, late_s = now_s - self._looked_s, now_s - due_s
        self._looked_s = now_s
        is_slow = now_s - self._slow_s <= RECOVERED_S
        if late_s <= (BEHIND_S if is_slow else HICCUP_S):
            return False
        if is_slow or pause_s < _ONE_PAUSE * late_s:
            self._slow_s = now_s
        return True

    def overrun(self, n: int) -> None:
        """Count n scan instants that were left out."""
        self._n += n

    def is_report_due(self, now_s: float) -> bool:
        """Whether overruns are to be reported now: the first at once, later ones each `REPORT_PERIOD_S`."""
        if self._n == self._n_reported or now_s < self._report_s + REPORT_PERIOD_S:
            return False
        self._n_reported, self._report_s = self._n, now_s
        return True


class SceneClock:
    """True instants of scene times: the scene stands still while the board misses scans.

    Parameters
    ----------
    t0_s : float
        True instant of scene time 0.
    """

    def __init__(self, t0_s: float) -> None:
        self._from_s = [-math.inf]
        self._t0_s = [t0_s]

    @property
    def t0_s(self) -> float:
        """True instant minus scene time, as it is now."""
        return self._t0_s[-1]

    @property
    def held_s(self) -> float:
        """For how long the scene has stood still in all."""
        return self._t0_s[-1] - self._t0_s[0]

    def hold(self, scene_s: float, t0_s: float) -> None:
        """From scene time `scene_s` on, `t0_s` is added to a scene time."""
        if t0_s != self._t0_s[-1]:
            self._from_s.append(scene_s)
            self._t0_s.append(t0_s)

    def true_s(self, scene_s: float) -> float:
        """True instant of a scene time."""
        return scene_s + self._t0_s[bisect_right(self._from_s, scene_s) - 1]
