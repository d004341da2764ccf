"""One board of the daemon: port, pipeline, session, distributor and commands, put together and run.

A daemon has a runner for each board. They share the event loop, the sockets and the wall clock, and nothing
else: what one of them meets (no port, noise, a wrong board, a full disk, an exception) the others do not see.
"""

import asyncio
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from tactiled.daemon.board.datapath import DataPath
from tactiled.daemon.board.diagnosis import other_layouts
from tactiled.daemon.board.link import make_link
from tactiled.daemon.board.load import LoopTurns
from tactiled.daemon.board.report import Report
from tactiled.daemon.board.requirements import SessionParams
from tactiled.daemon.clock import EpochClock
from tactiled.daemon.operations.distributor import Distributor
from tactiled.daemon.operations.exporter import MetricsParams
from tactiled.daemon.operations.metrics import Metrics
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.serial.connection import Connection
from tactiled.daemon.serial.port import PortParams, check_url
from tactiled.daemon.zmq.commands import Commands, Done
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import CommandRequest, Requester
from tactiled.pipeline import Pipeline
from tactiled.tomlfile import Params
from tactiled.wire.codec import Encoder

logger = logging.getLogger(__name__)

STATUS_PERIOD_S = 0.1
# A status that is due so soon is published directly behind a scan. On its own, it would now and then hold up
# the next scan of a board at 100 Hz or more.
_EARLY_S = 0.01


class ServiceParams(Params):
    """Parameters of the daemon for one board; boards of one process share `metrics`."""

    port: PortParams
    session: SessionParams = SessionParams()
    publish: PublishParams = PublishParams()
    metrics: MetricsParams = MetricsParams()

    def without_publishing(self) -> Self:
        """Return a copy without endpoints, for a program that only records."""
        return self.model_copy(update={"publish": PublishParams(endpoints=())})


@dataclass(frozen=True)
class ServedBoard:
    """Board that a service reads."""

    params: ServiceParams
    # Returns a pipeline in its initial state; called at the start, and again after a fault of tactiled
    make_pipeline: Callable[[], Pipeline]
    # Takes every read of the port with its outputs, and all events that the daemon itself makes
    recorder: Recorder | None = None
    # Reads the configuration again (SIGHUP) and returns its parameters
    reload: Callable[[], ServiceParams] | None = None


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

    Parameters
    ----------
    params : ServiceParams
        Those of `board`, or what a reload has made of them.
    phase_s : float
        Delay of the first status, so that the boards of a daemon do not publish theirs all at once.

    Raises
    ------
    ConfigError
        The parameters can never work.
    """

    def __init__(
        self, board: ServedBoard, params: ServiceParams, shared: SharedParts, phase_s: float = 0.0
    ) -> None:
        check_url(params.port.url)
        self.params = params
        self._recorder = recorder = board.recorder
        self._shared = shared
        self._phase_s = phase_s
        self._status_s = math.inf  # when the next status is due
        pipeline = self._pipeline = board.make_pipeline()
        self._layout = pipeline.layout
        link = make_link(pipeline, params.session, self._baud, other_layouts(pipeline.layout), shared.turns)
        session = self._session = link.session
        self._connection = connection = Connection(params.port.url, self._baud)
        switch = None if recorder is None else lambda on: recorder.switch(on, pipeline.hello)
        self.metrics = Metrics(pipeline.health, connection.errors, lambda: session.board_serial)
        self._distributor = Distributor(
            pipeline, session, shared.publisher, self.metrics, shared.clock, recorder
        )
        self._commands = Commands(pipeline, session, self._distributor.tuned, switch)
        self._report = Report(
            session, link, connection, pipeline.layout, pipeline.array, self._distributor, self._state_told
        )
        self.words = ""
        """State of the board and its reason, as logged; empty before the first."""
        self._path = DataPath(
            link, connection, Encoder(pipeline.layout), self._distributor, shared.turns,
            self._changed, self._handled, self._failed,
        )  # fmt: skip

    @property
    def serial(self) -> str:
        """Serial number of the board; empty while it is unknown."""
        return self._session.board_serial

    @property
    def is_fresh(self) -> bool:
        """True where the newest status of the board says that its data are fresh."""
        return self._report.is_fresh

    async def run(self, fault: str = "", pause_s: float = 0.0) -> None:
        """Read the board until `stop`; an error in the data path ends it.

        Parameters
        ----------
        fault : str
            Published as the reason for having no board, until the port is opened.
        pause_s : float
            Time until the port is opened, in seconds.
        """
        self._end: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        if fault:
            self._session.lost(fault)
        tasks = [asyncio.create_task(self._connect(pause_s)), asyncio.create_task(self._watch())]
        try:
            await asyncio.wait([self._end, *tasks], return_when=asyncio.FIRST_COMPLETED)
            for finished in (self._end, *tasks):
                if finished.done():
                    finished.result()
            await self._path.drain()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._path.close()

    def stop(self) -> None:
        """Drain the line and end."""
        if hasattr(self, "_end") and not self._end.done():
            self._end.set_result(None)

    def abandon(self, reason: str) -> None:
        """Answer the command that waits, and end the recording, after `run` has ended with an error."""
        self._commands.give_up(reason)
        if self._recorder is not None and self._recorder.is_on:
            # The next pipeline knows nothing of what is in the present file: a replay of both would differ.
            for on in (False, True):
                if refused := self._recorder.switch(on, None):
                    logger.error("board %s: recording not begun anew: %s", self.serial, refused)

    def apply(self, new: ServiceParams) -> None:
        """Take the parameters that can change while running, and log which of the others have changed.

        Raises
        ------
        ConfigError
            The new parameters can never work; the old ones stay.
        """
        check_url(new.port.url)
        self._commands.configure(new.session)
        for table in ("publish", "metrics"):
            if getattr(new, table) != getattr(self.params, table):
                logger.warning("%s has changed: restart tactiled for it to take effect", table)
        moved = new.port != self.params.port
        self.params = new
        if moved:
            self._connection.move(new.port.url, self._baud)

    def act(self) -> None:
        """Send the commands that the board needs after a change."""
        self._path.act()

    def settings(self, now_s: float) -> dict[str, Any]:
        """Return the present settings, by the names that requests use."""
        return self._commands.settings(now_s)

    def do(self, request: CommandRequest, requester: Requester, now_s: float, done: Done) -> None:
        """Carry out a command, publish its outcome (of a stream, the first), and answer the client."""

        def finish(reason: str) -> None:
            event = self._commands.event(request, requester, reason, time.monotonic())
            if event is not None:
                self._distributor.publish_and_record(event)
            done(reason)

        self._commands.do(request, requester, now_s, finish)
        self._path.act()

    async def _connect(self, pause_s: float) -> None:
        await asyncio.sleep(pause_s)
        await self._connection.run(self._path)

    async def _watch(self) -> None:
        """Check the line and publish the status, at 10 Hz in every state."""
        await asyncio.sleep(self._phase_s)
        self._status_s = time.monotonic()
        self._look(self._status_s)
        while True:
            due_s = self._status_s
            await asyncio.sleep(due_s - time.monotonic())
            if due_s == self._status_s:  # there was no scan shortly before
                now_s = time.monotonic()
                self._shared.turns.add(now_s, now_s - due_s)
                self._look(now_s)

    def _look(self, now_s: float) -> None:
        """Check the line and publish the status."""
        self._status_s = max(self._status_s + STATUS_PERIOD_S, now_s)  # after a hang, missed ones are skipped
        self._path.watch(now_s)
        self._report.regular(now_s)
        self._shared.watched(now_s)

    def _handled(self, now_s: float) -> None:
        """Publish the status behind a scan if it is due soon."""
        if now_s >= self._status_s - _EARLY_S:
            self._look(now_s)

    def _changed(self, now_s: float) -> None:
        self._report.changed(now_s, leaving=self._end.done())
        self._commands.poll(now_s)

    def _state_told(self, words: str) -> None:
        self.words = words
        self._shared.show_states()

    def _failed(self, error: Exception) -> None:
        if not self._end.done():
            self._end.set_exception(error)

    @property
    def _baud(self) -> int:
        return self.params.port.baud or self._layout.file.baud
