"""Service: all boards of a process in one event loop, with shared sockets, wall clock and metrics page.

Each board has a runner (`daemon/runner.py`). When a bug of tactiled ends one, the process ends with it, and
the service manager restarts it.
"""

import asyncio
import gc
import logging
import os
import signal
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from tactiled import compiled
from tactiled.daemon.board.host_load import LoopTurns
from tactiled.daemon.clock import EpochClock
from tactiled.daemon.operations.exporter import Exporter
from tactiled.daemon.operations.metrics import metrics_text
from tactiled.daemon.operations.notify import Notifier
from tactiled.daemon.runner import STATUS_PERIOD_S, BoardRunner, ServedBoard, SharedParts
from tactiled.daemon.zmq.endpoints import filled
from tactiled.daemon.zmq.network import Network
from tactiled.limited_log import RateLimitedLog

logger = logging.getLogger(__name__)

CLOCK_PERIOD_S = 1.0  # a step of the wall clock is followed within this
_NAMED = 3  # boards that the line of status names; the log has all of them


class Service:
    """Run the daemon for one or several boards; made in the event loop that runs it.

    `ConfigError` or `OperatorError` if the parameters can never work, `UnavailableError` if they do not now,
    for example with an endpoint in use.

    Parameters
    ----------
    boards : sequence of ServedBoard
        They agree on `metrics` and `publish`; of several, each has a serial number and a port of its own.
    """

    def __init__(self, boards: Sequence[ServedBoard]) -> None:
        self._clock = EpochClock()
        self._turns = LoopTurns()
        self._log = RateLimitedLog(logger)
        self._end: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._status = ""
        self._runners: list[BoardRunner] = []
        params = boards[0].params
        self._endpoints = " and ".join(map(filled, params.publish.endpoints)) or "no endpoint"
        self._network = Network(params.publish, self._runners, len(boards))
        self._exporter = Exporter(params.metrics, self._metrics) if params.metrics.port else None
        self._notifier = Notifier()
        shared = SharedParts(
            self._network.publisher, self._clock, self._turns, self._notifier.alive, self._show_states
        )
        try:
            for number, board in enumerate(boards):
                phase_s = STATUS_PERIOD_S * number / len(boards)
                self._runners.append(BoardRunner(board, shared, phase_s))
        except BaseException:
            self._close()
            raise

    async def run(self) -> None:
        """Serve until `stop`; an error in the data path of a board ends the service."""
        boards = [asyncio.create_task(runner.run()) for runner in self._runners]
        tasks = [*boards, asyncio.create_task(self._follow()), asyncio.create_task(self._network.run())]
        if self._exporter is not None:
            tasks.append(asyncio.create_task(self._exporter.run()))
        try:
            self._notifier.ready()
            logger.info("path of a scan: %s", compiled.path_words())
            logger.info("events on %s", self._endpoints)
            await asyncio.wait([self._end, *tasks], return_when=asyncio.FIRST_COMPLETED)
            self._notifier.stopping()
            for finished in (self._end, *tasks):
                if finished.done():
                    finished.result()
            for runner in self._runners:
                runner.stop()
            await asyncio.gather(*boards)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._close()

    def stop(self) -> None:
        """Drain the lines and end."""
        if not self._end.done():
            self._end.set_result(None)

    async def _follow(self) -> None:
        """Follow the wall clock, and keep the service manager informed."""
        while True:
            now_s = time.monotonic()
            if step_s := self._clock.follow():
                words = f"the wall clock was set by {step_s:+.3f} s; timestamps follow it"
                self._log.add(words, now_s, kind="wall clock")
            self._log.write_counts(now_s)
            self._notifier.alive(now_s)
            self._show_states()
            await asyncio.sleep(CLOCK_PERIOD_S)

    def _show_states(self) -> None:
        """Set the line of status that the service manager shows."""
        if len(self._runners) == 1:
            status = self._runners[0].words
        else:
            others = [runner.words for runner in self._runners if not runner.is_fresh and runner.words]
            more = [f"and {len(others) - _NAMED} more"] if len(others) > _NAMED else []
            fresh = sum(runner.is_fresh for runner in self._runners)
            status = "; ".join([f"{fresh} of {len(self._runners)} boards fresh", *others[:_NAMED], *more])
        if status and status != self._status:
            self._status = status
            self._notifier.status(status)

    def _metrics(self) -> str:
        return metrics_text(runner.metrics for runner in self._runners)

    def _close(self) -> None:
        self._network.close()
        self._notifier.close()


async def serve(boards: Sequence[ServedBoard], duration_s: float | None = None) -> None:
    """Run the daemon for `duration_s`, or until SIGTERM, SIGINT or SIGHUP."""
    service = Service(boards)
    loop = asyncio.get_running_loop()
    # Closing a port may block its thread for a while, which must not delay the ports of other boards.
    loop.set_default_executor(ThreadPoolExecutor(len(boards) + (os.cpu_count() or 1)))
    signals = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # `nohup` outlives its terminal
        signals.append(signal.SIGHUP)
    for number in signals:
        loop.add_signal_handler(number, service.stop)
    timer = None if duration_s is None else loop.call_later(duration_s, service.stop)
    try:
        await service.run()
    finally:
        if timer is not None:
            timer.cancel()
        for number in signals:
            loop.remove_signal_handler(number)


def run_service(boards: Sequence[ServedBoard], duration_s: float | None = None) -> None:
    """Run the daemon in a new event loop; raises as `Service`."""
    # What was made until here lives as long as the daemon. A collection that looked through it (80,000
    # objects) would stop the event loop for 15 to 40 ms.
    gc.collect()
    gc.freeze()
    asyncio.run(serve(boards, duration_s))
