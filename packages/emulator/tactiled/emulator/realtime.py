"""The emulator in real time, on a pty or a TCP port, until a signal ends it.

Deadlines are absolute on CLOCK_MONOTONIC, so lateness does not accumulate. The loop sleeps in ``select``
until the next deadline or until the host writes. Scene time starts with the board's first ``start`` command,
which is reported. A host that cannot compute the scans in time sends them late, as an adapter that buffers
does: each is sent before the next one is computed, and how far the board is behind is reported. What comes
from outside, bytes and faults, takes effect when the board has reached the instant at which it came.
"""

import contextlib
import os
import select
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.control import ControlLines, contact_report
from tactiled.emulator.line.faults import FaultKind, FaultParams
from tactiled.emulator.line.links import HostLink, SocketLink
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.truth import Truth
from tactiled.wire.layout import Layout

Report = Callable[[dict[str, Any]], None]
_PLAYED_S = 0.1  # of a scene at once, while its tables are solved
_TELL_S = 2.0  # between two reports of tables that are being solved, or of a board that is behind
_BEHIND_S = 0.5  # further behind than this, the board is too late for a host that waits for scans or answers
_LONGEST_SLEEP_S = 1.0  # after a suspended machine wakes, the loop looks at its deadlines within this time
_MOST_INPUTS = 64  # reads of the host that wait for a late board; the rest waits in the link


class Emulator:
    """A board in real time; `run` until `stop`, or `run_until_signal`.

    `report` gets maps with ``what``: ``"ready"`` (address of the port), ``"scene"`` (truth, instants on
    CLOCK_MONOTONIC), ``"unplugged"``, ``"plugged"``, ``"scan"`` (its truth, `with_scans`), ``"behind"`` (the
    host is too slow for the scene), ``"preparing"`` (tables are solved), ``"end"`` (counts). At `control` a
    controller can move the grip. The constructor raises `ConfigError` where scene, layout and board do not
    fit.
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
        control: SocketLink | None = None,
    ) -> None:
        self._scene = scene
        self._link = link
        self._report = report
        self._make_port = partial(
            EmulatedPort,
            scene,
            layout,
            board=board,
            faults=faults,
            seed=seed,
            on_scan=self._report_scan if with_scans else lambda _: None,
        )
        self._control = control
        self._power_up()
        self._faults_to_cause: deque[FaultKind] = deque()
        # Bytes of the host and faults that the board has not reached, with their instants, in order.
        self._inputs: deque[tuple[float, Callable[[float], None]]] = deque()
        self._is_stopping = False
        self._is_plugged = True
        self._is_scene_reported = False
        self._bytes_overflowed = 0
        self._told_behind_s = float("-inf")
        self._wake_read, self._wake_write = os.pipe()

    def stop(self) -> None:
        """End `run`; may be called from a signal handler or another thread."""
        self._is_stopping = True
        self._wake()

    def inflict(self, kind: FaultKind) -> None:
        """Cause a fault of line or board at this instant; may be called from another thread."""
        self._faults_to_cause.append(kind)
        self._wake()

    def run_until_signal(self) -> None:
        """Solve the tables that a grooved plate needs, then run until `stop`, SIGTERM or SIGINT.

        `ConfigError` where the link cannot be made.
        """
        self._solve_tables()
        # Anew: the scene was played, and of a board that waited, hellos and faults would all come at once.
        self._power_up()
        with _stopped_by_signals(self.stop):
            self.run()

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
            ends = self._wake_read, self._wake_write
            self._wake_read = self._wake_write = -1  # the numbers may become those of other files
            for end in ends:
                os.close(end)
        counts = vars(self._port.counts) | {"bytes_overflowed": self._bytes_overflowed}
        self._report({"what": "end", "counts": counts})

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # `run` has ended
            os.write(self._wake_write, b"x")

    def _power_up(self) -> None:
        self._port = self._make_port(power_up_s=time.monotonic())
        self._control_lines = ControlLines(self._port.contact, self._scene.duration_s)

    def _solve_tables(self) -> None:
        """Play a scene over grooves once: tables that are not shipped, a minute each, are solved and kept."""
        contact = self._port.contact
        if not isinstance(contact, PhysicalContact) or not contact.has_tables:
            return
        told_s, duration_s = time.monotonic(), self._scene.duration_s
        while contact.played_s < duration_s:
            contact.play_until(contact.played_s + _PLAYED_S)
            if time.monotonic() > told_s + _TELL_S:
                told_s = time.monotonic()
                self._report({"what": "preparing", "played_s": contact.played_s, "duration_s": duration_s})

    def _step(self) -> None:
        """Do one event or input that is due, then sleep until something is."""
        now_s = time.monotonic()
        while self._faults_to_cause:
            self._inputs.append((now_s, partial(self._port.inflict, self._faults_to_cause.popleft())))
        until_s = self._inputs[0][0] if self._inputs else now_s
        for arrival in self._port.step(until_s):
            self._bytes_overflowed += len(arrival.data) - self._link.write(arrival.data)
        if self._inputs and self._port.next_deadline_s() > until_s:
            _, take = self._inputs.popleft()
            take(until_s)
        if self._is_plugged != self._port.plugged:
            self._is_plugged = self._port.plugged
            self._replug()
        self._report_scene()
        self._report_behind()
        wait_s = 0.0 if self._inputs else self._port.next_deadline_s() - time.monotonic()
        wait_s = min(max(wait_s, 0.0), _LONGEST_SLEEP_S)
        fds = self._link.fds() if len(self._inputs) < _MOST_INPUTS else []
        control_fds = self._control.fds() if self._control else []
        ready, _, _ = select.select([self._wake_read, *control_fds, *fds], [], [], wait_s)
        if self._wake_read in ready:
            os.read(self._wake_read, 64)
        if any(fd in fds for fd in ready) and (data := self._link.read()):
            self._inputs.append((time.monotonic(), partial(self._port.receive, data)))
        if self._control is not None and any(fd in control_fds for fd in ready):
            self._obey(self._control)

    def _obey(self, control: SocketLink) -> None:
        """Answer the controller, as of where a late board is; scene time is 0 before the scene begins.

        A controller that has left gets no answer, and its unfinished line ends with it.
        """
        t0_s, reached_s = self._port.board.scene_start_s, min(time.monotonic(), self._port.next_deadline_s())
        scene_s = 0.0 if t0_s is None else reached_s - t0_s
        n_peers = control.n_peers
        answer = self._control_lines.receive(control.read(), scene_s)
        if control.n_peers != n_peers:
            self._control_lines = ControlLines(self._port.contact, self._scene.duration_s)
        elif answer:
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
            truth = Truth(self._scene, t0_s, self._port.contact)
            self._report({"what": "scene", **truth.to_map()})

    def _report_behind(self) -> None:
        now_s = time.monotonic()
        behind_s = now_s - self._port.next_deadline_s()
        if behind_s > _BEHIND_S and now_s > self._told_behind_s + _TELL_S:
            self._told_behind_s = now_s
            self._report({"what": "behind", "behind_s": behind_s})

    def _report_scan(self, scan: ScanTruth) -> None:
        names = ("index", "sequence", "boot", "began_s", "sent")
        of_scan = {name: getattr(scan, name) for name in names}
        self._report({"what": "scan", **of_scan, **contact_report(self._port.contact, scan.scene_s)})


@contextlib.contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Let SIGTERM and SIGINT call `stop`."""
    numbers = (signal.SIGTERM, signal.SIGINT)
    before = [signal.signal(number, lambda *_: stop()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
