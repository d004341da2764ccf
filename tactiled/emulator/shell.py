"""The emulator in real time, on a real pty or TCP port.

Deadlines are absolute on CLOCK_MONOTONIC, so lateness never adds up; the loop sleeps in ``select`` until the
next one or until the host writes. Scene time starts with the board's first ``start`` command; the report
says when that was. What must be solved before is solved in a thread: the board introduces itself meanwhile
and answers ``start`` with ``busy``. A host that cannot compute the scans in time makes the board miss some,
see `pace`; the bytes of each scan go out before the next one is computed.
"""

import contextlib
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.control import ControlLines, contact_report
from tactiled.emulator.line.faults import FaultKind, FaultParams
from tactiled.emulator.line.links import HostLink
from tactiled.emulator.pace import OverrunPolicy, SceneClock
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.prepare import check_real_time, prepare
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.slip_instants import SlipEpisodeTracker
from tactiled.emulator.scene.truth import Truth, plain_slip
from tactiled.errors import ConfigError
from tactiled.wire.layout import Layout

Report = Callable[[dict[str, Any]], None]
# Longest sleep: a scan that ends in the far future must not outlive a suspended machine by much.
_LONGEST_SLEEP_S = 1.0
_LONG_PREPARATION_S = 2.0  # beyond it, a person is told that the board is not dead


class Emulator:
    """A port in real time; `run` until `stop`.

    Parameters
    ----------
    scene : Scene
    layout : Layout
    link : HostLink
    board : EmulatedBoardParams
    faults : FaultParams
    seed : int
        Of the faults.
    report : callable
        Gets maps with ``what``: ``"ready"`` (where the port is), ``"preparing"`` (before each table that is
        solved, and after two seconds of looking which are needed), ``"prepared"`` (if it took two seconds),
        ``"scene"`` (truth, instants on CLOCK_MONOTONIC), ``"slip"`` (on a physical rung, with its
        ``number``: once it is gross, and again once it has ended), ``"overrun"`` (this host is too slow: how
        many scan instants were missed so far, for how long the scene stood still, and the ``t0_s`` that
        holds from now on), ``"unplugged"``, ``"plugged"``, ``"scan"`` (if asked), ``"end"`` (counts).
    with_scans : bool
        Report the truth of each scan.
    control : HostLink or None
        Where a controller speaks; see `control`.

    Raises
    ------
    ConfigError
        Scene, layout and board do not fit, or the link cannot be made.
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
        check_real_time(scene)
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
        self._asked_for: deque[FaultKind] = deque()
        self._is_stopping = False
        self._is_plugged = True
        self._clock: SceneClock | None = None
        self._pace = OverrunPolicy()
        self._refused: ConfigError | None = None
        self._preparing_s: float | None = None
        self._is_preparing_reported = False
        self._bytes_overflowed = 0
        self._wake_read, self._wake_write = os.pipe()

    def stop(self) -> None:
        """End `run` soon; may be called from a signal handler or another thread."""
        self._is_stopping = True
        with contextlib.suppress(OSError):  # `run` has ended and closed it
            os.write(self._wake_write, b"x")

    def inflict(self, kind: FaultKind) -> None:
        """Do this to the line or the board at once; may be called from another thread."""
        self._asked_for.append(kind)
        os.write(self._wake_write, b"x")

    def run(self) -> None:
        """Be a board until `stop`."""
        try:
            self._link.open()
            control = {}
            if self._control is not None:
                self._control.open()
                control = {"control": self._control.describe()["link"]}
            self._report({"what": "ready", **self._link.describe(), **control})
            self._port.board.preparing = True
            self._preparing_s = time.monotonic()
            threading.Thread(target=self._prepare, name="prepare", daemon=True).start()
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
        while self._asked_for:
            self._port.inflict(self._asked_for.popleft(), time.monotonic())
        self._look_at_preparation()
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
        # To answer, the board must have come up to now: what is overdue is done first, one step at a time.
        awaited = [self._wake_read, *([*fds, *control_fds] if wait_s > 0 else [])]
        ready, _, _ = select.select(awaited, [], [], min(max(wait_s, 0.0), _LONGEST_SLEEP_S))
        if self._wake_read in ready:
            os.read(self._wake_read, 64)
        if any(fd in fds for fd in ready) and (data := self._link.read()):
            self._port.receive(data, time.monotonic())
        if self._control is not None and any(fd in control_fds for fd in ready):
            self._obey(self._control)

    def _keep_pace(self, now_s: float) -> None:
        """Leave out scans that are too late, and report it."""
        board = self._port.board
        if self._clock is not None and board.running and self._pace.is_behind(board.next_deadline_s(), now_s):
            scene_s = board.next_scene_s
            self._pace.overrun(self._port.skip_until(now_s))
            if board.scene_start_s is not None:
                self._clock.hold(scene_s, board.scene_start_s)
        if self._clock is not None and self._pace.is_report_due(now_s):
            self._report(
                {
                    "what": "overrun",
                    "time_s": now_s,
                    "missed": self._pace.missed,
                    "held_s": self._clock.held_s,
                    "t0_s": self._clock.t0_s,
                }
            )

    def _prepare(self) -> None:
        """In a thread: solve what the scene needs, then let the board start."""
        try:
            prepare(self._scene, self._port.array, self._report_preparing)
        except ConfigError as error:
            self._refused = error
        self._port.board.preparing = False
        with contextlib.suppress(OSError):  # `run` has ended and closed it
            os.write(self._wake_write, b"x")

    def _look_at_preparation(self) -> None:
        if self._refused is not None:
            raise self._refused
        if self._preparing_s is None:
            return
        took_s = time.monotonic() - self._preparing_s
        if not self._port.board.preparing:
            self._preparing_s = None
            if took_s > _LONG_PREPARATION_S:
                self._report({"what": "prepared", "took_s": took_s})
        elif took_s > _LONG_PREPARATION_S and not self._is_preparing_reported:
            self._report_preparing(0, 0)

    def _obey(self, control: HostLink) -> None:
        """Answer the controller; before the scene begins, scene time stands at 0."""
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

    def _report_preparing(self, done: int, tables: int) -> None:
        self._is_preparing_reported = True
        self._report({"what": "preparing", "tables": tables, "solved": done})

    def _report_scan(self, scan: ScanTruth) -> None:
        self._report(
            {
                "what": "scan",
                "index": scan.index,
                "sequence": scan.sequence,
                "boot": scan.boot,
                "began_s": scan.began_s,
                "sent": scan.sent,
                **contact_report(self._port.contact, scan.scene_s),
            }
        )


class SlipReports:
    """Each slip when it becomes gross, and again when it has ended.

    Parameters
    ----------
    watch : SlipEpisodeTracker
    """

    def __init__(self, watch: SlipEpisodeTracker) -> None:
        self._watch = watch
        self._number = 0  # of the slip that may have news
        self._said_gross = False

    def since_last(self, truth: Callable[[], Truth]) -> Iterator[dict[str, Any]]:
        """Slips as plain data, with their ``number``; `truth` is asked only where there is news."""
        while self._number < self._watch.count:
            back = self._number - self._watch.count
            slip = self._watch.episodes[back]
            ended = slip.end_s is not None
            if ended or (slip.gross_s is not None and not self._said_gross):
                yield {"number": self._number, **plain_slip(truth().episodes[back])}
                self._said_gross = True
            if not ended:
                return
            self._number, self._said_gross = self._number + 1, False
