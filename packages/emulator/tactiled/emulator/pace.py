"""Scans left out by a board in real time on a host that is too slow, and the scene time that follows.

A real board samples at its instants or not at all. An emulated one must compute each scan and can fall
behind. After a short delay it catches up: the scans are sent late, as from an adapter that buffers. After a
longer one it acts as ``protocols/board.md`` requires of delayed firmware: it misses scan instants, their
sequence numbers are used up, and the next scan carries the flag ``overrun``.
"""

import math
from bisect import bisect_right

# Longest delay by a busy scheduler that is caught up with; the buffer of an adapter holds as much.
HICCUP_S = 0.5
# Longest delay on a host that computes too slowly: two scans at 100 Hz. Scans are then less than the 0.1 s
# late that the daemon reports, and gaps shorter than the 50 ms that it reports as a stall.
BEHIND_S = 0.02
RECOVERED_S = 5.0  # without an overrun, after which the host no longer counts as slow
_ONE_PAUSE = 0.8  # part of a delay that came in one pause if the host was suspended rather than slow
REPORT_PERIOD_S = 5.0  # between reports of continuing overruns


class OverrunPolicy:
    """Decide when overdue scans are left out and when that is reported, without reading a clock."""

    def __init__(self) -> None:
        self._slow_s = self._looked_s = self._report_s = -math.inf
        self._n = self._n_reported = 0

    @property
    def missed(self) -> int:
        """Number of scan instants missed so far."""
        return self._n

    def is_behind(self, due_s: float, now_s: float) -> bool:
        """Return whether a scan that was due at `due_s` is so late that all overdue scans are left out.

        Call it after each scan: if the delay grows from scan to scan, the host computes too slowly.
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
        """Count n scan instants as left out."""
        self._n += n

    def is_report_due(self, now_s: float) -> bool:
        """Return whether overruns are reported now: the first at once, later ones each `REPORT_PERIOD_S`."""
        if self._n == self._n_reported or now_s < self._report_s + REPORT_PERIOD_S:
            return False
        self._n_reported, self._report_s = self._n, now_s
        return True


class SceneClock:
    """Conversion of scene time to true instants; the scene stands still while the board misses scans."""

    def __init__(self, t0_s: float) -> None:
        self._from_s = [-math.inf]
        self._t0_s = [t0_s]

    @property
    def t0_s(self) -> float:
        """True instant minus scene time at present."""
        return self._t0_s[-1]

    @property
    def held_s(self) -> float:
        """Total time for which the scene has stood still."""
        return self._t0_s[-1] - self._t0_s[0]

    def hold(self, scene_s: float, t0_s: float) -> None:
        """Add `t0_s` to scene times from `scene_s` on."""
        if t0_s != self._t0_s[-1]:
            self._from_s.append(scene_s)
            self._t0_s.append(t0_s)

    def true_s(self, scene_s: float) -> float:
        """True instant of a scene time."""
        return scene_s + self._t0_s[bisect_right(self._from_s, scene_s) - 1]
