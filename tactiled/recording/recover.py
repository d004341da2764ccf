"""``tactiled recover``: copy the whole chunks of a cut or damaged recording into a new file."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, McapRecord, Message, Schema
from mcap.writer import CompressionType, Writer

from tactiled.errors import DataError
from tactiled.recording import contents
from tactiled.recording.chunks import Damage, Extent, chunks
from tactiled.recording.contents import Header
from tactiled.recording.directory import unfinished
from tactiled.recording.reader import Reached, open_recording, read_header
from tactiled.recording.rotation import free_mb
from tactiled.recording.writer import ACTIVE, sync_directory
from tactiled.version import __version__


@dataclass(frozen=True)
class RecoveryResult:
    """Outcome of `recover`: what was saved, and what is missing."""

    path: Path  # the finished file
    messages: int
    # first_unix_s, last_unix_s: epoch times of the saved messages; 0.0 where there are none
    first_unix_s: float
    last_unix_s: float
    lost_bytes: int  # bytes of the file after its last whole chunk
    lost_s: float  # time covered by the incomplete chunk at the end; -1.0 where unknown
    is_complete: bool  # the end of the data was there: nothing is missing at the end
    damaged: str  # description of what is missing before the end; empty where nothing is
    sync_s: float  # longest time of data that the recorder had not yet synced to disk

    def words(self) -> str:
        """Describe the outcome for the user."""
        span = f"{self.messages} messages over {self.last_unix_s - self.first_unix_s:.2f} s"
        if self.damaged:
            span += f"; in the original {self.damaged} (replay reports where)"
        if self.is_complete:
            end = "the end is complete" if self.damaged else "nothing is missing"
            return f"{self.path}: {span}; {end}"
        torn = f"an incomplete chunk of {self.lost_bytes} bytes" if self.lost_bytes else "no incomplete chunk"
        if self.lost_s >= 0:
            torn += f" ({self.lost_s:.2f} s)"
        return (
            f"{self.path}: {span}; missing: {torn}, and all later data. A recorder that was killed loses up "
            f"to {self.sync_s:g} s; of a truncated file the original length is unknown"
        )


def recover(
    path: Path, out: Path | None = None, reached: Reached | None = None, *, replace_original: bool = False
) -> RecoveryResult:
    """Copy all whole chunks into a finished file; the original is locked and only read.

    Parameters
    ----------
    path : Path
        A ``.active`` file, or a recording cut anywhere.
    out : Path, optional
        Default: the name without ``.active``; of other files, ``NAME.recovered.mcap``.
    reached : callable, optional
        Called with the completed fraction, 0 to 1.
    replace_original : bool
        Remove the original once the new file is on disk, and copy its modification time to the new file.

    Raises
    ------
    DataError
        The original is being written, nothing can be saved, or the new file cannot be written.
    """
    out = out or default_name(path)
    extent = Extent()
    with open_recording(path) as stream:
        if path.name.endswith(ACTIVE):
            _claim(stream, path, must_lock=replace_original)
        header = read_header(path)
        try:
            with _finished_file(out) as target:
                copy = _Copy(target, header)
                for found in chunks(stream, extent):
                    copy.take(found)
                    if reached is not None:
                        reached(extent.share_read)
                lost_bytes = 0 if extent.is_complete else extent.size_bytes - extent.good_bytes
                copy.finish()
            if replace_original:
                written_ns = os.fstat(stream.fileno()).st_mtime_ns
                os.utime(out, ns=(written_ns, written_ns))
                path.unlink()
        except OSError as error:
            raise DataError(f"{out}: cannot be written: {error.strerror}") from None
    torn_s = extent.torn_s
    return RecoveryResult(
        path=out,
        messages=copy.messages,
        first_unix_s=copy.first_ns / 1e9,
        last_unix_s=copy.last_ns / 1e9,
        lost_bytes=lost_bytes,
        lost_s=torn_s[1] - torn_s[0] if torn_s else -1.0,
        is_complete=extent.is_complete,
        damaged=replace(extent, is_complete=True).words(),
        sync_s=header.sync_s,
    )


def recover_directory(directory: Path, min_free_mb: float = 0.0) -> Iterator[tuple[bool, str]]:
    """Recover the unfinished recordings of earlier runs one by one, replacing the originals.

    Parameters
    ----------
    directory : Path
        Record directory; files with other names than the daemon's are left alone.
    min_free_mb : float
        A file is skipped where its copy would leave less free space than this on the disk (10^6 bytes).

    Yields
    ------
    words : str
        Description of what was recovered, or why it was not.

    Raises
    ------
    DataError
        The directory cannot be read.
    """
    try:
        paths = unfinished(directory)
    except OSError as error:
        raise DataError(f"{directory}: cannot be read: {error.strerror}") from None
    for path in paths:
        try:
            left_mb = free_mb(directory) - path.stat().st_size / 1e6
            if left_mb < min_free_mb:
                yield False, f"{path}: skipped, because its copy would leave only {left_mb:.0f} MB free"
                continue
            yield True, recover(path, replace_original=True).words()
        except FileNotFoundError:  # another process has just recovered it
            continue
        except DataError as error:
            yield False, str(error)


def default_name(path: Path) -> Path:
    """Default output path of `recover`."""
    if path.name.endswith(ACTIVE):
        return path.with_name(path.name.removesuffix(ACTIVE))
    return path.with_name(f"{path.stem}.recovered.mcap")


def _claim(stream: BinaryIO, path: Path, *, must_lock: bool) -> None:
    """Lock a file while it is open; `DataError` where a recorder that writes it holds the lock."""
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DataError(
            f"{path}: a recorder is writing it; stop the recorder, which then finishes the file"
        ) from None
    except OSError as error:  # a file system without locks
        if must_lock:
            raise DataError(
                f"{path}: cannot be locked ({error.strerror}), so it may be in use; if it is not: "
                f"tactiled recover {path}"
            ) from None


class _Copy:
    """Copy of records into a new file, chunk by chunk."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        self._header = header
        self.messages = self.first_ns = self.last_ns = 0
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._writer = Writer(stream, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"tactiled {__version__} recover")
        self._writer.add_metadata(contents.METADATA, header.to_metadata())

    def take(self, found: list[McapRecord] | Damage) -> None:
        if isinstance(found, Damage):
            self._mark(found)
            return
        for record in found:
            if isinstance(record, Schema) and record.id not in self._schemas:
                number = self._writer.register_schema(record.name, record.encoding, record.data)
                self._schemas[record.id] = number
            elif isinstance(record, Channel) and record.id not in self._channels:
                self._channels[record.id] = self._writer.register_channel(
                    record.topic, record.message_encoding, self._schemas[record.schema_id], record.metadata
                )
            elif isinstance(record, Message):
                self._message(record)
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        self._writer.add_metadata(contents.METADATA, self._header.to_metadata())
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _mark(self, damage: Damage) -> None:
        """Mark in the new file where data is missing."""
        schema = contents.INPUT
        number = self._writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        channel = self._writer.register_channel(contents.INPUT_TOPIC, "cdr", number, {"origin": "pipeline"})
        mark, stamp_ns = damage.mark(), int(damage.first_unix_s * 1e9)
        self._writer.add_message(channel, stamp_ns, schema.encode(vars(mark)), stamp_ns)

    def _message(self, record: Message) -> None:
        self._writer.add_message(
            self._channels[record.channel_id],
            record.log_time,
            record.data,
            record.publish_time,
            record.sequence,
        )
        self.first_ns = min(self.first_ns, record.log_time) if self.messages else record.log_time
        self.last_ns = max(self.last_ns, record.log_time)
        self.messages += 1


@contextlib.contextmanager
def _finished_file(out: Path) -> Iterator[BinaryIO]:
    """Open a new file that gets its name only once it is complete and on disk."""
    if out.exists():
        raise DataError(f"{out}: exists already; choose another name with --out")
    part = out.with_name(f"{out.name}.part")
    try:
        with part.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        part.rename(out)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    sync_directory(out.parent)
