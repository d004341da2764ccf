"""The emulator in real time, on a pty or a TCP port, until a signal ends it.

Deadlines are absolute on CLOCK_MONOTONIC, so lateness does not accumulate. The loop sleeps in ``select``
until the next deadline or until the host writes. Scene time starts with the board's first ``start`` command,
which is reported. Tables that the scene needs are solved before the port appears. A host that cannot compute
the scans in time makes the board miss some (`pace`); the bytes of each scan are sent before the next one is
computed.
"""

import contextlib
import os
import select
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tactiled.emulator.board.identity import EmulatedBoardParams, emulated_array
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.control import ControlLines, contact_report
from tactiled.emulator.line.faults import FaultKind, FaultParams
from tactiled.emulator.line.links import HostLink, make_control_link, make_link
from tactiled.emulator.pace import OverrunPolicy, SceneClock
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.prepare import missing_tables
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.slip_instants import SlipEpisodeTracker
from tactiled.emulator.scene.truth import Truth, plain_slip
from tactiled.wire.layout import Layout

Report = Callable[[dict[str, Any]], None]
_LONGEST_SLEEP_S = 1.0  # after a suspended machine wakes, the loop looks at its deadlines within this time


class Emulator:
    """A board in real time; `run` until `stop`.

    Parameters
    ----------
    report : callable
        Gets maps with ``what``: ``"ready"`` (address of the port), ``"scene"`` (truth, instants on
        CLOCK_MONOTONIC), ``"slip"`` (on a physical contact model, with its ``number``: when it is gross, and
        again when it has ended), ``"overrun"`` (this host is too slow: scan instants missed so far, time for
        which the scene stood still, and the ``t0_s`` from now on), ``"unplugged"``, ``"plugged"``, ``"scan"``
        (with `with_scans`), ``"end"`` (counts).
    with_scans : bool
        Report the truth of each scan.

    The constructor raises `ConfigError` where scene, layout and board do not fit.
    """

    def __init__(
        self,
        scene: Scene,
        layout: Layout,
        link: HostLink,
        *,
        board: EmulatedBoardParams | None = None,
        faults: FaultParams | None = None,
        seed: int = 0,
        report: Report,
        with_scans: bool = False,
        control: HostLink | None = None,
    ) -> None:
        self._scene = scene
        self._link = link
        self._report = report
        self._port = EmulatedPort(
            scene,
            layout,
            power_up_s=time.monotonic(),
            board=board,
            faults=faults,
            seed=seed,
            on_scan=self._report_scan if with_scans else lambda _: None,
        )
        self._control = control
        self._control_lines = ControlLines(self._port.contact)
        contact = self._port.contact
        self._slips = SlipReports(contact.watch) if isinstance(contact, PhysicalContact) else None
        self._faults_to_cause: deque[FaultKind] = deque()
        self._is_stopping = False
        self._is_plugged = True
        self._clock: SceneClock | None = None
        self._pace = OverrunPolicy()
        self._bytes_overflowed = 0
        self._wake_read, self._wake_write = os.pipe()

    def stop(self) -> None:
        """End `run`; may be called from a signal handler or another thread."""
        self._is_stopping = True
        with contextlib.suppress(OSError):  # `run` has ended and closed it
            os.write(self._wake_write, b"x")

    def inflict(self, kind: FaultKind) -> None:
        """Cause a fault of line or board at once; may be called from another thread."""
        self._faults_to_cause.append(kind)
        os.write(self._wake_write, b"x")

    def run(self) -> None:
        """Run the board until `stop`."""
        try:
            self._link.open()
            control = {}
            if self._control is not None:
                self._control.open()
                control = {"control": self._control.describe()["link"]}
            self._report({"what": "ready", **self._link.describe(), **control})
            while not self._is_stopping:
                self._step()
        finally:
            self._link.close()
            if self._control is not None:
                self._control.close()
            os.close(self._wake_read)
            os.close(self._wake_write)
        counts = vars(self._port.counts) | {"bytes_overflowed": self._bytes_overflowed}
        self._report({"what": "end", "counts": counts})

    def _step(self) -> None:
        """Do what is due, then sleep until something is."""
        while self._faults_to_cause:
            self._port.inflict(self._faults_to_cause.popleft(), time.monotonic())
        for arrival in self._port.step(time.monotonic()):
            self._bytes_overflowed += len(arrival.data) - self._link.write(arrival.data)
        if self._is_plugged != self._port.plugged:
            self._is_plugged = self._port.plugged
            self._replug()
        self._report_scene()
        self._report_slips()
        now_s = time.monotonic()
        self._keep_pace(now_s)
        wait_s = self._port.next_deadline_s() - now_s
        fds, control_fds = self._link.fds(), self._control.fds() if self._control else []
        # The board must have come up to now before it answers: overdue steps come first, one at a time.
        # A controller is answered at any time: a gripper does not wait for the board.
        awaited = [self._wake_read, *control_fds, *(fds if wait_s > 0 else [])]
        ready, _, _ = select.select(awaited, [], [], min(max(wait_s, 0.0), _LONGEST_SLEEP_S))
        if self._wake_read in ready:
            os.read(self._wake_read, 64)
        if any(fd in fds for fd in ready) and (data := self._link.read()):
            self._port.receive(data, time.monotonic())
        if self._control is not None and any(fd in control_fds for fd in ready):
            self._obey(self._control)

    def _keep_pace(self, now_s: float) -> None:
        """Leave out scans that are too late, and report overruns."""
        board = self._port.board
        if self._clock is not None and board.running and self._pace.is_behind(board.next_deadline_s(), now_s):
            scene_s = board.next_scene_s
            self._pace.overrun(self._port.skip_until(now_s))
            if board.scene_start_s is not None:
                self._clock.hold(scene_s, board.scene_start_s)
        if self._clock is not None and self._pace.is_report_due(now_s):
            scene = {"held_s": self._clock.held_s, "t0_s": self._clock.t0_s}
            self._report({"what": "overrun", "time_s": now_s, "missed": self._pace.missed, **scene})

    def _obey(self, control: HostLink) -> None:
        """Answer the controller; scene time is 0 before the scene begins."""
        t0_s = self._port.board.scene_start_s
        scene_s = 0.0 if t0_s is None else time.monotonic() - t0_s
        if answer := self._control_lines.receive(control.read(), scene_s):
            control.write(answer)

    def _replug(self) -> None:
        if self._is_plugged:
            self._link.open()
            self._report({"what": "plugged", "time_s": time.monotonic(), **self._link.describe()})
        else:
            self._link.close()
            self._report({"what": "unplugged", "time_s": time.monotonic()})

    def _report_scene(self) -> None:
        t0_s = self._port.board.scene_start_s
        if t0_s is not None and self._clock is None:
            self._clock = SceneClock(t0_s)
            self._report({"what": "scene", **self._truth(t0_s).to_map()})

    def _truth(self, t0_s: float) -> Truth:
        return Truth(self._scene, t0_s, self._port.contact, self._port.array)

    def _report_slips(self) -> None:
        clock = self._clock
        if clock is not None and self._slips is not None:
            for slip in self._slips.since_last(lambda: self._truth(0.0)):
                instants = {k: clock.true_s(v) for k, v in slip.items() if k.endswith("_s") and v is not None}
                self._report({"what": "slip", **slip, **instants})

    def _report_scan(self, scan: ScanTruth) -> None:
        names = ("index", "sequence", "boot", "began_s", "sent")
        of_scan = {name: getattr(scan, name) for name in names}
        self._report({"what": "scan", **of_scan, **contact_report(self._port.contact, scan.scene_s)})


class SlipReports:
    """Report each slip when it becomes gross, and again when it has ended."""

    def __init__(self, tracker: SlipEpisodeTracker) -> None:
        self._tracker = tracker
        self._number = 0  # of the oldest slip that is not reported as ended
        self._is_gross_reported = False

    def since_last(self, truth: Callable[[], Truth]) -> Iterator[dict[str, Any]]:
        """New reports of slips as plain data with their ``number``; `truth` is called only for these."""
        while self._number < self._tracker.count:
            back = self._number - self._tracker.count
            slip = self._tracker.episodes[back]
            ended = slip.end_s is not None
            if ended or (slip.gross_s is not None and not self._is_gross_reported):
                yield {"number": self._number, **plain_slip(truth().episodes[back])}
                self._is_gross_reported = True
            if not ended:
                return
            self._number, self._is_gross_reported = self._number + 1, False


def run_emulator(
    scene: Scene,
    layout: Layout,
    *,
    link: Path | None = None,
    tcp: str | None = None,
    board: EmulatedBoardParams | None = None,
    faults: FaultParams | None = None,
    seed: int = 0,
    report: Report,
    with_scans: bool = False,
    control: str | None = None,
) -> None:
    """Run an `Emulator` until SIGTERM or SIGINT, on a pty with the name `link`, or listening on `tcp`.

    A controller can move the grip at `control`, which is ``unix:///PATH`` or ``tcp://HOST:PORT``. Before each
    table that is solved first, `report` gets ``"preparing"``.

    Raises
    ------
    ConfigError
        The arguments do not fit each other, the link cannot be made, or the scene is not for real time.
    """
    port = make_link(link, tcp)
    control_port = None if control is None else make_control_link(control)
    missing = missing_tables(scene, emulated_array(scene, layout))
    if missing:  # a minute each, after which it would be late to say that a port cannot be made
        with contextlib.ExitStack() as tried:
            for each in (port, control_port):
                if each is not None:
                    each.open()
                    tried.callback(each.close)
    emulator = Emulator(
        scene,
        layout,
        port,
        board=board,
        faults=faults,
        seed=seed,
        report=report,
        with_scans=with_scans,
        control=control_port,
    )
    for done, solve in enumerate(missing):
        report({"what": "preparing", "tables": len(missing), "solved": done})
        solve()
    with _stopped_by_signals(emulator.stop):
        emulator.run()


@contextlib.contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Let SIGTERM and SIGINT call `stop`; handlers can only be set in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGTERM, signal.SIGINT)
    before = [signal.signal(number, lambda *_: stop()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def words_for_people(what: dict[str, Any]) -> str:
    """Report of `Emulator` in words; empty for most reports."""
    if what["what"] == "preparing":
        stage = f"table {what['solved'] + 1} of {what['tables']}, up to a minute"
        return f"solving the contact before the port appears: {stage}"
    if what["what"] == "overrun":
        held = f"; the scene has stood still for {what['held_s']:.2f} s in all" if what["held_s"] else ""
        return (
            f"overrun: this host is too slow for the scene: {what['missed']} scan instants missed so far, "
            f"each flagged on the wire as an overrun{held}"
        )
    return ""
