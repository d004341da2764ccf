"""Recording session: writes pipeline inputs and events to files, and marks where data is missing.

Synchronous, like `rotation`: `daemon.operations.recorder` calls it in a thread of its own.
"""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from tactiled.events.types import Event
from tactiled.received import Output
from tactiled.recording.contents import Header, Input, Read
from tactiled.recording.directory import new_name, remove_surplus
from tactiled.recording.rotation import OFF, RecordParams, Rotation
from tactiled.recording.writer import RecordingWriter
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Hello

logger = logging.getLogger(__name__)

RETAIN_S = 60.0  # interval of checks for old recordings; filling a part of the default size takes longer


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
    """

    def __init__(self, params: RecordParams, header: Header, path: Path | None, now_s: float) -> None:
        self.dropped = 0
        """Number of reads that could not be written."""
        self.dropped_because = ""
        """Reason for the last of them, which may be over when it is reported."""
        self.progress = OFF
        self._params = params
        self._header = header
        self._encoder = Encoder(header.source.layout)
        assumed = header.source.layout_file.assumed_hello
        self._board = "" if assumed is None else assumed.board_serial
        self._hello: Hello | None = None
        self._hello_frame = b""
        self._measured_hz = 0.0
        self._missing = (0, 0)  # reads and bytes not yet marked in the file
        self._rotation: Rotation | None = None
        self._retains = False
        self._next_retain_s = now_s
        self._retain_fault = ""
        if path is not None or params.directory is not None:
            self._start(path, header, now_s)

    def begin(self, hello: Hello | None, now_s: float) -> None:
        """Start a new recording during a run; `hello` is what the pipeline knows of its board."""
        self.end(now_s)
        self._know(hello)
        if hello is not None:
            self._board = hello.board_serial
        self._missing = (0, 0)
        header = replace(self._header, fresh=False, hello=self._hello_frame, measured_hz=self._measured_hz)
        self._start(None, header, now_s)

    def end(self, now_s: float) -> None:
        """Finish the recording."""
        if self._rotation is not None:
            self._rotation.close(now_s)
            self._look(self._rotation)
            self._rotation = None

    def tick(self, now_s: float) -> None:
        """Do what is due: remove old recordings, sync, rotate, check the free space."""
        if self._rotation is not None:
            self._retain(now_s)
            self._rotation.measured_hz = self._measured_hz
            self._rotation.tick(self._hello_frame, now_s)
            self._look(self._rotation)

    def take(self, entry: RecordEntry, now_s: float) -> None:
        """Write one entry after a mark for missing reads; count it as missing if that fails."""
        reads, n_bytes = self._missing[0] + entry.dropped[0], self._missing[1] + entry.dropped[1]
        if self._rotation is not None and self._rotation.write(
            lambda writer: self._append(writer, entry, reads, n_bytes), now_s
        ):
            self._missing = (reads, n_bytes) if entry.cause is None else (0, 0)
        else:
            more_reads, more_bytes = entry.weight
            self._missing = (reads + more_reads, n_bytes + more_bytes)
            self.dropped += more_reads
            if self._rotation is not None:
                self.dropped_because = self._rotation.progress.reason
        if entry.cause is not None and entry.hello is not self._hello:
            self._know(entry.hello)

    def _append(self, writer: RecordingWriter, entry: RecordEntry, reads: int, n_bytes: int) -> None:
        cause, offset_s = entry.cause, entry.unix_offset_s
        now_s = 0.0 if cause is None else cause.arrival_s if isinstance(cause, Read) else cause.time_s
        if cause is not None and reads:
            writer.input(Input(now_s, offset_s, "dropped", json.dumps({"reads": reads, "bytes": n_bytes})))
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

    def _know(self, hello: Hello | None) -> None:
        """Store the hello of the board for the header of a later file."""
        self._hello = hello
        # A layout without hello frames has an assumed hello in its file, which every replay reads.
        has_hello = self._encoder.layout.has("hello")
        self._hello_frame = self._encoder.encode(hello) if hello is not None and has_hello else b""
        is_measured = hello is not None and self._header.source.layout.measures_rate
        self._measured_hz = hello.rate_hz if hello is not None and is_measured else 0.0

    def _start(self, path: Path | None, header: Header, now_s: float) -> None:
        self._retains = path is None
        self._rotation = Rotation(path or self._new_path(), self._params, header, now_s)
        self._look(self._rotation)

    def _look(self, rotation: Rotation) -> None:
        """Take over the progress, and log the file name when it changes."""
        before, self.progress = self.progress, rotation.progress
        if self.progress.state == "recording" and self.progress.file != before.file:
            logger.info("recording into %s", self.progress.file)

    def _new_path(self) -> Path:
        """Path of a recording that begins now."""
        return Path(self._params.directory or ".") / new_name(datetime.now(UTC))

    def _retain(self, now_s: float) -> None:
        """Remove old recordings to keep the directory within `record.keep_mb`."""
        keep_mb = self._params.keep_mb
        if keep_mb is None or not self._retains or now_s < self._next_retain_s:
            return
        self._next_retain_s = now_s + RETAIN_S
        fault = ""
        try:
            if removed := remove_surplus(self._new_path().parent, keep_mb, datetime.now(UTC).timestamp()):
                size_mb, last = sum(file.size_mb for file in removed), removed[-1].path
                logger.info(
                    "removed the %d oldest recordings, %.0f MB, up to %s", len(removed), size_mb, last
                )
        except OSError as error:
            fault = f"{error.filename}: {error.strerror}"
        if fault and fault != self._retain_fault:
            logger.warning("old recordings cannot be removed: %s", fault)
        self._retain_fault = fault
