"""From bytes to sends: what is done when bytes, a port or a deadline come.

The hot path is one callback: bytes -> `Pipeline.receive_data` -> non-blocking sends. No task, queue or
lock stands between, so what a subscriber gets is as old as the line made it.
"""

import asyncio
import math
import time
from collections.abc import Callable, Sequence

from tactiled.daemon.board.link import BoardLink
from tactiled.daemon.board.session import Session
from tactiled.daemon.operations.outlets import Outlets
from tactiled.daemon.serial.connection import Connection
from tactiled.pipeline import Output, Pipeline
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command

_DRAIN_S = 0.1  # scans on their way when we stop: more than an FTDI bucket and the board's answer take


class DataPath:
    """The `connection.Listener` of the daemon, and the deadlines of its session.

    Parameters
    ----------
    pipeline : Pipeline
    session : Session
    link : BoardLink
        Made of these two.
    connection : Connection
        Written to; whoever runs it gives it this object.
    encoder : Encoder
    outlets : Outlets
    changed : callable
        Called with the time whenever something may have changed.
    failed : callable
        Takes what a callback of the loop raised: the loop would only log it and go on, broken.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        session: Session,
        link: BoardLink,
        connection: Connection,
        encoder: Encoder,
        outlets: Outlets,
        changed: Callable[[float], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._pipeline = pipeline
        self._session = session
        self._link = link
        self._connection = connection
        self._encoder = encoder
        self._outlets = outlets
        self._changed = changed
        self._failed = failed
        self._handover_s: float | None = None
        self._timer: asyncio.TimerHandle | None = None

    # ---- what the connection tells -----------------------------------------------------------------

    def opened(self) -> None:
        """A port is there."""
        now_s, handover_s = time.monotonic(), self._connection.handover_s
        if handover_s != self._handover_s:
            self._handover_s = handover_s
            told = {"handover_s": handover_s}
            self._outlets.tuned("adapter", told, self._pipeline.command("adapter", told, now_s)[1], now_s)
        self.act(self._link.opened(now_s, self._framing_errors(), is_pty=self._connection.is_pty))

    def received(self, data: bytes) -> None:
        """Bytes came."""
        self._guarded(lambda: self._handle(data))

    def lost(self, reason: str) -> None:
        """There is no port."""
        if self._link.lost(reason):
            self._outlets.disconnected(time.monotonic())
        self.act()

    # ---- what time brings --------------------------------------------------------------------------

    def watch(self, now_s: float) -> None:
        """Look at the line and at what is overdue; call it some ten times a second."""
        self.act(self._link.watch(now_s, self._framing_errors()))
        if self._session.state != "running":
            self._connection.check(self._link.dead_because(now_s))

    def act(self, commands: Sequence[Command] = ()) -> None:
        """Send what the session asks for, tell the world of a new state, and set the next deadline."""
        for command in commands:
            data = self._encoder.encode(command)
            now_s = time.monotonic()
            if (arguments := self._link.sending(command, now_s)) is not None:
                self._outlets.tuned(command.name, arguments, (), now_s)
            self._connection.write(data)
        now_s = time.monotonic()
        self._changed(now_s)
        deadline_s = self._session.deadline_s
        # An armed timer is moved only when it would come too late: at 100 Hz it is hardly ever touched.
        if self._timer is None or self._timer.when() > deadline_s:
            self.close()
            if deadline_s < math.inf:
                self._timer = asyncio.get_running_loop().call_at(deadline_s, self._deadline)

    async def drain(self) -> None:
        """Stop the board, take what is still on its way, say goodbye."""
        if self._connection.is_open:
            self.act(self._session.stop())
            await asyncio.sleep(_DRAIN_S)
        self.lost("tactiled is stopping")

    def close(self) -> None:
        """Forget the deadline."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None

    def _handle(self, data: bytes) -> None:
        now_s = time.monotonic()
        outputs: list[Output] = []
        try:
            outputs = self._pipeline.receive_data(data, now_s)
        finally:  # bytes that break us are those that must be looked at later
            self._outlets.received(data, outputs, now_s)
        commands = self._link.heard(data, outputs, now_s, self._outlets.found)
        self._outlets.notifier.alive(now_s)
        self.act(commands)
        self._outlets.metrics.handled(time.monotonic() - now_s)

    def _deadline(self) -> None:
        self._timer = None
        self._guarded(lambda: self.act(self._session.tick(time.monotonic())))

    def _guarded(self, step: Callable[[], None]) -> None:
        try:
            step()
        except Exception as error:  # a bug: end with it, loudly, and let the manager start us afresh
            self._failed(error)

    def _framing_errors(self) -> int | None:
        errors = self._connection.errors()
        return errors.framing if errors is not None else None
