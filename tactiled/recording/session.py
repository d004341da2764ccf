"""Recording session: writes pipeline inputs and events to the parts of a recording, and marks missing data.

Parts are limited by size and age; recording pauses while the disk has no room, and is tried again after a
failure. Synchronous and single-threaded; `daemon.operations.recorder` calls it in a thread of its own,
because every call may wait for the disk. Time is an argument.
"""

import json
import logging
import os
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from tactiled.errors import DataError
from tactiled.events.types import Event
from tactiled.received import Output
from tactiled.recording.contents import Header, Input, Read
from tactiled.recording.directory import new_name, remove_surplus
from tactiled.recording.writer import RecordingWriter, is_taken
from tactiled.tomlfile import Params
from tactiled.wire.frames import Hello

logger = logging.getLogger(__name__)

_MB = 1e6
_ROOM_FACTOR = 1.1  # free space must exceed the limit by a tenth before recording resumes: hysteresis
RETRY_S = 10.0  # pause after a failed write
RETAIN_S = 60.0  # interval of checks for old recordings; filling a part of the default size takes longer

RecordingState = Literal["off", "recording", "no-room", "failed"]


class RecordParams(Params):
    """Directory, part size and retention of recordings."""

    directory: str | None = Field(
        default=None,
        min_length=1,
        description="Record permanently into this directory; files are named by their time. If omitted, only "
        "`tactiled run --record FILE` and `tactiled record` write recordings.",
    )
    sync_s: float = Field(
        default=1.0,
        gt=0,
        le=60,
        description="Everything older than this (seconds) is on the disk: the most that a kill or a power "
        "cut can lose.",
    )
    max_file_mb: float = Field(
        default=256.0, ge=0.01, description="A part is finished when it reaches this size (10^6 bytes)."
    )
    max_file_s: float = Field(
        default=3600.0, gt=0, description="A part is finished when it reaches this age (seconds)."
    )
    keep_mb: float | None = Field(
        default=None,
        gt=0,
        description="Finished recordings in `directory` are removed, oldest first, while together they are "
        "larger than this (10^6 bytes); the newest one is never removed. If omitted, all are kept.",
    )
    min_free_mb: float = Field(
        default=500.0,
        ge=0,
        description="Recording pauses while the disk has less free space than this (10^6 bytes), and "
        "continues with a new part when it has a tenth more.",
    )


@dataclass(frozen=True)
class RecordingProgress:
    """State of a recording."""

    state: RecordingState  # in ``"no-room"`` and ``"failed"`` nothing is recorded; the recorder retries
    reason: str  # empty while recording; in ``"off"``, why the last part could not be finished
    file: str  # finished name of the part being written; empty where there is none
    parts: int  # number of parts begun so far
    bytes_written: int  # total over all parts, without data that waits for the next sync
    free_mb: float  # free space on the disk at the last check


OFF = RecordingProgress(state="off", reason="", file="", parts=0, bytes_written=0, free_mb=0.0)


@dataclass(frozen=True)
class RecordEntry:
    """One input of the pipeline and the outputs that it caused."""

    cause: Read | Input | None  # the input; None for events of the daemon itself, about `board`
    outputs: Sequence[Output]
    hello: Hello | None  # hello of the board as the pipeline knows it afterwards
    board: str
    unix_offset_s: float
    dropped: tuple[int, int] = (0, 0)  # reads and bytes that were dropped just before this entry

    @property
    def weight(self) -> tuple[int, int]:
        """Reads and bytes lost with this entry; a lost port or a command counts as a read of 0 bytes."""
        if self.cause is None:
            return (0, 0)
        return (1, len(self.cause.data) if isinstance(self.cause, Read) else 0)


class RecordingSession:
    """Writer of record entries while a recording is active.

    Parameters
    ----------
    path : Path, optional
        File to record into from the start; by default a new file in `params.directory`, if that is set.

    Attributes
    ----------
    progress : RecordingProgress
        Of the last call, so that another thread may read it at any time.
    dropped : int
        Number of reads that could not be written.
    dropped_because : str
        Reason for the last of them, which may be over when it is reported.
    """

    def __init__(self, params: RecordParams, header: Header, path: Path | None, now_s: float) -> None:
        self.dropped, self.dropped_because = 0, ""
        self.progress = OFF
        self._params = params
        self._header = header  # of the newest part, with what is known for the next one
        assumed = header.source.layout_file.assumed_hello
        self._board = "" if assumed is None else assumed.board_serial
        self._missing = (0, 0)  # reads and bytes not yet marked in the file
        self._unix_offset_s = 0.0  # of the newest entry
        # Reads and bytes written or marked since the last sync, and how many of these reads were written
        self._unsynced, self._unsynced_reads = (0, 0), 0
        self._path: Path | None = None  # of the first part of the recording; None: none runs
        self._writer: RecordingWriter | None = None
        self._bytes_before = 0
        self._opened_s = self._due_s = now_s
        self._retains = False
        self._next_retain_s = now_s
        self._retain_fault = ""
        if path is not None or params.directory is not None:
            self._start(path, now_s)

    def begin(self, hello: Hello | None, now_s: float) -> None:
        """Start a new recording during a run; `hello` is what the pipeline knows of its board."""
        self.end(now_s)
        if hello is not None:
            self._board = hello.board_serial
        self._missing = (0, 0)
        self._header = replace(self._header, fresh=False, hello=hello)
        self._start(None, now_s)

    def end(self, now_s: float, dropped: tuple[int, int] = (0, 0)) -> None:
        """Finish the recording, after `dropped` more reads and bytes."""
        if self._path is not None:
            self._missing = _sum(self._missing, dropped)
            if self._missing[0] and self._write(lambda w: self._mark(w, now_s, *self._missing), now_s):
                self._missing = (0, 0)
            is_finished = self._writer is None or self._leave(now_s)
            if not is_finished:
                logger.error("recording: not finished: %s", self.progress.reason)
            self._note(state="off", reason="" if is_finished else self.progress.reason)
            self._path = None

    def tick(self, now_s: float) -> None:
        """Do what is due: remove old recordings, sync, begin the next part, check the free space."""
        if self._path is None:
            return
        self._retain(now_s)
        if now_s >= self._due_s:
            self._due_s = now_s + self._params.sync_s
            if self._writer is None:
                self._open(self._path, now_s)
            elif self._write(RecordingWriter.sync, now_s):
                self._unsynced, self._unsynced_reads = (0, 0), 0
                self._check(self._path, self._writer, now_s)
        self._note()

    def take(self, entry: RecordEntry, now_s: float) -> None:
        """Write one entry after a mark for missing reads; count it as missing if that fails."""
        self._unix_offset_s = entry.unix_offset_s
        self._missing = _sum(self._missing, entry.dropped)
        if entry.dropped[0] and entry.hello is not None:  # which may have been among the dropped reads
            self._board = entry.hello.board_serial
        if self._path is not None and self._write(lambda writer: self._append(writer, entry), now_s):
            if entry.cause is not None:
                self._unsynced = _sum(self._unsynced, self._missing, entry.weight)
                self._unsynced_reads += entry.weight[0]
                self._missing = (0, 0)
        else:
            self._missing = _sum(self._missing, entry.weight)
            self.dropped += entry.weight[0]
            for output in entry.outputs:
                if isinstance(output, Hello):
                    self._board = output.board_serial
            if self._path is not None:
                self.dropped_because = self.progress.reason
        if entry.cause is not None and entry.hello is not self._header.hello:
            self._header = replace(self._header, hello=entry.hello)

    def _append(self, writer: RecordingWriter, entry: RecordEntry) -> None:
        cause, offset_s = entry.cause, entry.unix_offset_s
        reads, n_bytes = self._missing
        now_s = 0.0 if cause is None else cause.arrival_s if isinstance(cause, Read) else cause.time_s
        if cause is not None and reads:
            self._mark(writer, now_s, reads, n_bytes)
        if isinstance(cause, Read):
            writer.read(cause)
        elif cause is not None:
            writer.input(cause)
        for output in entry.outputs:
            if isinstance(output, Hello):
                self._board = output.board_serial
            elif isinstance(output, Event) and cause is None:
                writer.event(output, entry.board, offset_s, "daemon")
            elif isinstance(output, Event):
                writer.event(output, self._board, offset_s, "pipeline")

    def _mark(self, writer: RecordingWriter, now_s: float, reads: int, n_bytes: int) -> None:
        """Write a mark for missing reads."""
        words = json.dumps({"reads": reads, "bytes": n_bytes})
        writer.input(Input(now_s, self._unix_offset_s, "dropped", words))

    def _start(self, path: Path | None, now_s: float) -> None:
        self._retains = path is None
        self._path = path or Path(self._params.directory or ".") / new_name(datetime.now(UTC))
        self._header = replace(self._header, run=uuid.uuid4().hex, part=0, sync_s=self._params.sync_s)
        self._bytes_before = 0
        self.progress = OFF
        self._due_s = now_s + self._params.sync_s
        self._open(self._path, now_s)

    def _open(self, path: Path, now_s: float) -> None:
        """Open the next part if there is enough free space."""
        try:
            room_mb = free_mb(path.parent)
            is_resuming = self.progress.state == "no-room"
            if room_mb < self._params.min_free_mb * (_ROOM_FACTOR if is_resuming else 1.0):
                self._lack_room(path, room_mb)
                return
            header = replace(self._header, part=self._header.part + 1)
            number = header.part
            # After a clock was set back, a name of ours may be taken; one that somebody gave is then refused.
            while (number > 1 or self._retains) and is_taken(part_path(path, number)):
                number += 1
            self._writer = RecordingWriter(part_path(path, number), header)
        except (DataError, OSError) as error:
            self._fail(str(error), now_s)
            return
        self._header = replace(header, fresh=False)
        self._opened_s, self._due_s = now_s, now_s + self._params.sync_s
        self._note(state="recording", reason="", free_mb=room_mb)
        logger.info("recording into %s", self._writer.path)

    def _write(self, append: Callable[[RecordingWriter], None], now_s: float) -> bool:
        """Append to the open part; return False, and lose the data, while there is none."""
        if self._writer is None:
            # The pipeline has processed data that no part holds.
            self._header = replace(self._header, fresh=False)
            return False
        try:
            append(self._writer)
        except OSError as error:
            reason = f"{self._writer.active}: {error.strerror}; recover its data with `tactiled recover`"
            self._fail(reason, now_s)
            return False
        return True

    def _check(self, path: Path, writer: RecordingWriter, now_s: float) -> None:
        """Check the size and age of the part and the free space after a sync."""
        try:
            room_mb = free_mb(path.parent)
        except DataError as error:
            self._fail(f"{error}; it was there when the part was begun: is its disk gone?", now_s)
            return
        self._note(free_mb=room_mb)
        has_room = room_mb >= self._params.min_free_mb
        is_long = (
            writer.size_bytes / _MB >= self._params.max_file_mb
            or now_s - self._opened_s >= self._params.max_file_s
        )
        if (not has_room or is_long) and self._leave(now_s):
            if has_room:
                self._open(path, now_s)
            else:
                self._lack_room(path, room_mb)

    def _leave(self, now_s: float) -> bool:
        """Finish the open part; False where the write failed."""
        writer = self._writer
        if writer is None or not self._write(RecordingWriter.close, now_s):
            return False
        self._bytes_before += writer.size_bytes
        self._writer = None
        self._unsynced, self._unsynced_reads = (0, 0), 0
        return True

    def _lack_room(self, path: Path, room_mb: float) -> None:
        reason = (  # without the free space of now, because each new reason is logged
            f"{path.parent}: the free space fell below record.min_free_mb = {self._params.min_free_mb:g}; "
            f"recording continues above {self._params.min_free_mb * _ROOM_FACTOR:g} MB"
        )
        self._note(state="no-room", reason=reason, free_mb=room_mb)

    def _fail(self, reason: str, now_s: float) -> None:
        """Abandon the open part after a failed write, and schedule a new part.

        All reads since the last sync count as missing, although some may be on the disk.
        """
        if self._writer is not None:
            self._writer.abandon()
            self._bytes_before += self._writer.size_bytes
            self._writer = None
        if self._unsynced_reads:
            self.dropped += self._unsynced_reads
            self.dropped_because = reason
        self._missing = _sum(self._missing, self._unsynced)
        self._unsynced, self._unsynced_reads = (0, 0), 0
        self._due_s = now_s + RETRY_S
        self._note(state="failed", reason=reason)

    def _note(self, **changes: Any) -> None:
        """Make the progress known."""
        writer = self._writer
        self.progress = replace(
            self.progress,
            file="" if writer is None else str(writer.path),
            parts=self._header.part,
            bytes_written=self._bytes_before + (0 if writer is None else writer.size_bytes),
            **changes,
        )

    def _retain(self, now_s: float) -> None:
        """Remove old recordings to keep the directory within `record.keep_mb`."""
        keep_mb = self._params.keep_mb
        if keep_mb is None or not self._retains or now_s < self._next_retain_s:
            return
        self._next_retain_s = now_s + RETAIN_S
        fault = ""
        try:
            if removed := remove_surplus(
                Path(self._params.directory or "."), keep_mb, datetime.now(UTC).timestamp()
            ):
                size_mb, last = sum(file.size_mb for file in removed), removed[-1].path
                logger.info(
                    "removed the %d oldest recordings, %.0f MB, up to %s", len(removed), size_mb, last
                )
        except OSError as error:
            fault = f"{error.filename}: {error.strerror}"
        if fault and fault != self._retain_fault:
            logger.warning("old recordings cannot be removed: %s", fault)
        self._retain_fault = fault


def _sum(*counts: tuple[int, int]) -> tuple[int, int]:
    return sum(reads for reads, _ in counts), sum(n_bytes for _, n_bytes in counts)


def part_path(path: Path, part: int) -> Path:
    """File name of a part: ``NAME.mcap``, then ``NAME.002.mcap``, ``NAME.003.mcap``, ..."""
    return path if part == 1 else path.with_name(f"{path.stem}.{part:03d}{path.suffix}")


def free_mb(directory: Path) -> float:
    """Free disk space for this user, 10^6 bytes; `DataError` if there is no such directory."""
    try:
        disk = os.statvfs(directory)
    except OSError as error:
        raise DataError(f"{directory}: {error.strerror}; make the directory, or choose another one") from None
    return disk.f_bavail * disk.f_frsize / _MB
