"""Recorder of the running service: a thread writes, so that the event loop never waits for the disk.

A bounded queue connects the event loop with the thread. When the disk is slower than the line for longer than
the queue lasts, reads are dropped, counted and reported, and the file has a mark at that place. Only the
thread waits for the disk, and `close`, for a limited time.
"""

import contextlib
import logging
import math
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from tactiled.errors import DataError
from tactiled.events.types import Event, RecordingEvent
from tactiled.received import Output
from tactiled.recording.contents import Header, Input, Read
from tactiled.recording.directory import unfinished
from tactiled.recording.session import OFF, RecordEntry, RecordingProgress, RecordingSession, RecordParams
from tactiled.recording.writer import ACTIVE
from tactiled.wire.frames import Hello

logger = logging.getLogger(__name__)

# Some 40 s of a 100 Hz board with its status, and about 10 MB: longer than a disk takes to spin up, or a
# memory card to reorganise itself.
_QUEUE_ITEMS = 5000
_START_S = 1.0  # longest wait for the first file; sensing then begins without it
_CLOSE_S = 3.0  # less than the 5 s after which systemd kills the daemon
_WAKE_S = 0.1  # period at which the idle thread checks for a sync that is due, or for the end
_REPORT_S = 1.0  # period of the recording event
_COMPLAIN_S = 10.0  # between two lines of the log about drops
# A disk that starts to spin, or a memory card that reorganises itself, answers within some 10 s.
_SILENT_S = 15.0
# Niceness of a recovery: the smallest share of a busy processor that never becomes zero, as that of
# SCHED_IDLE may.
_RECOVERY_NICE = 19
_RECOVERY_CLOSE_S = 1.0  # a copy that is incomplete then is made again by the next run


@dataclass(frozen=True)
class _Switch:
    """Request to begin or end a recording; `hello` is that of the pipeline."""

    on: bool
    hello: Hello | None
    dropped: tuple[int, int]  # as in `RecordEntry`


class Recorder:
    """Record reads, commands and events of the service while switched on.

    It records into `path` from the start, or into `params.directory`, if there is one. A file that cannot
    be written is no error: `report` gives the reason, and it is tried again.
    """

    def __init__(self, params: RecordParams, header: Header, path: Path | None = None) -> None:
        self._params = params
        self._header = header
        self._path = path
        self._session: RecordingSession | None = None
        self.is_on = path is not None or params.directory is not None
        """True while recording is wanted, whether or not the disk takes it."""
        # In place of `_session.progress`, before it exists and after a fault
        self._instead: RecordingProgress | None = OFF
        if self.is_on:
            place = path or params.directory
            self._instead = replace(OFF, state="failed", reason=f"{place}: the disk does not answer")
        self._unplaced = (0, 0)  # reads and bytes dropped by a full queue, and not yet marked in the file
        self._queue_dropped = self._complained = self._complained_unwritten = 0
        self._asked_s = math.inf  # since when the thread waits for the disk
        self._reported, self._next_report_s, self._complain_s = "", 0.0, 0.0
        self._fault = ""  # last fault that was logged
        self._is_broken = False  # the thread has ended by a fault of tactiled: it takes nothing more
        self._queue: queue.Queue[RecordEntry | _Switch] = queue.Queue(_QUEUE_ITEMS)
        self._started, self._ending = threading.Event(), threading.Event()
        self._close_by_s = math.inf
        self._thread = threading.Thread(target=self._live, name="recorder", daemon=True)
        if self.is_on:  # without a place to record, it can never be switched on: no thread is needed
            self._thread.start()
            self._started.wait(_START_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def reads_dropped(self) -> int:
        """Number of reads that are in no file: the disk was too slow, full, or failed."""
        return self._queue_dropped + (0 if self._session is None else self._session.dropped)

    @property
    def progress(self) -> RecordingProgress:
        """State of the recording."""
        if self._instead is not None:
            return self._instead
        assert self._session is not None  # it is made before `_instead` is cleared
        progress = self._session.progress
        if progress.state == "recording" and time.monotonic() - self._asked_s > _SILENT_S:
            return replace(progress, state="failed", reason=f"{progress.file}: the disk does not answer")
        return progress

    def check(self) -> None:
        """Raise `DataError` when nothing is recorded, for a program whose only purpose is recording."""
        if self.progress.state != "recording":
            raise DataError(self.progress.reason)

    # ---- called by the event loop; nothing here waits but `close` ----------------------------------

    def record(self, cause: Read | Input, outputs: Sequence[Output], hello: Hello | None) -> None:
        """Record a read or another input of the pipeline, its outputs, and its hello afterwards."""
        self._hand(RecordEntry(cause, outputs, hello, "", cause.unix_offset_s, self._unplaced))

    def record_event(self, event: Event, board: str, unix_offset_s: float) -> None:
        """Record an event that the daemon itself made."""
        self._hand(RecordEntry(None, (event,), None, board, unix_offset_s, self._unplaced))

    def switch(self, on: bool, hello: Hello | None) -> str:
        """Begin a new recording or end the present one; returns the reason for a refusal, or an empty string.

        `report` tells later whether the disk accepted the file.
        """
        if self._is_broken:
            return self.progress.reason
        if on == self.is_on:
            return ""
        if on and self._params.directory is None:
            return "nowhere to record: set record.directory in the configuration"
        try:
            self._queue.put_nowait(_Switch(on, hello, self._unplaced))
        except queue.Full:
            return "the disk does not keep up: ask again"
        self.is_on, self._unplaced = on, (0, 0)
        return ""

    def report(self, now_s: float) -> RecordingEvent | None:
        """Return the recording event, each second and at each change of state; log faults and drops."""
        progress = self.progress
        fault = progress.reason if progress.state in ("no-room", "failed") else ""
        dropped = self.reads_dropped
        if dropped > self._complained and now_s >= self._complain_s:
            self._complain_s = now_s + _COMPLAIN_S
            new, self._complained = dropped - self._complained, dropped
            cause = self._cause_of_drops(fault)
            into = progress.file or self._params.directory or self._path  # several boards have one log
            logger.warning(
                "recording into %s: %d more reads are in no file, %d in all: %s", into, new, dropped, cause
            )
        if fault and fault != self._fault:
            logger.error("not recording, tried again: %s", fault)
        self._fault = fault
        if now_s < self._next_report_s and progress.state == self._reported:
            return None
        self._next_report_s, self._reported = now_s + _REPORT_S, progress.state
        return RecordingEvent(
            time_s=now_s,
            state=progress.state,
            reason=progress.reason,
            file=progress.file,
            parts=progress.parts,
            bytes_written=progress.bytes_written,
            free_mb=progress.free_mb,
            reads_dropped=dropped,
            reads_waiting=self._queue.qsize(),
        )

    def _cause_of_drops(self, fault: str) -> str:
        """Reason for the reads that were dropped since it was last asked for; `fault` is that of now."""
        unwritten = 0 if self._session is None else self._session.dropped
        before, self._complained_unwritten = self._complained_unwritten, unwritten
        because = "" if self._session is None or unwritten == before else self._session.dropped_because
        return because or fault or "the disk is too slow"

    def finish(self) -> None:
        """Begin to finish the file; `close` waits for it."""
        self._close_by_s = min(self._close_by_s, time.monotonic() + _CLOSE_S)
        self._ending.set()

    def close(self) -> None:
        """Finish the file; gives up `_CLOSE_S` after `finish` on a disk that does not respond."""
        if self._thread.ident is None:
            return  # it was never started
        self.finish()
        self._thread.join(max(0.0, self._close_by_s - time.monotonic()))
        if self._thread.is_alive():
            if not (file := self.progress.file):
                logger.error("recording: the disk has not answered for %g s: nothing is recorded", _CLOSE_S)
                return
            logger.error(
                "recording: in %g s the disk has not taken the end of %s; have what it took: "
                "tactiled recover %s%s", _CLOSE_S, file, file, ACTIVE,
            )  # fmt: skip

    def _hand(self, entry: RecordEntry) -> None:
        if not self.is_on:
            return
        try:
            self._queue.put_nowait(entry)
        except queue.Full:
            self._drop(entry)
        else:
            self._unplaced = (0, 0)
        while self._is_broken and not self._queue.empty():
            if isinstance(left := self._queue.get_nowait(), RecordEntry):
                self._drop(left)

    def _drop(self, entry: RecordEntry) -> None:
        reads, n_bytes = entry.weight
        self._unplaced = (self._unplaced[0] + reads, self._unplaced[1] + n_bytes)
        self._queue_dropped += reads

    # ---- the thread --------------------------------------------------------------------------------

    def _live(self) -> None:
        session: RecordingSession | None = None
        leftovers: Leftovers | None = None
        try:
            session = self._session = RecordingSession(
                self._params, self._header, self._path, time.monotonic()
            )
            self._instead = None
            self._started.set()
            if self._params.directory is not None:
                leftovers = Leftovers(Path(self._params.directory), self._params.min_free_mb)
            while not (self._ending.is_set() and self._queue.empty()):
                with contextlib.suppress(queue.Empty):
                    item = self._queue.get(timeout=_WAKE_S)
                    self._asked_s = time.monotonic()
                    if isinstance(item, RecordEntry):
                        session.take(item, time.monotonic())
                    elif item.on:
                        session.begin(item.hello, time.monotonic())
                    else:
                        session.end(time.monotonic(), item.dropped)
                self._asked_s = min(self._asked_s, time.monotonic())
                session.tick(time.monotonic())
                self._asked_s = math.inf
                if leftovers is not None:
                    leftovers.look(session.progress)
            session.end(time.monotonic(), self._unplaced)
        except Exception:  # a bug: sensing continues without a recording, and `report` says so
            logger.exception("recording ended by a fault of tactiled")
            with contextlib.suppress(Exception):  # perhaps the same fault again; the file can be recovered
                if session is not None:
                    session.end(time.monotonic())
            self._is_broken = True
            self._instead = replace(OFF, state="failed", reason="a fault of tactiled itself, see the log")
            self._started.set()
        finally:
            if leftovers is not None:
                leftovers.close()


class Leftovers:
    """Recover what earlier runs left unfinished in a directory, each time that recording in it begins.

    Recovering a file takes seconds of computing, which would delay the event loop even from a thread. It is
    therefore done in a process, which locks each file, so that one which is still written is not touched.
    """

    def __init__(self, directory: Path, min_free_mb: float) -> None:
        self._directory = directory
        self._min_free_mb = min_free_mb
        self._was_recording = False
        self._child: subprocess.Popen[bytes] | None = None

    def look(self, progress: RecordingProgress) -> None:
        """Start the process when recording in the directory has begun; never waits for it."""
        if self._child is not None and (code := self._child.poll()) is not None:
            if code != 0:
                logger.warning("%s: not every unfinished recording could be recovered", self._directory)
            self._child = None
        is_recording = progress.state == "recording" and Path(progress.file).parent == self._directory
        if is_recording and not self._was_recording and self._child is None:
            self._start()
        self._was_recording = is_recording

    def close(self) -> None:
        """End the process."""
        if self._child is None:
            return
        self._child.terminate()
        try:
            self._child.wait(_RECOVERY_CLOSE_S)
        except subprocess.TimeoutExpired:  # it waits for the disk, and ignores SIGTERM meanwhile
            self._child.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._child.wait(_RECOVERY_CLOSE_S)

    def _start(self) -> None:
        try:
            if not (files := unfinished(self._directory)):
                return
            logger.info("recovering %d unfinished recordings in %s", len(files), self._directory)
            command = [sys.executable, "-P", "-m", "tactiled", "recover", str(self._directory)]
            environ = {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}
            self._child = subprocess.Popen(
                [*command, "--min-free-mb", str(self._min_free_mb)],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=environ,
            )  # fmt: skip
        except OSError as error:
            logger.warning("unfinished recordings in %s: not recovered: %s", self._directory, error.strerror)
            return
        with contextlib.suppress(OSError):  # it has ended already
            os.setpriority(os.PRIO_PROCESS, self._child.pid, _RECOVERY_NICE)
