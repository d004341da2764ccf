"""Data path of the daemon: reactions to bytes, to a port that opens or is lost, and to deadlines.

The hot path is one callback: bytes -> `BoardLink.received` -> non-blocking sends. There is no task, queue or
lock in it, so the age of an event is that of its bytes plus the time of computing.

A scan leaves before the detectors run, and the processor is then offered to other threads once. Where no
processor is idle, Linux would let the subscriber begin when this thread waits, which is after the detectors.
"""

import asyncio
import math
import os
import time
from collections.abc import Callable, Sequence

from tactiled.daemon.board.link import BoardLink
from tactiled.daemon.board.load import LoopTurns
from tactiled.daemon.operations.distributor import Distributor
from tactiled.daemon.serial.connection import Connection
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command

# Wait for the last scans when the daemon stops, where no answer tells which is the last: longer than an FTDI
# bucket (16 ms).
_DRAIN_S = 0.1
STOP_S = 1.0  # longest wait for the answer to that stop, which takes 20 ms, and more where the host is busy
_LOOK_S = 0.005  # between looks for it: a stop takes at most a quarter longer than the board needs


class DataPath:
    """Pass bytes from a connection to a board link, its events to the distributor, its commands to the board.

    Implements `connection.Listener`, and keeps the timer for the deadlines of the session.

    Parameters
    ----------
    connection : Connection
        Commands are written to it. Its `run` is given this object.
    turns : LoopTurns
        Told how long the handling of each read takes.
    changed : callable
        Called with the time (host monotonic seconds) whenever the session may have changed.
    handled : callable
        Called with the time after each read was handled.
    failed : callable
        Takes an exception that was raised in a callback of the event loop, which would log it and continue.
        `opened` and `watch` are called in tasks, and raise.
    """

    def __init__(
        self,
        link: BoardLink,
        connection: Connection,
        encoder: Encoder,
        distributor: Distributor,
        turns: LoopTurns,
        changed: Callable[[float], None],
        handled: Callable[[float], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._link = link
        self._session = link.session
        self._connection = connection
        self._encoder = encoder
        self._distributor = distributor
        self._turns = turns
        self._changed = changed
        self._handled = handled
        self._failed = failed
        self._handover_s: float | None = None
        self._timer: asyncio.TimerHandle | None = None

    # ---- called by the connection ------------------------------------------------------------------

    def opened(self) -> None:
        """Handle a port that was just opened."""
        now_s, handover_s = time.monotonic(), self._connection.handover_s
        if handover_s != self._handover_s:
            self._handover_s = handover_s
            arguments = {"handover_s": handover_s}
            _, events = self._link.pipeline.command("adapter", arguments, now_s)
            self._distributor.tuned("adapter", arguments, events, now_s)
        self.act(self._link.opened(now_s, self._framing_errors(), is_pty=self._connection.is_pty))

    def received(self, data: bytes) -> None:
        """Handle the bytes of one read."""
        now_s = time.monotonic()
        try:
            self.act(
                self._link.received(
                    data, now_s, self._distributor.publish, self._distributor.record_read, self._send_scans
                )
            )
            end_s = time.monotonic()
            self._distributor.metrics.handled(end_s - now_s)
            self._turns.add(end_s, end_s - now_s)
            self._handled(end_s)
        except Exception as error:  # as in `_attempt`, without a call between bytes and scan
            self._failed(error)

    def lost(self, reason: str) -> None:
        """Handle a port that was lost or could not be opened."""
        self._attempt(lambda: self._handle_loss(reason))

    # ---- called as time passes ---------------------------------------------------------------------

    def watch(self, now_s: float) -> None:
        """Check line and deadlines, and close a dead port; call it about ten times a second."""
        self.act(self._link.watch(now_s, self._framing_errors()))
        if self._session.state != "running":
            self._connection.check(self._link.expire_silence(now_s))

    def act(self, commands: Sequence[Command] = ()) -> None:
        """Send commands to the board, report a new state, and set the timer for the next deadline."""
        for command in commands:
            data = self._encoder.encode(command)
            now_s = time.monotonic()
            if (arguments := self._link.sending(command, now_s)) is not None:
                self._distributor.tuned(command.name, arguments, (), now_s)
            self._connection.write(data)
        now_s = time.monotonic()
        self._changed(now_s)
        deadline_s = self._session.deadline_s
        # A timer that is set is replaced only where it would fire too late, which is rare even at 100 Hz.
        if self._timer is None or self._timer.when() > deadline_s:
            self.close()
            if deadline_s < math.inf:
                self._timer = asyncio.get_running_loop().call_at(deadline_s, self._deadline)

    def _send_scans(self) -> None:
        """Send the scans, and let a subscriber begin with them."""
        self._distributor.flush()
        os.sched_yield()

    async def drain(self) -> None:
        """Stop the board, handle the scans that are still in transit, and report the port as lost."""
        if self._connection.is_open:
            self.act(self._session.stop())
            is_answered = self._session.is_stopping
            end_s = time.monotonic() + STOP_S
            # A port that is closed loses what the board has not read yet: it would go on sending.
            while self._session.is_stopping and time.monotonic() < end_s:
                await asyncio.sleep(_LOOK_S)
            if not is_answered:
                await asyncio.sleep(_DRAIN_S)
        self.lost("tactiled is stopping")

    def close(self) -> None:
        """Cancel the timer."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None

    def _handle_loss(self, reason: str) -> None:
        if self._link.lost(reason):
            self._distributor.disconnected(time.monotonic())
        self.act()

    def _deadline(self) -> None:
        self._timer = None
        self._attempt(lambda: self.act(self._session.tick(time.monotonic())))

    def _attempt(self, step: Callable[[], None]) -> None:
        try:
            step()
        except Exception as error:  # a bug: it ends this board's part of the daemon, which begins anew
            self._failed(error)

    def _framing_errors(self) -> int | None:
        errors = self._connection.errors()
        return errors.framing if errors is not None else None
