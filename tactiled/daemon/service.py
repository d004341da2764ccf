"""Service: port, pipeline, session and publisher in one event loop.

This module builds the parts, runs them, stops them and reloads the configuration. `datapath` handles bytes
and deadlines, `report` makes status and info events, and `outlets` distributes events. Beside the data path
run the connection, which opens the port again after a loss, and the status at 10 Hz.
"""

import asyncio
import logging
import signal
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

from tactiled.array import Array
from tactiled.daemon.board.datapath import DataPath
from tactiled.daemon.board.diagnosis import other_layouts
from tactiled.daemon.board.link import make_link
from tactiled.daemon.board.report import Report
from tactiled.daemon.board.terms import SessionParams
from tactiled.daemon.operations.exporter import Exporter, MetricsParams
from tactiled.daemon.operations.metrics import Metrics
from tactiled.daemon.operations.outlets import Outlets
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.serial.connection import Connection
from tactiled.daemon.serial.port import PortParams, check_url
from tactiled.daemon.zmq.commands import Commands, Done
from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.publisher import PublishParams
from tactiled.daemon.zmq.requests import CommandRequest, Requester
from tactiled.errors import TactiledError
from tactiled.events.types import Event
from tactiled.pipeline import Pipeline
from tactiled.tomlfile import Params
from tactiled.wire.codec import Encoder
from tactiled.wire.layout import Layout

logger = logging.getLogger(__name__)

STATUS_PERIOD_S = 0.1


class ServiceParams(Params):
    """Parameters of the daemon."""

    port: PortParams
    session: SessionParams = SessionParams()
    publish: PublishParams = PublishParams()
    metrics: MetricsParams = MetricsParams()

    def without_publishing(self) -> Self:
        """Return a copy without endpoints, for a program that only records."""
        return self.model_copy(update={"publish": PublishParams(endpoints=())})


Reload = Callable[[], ServiceParams]


class Service:
    """Run one daemon for one port.

    Parameters
    ----------
    params : ServiceParams
    pipeline : Pipeline
        Made for `layout` and `array`.
    layout : Layout
    array : Array
    reload : callable, optional
        Reads the configuration again (SIGHUP) and returns its parameters.
    recorder : Recorder, optional
        Takes every read of the port with its outputs, and all events that the daemon itself makes.

    Raises
    ------
    ConfigError, OperatorError
        The parameters can never work. `UnavailableError`: not now, for example an endpoint in use.
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
        self._layout = layout
        self._reload = reload
        link = make_link(pipeline, params.session, self._baud, other_layouts(layout))
        self._link = link
        session = link.session
        self._connection = connection = Connection(params.port.url, self._baud)
        switch = None if recorder is None else lambda on: recorder.switch(on, pipeline.hello)
        self._commands = Commands(pipeline, session, self._tuned, switch)
        metrics = Metrics(pipeline.health, connection.errors)
        self._network = Network(params.publish, self._asked, self._commands.settings)
        self._exporter = Exporter(params.metrics, metrics.text) if params.metrics.port else None
        self._outlets = Outlets(pipeline, session, self._network.publisher, metrics, recorder)
        self._report = Report(session, link, connection, layout, array, self._outlets)
        self._path = DataPath(link, connection, Encoder(layout), self._outlets, self._changed, self._failed)

    async def run(self) -> None:
        """Serve until `stop`; an error in the data path ends the service."""
        self._end: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        notifier = self._outlets.notifier
        parts = (self._connection.run(self._path), self._watch(), self._network.run())
        tasks = [asyncio.create_task(part) for part in parts]
        if self._exporter is not None:
            tasks.append(asyncio.create_task(self._exporter.run()))
        try:
            notifier.ready()
            await asyncio.wait([self._end, *tasks], return_when=asyncio.FIRST_COMPLETED)
            notifier.stopping()
            for finished in (self._end, *tasks):
                if finished.done():
                    finished.result()
            await self._path.drain()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._path.close()
            self._network.close()
            if self._exporter is not None:
                self._exporter.close()
            notifier.close()

    def stop(self) -> None:
        """Drain the line and end."""
        if not self._end.done():
            self._end.set_result(None)

    def reload(self) -> None:
        """Read the configuration again, and apply the parameters that can change while running."""
        if self._reload is None:
            logger.info("nothing to reload: there is no configuration file")
            return
        self._outlets.notifier.reloading()
        try:
            new = self._reload()
            check_url(new.port.url)
            self._commands.configure(new.session)
        except TactiledError as error:
            # An operator needs the message of a TactiledError, and no traceback.
            logger.error("configuration not reloaded, the old one stays: %s", error)  # noqa: TRY400
        else:
            for table in ("publish", "metrics"):
                if getattr(new, table) != getattr(self._params, table):
                    logger.warning("%s has changed: restart tactiled for it to take effect", table)
            moved = new.port != self._params.port
            self._params = new
            if moved:
                self._connection.move(new.port.url, self._baud)
            logger.info("configuration reloaded")
        self._outlets.notifier.ready()
        self._path.act()

    async def _watch(self) -> None:
        """Check the line and publish the status, at 10 Hz in every state."""
        link = self._link
        next_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            self._path.watch(now_s)
            self._report.regular(now_s)
            self._outlets.notifier.alive(now_s)
            next_s = max(next_s + STATUS_PERIOD_S, now_s)  # after a hang, missed ticks are skipped
            await asyncio.sleep(next_s - time.monotonic())
            link.load.turn(time.monotonic() - next_s)

    def _changed(self, now_s: float) -> None:
        self._report.changed(now_s, leaving=self._end.done())
        self._commands.look(now_s)

    def _failed(self, error: Exception) -> None:
        if not self._end.done():
            self._end.set_exception(error)

    def _asked(self, request: CommandRequest, requester: Requester, now_s: float, done: Done) -> None:
        """Carry out a command, publish its outcome, and answer the client."""

        def finish(reason: str) -> None:
            self._outlets.publish_and_record(
                self._commands.event(request, requester, reason, time.monotonic())
            )
            done(reason)

        self._commands.do(request, now_s, finish)
        self._path.act()

    def _tuned(self, name: str, arguments: dict[str, Any], events: Sequence[Event], now_s: float) -> None:
        self._outlets.tuned(name, arguments, events, now_s)

    @property
    def _baud(self) -> int:
        return self._params.port.baud or self._layout.file.baud


async def serve(
    params: ServiceParams,
    pipeline: Pipeline,
    layout: Layout,
    array: Array,
    reload: Reload | None = None,
    recorder: Recorder | None = None,
    duration_s: float | None = None,
) -> None:
    """Run the daemon for `duration_s`, or until SIGTERM or SIGINT; SIGHUP reloads the configuration."""
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
    """Run the daemon in a new event loop; returns exit code 0 after a requested end.

    Raises
    ------
    OperatorError
        The configuration must be corrected first, for example an invalid URL.
    UnavailableError
        Something is not available now, for example an endpoint in use.
    """
    asyncio.run(serve(params, pipeline, layout, array, reload, recorder, duration_s))
    return 0
