"""Link of the daemon on an emulated port in simulated time, for days of board time."""

from collections.abc import Callable

from tactiled.array import Array
from tactiled.daemon.board.link import BoardLink
from tactiled.daemon.board.session import SessionParams
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.suite import DetectParams
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.line.faults import FaultKind, FaultParams
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.phases import HoldPhase, LiftPhase, PressPhase, RestPhase, SlidePhase
from tactiled.events.types import Event, StatusEvent
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command
from tactiled.wire.layout import Layout

TICK_S = 0.1  # the service's status period
REOPEN_S = 0.05  # the connection's quick tries


class SimulatedLink:
    """Link, session, pipeline and emulated port on one clock that jumps from deadline to deadline.

    As the service does, it opens and reopens the port, passes bytes and commands, and ticks.

    Parameters
    ----------
    scene, layout, array
    publish : callable
        Called with every event, the status at each tick among them.
    on_scan : callable
        Called with the truth of every scan instant.
    origin_s : float
        Time of the clock at the beginning.
    tick_s : float
        Period of the status and of the check of the line; the service's is the default.

    Attributes
    ----------
    port, pipeline, session, link
    connects : int
        Number of times that the port was opened.
    bytes_read, bytes_unread : int
        Bytes that arrived while the port was open, and while it was closed.
    """

    def __init__(
        self,
        scene: Scene,
        layout: Layout,
        array: Array,
        *,
        board: EmulatedBoardParams | None = None,
        faults: FaultParams | None = None,
        seed: int = 0,
        session: SessionParams | None = None,
        publish: Callable[[Event], None],
        on_scan: Callable[[ScanTruth], None],
        origin_s: float = 1000.0,
        tick_s: float = TICK_S,
    ) -> None:
        self.now_s = self._began_s = origin_s
        self.port = EmulatedPort(
            scene, layout, power_up_s=origin_s, board=board, faults=faults, seed=seed, on_scan=on_scan
        )
        seldom = DetectParams(texture=JointParams(hop_s=10.0))  # fits take more time than all the rest
        self.pipeline = Pipeline(layout, array, PipelineParams(detect=seldom))
        self.link = BoardLink(self.pipeline, session or SessionParams(), layout.file.baud)
        self.session = self.link.session
        self.connects = 0
        self.bytes_read = 0
        self.bytes_unread = 0
        self._publish = publish
        self._encoder = Encoder(layout)
        self._is_open = False
        self._tick_period_s = tick_s
        self._open_s = self._tick_s = origin_s

    def run_until(self, end_s: float) -> None:
        """Run until an instant."""
        while (due_s := self._next_s()) <= end_s:
            self._step(max(due_s, self.now_s))
        self._step(end_s)

    def inflict(self, kind: FaultKind) -> None:
        """Cause a fault of line or board now."""
        self.port.inflict(kind, self.now_s)
        self._check_plug()

    def status(self) -> StatusEvent:
        """Status at present."""
        return self.link.make_status(self.now_s, started_s=self._began_s, connects=self.connects)

    def _next_s(self) -> float:
        deadline_s = self.session.deadline_s if self._is_open else self._open_s
        return min(self.port.next_deadline_s(), deadline_s, self._tick_s)

    def _step(self, now_s: float) -> None:
        self.now_s = now_s
        for arrival in self.port.advance(now_s):
            if self._is_open:
                self.bytes_read += len(arrival.data)
                self._send(self.link.received(arrival.data, now_s, self._publish))
            else:
                self.bytes_unread += len(arrival.data)
        self._check_plug()
        if not self._is_open and now_s >= self._open_s:
            self._open()
        if self._is_open and now_s >= self.session.deadline_s:
            self._send(self.session.tick(now_s))
        if now_s >= self._tick_s:
            self._tick_s = now_s + self._tick_period_s
            self._send(self.link.watch(now_s))
            if self._is_open and self.session.state != "running" and (why := self.link.expire_silence(now_s)):
                self._lose(why)
            self._publish(self.status())

    def _open(self) -> None:
        self._open_s = self.now_s + REOPEN_S
        if self.port.plugged:
            self._is_open = True
            self.connects += 1
            self._send(self.link.opened(self.now_s))
        else:
            self.link.lost("no such port")

    def _check_plug(self) -> None:
        if self._is_open and not self.port.plugged:
            self._lose("unplugged")

    def _lose(self, reason: str) -> None:
        self._is_open = False
        self._open_s = self.now_s + REOPEN_S
        self.link.lost(reason)
        self._publish(self.status())

    def _send(self, commands: list[Command]) -> None:
        for command in commands:
            self.link.sending(command, self.now_s)
            self.port.receive(self._encoder.encode(command), self.now_s)


def grasps(duration_s: float) -> Scene:
    """Scene of a hand that each ten minutes takes something, holds it, lets it slide once, puts it back."""
    cycle = [
        RestPhase(kind="rest", duration_s=20.0),
        PressPhase(kind="press", duration_s=2.0, force_n=20.0),
        HoldPhase(kind="hold", duration_s=478.0),
        SlidePhase(kind="slide", duration_s=20.0, speed_mm_s=1.0),
        HoldPhase(kind="hold", duration_s=20.0),
        LiftPhase(kind="lift", duration_s=2.0),
        RestPhase(kind="rest", duration_s=58.0),
    ]
    n = max(1, round(duration_s / sum(phase.duration_s for phase in cycle)))
    return Scene(name="grasps", phases=cycle * n)
