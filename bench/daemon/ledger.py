"""Every scan accounted for: what a daemon published against what the emulator knows really happened."""

import math
from collections import deque
from dataclasses import dataclass

from tactiled.emulator.board.scanning import ScanTruth
from tactiled.events.types import Event, ScanEvent, StatusEvent


@dataclass
class Account:
    """What became of the scans, and how true their instants were."""

    taken: int = 0
    """Scan instants of the board, missed ones (overruns) included."""
    delivered: int = 0
    late: int = 0
    """Delivered, and marked as too old to act on."""
    lost_in_runs: int = 0
    """Not delivered, between two that were, of one run of the board: the daemon must have counted each."""
    lost_at_restarts: int = 0
    """Before the first and after the last delivered scan of a run: nobody at this end can count them."""
    repeated: int = 0
    """Published twice, or out of order."""
    mistimed: int = 0
    """Further from any true instant than half a period, although the clock had time to settle."""
    largest_error_s: float = 0.0
    false_fresh: int = 0
    """Statuses that were valid while the newest delivered scan was older than that allows."""


class Ledger:
    """Truth and what was published, side by side; memory is that of what is still under way.

    Runs of the board are told apart by time: what comes late has late instants at worst, until the clock of
    a new run has settled, and a board that boots is silent for longer than the clock errs.

    Parameters
    ----------
    rate_hz : float
    oldest_valid_s : float
        A status may be valid with a newest scan of this age and no more.
    settled_s : float
        After each new run the clock is given so long before its errors count.
    """

    def __init__(self, rate_hz: float, oldest_valid_s: float, settled_s: float = 10.0) -> None:
        self._half_s = 0.5 / rate_hz
        self._oldest_valid_s = oldest_valid_s
        self._settled_s = settled_s
        self._truth: deque[ScanTruth] = deque()
        self._taken: dict[int, int] = {}  # by boot, for those that are not closed yet
        self._run: _Run | None = None
        self._newest_began_s = -math.inf
        self.account = Account()
        self.errors_s: list[float] = []
        """Errors of settled instants; whoever reads them clears them."""

    def taken(self, scan: ScanTruth) -> None:
        """The board reached a scan instant."""
        self.account.taken += 1
        self._taken[scan.boot] = self._taken.get(scan.boot, 0) + 1
        self._truth.append(scan)

    def published(self, event: Event) -> None:
        """The daemon said something."""
        if isinstance(event, ScanEvent):
            self._scan(event)
        elif isinstance(event, StatusEvent) and event.valid:
            age_s = event.time_s - self._newest_began_s
            self.account.false_fresh += age_s > self._oldest_valid_s

    def close(self) -> None:
        """No more scans: what the last run lost at its ends is counted too."""
        self._close_runs_before(math.inf)

    def _scan(self, event: ScanEvent) -> None:
        account, truth = self.account, self._truth
        while len(truth) > 1 and truth[1].began_s <= event.time_s + self._half_s:
            truth.popleft()
        if not truth:
            account.mistimed += 1
            return
        scan = truth[0]
        if self._run is None or scan.boot > self._run.boot:
            self._close_runs_before(scan.boot)
            self._run = _Run(scan.boot, event.index, event.index - 1, scan.began_s)
        run = self._run
        if event.index <= run.last:
            account.repeated += 1
            return
        account.lost_in_runs += event.index - run.last - 1
        account.delivered += 1
        account.late += event.late
        run.last = event.index
        self._newest_began_s = min(scan.began_s, event.time_s)
        if scan.began_s > run.began_s + self._settled_s:
            error_s = event.time_s - scan.began_s
            account.mistimed += abs(error_s) > self._half_s
            account.largest_error_s = max(account.largest_error_s, abs(error_s))
            self.errors_s.append(error_s)

    def _close_runs_before(self, boot: float) -> None:
        """Runs that are over: what of them lies outside of what was delivered."""
        span = {self._run.boot: self._run.last - self._run.first + 1} if self._run is not None else {}
        for over in [known for known in self._taken if known < boot]:
            self.account.lost_at_restarts += self._taken.pop(over) - span.get(over, 0)


@dataclass
class _Run:
    """Indices of the scans delivered since a boot, and when the first of them was taken."""

    boot: int
    first: int
    last: int
    began_s: float
