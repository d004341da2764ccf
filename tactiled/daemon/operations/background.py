"""Worker thread for groove fits, at low priority beside the event loop."""

import contextlib
import os
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Generic, Self, TypeVar

from tactiled.detect.worker import Job, Worker, set_pause

T = TypeVar("T")

# The event loop's thread, at the usual priority, comes first. Not SCHED_IDLE: a thread that is not scheduled
# at all may hold the interpreter lock.
_NICE = 10
# At a pause of the computation the lock is given away, but no more often than this, and for at least so long.
# The event loop then seldom waits for the 5 ms after which the interpreter takes the lock from this thread:
# `./run bench latency` prints the longest turn of the loop. More pauses make the fits slower.
_PAUSE_EVERY_S = 1e-4
_PAUSE_S = 2e-5


class _GivenUpError(Exception):
    """The result of the running job is no longer wanted."""


class _ThreadJob(Generic[T]):
    def __init__(self, work: Callable[[], T], board: object) -> None:
        self._work = work
        self.board = board
        self._result: T | None = None
        self.error: Exception | None = None
        """Raised in the thread that takes the result."""
        self.is_wanted = True

    def run(self) -> None:
        """Compute the result, and keep it or the error."""
        try:
            self._result = self._work()
        except _GivenUpError:
            pass
        except Exception as error:
            self.error = error

    def result(self) -> T | None:
        """Return the result, or None where it is not ready, and stop computing it."""
        self.is_wanted = False
        if self.error is not None:
            raise self.error
        return self._result


class BackgroundWorker:
    """Compute jobs in a thread, which ends with the block; a job that was given up is ended or never begun.

    Boards take turns, and the newest job of a board comes first: it has the most time left. So a host that is
    too slow for all jobs still gives some answers in time, of each board.

    Parameters
    ----------
    prepare : callable, optional
        Called first in the thread: loads what the jobs need. What it raises is the result of every job.
    """

    def __init__(self, prepare: Callable[[], None] = lambda: None) -> None:
        self._prepare = prepare

    def __enter__(self) -> Self:
        self._changed = threading.Condition()
        self._jobs: list[_ThreadJob[object]] = []
        self._served: dict[object, int] = {}  # number of the turn in which a board was served last
        self._running: _ThreadJob[object] | None = None
        self._is_open = True
        self._thread = threading.Thread(target=self._run, name="groove fits", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._is_open = False
            self._changed.notify()
        self._thread.join()

    def of_board(self) -> Worker:
        """Return the worker of one board, which takes turns with those of other boards."""
        return _BoardWorker(self)

    def submit(self, work: Callable[[], T], board: object = None) -> Job[T]:
        """Hand over a computation for a board."""
        job = _ThreadJob(work, board)
        with self._changed:
            # Without those that were given up meanwhile: a host that is too slow keeps no list of them.
            self._jobs = [other for other in self._jobs if other.is_wanted]
            self._jobs.append(job)  # type: ignore[arg-type] # results pass through unchanged
            self._changed.notify()
        return job

    def _next(self) -> _ThreadJob[object]:
        """Take the newest job of the board that was served longest ago."""
        job = min(reversed(self._jobs), key=lambda one: (not one.is_wanted, self._served.get(one.board, 0)))
        self._jobs.remove(job)
        self._served[job.board] = 1 + max(self._served.values(), default=0)
        return job

    def _run(self) -> None:
        with contextlib.suppress(OSError):  # a container may forbid it; the pauses matter more
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        self._next_pause_s = 0.0
        failure: Exception | None = None
        try:
            self._prepare()
        except Exception as error:
            failure = error
        set_pause(self._pause)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or not self._is_open)
                if not self._is_open:
                    return
                self._running = self._next()
            if failure is not None:
                self._running.error = failure
            elif self._running.is_wanted:
                self._running.run()
            with self._changed:
                self._running = None

    def _pause(self) -> None:
        assert self._running is not None  # a pause belongs to a job
        if not (self._is_open and self._running.is_wanted):
            raise _GivenUpError
        now_s = time.perf_counter()
        if now_s >= self._next_pause_s:
            time.sleep(_PAUSE_S)
            self._next_pause_s = time.perf_counter() + _PAUSE_EVERY_S


class _BoardWorker:
    """Hands over computations in the name of one board."""

    def __init__(self, worker: BackgroundWorker) -> None:
        self._worker = worker

    def submit(self, work: Callable[[], T]) -> Job[T]:
        """Hand over a computation."""
        return self._worker.submit(work, self)
