"""Rotation of a recording: parts limited by size and age, a check of free disk space, retries after failures.

Synchronous and single-threaded; `daemon.operations.recorder` calls it in a thread of its own, because every
call may wait for the disk. Time is an argument.
"""

import os
import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pydantic import Field

from tactiled.errors import DataError
from tactiled.recording.contents import Header
from tactiled.recording.writer import RecordingWriter, disk_words
from tactiled.tomlfile import Params

_MB = 1e6
_ROOM_FACTOR = 1.1  # free space must exceed the limit by a tenth before recording resumes: hysteresis
RETRY_S = 10.0  # pause after a failed write

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
    reason: str  # empty while recording
    file: str  # finished name of the part being written; empty where there is none
    parts: int  # number of parts begun so far
    bytes_written: int  # total over all parts, without data that waits for the next sync
    free_mb: float  # free space on the disk at the last check


OFF = RecordingProgress(state="off", reason="", file="", parts=0, bytes_written=0, free_mb=0.0)


class Rotation:
    """Parts of one recording; the first is opened at once, or as soon as the disk allows it."""

    def __init__(self, path: Path, params: RecordParams, header: Header, now_s: float) -> None:
        self._path = path
        self._params = params
        self._header = replace(header, run=header.run or uuid.uuid4().hex, sync_s=params.sync_s)
        self._writer: RecordingWriter | None = None
        self._state: RecordingState = "off"
        self._reason = ""
        self._parts = self._bytes_before = 0
        self._free_mb = 0.0
        self._is_fresh = header.fresh
        self._due_s = now_s + params.sync_s
        self.measured_hz = header.measured_hz
        """Measured scan rate for the header of a new part; see `Header`."""
        self._begin(header.hello, now_s)

    @property
    def progress(self) -> RecordingProgress:
        """Current state of the recording."""
        writer = self._writer
        return RecordingProgress(
            state=self._state,
            reason=self._reason,
            file="" if writer is None else str(writer.path),
            parts=self._parts,
            bytes_written=self._bytes_before + (0 if writer is None else writer.size_bytes),
            free_mb=self._free_mb,
        )

    def write(self, append: Callable[[RecordingWriter], None], now_s: float) -> bool:
        """Append to the open part; return False, and lose the data, while there is none."""
        if self._writer is None:
            self._is_fresh = False  # the pipeline has processed data that no part holds
            return False
        try:
            append(self._writer)
        except OSError as error:
            reason = f"{self._writer.active}: {disk_words(error)}; recover its data with `tactiled recover`"
            self._fail(reason, now_s)
            return False
        return True

    def tick(self, hello: bytes, now_s: float) -> None:
        """Do what is due: sync, rotate, check the free space; `hello` is for the header of a new part."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + self._params.sync_s
        if self._writer is None:
            self._begin(hello, now_s)
        elif self.write(RecordingWriter.sync, now_s):
            self._look(hello, now_s)

    def close(self, now_s: float) -> None:
        """Finish the open part."""
        if self._writer is None or self._leave(now_s):
            self._state, self._reason = "off", ""

    def _look(self, hello: bytes, now_s: float) -> None:
        """Check the size and age of the part and the free space after a sync."""
        assert self._writer is not None
        try:
            self._free_mb = free_mb(self._path.parent)
        except DataError as error:
            self._fail(f"{error}; it was there when the part was begun: is its disk gone?", now_s)
            return
        size_mb = self._writer.size_bytes / _MB
        if self._free_mb < self._params.min_free_mb:
            if self._leave(now_s):
                self._lack_room()
            return
        age_s = now_s - self._opened_s
        is_long = size_mb >= self._params.max_file_mb or age_s >= self._params.max_file_s
        if is_long and self._leave(now_s):
            self._begin(hello, now_s)

    def _begin(self, hello: bytes, now_s: float) -> None:
        """Open a part if there is enough free space."""
        try:
            self._free_mb = free_mb(self._path.parent)
            if self._state == "no-room":
                if self._free_mb < _ROOM_FACTOR * self._params.min_free_mb:
                    return
            elif self._free_mb < self._params.min_free_mb:
                self._lack_room()
                return
            self._open(hello, now_s)
        except DataError as error:
            self._fail(str(error), now_s)
        else:
            self._state, self._reason = "recording", ""

    def _open(self, hello: bytes, now_s: float) -> None:
        part = self._parts + 1
        header = replace(
            self._header, part=part, fresh=self._is_fresh, hello=hello, measured_hz=self.measured_hz
        )
        self._writer = RecordingWriter(part_path(self._path, part), header)
        self._parts = part
        self._is_fresh = False
        self._opened_s = now_s
        self._due_s = now_s + self._params.sync_s

    def _leave(self, now_s: float) -> bool:
        """Finish the open part; False where the write failed."""
        writer = self._writer
        if writer is None or not self.write(RecordingWriter.close, now_s):
            return False
        self._bytes_before += writer.size_bytes
        self._writer = None
        return True

    def _lack_room(self) -> None:
        self._state = "no-room"
        self._reason = (
            f"{self._path.parent}: {self._free_mb:.0f} MB free, less than record.min_free_mb = "
            f"{self._params.min_free_mb:g}; recording continues when there is more space"
        )

    def _fail(self, reason: str, now_s: float) -> None:
        """Abandon the open part after a failed write, and schedule a new part."""
        if self._writer is not None:
            self._writer.abandon()
            self._bytes_before += self._writer.size_bytes
            self._writer = None
        self._state, self._reason, self._due_s = "failed", reason, now_s + RETRY_S


def part_path(path: Path, part: int) -> Path:
    """File name of a part: ``NAME.mcap``, then ``NAME.002.mcap``, ``NAME.003.mcap``, ..."""
    return path if part == 1 else path.with_name(f"{path.stem}.{part:03d}{path.suffix}")


def free_mb(directory: Path) -> float:
    """Free disk space for this user, 10^6 bytes.

    Raises
    ------
    DataError
        There is no such directory.
    """
    try:
        disk = os.statvfs(directory)
    except OSError as error:
        raise DataError(f"{directory}: {error.strerror}; make the directory, or choose another one") from None
    return disk.f_bavail * disk.f_frsize / _MB
