"""The daemon: a port, a pipeline, a session and a publisher in one event loop.

The hot path is one callback: bytes -> `Pipeline.receive_data` -> non-blocking sends. No task, queue or
lock stands between, so what a subscriber gets is as old as the line made it. Beside it run the
connection (open, wait until lost, open again), the status at 10 Hz and the session's own deadlines.
"""

import asyncio
import logging
import math
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Self

from tactiled.array import Array
from tactiled.daemon.clock import EpochClock
from tactiled.daemon.commands import Commands, Done
from tactiled.daemon.connection import Connection
from tactiled.daemon.diagnosis import LineWatch, other_layouts
from tactiled.daemon.exporter import Exporter, MetricsParams
from tactiled.daemon.health import info_event
from tactiled.daemon.link import Link
from tactiled.daemon.metrics import Metrics
from tactiled.daemon.network import Network
from tactiled.daemon.notify import Notifier
from tactiled.daemon.publisher import PublishParams
from tactiled.daemon.recorder import Recorder
from tactiled.daemon.requests import Command as Request
from tactiled.daemon.session import Session, SessionParams
from tactiled.daemon.source import PortParams, check_url
from tactiled.errors import TactiledError
from tactiled.events.types import BoardState, Event
from tactiled.pipeline import Output, Pipeline, check_hello
from tactiled.recording.contents import Read
from tactiled.tomlfile import Params
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command
from tactiled.wire.layout import Layout

logger = logging.getLogger(__name__)

STATUS_PERIOD_S = 0.1
INFO_PERIOD_S = 1.0
CLOCK_PERIOD_S = 1.0  # a step of the wall clock is followed within this
_DRAIN_S = 0.1  # scans on their way when we stop: more than an FTDI bucket and the board's answer take


class ServiceParams(Params):
    """All that the daemon's room needs to be told."""

    port: PortParams
    session: SessionParams = SessionParams()
    publish: PublishParams = PublishParams()
    metrics: MetricsParams = MetricsParams()

    def without_publishing(self) -> Self:
        """The same, but nobody is told: for one who only records."""
        return self.model_copy(update={"publish": PublishParams(endpoints=())})


Reload = Callable[[], ServiceParams]


class Service:
    """The running daemon.

    Parameters
    ----------
    params : ServiceParams
    pipeline : Pipeline
        Made for `layout` and `array`.
    layout : Layout
    array : Array
    reload : callable, optional
        Reads the configuration again (SIGHUP) and gives what it says now.
    recorder : Recorder, optional
        Told of every read of the port, of what came of it, and of all that is said beside.

    Raises
    ------
    ConfigError, OperatorError
        An endpoint cannot be bound, or something can never work.
    """

    def __init__(
        self,
        params: ServiceParams,
        pipeline: Pipeline,
        layout: Layout,
        array: Array,
        reload: Reload | None = None,
        recorder: Recorder | None = None,
    ) -> None:
        check_url(params.port.url)
        self._params = params
        self._pipeline = pipeline
        self._layout = layout
        self._array = array
        self._reload = reload
        self._recorder = recorder
        self._encoder = Encoder(layout)
        self._line = LineWatch(layout.name, self._baud, other_layouts(layout))
        self._session = Session(
            params.session, layout, lambda hello: check_hello(hello, layout, array), self._line
        )
        self._link = Link(pipeline, self._session, self._line)
        self._connection = Connection(
            params.port.url, self._baud, opened=self._opened, received=self._received, lost=self._lost
        )
        self._clock = EpochClock()
        self._commands = Commands(
            pipeline,
            self._session,
            self._tuned,
            None if recorder is None else lambda on: recorder.switch(on, pipeline.hello),
        )
        self._metrics = Metrics(pipeline.health, self._connection.errors)
        self._network = Network(params.publish, self._asked, self._commands.settings)
        self._publisher = self._network.publisher
        self._exporter = self._make_exporter(params.metrics)
        self._notifier = Notifier()
        self._said: tuple[BoardState, str] = (self._session.state, self._session.reason(0.0))
        self._warned = ""
        self._handover_s: float | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._started_s = time.monotonic()
        self._next_info_s = self._started_s

    async def run(self) -> None:
        """Serve until `stop`; an error in the data path ends the service instead of being served around."""
        loop = asyncio.get_running_loop()
        self._end: asyncio.Future[None] = loop.create_future()
        parts = (self._connection.run(), self._report(), self._network.run())
        tasks = [asyncio.create_task(part) for part in parts]
        if self._exporter is not None:
            tasks.append(asyncio.create_task(self._exporter.run()))
        try:
            self._notifier.ready()
            await asyncio.wait([self._end, *tasks], return_when=asyncio.FIRST_COMPLETED)
            self._notifier.stopping()
            for finished in (self._end, *tasks):
                if finished.done():
                    finished.result()
            await self._drain()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            if self._timer is not None:
                self._timer.cancel()
            self._network.close()
            if self._exporter is not None:
                self._exporter.close()
            self._notifier.close()

    def stop(self) -> None:
        """Drain and end."""
        if not self._end.done():
            self._end.set_result(None)

    def reload(self) -> None:
        """Read the configuration again; take what can be taken while running."""
        if self._reload is None:
            logger.info("nothing to reload: there is no configuration file")
            return
        self._notifier.reloading()
        try:
            new = self._reload()
            check_url(new.port.url)
            self._session.configure(new.session)
        except TactiledError as error:
            logger.error("configuration not reloaded, the old one stays: %s", error)
        else:
            for table in ("publish", "metrics"):
                if getattr(new, table) != getattr(self._params, table):
                    logger.warning("%s has changed: restart tactiled for it to take effect", table)
            moved = new.port != self._params.port
            self._params = new
            if moved:
                self._connection.move(new.port.url, self._baud)
            logger.info("configuration reloaded")
        self._notifier.ready()
        self._act([])

    def _make_exporter(self, params: MetricsParams) -> Exporter | None:
        try:
            return Exporter(params, self._metrics.text) if params.port else None
        except TactiledError:
            self._network.close()
            raise

    @property
    def _baud(self) -> int:
        return self._params.port.baud or self._layout.file.baud

    # ---- the data path -----------------------------------------------------------------------------

    def _received(self, data: bytes) -> None:
        self._guarded(lambda: self._handle(data))

    def _handle(self, data: bytes) -> None:
        now_s = time.monotonic()
        board_before = self._session.hello
        outputs: list[Output] = []
        try:
            outputs = self._pipeline.receive_data(data, now_s)
        finally:  # bytes that break us are those that must be looked at later
            if self._recorder is not None:
                read = Read(now_s, self._clock.offset_s, data)
                self._recorder.received(read, outputs, self._pipeline.hello)
        commands = self._link.heard(data, outputs, now_s, self._send)
        if self._session.hello is not board_before:
            self._next_info_s = now_s
        self._notifier.alive(now_s)
        self._act(commands)
        self._metrics.handled(time.monotonic() - now_s)

    def _send(self, event: Event) -> None:
        """Publish what the pipeline found; the recorder has it with the bytes that it was found in."""
        self._publisher.send(event, board=self._board, unix_offset_s=self._clock.offset_s)
        self._metrics.said(event, self._publisher.dropped)

    def _publish(self, event: Event) -> None:
        """Publish, and record, what the daemon says itself."""
        self._send(event)
        if self._recorder is not None:
            self._recorder.said(event, self._board, self._clock.offset_s)

    @property
    def _board(self) -> str:
        hello = self._session.hello
        return hello.board_serial if hello is not None else self._params.session.board_serial or ""

    def _act(self, commands: list[Command]) -> None:
        """Send what the session asks for, tell the world of a new state, and set the next deadline."""
        for command in commands:
            self._connection.write(self._encoder.encode(command))
        now_s = time.monotonic()
        said = (self._session.state, self._session.reason(now_s))
        if said != self._said:
            self._announce(*said, now_s)
        self._commands.look(now_s)
        deadline_s = self._session.deadline_s
        # An armed timer is moved only when it would come too late: at 100 Hz it is hardly ever touched.
        if self._timer is None or self._timer.when() > deadline_s:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = None
            if deadline_s < math.inf:
                self._timer = asyncio.get_running_loop().call_at(deadline_s, self._deadline)

    def _deadline(self) -> None:
        self._timer = None
        self._guarded(lambda: self._act(self._session.tick(time.monotonic())))

    def _guarded(self, step: Callable[[], None]) -> None:
        """Run a callback of the loop, which would only log what it raises and go on, broken."""
        try:
            step()
        except Exception as error:  # a bug: end with it, loudly, and let the manager start us afresh
            if not self._end.done():
                self._end.set_exception(error)

    def _announce(self, state: BoardState, reason: str, now_s: float) -> None:
        new_state = state != self._said[0]
        self._said = (state, reason)
        hello = self._session.hello
        board = f"board {hello.board_serial}" if hello is not None else "board"
        text = f"{board} {state}: {reason or f'{self._session.rate_hz:g} Hz'}"
        expected = state in ("running", "syncing") or self._end.done()
        logger.log(logging.INFO if expected else logging.WARNING, "%s", text)
        self._notifier.status(text)
        if new_state:
            self._publish_status(now_s)  # a controller learns of a stall now, not at the next tick

    # ---- what clients ask for ----------------------------------------------------------------------

    def _asked(self, request: Request, key: str, now_s: float, done: Done) -> None:
        """Do a command, say in the events what came of it, and tell who asked."""

        def finish(reason: str) -> None:
            self._publish(self._commands.event(request, key, reason, time.monotonic()))
            done(reason)

        self._commands.do(request, now_s, finish)
        self._act([])

    def _tuned(self, name: str, arguments: dict[str, Any], events: Sequence[Event], now_s: float) -> None:
        """A command changed what the pipeline goes by, and brought events."""
        if self._recorder is not None:
            hello, offset_s = self._pipeline.hello, self._clock.offset_s
            self._recorder.commanded(name, arguments, events, hello, now_s, offset_s)
        for event in events:
            self._send(event)

    # ---- the connection ----------------------------------------------------------------------------

    def _framing_errors(self) -> int | None:
        errors = self._connection.errors()
        return errors.framing if errors is not None else None

    def _opened(self) -> None:
        now_s, handover_s = time.monotonic(), self._connection.handover_s
        if handover_s != self._handover_s:
            self._handover_s = handover_s
            told = {"handover_s": handover_s}
            self._tuned("adapter", told, self._pipeline.command("adapter", told, now_s)[1], now_s)
        self._act(self._link.opened(now_s, self._framing_errors()))

    def _lost(self, reason: str) -> None:
        if self._link.lost(reason) and self._recorder is not None:
            self._recorder.disconnected(time.monotonic(), self._clock.offset_s, self._pipeline.hello)
        self._act([])

    async def _drain(self) -> None:
        """Stop the board, take what is still on its way, say goodbye."""
        if self._connection.is_open:
            self._act(self._session.stop())
            await asyncio.sleep(_DRAIN_S)
        self._lost("tactiled is stopping")

    # ---- what is said regularly --------------------------------------------------------------------

    async def _report(self) -> None:
        """Status at 10 Hz whatever happens, info each second once there is something to say."""
        next_s = next_look_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            self._act(self._link.watch(now_s, self._framing_errors()))
            if self._session.state != "running":
                self._connection.check(self._link.dead_because(now_s))
            self._publish_status(now_s)
            if now_s >= self._next_info_s and self._session.hello is not None:
                self._next_info_s = now_s + INFO_PERIOD_S
                self._publish(info_event(self._session.hello, self._layout, self._array, now_s))
            if self._recorder is not None and (recording := self._recorder.report(now_s)) is not None:
                self._publish(recording)
            if now_s >= next_look_s:
                next_look_s = now_s + CLOCK_PERIOD_S
                if step_s := self._clock.follow():
                    logger.warning("the wall clock was set by %+.3f s; timestamps follow it", step_s)
            self._notifier.alive(now_s)
            next_s = max(next_s + STATUS_PERIOD_S, now_s)  # after a hang there is nothing to catch up with
            await asyncio.sleep(next_s - time.monotonic())

    def _publish_status(self, now_s: float) -> None:
        event = self._link.status(
            now_s,
            started_s=self._started_s,
            connects=self._connection.connects,
            warning=self._connection.warning,
        )
        if event.warning and not self._warned:
            logger.warning("%s", event.warning)
        self._warned = event.warning
        settings = self._pipeline.tuning
        self._publish(
            replace(
                event,
                inhibited_s=settings.inhibited_s(now_s),
                sent=self._publisher.sent(self._board),
            )
        )


async def serve(
    params: ServiceParams,
    pipeline: Pipeline,
    layout: Layout,
    array: Array,
    reload: Reload | None = None,
    recorder: Recorder | None = None,
    duration_s: float | None = None,
) -> None:
    """Run the daemon for `duration_s` or until SIGTERM or SIGINT; SIGHUP reloads."""
    service = Service(params, pipeline, layout, array, reload, recorder)
    loop = asyncio.get_running_loop()
    handlers = {signal.SIGTERM: service.stop, signal.SIGINT: service.stop, signal.SIGHUP: service.reload}
    for number, handler in handlers.items():
        loop.add_signal_handler(number, handler)
    if duration_s is not None:
        loop.call_later(duration_s, service.stop)
    try:
        await service.run()
    finally:
        for number in handlers:
            loop.remove_signal_handler(number)


def run_service(
    params: ServiceParams,
    pipeline: Pipeline,
    layout: Layout,
    array: Array,
    reload: Reload | None = None,
    recorder: Recorder | None = None,
    duration_s: float | None = None,
) -> int:
    """Run the daemon; 0 after a wanted end.

    Raises
    ------
    OperatorError
        Something that must be mended first (an endpoint in use, a URL that is none).
    """
    asyncio.run(serve(params, pipeline, layout, array, reload, recorder, duration_s))
    return 0
