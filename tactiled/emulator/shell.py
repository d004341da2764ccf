"""The emulator in real time, on a real pty or TCP port.

Deadlines are absolute on CLOCK_MONOTONIC, so lateness never adds up; the loop sleeps in ``select`` until the
next one or until the host writes. Scene time starts with the board's first ``start`` command; the report
says when that was.
"""

import contextlib
import os
import select
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from tactiled.emulator.control import ControlLines, contact_report
from tactiled.emulator.faults import FaultKind, FaultParams
from tactiled.emulator.identity import BoardParams, worn_array
from tactiled.emulator.links import Link
from tactiled.emulator.physical import PhysicalContact
from tactiled.emulator.port import Port
from tactiled.emulator.prepare import prepare
from tactiled.emulator.scanning import ScanTruth
from tactiled.emulator.scene import Scene
from tactiled.emulator.slipnews import SlipNews
from tactiled.emulator.truth import Truth
from tactiled.wire.layout import Layout

Report = Callable[[dict[str, Any]], None]
# Longest sleep: a scan that ends in the far future must not outlive a suspended machine by much.
_LONGEST_SLEEP_S = 1.0


class Emulator:
    """A port in real time; `run` until `stop`.

    Parameters
    ----------
    scene : Scene
    layout : Layout
    link : Link
    board : BoardParams
    faults : FaultParams
    seed : int
        Of the faults.
    report : callable
        Gets maps with ``what``: ``"preparing"`` (before each table that is solved), ``"ready"`` (where the
        port is), ``"scene"`` (truth, instants on
        CLOCK_MONOTONIC), ``"slip"`` (on a physical rung, with its
        ``number``: once it is gross, and again once it has ended), ``"unplugged"``, ``"plugged"``,
        ``"scan"`` (if asked), ``"end"`` (counts).
    with_scans : bool
        Report the truth of each scan.
    control : Link or None
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
        link: Link,
        *,
        board: BoardParams | None = None,
        faults: FaultParams | None = None,
        seed: int = 0,
        report: Report,
        with_scans: bool = False,
        control: Link | None = None,
    ) -> None:
        self._scene = scene
        self._link = link
        self._report = report
        prepare(scene, worn_array(scene, layout), self._report_preparing)  # before power-up: it takes time
        self._port = Port(
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
        self._slips = SlipNews(contact.watch) if isinstance(contact, PhysicalContact) else None
        self._asked_for: deque[FaultKind] = deque()
        self._is_stopping = False
        self._is_plugged = True
        self._is_scene_reported = False
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
        for arrival in self._port.advance(time.monotonic()):
            self._bytes_overflowed += len(arrival.data) - self._link.write(arrival.data)
        if self._is_plugged != self._port.plugged:
            self._is_plugged = self._port.plugged
            self._replug()
        self._report_scene()
        self._report_slips()
        wait_s = self._port.next_deadline_s() - time.monotonic()
        fds, control_fds = self._link.fds(), self._control.fds() if self._control else []
        awaited = [self._wake_read, *fds, *control_fds]
        ready, _, _ = select.select(awaited, [], [], min(max(wait_s, 0.0), _LONGEST_SLEEP_S))
        if self._wake_read in ready:
            os.read(self._wake_read, 64)
        if any(fd in fds for fd in ready) and (data := self._link.read()):
            self._port.receive(data, time.monotonic())
        if self._control is not None and any(fd in control_fds for fd in ready):
            self._obey(self._control)

    def _obey(self, control: Link) -> None:
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
        if t0_s is not None and not self._is_scene_reported:
            self._is_scene_reported = True
            self._report({"what": "scene", **self._truth(t0_s).to_map()})

    def _truth(self, t0_s: float) -> Truth:
        return Truth(self._scene, t0_s, self._port.contact, self._port.array)

    def _report_slips(self) -> None:
        t0_s = self._port.board.scene_start_s
        if t0_s is not None and self._slips is not None:
            for slip in self._slips.since_last(lambda: self._truth(t0_s)):
                self._report({"what": "slip", **slip})

    def _report_preparing(self, done: int, tables: int) -> None:
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
                **contact_report(self._port.contact, scan.began_s - (self._port.board.scene_start_s or 0.0)),
            }
        )
