"""Service: all boards of a process in one event loop, with shared sockets, wall clock and metrics page.

Boards whose configurations have the same `publish` table share its sockets. Each board has a runner
(`daemon/runner.py`). When a bug of tactiled ends the only runner, the process ends with it, and the service
manager restarts it; among several boards, that board alone is started again.
"""

import asyncio
import contextlib
import gc
import logging
import os
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from tactiled import compiled
from tactiled.daemon.board.link import LoopTurns
from tactiled.daemon.clock import EpochClock
from tactiled.daemon.operations.exporter import Exporter
from tactiled.daemon.operations.metrics import metrics_text
from tactiled.daemon.operations.notify import Notifier
from tactiled.daemon.runner import STATUS_PERIOD_S, BoardRunner, ServedBoard, ServiceParams, SharedParts
from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.params import PublishParams
from tactiled.errors import ConfigError, TactiledError
from tactiled.limited_log import RateLimitedLog

logger = logging.getLogger(__name__)

CLOCK_PERIOD_S = 1.0  # a step of the wall clock is followed within this
RESTART_S = 0.5  # pause after a fault of one board among several, as RestartSec= of the unit; doubled ...
_LONGEST_RESTART_S = 60.0  # ... at each further fault up to this, so that the log and the disk do not fill
BEGIN_S = 30.0  # for what a limited run counts from; longer than a board takes to boot and a port to be found
_LOOK_S = 0.02  # period of looking for it: two scans
_NAMED = 3  # boards that the line of status names; the log has all of them


class Service:
    """Run the daemon for one or several boards.

    Parameters
    ----------
    boards : sequence of ServedBoard
        They agree on `metrics`; of several boards, each has a serial number and a port of its own.

    Raises
    ------
    ConfigError, OperatorError
        The parameters can never work. `UnavailableError`: not now, for example an endpoint in use.
    """

    def __init__(self, boards: Sequence[ServedBoard]) -> None:
        self._boards = tuple(boards)
        self._clock = EpochClock()
        self._turns = LoopTurns()
        self._log = RateLimitedLog(logger)
        self._status = ""
        self._runners: list[BoardRunner] = []
        self._networks: dict[PublishParams, Network] = {}
        self._notifier = Notifier()
        metrics = boards[0].params.metrics
        self._exporter = Exporter(metrics, self._metrics) if metrics.port else None
        try:
            publish = [board.params.publish for board in boards]
            for params in dict.fromkeys(publish):
                boards_there = partial(self._runners_at, params)
                self._networks[params] = Network(params, boards_there, publish.count(params))
            self._runners = [self._runner(number, board.params) for number, board in enumerate(boards)]
        except BaseException:
            self._close()
            raise

    async def run(self) -> None:
        """Serve until `stop`; an error in the data path of the only board ends the service."""
        self._end: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        boards = [asyncio.create_task(self._read(number)) for number in range(len(self._boards))]
        tasks = [*boards, asyncio.create_task(self._follow())]
        tasks += [asyncio.create_task(network.run()) for network in self._networks.values()]
        if self._exporter is not None:
            tasks.append(asyncio.create_task(self._exporter.run()))
        try:
            self._notifier.ready()
            logger.info("path of a scan: %s", compiled.path_words())
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

    def reload(self) -> None:
        """Read the configurations again, and apply the parameters that can change while running."""
        if all(board.reload is None for board in self._boards):
            logger.info("nothing to reload: there is no configuration file")
            return
        self._notifier.reloading()
        for number, (board, runner) in enumerate(zip(self._boards, self._runners, strict=True)):
            if board.reload is None:
                continue
            try:
                new = board.reload()
                self._check_apart(number, new)
                runner.apply(new)
            except TactiledError as error:
                # An operator needs the message of a TactiledError, and no traceback.
                logger.error("configuration not reloaded, the old one stays: %s", error)  # noqa: TRY400
            else:
                logger.info("configuration reloaded%s", f": board {runner.serial}" if runner.serial else "")
        self._notifier.ready()
        for runner in self._runners:
            runner.act()

    async def _read(self, number: int) -> None:
        """Run a board until stopped; among several boards, start it again after a fault of tactiled."""
        loop = asyncio.get_running_loop()
        fault, pause_s = "", 0.0
        while True:
            runner, begin_s = self._runners[number], loop.time()
            try:
                await runner.run(fault, pause_s)
            except Exception as error:
                if len(self._boards) == 1:
                    raise
                logger.exception("board %s: a fault of tactiled, it is started again", runner.serial)
                is_first = loop.time() - begin_s > _LONGEST_RESTART_S or not pause_s
                pause_s = RESTART_S if is_first else min(2 * pause_s, _LONGEST_RESTART_S)
                fault = f"a fault of tactiled itself, see the log ({error!r:.80}): started again"
                runner.abandon(fault)
                self._runners[number] = self._runner(number, runner.params)
            else:
                return

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

    def _runner(self, number: int, params: ServiceParams) -> BoardRunner:
        board = self._boards[number]
        publisher = self._networks[board.params.publish].publisher
        shared = SharedParts(publisher, self._clock, self._turns, self._notifier.alive, self._show_states)
        phase_s = STATUS_PERIOD_S * number / len(self._boards)
        return BoardRunner(board, params, shared, phase_s)

    def _check_apart(self, number: int, new: ServiceParams) -> None:
        """Refuse a serial number or a port that another board has."""
        for other, runner in enumerate(self._runners):
            if other == number:
                continue
            if new.session.board_serial in (None, runner.params.session.board_serial):
                raise ConfigError(
                    "session.board_serial",
                    [f"{new.session.board_serial}: each of several boards needs one of its own"],
                )
            if new.port.url == runner.params.port.url:
                raise ConfigError("port.url", [f"{new.port.url}: board {runner.serial} has this port"])

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

    def _runners_at(self, publish: PublishParams) -> list[BoardRunner]:
        """Return the runners of the boards that share these endpoints."""
        pairs = zip(self._boards, self._runners, strict=True)
        return [runner for board, runner in pairs if board.params.publish == publish]

    def _close(self) -> None:
        for network in self._networks.values():
            network.close()
        if self._exporter is not None:
            self._exporter.close()
        self._notifier.close()


async def serve(
    boards: Sequence[ServedBoard],
    duration_s: float | None = None,
    has_begun: Callable[[], bool] = lambda: True,
) -> None:
    """Run the daemon for `duration_s`, or until SIGTERM or SIGINT; SIGHUP reloads the configurations.

    The duration counts from the instant at which `has_begun` returns True; without that, the daemon ends
    `BEGIN_S` after it was started.
    """
    service = Service(boards)
    loop = asyncio.get_running_loop()
    # Closing a port may block its thread for a while, which must not delay the ports of other boards.
    loop.set_default_executor(ThreadPoolExecutor(len(boards) + (os.cpu_count() or 1)))
    handlers: dict[int, Callable[[], None]] = {
        signal.SIGTERM: service.stop, signal.SIGINT: service.stop, signal.SIGHUP: service.reload
    }  # fmt: skip
    for number, handler in handlers.items():
        loop.add_signal_handler(number, handler)
    stopping = None
    if duration_s is not None:
        stopping = asyncio.create_task(_stop_after(duration_s, service.stop, has_begun))
    try:
        await service.run()
    finally:
        if stopping is not None:
            stopping.cancel()
        for number in handlers:
            loop.remove_signal_handler(number)


async def _stop_after(duration_s: float, stop: Callable[[], None], has_begun: Callable[[], bool]) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(BEGIN_S):
            while not has_begun():
                await asyncio.sleep(_LOOK_S)
        await asyncio.sleep(duration_s)
    stop()


def run_service(
    boards: Sequence[ServedBoard],
    duration_s: float | None = None,
    has_begun: Callable[[], bool] = lambda: True,
) -> int:
    """Run the daemon in a new event loop; returns exit code 0 after a requested end, raises as `Service`."""
    # What was made until here lives as long as the daemon. A collection that looked through it (80,000
    # objects) would stop the event loop for 15 to 40 ms.
    gc.collect()
    gc.freeze()
    asyncio.run(serve(boards, duration_s, has_begun))
    return 0
