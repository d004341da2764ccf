"""One board behind one port: pipeline, session and line diagnosis together, with no I/O.

Every byte enters by `BoardLink.received`. The service, `tactiled doctor` and the benches all call it, with a
real port and clock or with simulated ones.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from tactiled import compiled
from tactiled.daemon.board.diagnosis import LineWatch, Tally
from tactiled.daemon.board.load import HostLoad, LoopTurns
from tactiled.daemon.board.requirements import BoardRequirements, SessionParams
from tactiled.daemon.board.session import Session
from tactiled.events.types import Event, ScanEvent, StatusEvent
from tactiled.pipeline import Health, Pipeline, check_hello
from tactiled.received import Output, Received
from tactiled.wire.frames import Acknowledge, Command, Hello
from tactiled.wire.layout import Layout

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
# Fields of the status event that the pipeline states under the same names.
_OF_HEALTH = {one.name for one in fields(Health)} & {one.name for one in fields(StatusEvent)}

RecordRead = Callable[[bytes, Sequence[Output], float], None]
"""Takes the bytes of one read, the outputs of the pipeline for them, and the time of the read."""


def _record_nothing(data: bytes, outputs: Sequence[Output], now_s: float) -> None:
    del data, outputs, now_s


def _go_on() -> None:
    pass


class BoardLink:
    """Connect pipeline, session and line diagnosis of one board.

    Parameters
    ----------
    line : LineWatch
        The one that `session` was made with.
    turns : LoopTurns, optional
        Takes the turns of the event loop; left out: status and warnings know of none.
    """

    def __init__(
        self, pipeline: Pipeline, session: Session, line: LineWatch, turns: LoopTurns | None = None
    ) -> None:
        self.pipeline = pipeline
        self.session = session
        self.warnings: dict[str, str] = {}
        """Faults at the newest status that do not stop the scans, by cause: line, clock, port, zero, host."""
        self._load = HostLoad(turns or LoopTurns())
        self._line = line
        self._patience_s = SILENT_S
        self._watched_s, self._awake_s = math.inf, -math.inf

    def opened(
        self, now_s: float, framing_errors: int | None = None, *, is_pty: bool = False
    ) -> list[Command]:
        """Begin with a port that was just opened; returns the commands to send first."""
        self._line.reset(now_s, is_pty=is_pty)
        self._count(now_s, framing_errors)
        return self.session.opened(now_s)

    def received(
        self,
        data: bytes,
        now_s: float,
        publish: Callable[[Event], None],
        record: RecordRead = _record_nothing,
        scans_published: Callable[[], None] = _go_on,
    ) -> list[Command]:
        """Process the bytes of one read of the port.

        Parameters
        ----------
        now_s : float
            Host monotonic seconds at which the bytes were read.
        publish : callable
            Takes each event of the accepted board before this method returns: the scans before the
            detectors run, then what the detectors found.
        record : callable, optional
            See `RecordRead`; called before what the detectors found is published, and also when the pipeline
            raises, because the bytes that made it fail are the ones to look at later.
        scans_published : callable, optional
            Called after scans were published, before the detectors run.
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
            session.streams()
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
        """Tell the pipeline of a ping that is about to be written.

        Parameters
        ----------
        now_s : float
            Time before the first byte is written; the board cannot have received it earlier.

        Returns
        -------
        dict or None
            Arguments of the pipeline's command of the same name, for the recording; None if there was none.
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
        self._count(now_s, framing_errors)
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

    def status(self, now_s: float, *, started_s: float, connects: int, warning: str = "") -> StatusEvent:
        """Make the status event, and set `warnings`.

        `valid` requires a running board and a fresh newest scan.

        Parameters
        ----------
        connects : int
            Number of times that the port was opened.
        """
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
        loop_lag_s = self._load.status(now_s, health.fits_late)  # also brings its warning up to date
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

    def _count(self, now_s: float, framing_errors: int | None) -> None:
        health = self.pipeline.health()
        tally = Tally(
            bytes_in=health.bytes_in,
            bytes_framed=health.bytes_framed,
            bytes_discarded=health.bytes_discarded,
            corrupt=health.corrupt_by_reason,
            framing_errors=framing_errors,
            scans_due=health.scans + health.scans_missing,
            scans_overrun=health.scans_overrun,
            scans_dropped=health.scans_dropped,
        )
        self._line.count(tally, now_s)


def make_link(
    pipeline: Pipeline,
    params: SessionParams,
    baud: int,
    others: Mapping[str, Layout] = MappingProxyType({}),
    turns: LoopTurns | None = None,
) -> BoardLink:
    """Make the link to the board that `pipeline` was made for.

    Parameters
    ----------
    others : mapping of str to Layout
        Layouts that a diagnosis tries on bytes that are no frames of the pipeline's layout.

    Raises
    ------
    ConfigError
        `params` ask for what the layout cannot do.
    """
    layout, array = pipeline.layout, pipeline.array
    line = LineWatch(layout.name, baud, others)
    requirements = BoardRequirements(params, layout, lambda hello: check_hello(hello, layout, array))
    return BoardLink(pipeline, Session(requirements, line), line, turns)
