"""Accounting of every scan: those that a daemon published against those that the emulated board took."""

import math
from collections import deque
from dataclasses import dataclass

from tactiled.emulator.board.scanning import ScanTruth
from tactiled.events.types import Event, ScanEvent, StatusEvent


@dataclass
class ScanCounts:
    """Counts of scans by their fate, and errors of their instants.

    Attributes
    ----------
    taken : int
        Scan instants of the board, missed ones (overruns) included.
    delivered, late : int
        Scans that were published, and those among them that were marked as too old to act on.
    lost_in_runs : int
        Not delivered, between two delivered scans of one run of the board: the daemon must count each.
    lost_at_restarts : int
        Not delivered, before the first or after the last delivered scan of a run: the daemon cannot count
        them.
    repeated : int
        Published twice, or out of order.
    mistimed : int
        Further than half a period from any true instant, after the clock fit had time to settle.
    largest_error_s : float
        Of the instants of settled scans.
    false_fresh : int
        Statuses that were valid while the newest delivered scan was too old.
    """

    taken: int = 0
    delivered: int = 0
    late: int = 0
    lost_in_runs: int = 0
    lost_at_restarts: int = 0
    repeated: int = 0
    mistimed: int = 0
    largest_error_s: float = 0.0
    false_fresh: int = 0


@dataclass
class _BoardRun:
    """Indices of the scans delivered since a boot, and the instant of the first of them."""

    boot: int
    first: int
    last: int
    began_s: float


class ScanAccounting:
    """Match published scans with the scans that the board took; memory is bounded by the scans in transit.

    Runs of the board are separated by time: the instants of late scans are at worst late until the clock fit
    of a new run has settled, and a board is silent while it boots for longer than the error of the clock.

    Parameters
    ----------
    oldest_valid_s : float
        Largest age of the newest scan at which a status may be valid.
    settled_s : float
        Time after the begin of a run from which errors of the clock fit count.

    Attributes
    ----------
    errors_s : list of float
        Errors of settled instants; the reader clears them.
    """

    def __init__(self, rate_hz: float, oldest_valid_s: float, settled_s: float = 10.0) -> None:
        self._half_s = 0.5 / rate_hz
        self._oldest_valid_s = oldest_valid_s
        self._settled_s = settled_s
        self._truth: deque[ScanTruth] = deque()
        self._taken: dict[int, int] = {}  # by boot, for those that are not closed yet
        self._run: _BoardRun | None = None
        self._newest_began_s = -math.inf
        self.counts = ScanCounts()
        self.errors_s: list[float] = []

    def taken(self, scan: ScanTruth) -> None:
        """Count a scan instant of the board."""
        self.counts.taken += 1
        self._taken[scan.boot] = self._taken.get(scan.boot, 0) + 1
        self._truth.append(scan)

    def published(self, event: Event) -> None:
        """Match an event of the daemon."""
        if isinstance(event, ScanEvent):
            self._scan(event)
        elif isinstance(event, StatusEvent) and event.valid:
            age_s = event.time_s - self._newest_began_s
            self.counts.false_fresh += age_s > self._oldest_valid_s

    def close(self) -> None:
        """Count the scans that the last run lost at its ends."""
        self._close_runs_before(math.inf)

    def _scan(self, event: ScanEvent) -> None:
        counts, truth = self.counts, self._truth
        while len(truth) > 1 and truth[1].began_s <= event.time_s + self._half_s:
            truth.popleft()
        if not truth:
            counts.mistimed += 1
            return
        scan = truth[0]
        if self._run is None or scan.boot > self._run.boot:
            self._close_runs_before(scan.boot)
            self._run = _BoardRun(scan.boot, event.index, event.index - 1, scan.began_s)
        run = self._run
        if event.index <= run.last:
            counts.repeated += 1
            return
        counts.lost_in_runs += event.index - run.last - 1
        counts.delivered += 1
        counts.late += event.late
        run.last = event.index
        self._newest_began_s = min(scan.began_s, event.time_s)
        if scan.began_s > run.began_s + self._settled_s:
            error_s = event.time_s - scan.began_s
            counts.mistimed += abs(error_s) > self._half_s
            counts.largest_error_s = max(counts.largest_error_s, abs(error_s))
            self.errors_s.append(error_s)

    def _close_runs_before(self, boot: float) -> None:
        """Count the scans of past runs that lie outside of the delivered ones."""
        span = {self._run.boot: self._run.last - self._run.first + 1} if self._run is not None else {}
        for over in [known for known in self._taken if known < boot]:
            self.counts.lost_at_restarts += self._taken.pop(over) - span.get(over, 0)
