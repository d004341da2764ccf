"""One board of the daemon: port, pipeline, session and commands, put together and run.

A daemon has a runner for each board. They share the event loop, the sockets and the wall clock, and nothing
else: what one of them meets (no port, noise, a wrong board, a full disk) the others do not see.

The hot path is one callback: bytes -> `BoardLink.received` -> non-blocking sends. There is no task, queue or
lock in it, so the age of an event is that of its bytes plus the time of computing.

A scan leaves before the detectors run, and the processor is then offered once to other processes, such as a
subscriber. Where no processor is idle, Linux would let the subscriber begin when this thread waits, which is
after the detectors.
"""

import asyncio
import json
import logging
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tactiled.daemon.board.host_load import LoopTurns
from tactiled.daemon.board.link import STOP_S, BoardLink
from tactiled.daemon.board.session import SessionParams
from tactiled.daemon.clock import EpochClock
from tactiled.daemon.operations.exporter import MetricsParams
from tactiled.daemon.operations.metrics import Metrics
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.serial.device import LineErrors
from tactiled.daemon.serial.port import Connection, PortParams, SerialPort, check_url
from tactiled.daemon.zmq.commands import Commands
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import CommandRequest, Requester
from tactiled.events.types import Event
from tactiled.limited_log import RateLimitedLog
from tactiled.pipeline import Pipeline
from tactiled.received import Output
from tactiled.recording.contents import Input, Read
from tactiled.tomlfile import Params
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command

logger = logging.getLogger(__name__)

STATUS_PERIOD_S = 0.1
INFO_PERIOD_S = 1.0
# Wait for the last scans when the daemon stops, where no answer tells which is the last: longer than an FTDI
# bucket (16 ms).
_DRAIN_S = 0.1
_LOOK_S = 0.005  # between looks for that answer: a stop takes at most a quarter longer than the board needs


class ServiceParams(Params):
    """Parameters of the daemon for one board; boards of one process agree on `publish` and `metrics`."""

    port: PortParams
    session: SessionParams = SessionParams()
    publish: PublishParams = PublishParams()
    metrics: MetricsParams = MetricsParams()


@dataclass(frozen=True)
class ServedBoard:
    """Board that a service reads."""

    params: ServiceParams
    pipeline: Pipeline
    # Takes every read of the port with its outputs, and all events that the daemon itself makes
    recorder: Recorder


@dataclass(frozen=True)
class SharedParts:
    """Parts of the daemon that all boards use."""

    publisher: Publisher  # that of the endpoints of the board, which others may have too
    clock: EpochClock
    turns: LoopTurns
    watched: Callable[[float], None]  # takes the time, at 10 Hz for each board
    show_states: Callable[[], None]  # called when the state of a board has changed


class BoardRunner:
    """Read one board until stopped.

    Made in the event loop that runs it. `phase_s` delays the first status, so that boards do not publish
    theirs all at once and hold up the loop.
    """

    def __init__(self, board: ServedBoard, shared: SharedParts, phase_s: float = 0.0) -> None:
        params, pipeline = board.params, board.pipeline
        check_url(params.port.url)
        self.words = ""
        """State of the board and its reason, as logged; empty before the first."""
        self.is_fresh = False
        """True where the newest status says that data are fresh."""
        self._recorder = board.recorder
        self._shared = shared
        self._pipeline = pipeline
        self._encoder = Encoder(pipeline.layout)
        baud = params.port.baud or pipeline.layout.file.baud
        self._link = BoardLink(pipeline, params.session, baud, shared.turns)
        session = self._session = self._link.session
        self._connection = Connection(params.port.url, baud)
        self.metrics = Metrics(pipeline.health, self._line_errors, lambda: session.board_serial)
        self._commands = Commands(
            pipeline, self._took_input, lambda on: board.recorder.switch(on, pipeline.hello)
        )
        self._handover_s: float | None = None  # of the adapter, as the pipeline knows it
        self._deadline: asyncio.TimerHandle | None = None
        self._log = RateLimitedLog(logger)
        self._logged = (session.state, session.reason(0.0))  # the state at the start is not logged
        self._warned: dict[str, str] = {}
        self._started_s = time.monotonic()
        self._phase_s = phase_s
        self._next_info_s = self._started_s
        self._described = session.hello, self._pipeline.tuning.zero  # what the newest `info` tells
        self._end: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    @property
    def serial(self) -> str:
        """Serial number of the board; empty while it is unknown."""
        return self._session.board_serial

    async def run(self) -> None:
        """Read the board until `stop`; an error in the data path ends it."""
        connecting = self._connection.run(self._opened, self._received, self._lost)
        tasks = [asyncio.create_task(connecting), asyncio.create_task(self._watch())]
        try:
            await asyncio.wait([self._end, *tasks], return_when=asyncio.FIRST_COMPLETED)
            for finished in (self._end, *tasks):
                if finished.done():
                    finished.result()
            await self._drain()
        except Exception as error:
            error.add_note(self._board)
            raise
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._set_deadline(math.inf)

    def stop(self) -> None:
        """Drain the line and end."""
        if not self._end.done():
            self._end.set_result(None)

    def settings(self, now_s: float) -> dict[str, Any]:
        """Return the present settings, by the names that requests use."""
        return self._commands.settings(now_s)

    def do(self, request: CommandRequest, requester: Requester, now_s: float) -> str:
        """Carry out a client's command, and publish its outcome; return why it is refused."""
        reason = self._commands.do(request, requester, now_s)
        event = self._commands.event(request, requester, reason, now_s)
        if event is not None:
            self._publish_and_record(event)
        return reason

    def act(self, commands: Sequence[Command] = ()) -> None:
        """Send `commands` to the board, report a new state, and set the timer for the next deadline."""
        for command in commands:
            data = self._encoder.encode(command)
            now_s = time.monotonic()
            if (arguments := self._link.sending(command, now_s)) is not None:
                self._took_input(command.name, arguments, (), now_s)
            self._connection.write(data)
        now_s = time.monotonic()
        self._report_state(now_s)
        deadline_s = self._session.deadline_s
        # A timer that is set is replaced only where it would fire too late, which is rare even at 100 Hz.
        if self._deadline is None or self._deadline.when() > deadline_s:
            self._set_deadline(deadline_s)

    # ---- called by the connection and by timers ----------------------------------------------------

    def _opened(self, port: SerialPort) -> None:
        now_s = time.monotonic()
        if port.handover_s != self._handover_s:
            self._handover_s = port.handover_s
            arguments = {"handover_s": port.handover_s}
            _, events = self._pipeline.command("adapter", arguments, now_s)
            self._took_input("adapter", arguments, events, now_s)
        self.act(self._link.opened(now_s, self._framing_errors(), is_pty=port.is_pty))

    def _received(self, data: bytes) -> None:
        now_s, server = time.monotonic(), self._shared.publisher.server
        server.is_held = True
        try:
            self.act(self._link.received(data, now_s, self._publish, self._record_read, self._send_scans))
            end_s = time.monotonic()
            self._shared.turns.add(end_s, end_s - now_s)
        except Exception as error:  # as in `_attempt`, without a call between bytes and scan
            self._failed(error)
        server.is_held = False
        self._attempt(server.flush)

    def _send_scans(self) -> None:
        self._shared.publisher.server.flush()
        os.sched_yield()

    def _lost(self, reason: str) -> None:
        self._attempt(lambda: self._handle_loss(reason))

    def _handle_loss(self, reason: str) -> None:
        if self._link.lost(reason):
            self._record("disconnected", {}, (), time.monotonic())
        self.act()

    def _set_deadline(self, deadline_s: float) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = None
        if deadline_s < math.inf:
            self._deadline = asyncio.get_running_loop().call_at(deadline_s, self._pass_deadline)

    def _pass_deadline(self) -> None:
        self._deadline = None
        self._attempt(lambda: self.act(self._session.tick(time.monotonic())))

    def _attempt(self, step: Callable[[], None]) -> None:
        """Take a step in a callback of the event loop, which would log an exception and continue."""
        try:
            step()
        except Exception as error:  # a bug: it ends the daemon, which the service manager starts again
            self._failed(error)

    def _failed(self, error: Exception) -> None:
        if self._end.done():  # it ends already: the rest of the line is still drained
            logger.error("%s: a fault of tactiled while it ends", self._board, exc_info=error)
        else:
            self._end.set_exception(error)

    async def _drain(self) -> None:
        """Stop the board, handle the scans that are still in transit, and report the port as lost."""
        if self._connection.port is not None:
            self.act(self._session.stop(time.monotonic()))
            will_answer = self._session.is_stopping
            end_s = time.monotonic() + STOP_S
            # A port that is closed loses what the board has not read yet: it would go on sending.
            while self._session.is_stopping and time.monotonic() < end_s:
                await asyncio.sleep(_LOOK_S)
            if not will_answer:
                await asyncio.sleep(_DRAIN_S)
        self._lost("tactiled is stopping")

    # ---- status and info ---------------------------------------------------------------------------

    async def _watch(self) -> None:
        """Check the line and publish the status, at 10 Hz in every state."""
        due_s = time.monotonic() + self._phase_s
        while True:
            await asyncio.sleep(due_s - time.monotonic())
            now_s = time.monotonic()
            self._shared.turns.add(now_s, now_s - due_s)
            self._look(now_s)
            due_s = next_due_s(due_s, now_s)

    def _look(self, now_s: float) -> None:
        """Check line and deadlines, close a dead port, and publish what is due."""
        self.act(self._link.watch(now_s, self._framing_errors()))
        if self._session.state != "running":
            self._connection.check(self._link.expire_silence(now_s))
        self._publish_status(now_s)
        self._log.write_counts(now_s)
        self._connection.log.write_counts(now_s)
        hello, zero = self._session.hello, self._pipeline.tuning.zero
        is_new = hello is not self._described[0] or zero is not self._described[1]
        if hello is not None and (now_s >= self._next_info_s or is_new):
            self._described = hello, zero
            self._next_info_s = now_s + INFO_PERIOD_S
            self._publish_and_record(self._link.info(hello, now_s))
        if (recording := self._recorder.report(now_s)) is not None:
            self._publish_and_record(recording)
        self._shared.watched(now_s)

    def _report_state(self, now_s: float) -> None:
        """Report a change of state or reason in the log, and a new state to subscribers."""
        state, reason = state_and_reason = (self._session.state, self._session.reason(now_s))
        if state_and_reason == self._logged:
            return
        is_new = state != self._logged[0]
        self._logged = state_and_reason
        self.words = f"{self._board} {state}: {reason or f'{self._session.rate_hz:g} Hz'}"
        is_expected = state in ("running", "syncing") or self._end.done()
        self._log.add(self.words, now_s, logging.INFO if is_expected else logging.WARNING)
        if is_new:
            self._publish_status(now_s)  # a controller learns of a stall at once, not up to 0.1 s later
        self._shared.show_states()

    def _publish_status(self, now_s: float) -> None:
        port = self._connection.port
        event = self._link.make_status(
            now_s,
            started_s=self._started_s,
            connects=self._connection.connects,
            warning="" if port is None else port.warning,
        )
        warnings = self._link.warnings
        for cause in warnings.keys() - self._warned.keys():  # each cause once, whatever its numbers do
            self._log.add(f"{self._board}: {warnings[cause]}", now_s, kind=cause)
        self._warned = warnings
        self.is_fresh = event.valid
        self._publish_and_record(replace(event, sent=self._shared.publisher.sent(self.serial)))

    # ---- publisher, recorder and metrics -----------------------------------------------------------

    def _publish(self, event: Event) -> None:
        """Publish an event of the pipeline; the recorder gets it through `_record_read`, with its bytes."""
        serial, publisher = self.serial, self._shared.publisher
        publisher.send(event, board=serial, unix_offset_s=self._shared.clock.offset_s)
        self.metrics.count(event, publisher.server.dropped[serial])

    def _publish_and_record(self, event: Event) -> None:
        """Publish and record an event that the daemon itself made."""
        self._publish(event)
        self._recorder.record_event(event, self.serial, self._shared.clock.offset_s)

    def _took_input(
        self, name: str, arguments: Mapping[str, Any], events: Sequence[Event], now_s: float
    ) -> None:
        """Record an input that the pipeline has taken, and publish the events that it caused."""
        self._record(name, arguments, events, now_s)
        for event in events:
            self._publish(event)

    def _record_read(self, data: bytes, outputs: Sequence[Output], now_s: float) -> None:
        for index in self._pipeline.late_fits:  # before the read, so that a replay knows of them in time
            self._record("late-fit", {"index": index}, (), now_s)
        read = Read(now_s, self._shared.clock.offset_s, data)
        self._recorder.record(read, outputs, self._pipeline.hello)

    def _record(
        self, name: str, arguments: Mapping[str, Any], outputs: Sequence[Output], now_s: float
    ) -> None:
        """Record an input of the pipeline that is no read, with its outputs."""
        cause = Input(now_s, self._shared.clock.offset_s, name, json.dumps(dict(arguments)))
        self._recorder.record(cause, outputs, self._pipeline.hello)

    def _line_errors(self) -> LineErrors | None:
        port = self._connection.port
        return None if port is None else port.errors()

    def _framing_errors(self) -> int | None:
        errors = self._line_errors()
        return None if errors is None else errors.framing

    @property
    def _board(self) -> str:
        return f"board {self.serial}".rstrip()


def next_due_s(due_s: float, now_s: float) -> float:
    """Return when a status is due after one that was due at `due_s` and is sent at `now_s`.

    Those that a hang missed are skipped, boards stay apart by their phases, and half a period at least lies
    between two.
    """
    return due_s + STATUS_PERIOD_S * (math.floor((now_s - due_s) / STATUS_PERIOD_S + 0.5) + 1)
