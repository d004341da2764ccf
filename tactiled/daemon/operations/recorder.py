"""The recorder beside the running service: acquisition hands over and goes on, whatever the disk does.

One thread writes. Between it and the event loop stands a bounded queue: when the disk is slower than the
line for longer than the queue lasts, reads are dropped, counted, said, and marked in the file at the very
place. Nothing here waits for the disk but that thread, and `close`, for a stated time.
"""

import contextlib
import json
import logging
import queue
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from tactiled.daemon.operations.leftovers import Leftovers
from tactiled.errors import DataError
from tactiled.events.types import Event, RecordingEvent
from tactiled.pipeline import Output
from tactiled.recording.contents import Header, Input, Read
from tactiled.recording.rotation import OFF, Progress, RecordParams
from tactiled.recording.scribe import Handed, Scribe
from tactiled.recording.writer import ACTIVE
from tactiled.wire.frames import Hello

logger = logging.getLogger(__name__)

# Some 40 s of a 100 Hz board with its status, and about 10 MB: longer than a disk that spins up or a card
# that reorganises itself keeps us waiting.
_QUEUE_ITEMS = 5000
_START_S = 1.0  # a disk that has not taken the first part by then is not waited for: sensing begins
_CLOSE_S = 3.0  # less than the 5 s after which systemd kills us
_WAKE_S = 0.1  # how often an idle thread looks whether a sync is due or the end has come
_REPORT_S = 1.0
_COMPLAIN_S = 10.0  # between two lines of the log about drops


@dataclass(frozen=True)
class _Switch:
    """Begin to record, or end; `hello` is what the pipeline knows of the board."""

    on: bool
    hello: Hello | None


class Recorder:
    """Records what the service tells it, while it is switched on and the disk allows it.

    A first part that cannot be written is no error: `report` says why, and it is tried again.

    Parameters
    ----------
    params : RecordParams
    header : Header
    path : Path, optional
        Record into this file from the start; left out: into `params.directory`, if there is one.
    """

    def __init__(self, params: RecordParams, header: Header, path: Path | None = None) -> None:
        self._params = params
        self._header = header
        self._path = path
        self._scribe: Scribe | None = None
        self._is_on = path is not None or params.directory is not None
        self._instead: Progress | None = OFF  # of what `_scribe` knows: before it is made, and after a fault
        if self._is_on:
            place = path or params.directory
            self._instead = replace(OFF, state="failed", reason=f"{place}: the disk does not answer")
        self._unplaced = (0, 0)  # reads and bytes that the queue had no place for, not yet handed over
        self._queue_dropped = self._complained = 0
        self._reported, self._next_report_s, self._complain_s = "", 0.0, 0.0
        self._fault = ""  # as it was logged last
        self._queue: queue.Queue[Handed | _Switch] = queue.Queue(_QUEUE_ITEMS)
        self._started, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._live, name="recorder", daemon=True)
        self._thread.start()
        self._started.wait(_START_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def reads_dropped(self) -> int:
        """Reads that are in no file: the disk was too slow, too full, or failed."""
        return self._queue_dropped + (0 if self._scribe is None else self._scribe.dropped)

    @property
    def progress(self) -> Progress:
        """Where the recording stands."""
        if self._instead is not None or self._scribe is None:
            return self._instead or OFF
        return self._scribe.progress

    def check(self) -> None:
        """Raise `DataError` when nothing is recorded: for a program that does nothing else."""
        if self.progress.state != "recording":
            raise DataError(self.progress.reason)

    # ---- called by the event loop; nothing here waits but `close` ----------------------------------

    def received(self, read: Read, outputs: Sequence[Output], hello: Hello | None) -> None:
        """A read of the port, what the pipeline made of it, and what it knows of the board since."""
        self._hand(read, outputs, hello, "", read.unix_offset_s)

    def disconnected(self, time_s: float, unix_offset_s: float, hello: Hello | None) -> None:
        """The port was lost, and the pipeline was told so."""
        self._hand(Input(time_s, unix_offset_s, "disconnected"), (), hello, "", unix_offset_s)

    def commanded(
        self,
        name: str,
        arguments: Mapping[str, Any],
        outputs: Sequence[Output],
        hello: Hello | None,
        time_s: float,
        unix_offset_s: float,
    ) -> None:
        """A command went into the pipeline (`Pipeline.command`), and what came of it."""
        told = Input(time_s, unix_offset_s, name, json.dumps(dict(arguments)))
        self._hand(told, outputs, hello, "", unix_offset_s)

    def said(self, event: Event, board: str, unix_offset_s: float) -> None:
        """The daemon said something beside the pipeline."""
        self._hand(None, (event,), None, board, unix_offset_s)

    def switch(self, on: bool, hello: Hello | None) -> str:
        """Begin a new recording, or end the one that is; the reason why not, or nothing.

        Whether the disk takes it is told by `report`.
        """
        if on == self._is_on:
            return ""
        if on and self._params.directory is None:
            return "nowhere to record: set record.directory in the configuration"
        try:
            self._queue.put_nowait(_Switch(on, hello))
        except queue.Full:
            return "the disk does not keep up: ask again"
        self._is_on, self._unplaced = on, (0, 0)
        return ""

    def report(self, now_s: float) -> RecordingEvent | None:
        """How the recording is, each second and at each change; logs why there is none, and drops."""
        dropped = self.reads_dropped
        if dropped > self._complained and now_s >= self._complain_s:
            self._complain_s = now_s + _COMPLAIN_S
            new, self._complained = dropped - self._complained, dropped
            logger.warning(
                "recording: %d more reads are in no file, %d in all: disk too slow or full", new, dropped
            )
        progress = self.progress
        fault = progress.reason if progress.state in ("no-room", "failed") else ""
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

    def close(self) -> None:
        """Finish the file; gives up after some seconds on a disk that does not answer."""
        self._ending.set()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive():
            if not (file := self.progress.file):
                logger.error("recording: the disk has not answered for %g s: nothing is recorded", _CLOSE_S)
                return
            logger.error(
                "recording: in %g s the disk has not taken the end of %s; have what it took: "
                "tactiled recover %s%s", _CLOSE_S, file, file, ACTIVE,
            )  # fmt: skip

    def _hand(
        self,
        told: Read | Input | None,
        outputs: Sequence[Output],
        hello: Hello | None,
        board: str,
        unix_offset_s: float,
    ) -> None:
        if not self._is_on:
            return
        handed = Handed(told, outputs, hello, board, unix_offset_s, self._unplaced)
        try:
            self._queue.put_nowait(handed)
        except queue.Full:
            reads, n_bytes = handed.weight
            self._unplaced = (self._unplaced[0] + reads, self._unplaced[1] + n_bytes)
            self._queue_dropped += reads
        else:
            self._unplaced = (0, 0)

    # ---- the thread --------------------------------------------------------------------------------

    def _live(self) -> None:
        scribe: Scribe | None = None
        leftovers: Leftovers | None = None
        try:
            scribe = self._scribe = Scribe(self._params, self._header, self._path, time.monotonic())
            self._instead = None
            self._started.set()
            if self._params.directory is not None:
                leftovers = Leftovers(Path(self._params.directory), self._params.min_free_mb)
            while not (self._ending.is_set() and self._queue.empty()):
                with contextlib.suppress(queue.Empty):
                    item = self._queue.get(timeout=_WAKE_S)
                    if isinstance(item, Handed):
                        scribe.take(item, time.monotonic())
                    elif item.on:
                        scribe.begin(item.hello, time.monotonic())
                    else:
                        scribe.end(time.monotonic())
                scribe.tick(time.monotonic())
                if leftovers is not None:
                    leftovers.look(scribe.progress)
            scribe.end(time.monotonic())
        except Exception:  # a bug: acquisition goes on without us, and says so
            logger.exception("recording ended by a fault of tactiled")
            with contextlib.suppress(Exception):  # the same fault, perhaps; the file can be recovered
                if scribe is not None:
                    scribe.end(time.monotonic())
            self._instead = replace(OFF, state="failed", reason="a fault of tactiled itself, see the log")
            self._started.set()
        finally:
            if leftovers is not None:
                leftovers.close()
