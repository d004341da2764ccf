"""The daemon's link on an emulated port, in simulated time: days in minutes, every frame accounted for.

`Rig` plays what the service does around a link: it opens and reopens the port, hands over bytes, writes
commands, ticks. `Ledger` holds what was published against what the emulator knows really happened.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from tactiled.array import Array
from tactiled.daemon.diagnosis import LineWatch
from tactiled.daemon.link import Link
from tactiled.daemon.session import Session
from tactiled.daemon.terms import SessionParams, Terms
from tactiled.emulator.faults import FaultKind, FaultParams
from tactiled.emulator.identity import BoardParams
from tactiled.emulator.port import Port
from tactiled.emulator.scanning import ScanTruth
from tactiled.emulator.scene import Scene
from tactiled.events.types import Event, ScanEvent, StatusEvent
from tactiled.pipeline import Pipeline, check_hello
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command
from tactiled.wire.layout import Layout

TICK_S = 0.1  # the service's status period
REOPEN_S = 0.05  # the connection's quick tries


class Rig:
    """Link, session, pipeline and emulated port on one clock that jumps.

    Parameters
    ----------
    scene, layout, array
    board : BoardParams, optional
    faults : FaultParams, optional
    seed : int
    session : SessionParams, optional
    publish : callable
        Gets every event, status at 10 Hz among them.
    on_scan : callable
        Gets the truth of every scan instant.
    origin_s : float
        What the clock reads at the beginning.
    tick_s : float
        Period of looking at the line and of the status; the service's is the default.
    """

    def __init__(
        self,
        scene: Scene,
        layout: Layout,
        array: Array,
        *,
        board: BoardParams | None = None,
        faults: FaultParams | None = None,
        seed: int = 0,
        session: SessionParams | None = None,
        publish: Callable[[Event], None],
        on_scan: Callable[[ScanTruth], None],
        origin_s: float = 1000.0,
        tick_s: float = TICK_S,
    ) -> None:
        self.now_s = self._began_s = origin_s
        self.port = Port(
            scene, layout, power_up_s=origin_s, board=board, faults=faults, seed=seed, on_scan=on_scan
        )
        self.pipeline = Pipeline(layout, array)
        line = LineWatch(layout.name, layout.file.baud)
        terms = Terms(session or SessionParams(), layout, lambda hello: check_hello(hello, layout, array))
        self.session = Session(terms, line)
        self.link = Link(self.pipeline, self.session, line)
        self.connects = 0
        self.bytes_read = 0
        self.bytes_unread = 0
        """Bytes that arrived while nobody had the port open."""
        self._publish = publish
        self._encoder = Encoder(layout)
        self._is_open = False
        self._tick_period_s = tick_s
        self._open_s = self._tick_s = origin_s

    def run_until(self, end_s: float) -> None:
        """Let time pass."""
        while (due_s := self._next_s()) <= end_s:
            self._step(max(due_s, self.now_s))
        self._step(end_s)

    def inflict(self, kind: FaultKind) -> None:
        """Do this to the line or the board, now."""
        self.port.inflict(kind, self.now_s)
        self._look_at_plug()

    def status(self) -> StatusEvent:
        """How things are said to be, now."""
        return self.link.status(self.now_s, started_s=self._began_s, connects=self.connects)

    def _next_s(self) -> float:
        deadline_s = self.session.deadline_s if self._is_open else self._open_s
        return min(self.port.next_deadline_s(), deadline_s, self._tick_s)

    def _step(self, now_s: float) -> None:
        self.now_s = now_s
        for arrival in self.port.advance(now_s):
            if self._is_open:
                self.bytes_read += len(arrival.data)
                self._say(self.link.received(arrival.data, now_s, self._publish))
            else:
                self.bytes_unread += len(arrival.data)
        self._look_at_plug()
        if not self._is_open and now_s >= self._open_s:
            self._open()
        if self._is_open and now_s >= self.session.deadline_s:
            self._say(self.session.tick(now_s))
        if now_s >= self._tick_s:
            self._tick_s = now_s + self._tick_period_s
            self._say(self.link.watch(now_s))
            if self._is_open and self.session.state != "running" and (why := self.link.dead_because(now_s)):
                self._lose(why)
            self._publish(self.status())

    def _open(self) -> None:
        self._open_s = self.now_s + REOPEN_S
        if self.port.plugged:
            self._is_open = True
            self.connects += 1
            self._say(self.link.opened(self.now_s))
        else:
            self.link.lost("no such port")

    def _look_at_plug(self) -> None:
        if self._is_open and not self.port.plugged:
            self._lose("unplugged")

    def _lose(self, reason: str) -> None:
        self._is_open = False
        self._open_s = self.now_s + REOPEN_S
        self.link.lost(reason)
        self._publish(self.status())

    def _say(self, commands: list[Command]) -> None:
        for command in commands:
            self.port.receive(self._encoder.encode(command), self.now_s)


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
