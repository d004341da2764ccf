"""Pipeline, session and line watch as one: all that the daemon does with bytes and time, with no I/O.

The service gives it a port and a clock, benches and tests simulated ones; both run these lines.
"""

from collections.abc import Callable, Sequence
from typing import Any

from tactiled.daemon.board.diagnosis import LineWatch, Tally
from tactiled.daemon.board.health import status_event
from tactiled.daemon.board.session import Session
from tactiled.events.types import Event, ScanEvent, StatusEvent
from tactiled.pipeline import Output, Pipeline
from tactiled.wire.frames import Command, Hello

# An open port without a byte may be a dead descriptor: it is opened anew, rarer each time, because a board
# without power is silent too. A stall is mended by asking the board (session), which takes 0.2 s a try.
SILENT_S = 3.0
_SILENT_LONGEST_S = 60.0


class BoardLink:
    """The board at the other end, from open port to lost port.

    Parameters
    ----------
    pipeline : Pipeline
    session : Session
    line : LineWatch
        The one that `session` asks.
    """

    def __init__(self, pipeline: Pipeline, session: Session, line: LineWatch) -> None:
        self._pipeline = pipeline
        self._session = session
        self._line = line
        self._patience_s = SILENT_S

    def opened(
        self, now_s: float, framing_errors: int | None = None, *, is_pty: bool = False
    ) -> list[Command]:
        """The port is open; what to say first."""
        self._line.reset(now_s, is_pty=is_pty)
        self._count(now_s, framing_errors)
        return self._session.opened(now_s)

    def received(self, data: bytes, now_s: float, publish: Callable[[Event], None]) -> list[Command]:
        """Bytes came: events go to `publish`, in order and at once; what to say is given back."""
        return self.heard(data, self._pipeline.receive_data(data, now_s), now_s, publish)

    def heard(
        self, data: bytes, outputs: Sequence[Output], now_s: float, publish: Callable[[Event], None]
    ) -> list[Command]:
        """The second half of `received`, for one who gave the bytes to the pipeline already."""
        session = self._session
        commands: list[Command] = []
        scanned = False
        self._patience_s = SILENT_S
        self._line.received(data, now_s)
        for item in outputs:
            if isinstance(item, Event):
                if session.accepted:
                    scanned = scanned or isinstance(item, ScanEvent)
                    publish(item)
            elif isinstance(item, Hello):
                commands += session.greeted(item, now_s)
            else:
                commands += session.answered(item, now_s)
        if scanned:
            self._line.framed(now_s)
            commands += session.scanned(now_s)
        return commands

    def sending(self, command: Command, now_s: float) -> dict[str, Any] | None:
        """Tell the pipeline that a command is about to be written, where that matters to it.

        Parameters
        ----------
        command : Command
        now_s : float
            Before the first byte is written: what the board does for it comes later.

        Returns
        -------
        dict or None
            The arguments of the pipeline's command of the same name, for the recording; None for none.
        """
        if command.name != "ping":
            return None
        arguments = {"token": command.token}
        self._pipeline.command("ping", arguments, now_s)
        return arguments

    def lost(self, reason: str) -> bool:
        """The port is gone, or could not be opened; whether the pipeline was told of a disconnection."""
        was_open = self._session.state != "no-device"
        if was_open:
            self._pipeline.disconnected()
        self._session.lost(reason)
        return was_open

    def watch(self, now_s: float, framing_errors: int | None = None) -> list[Command]:
        """Look at the line and at what is overdue; call it some ten times a second."""
        self._count(now_s, framing_errors)
        return self._session.tick(now_s)

    def dead_because(self, now_s: float) -> str:
        """Why the open port should be opened anew; empty when it should not."""
        silent_s = now_s - self._line.byte_s
        if self._session.state == "no-device" or silent_s < self._patience_s:
            return ""
        self._patience_s = min(2 * self._patience_s, _SILENT_LONGEST_S)
        return f"no byte for {silent_s:.0f} s: opened anew"

    def warnings(self, port_warning: str = "") -> dict[str, str]:
        """What should be mended although scans come, by cause: ``"line"``, ``"clock"``, ``"port"``."""
        found = {
            "line": self._line.warning(),
            "clock": self._pipeline.health().clock_warning,
            "port": port_warning,
        }
        return {cause: words for cause, words in found.items() if words}

    def status(self, now_s: float, *, started_s: float, connects: int, warning: str = "") -> StatusEvent:
        """How things are; `warning` is what the port says of itself."""
        return status_event(
            self._session,
            self._pipeline.health(),
            now_s=now_s,
            started_s=started_s,
            connects=connects,
            inhibited_s=self._pipeline.tuning.inhibited_s(now_s),
            warning="; ".join(self.warnings(warning).values()),
        )

    def _count(self, now_s: float, framing_errors: int | None) -> None:
        health = self._pipeline.health()
        tally = Tally(
            health.bytes_in,
            health.bytes_framed,
            health.bytes_discarded,
            health.corrupt_by_reason,
            framing_errors,
            health.scans + health.scans_missing,
            health.scans_overrun,
            health.scans_dropped,
        )
        self._line.count(tally, now_s)
