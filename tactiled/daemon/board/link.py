"""One board behind one port: pipeline, session and line diagnosis together, with no I/O.

Every byte enters by `BoardLink.received`. The service, `tactiled doctor` and the benches all call it, with a
real port and clock or with simulated ones.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from tactiled import compiled
from tactiled.daemon.board.diagnosis import LineWatch
from tactiled.daemon.board.host_load import HostLoad, LoopTurns
from tactiled.daemon.board.session import Session, SessionParams
from tactiled.events.types import Event, InfoEvent, ScanEvent, StatusEvent
from tactiled.pipeline import Health, Pipeline, check_hello
from tactiled.received import Output, Received
from tactiled.version import __version__
from tactiled.wire.frames import Acknowledge, Command, Hello

# An open port that delivers no byte may be a dead descriptor, so it is closed and opened again. Each interval
# is twice the one before, because a board without power is silent too. A stall of a board that sends bytes is
# handled by the session instead, which asks the board every 0.2 s.
SILENT_S = 3.0
_SILENT_LONGEST_S = 60.0
# `watch` is called ten times a second: after so long a pause this process slept, and not the port. What the
# board sent meanwhile waits to be read, and would be lost with the port.
_SLEPT_S = 2.0
# Largest age of a fresh scan, in units of `Session.silence_s`: one for a stall that is not detected yet, and
# one for bunching by the adapter. An older scan came out of a backlog.
_STALE_FACTOR = 2.0
STOP_S = 1.0  # longest wait for the answer to the last stop, which takes 20 ms, and more on a busy host
# Fields of the status event that the pipeline states under the same names.
_OF_HEALTH = {one.name for one in fields(Health)} & {one.name for one in fields(StatusEvent)}

RecordRead = Callable[[bytes, Sequence[Output], float], None]
"""Takes the bytes of one read, the outputs of the pipeline for them, and the time of the read."""


class BoardLink:
    """Connect pipeline, session and line diagnosis of one board; raises as `Session`."""

    def __init__(
        self, pipeline: Pipeline, params: SessionParams, baud: int, turns: LoopTurns | None = None
    ) -> None:
        layout, array = pipeline.layout, pipeline.array
        self._line = LineWatch(layout.name, baud)
        self.pipeline = pipeline
        self.session = Session(params, layout, lambda hello: check_hello(hello, layout, array), self._line)
        self.warnings: dict[str, str] = {}
        """Faults at the newest status that do not stop the scans, by cause: line, clock, port, zero, host."""
        self._load = HostLoad(turns or LoopTurns())
        self._patience_s = SILENT_S
        self._watched_s, self._awake_s = math.inf, -math.inf

    def opened(
        self, now_s: float, framing_errors: int | None = None, *, is_pty: bool = False
    ) -> list[Command]:
        """Begin with a port that was just opened; returns the commands to send first."""
        self._line.reset(now_s, is_pty=is_pty)
        self._line.count(self.pipeline.health(), framing_errors, now_s)
        return self.session.opened(now_s)

    def received(
        self,
        data: bytes,
        now_s: float,
        publish: Callable[[Event], None],
        record: RecordRead = lambda *_: None,
        scans_published: Callable[[], None] = lambda: None,
    ) -> list[Command]:
        """Process the bytes of one read of the port.

        Parameters
        ----------
        publish : callable
            Takes each event of the accepted board before this method returns: the scans before the
            detectors run, then what the detectors found.
        record : callable, optional
            Called before what the detectors found is published, and also when the pipeline raises, because
            the bytes that made it fail are the ones to look at later.
        scans_published : callable, optional
            Called between scans and detectors.
        """
        session, outputs = self.session, list[Output]()
        try:
            received = self.pipeline.receive(data, now_s)
            commands = self._greet(received, now_s)
            # A read with scans of two boards is recorded only: what it gave has no single sender.
            is_accepted = session.accepted and received.boards <= {session.board_serial}
            scans = received.scan_events if is_accepted else []
            if scans:
                for scan in scans:
                    publish(scan)
                scans_published()
            outputs = self.pipeline.detect([received])[0]
        finally:
            record(data, outputs, now_s)
        self._patience_s = SILENT_S
        self._line.received(data, now_s)
        if received.items:
            self._line.framed(now_s)
        if is_accepted:
            for output in outputs:
                if isinstance(output, Event) and not isinstance(output, ScanEvent):
                    publish(output)
        if self.pipeline.is_measuring:
            session.note_streaming()
        if scans:
            commands += session.scanned(now_s)
        return commands

    def _greet(self, received: Received, now_s: float) -> list[Command]:
        """Pass hellos and answers of the board to the session; return the commands to be sent."""
        commands: list[Command] = []
        for item in received.items:
            if isinstance(item, Hello):
                commands += self.session.greeted(item, now_s)
            elif isinstance(item, Acknowledge):
                commands += self.session.answered(item, now_s)
        return commands

    def sending(self, command: Command, now_s: float) -> dict[str, Any] | None:
        """Announce a ping, which is about to be written, to the pipeline.

        No board receives it before `now_s`. Returns the arguments of the pipeline's input of the same name,
        for the recording; None if none was given.
        """
        if command.name != "ping":
            return None
        arguments = {"token": command.token}
        self.pipeline.command("ping", arguments, now_s)
        return arguments

    def lost(self, reason: str) -> bool:
        """Take note that the port was lost or could not be opened; returns whether it was open before."""
        was_open = self.session.state != "no-device"
        if was_open:
            self.pipeline.disconnected()
        self.session.lost(reason)
        return was_open

    def watch(self, now_s: float, framing_errors: int | None = None) -> list[Command]:
        """Update the line diagnosis and act on passed deadlines; call it about ten times a second."""
        if now_s > self._watched_s + _SLEPT_S:
            self._awake_s = now_s
        self._watched_s = now_s
        self._line.count(self.pipeline.health(), framing_errors, now_s)
        return self.session.tick(now_s)

    def expire_silence(self, now_s: float) -> str:
        """Return the reason for reopening a port that was silent for too long; empty for none.

        After a reason, the next silence may be twice as long; the first byte restores `SILENT_S`.
        """
        silent_s = now_s - max(self._line.byte_s, self._awake_s)
        if self.session.state == "no-device" or silent_s < self._patience_s:
            return ""
        self._patience_s = min(2 * self._patience_s, _SILENT_LONGEST_S)
        return f"no byte for {silent_s:.0f} s: opened anew"

    def make_status(self, now_s: float, *, started_s: float, connects: int, warning: str = "") -> StatusEvent:
        """Make the status event, and set `warnings`; `valid` requires a running board and a fresh scan."""
        session, health = self.session, self.pipeline.health()
        # Before the first scan the age counts from the start of the daemon.
        age_s = max(0.0, now_s - max(health.newest_scan_s, started_s))
        fresh_s = _STALE_FACTOR * session.silence_s
        reason = session.reason(now_s)
        if session.state == "running" and age_s > fresh_s:
            reason = (
                f"scans come late: the newest was taken {age_s * 1000:.0f} ms ago, and {fresh_s * 1000:.0f} "
                "ms is the most; is the host or the line overloaded?"
            )
        loop_lag_s = self._load.note_status(now_s, health.fits_late)
        found = {
            "line": self._line.warning(),
            "clock": health.clock_warning,
            "port": warning,
            "zero": self.pipeline.tuning.zero_warning,
            "host": self._load.warning(),
        }
        self.warnings = {cause: words for cause, words in found.items() if words}
        return StatusEvent(
            time_s=now_s,
            state=session.state,
            valid=session.state == "running" and age_s <= fresh_s,
            reason=reason,
            loop_lag_s=loop_lag_s,
            warning="; ".join(self.warnings.values()),
            age_s=age_s,
            connects=connects,
            uptime_s=now_s - started_s,
            inhibited_s=self.pipeline.tuning.inhibited_s(now_s),
            path="python" if compiled.reason_plain else "compiled",
            **{name: getattr(health, name) for name in _OF_HEALTH},
        )

    def info(self, hello: Hello, now_s: float) -> InfoEvent:
        """Make the info event from the hello of the board and the configured layout and array."""
        layout, array = self.pipeline.layout, self.pipeline.array
        zero = self.pipeline.tuning.zero
        return InfoEvent(
            time_s=now_s,
            board_serial=hello.board_serial,
            firmware_version=hello.firmware_version,
            protocol=layout.name,
            protocol_version=hello.protocol_version,
            array_id=hello.array_id,
            channels=layout.n_channels,
            taxels=array.n_taxels,
            x_mm=tuple(array.x_mm.tolist()),
            y_mm=tuple(array.y_mm.tolist()),
            channel_names=array.channel_name,
            rate_hz=hello.rate_hz,
            volts_per_count=hello.volts_per_count,
            channel_offset_s=hello.channel_offset_s or (0.0,) * layout.n_channels,
            tactiled_version=__version__,
            zero=() if zero is None else tuple(np.nan_to_num(zero).tolist()),
        )
