"""Writer of one recording file, named `FILE.active` until it is finished."""

import contextlib
import errno
import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from mcap.writer import CompressionType, Writer

from tactiled.errors import DataError
from tactiled.events.types import Event
from tactiled.recording import contents
from tactiled.recording.cdr import Schema
from tactiled.recording.contents import Header, Input, Origin, Read, RecordedEvent
from tactiled.version import __version__

ACTIVE = ".active"
DAMAGED = ".damaged"  # behind it: the original of a recovered file, which could not be read whole
_CHUNK_BYTES = (
    256 * 1024
)  # readers decompress one chunk at a time; at usual rates the sync closes chunks sooner


class RecordingWriter:
    """Writer of one recording file; a context manager that finishes it.

    `DataError` if the file cannot be written, or a file of that name exists or is being written. `OSError`
    from every method if the disk is full or fails; data synced before can be recovered.
    """

    def __init__(self, path: Path, header: Header) -> None:
        self.path = path
        self.active = path.with_name(path.name + ACTIVE)
        self._header = header
        self._stream = _create(self.path, self.active)
        self._size_bytes = 0
        self._ids: dict[tuple[str, Origin], int] = {}
        self._sequence: dict[int, int] = {}
        self._writer = Writer(self._stream, _CHUNK_BYTES, CompressionType.ZSTD)
        try:
            self._begin()
        except OSError as error:
            self.abandon()
            with contextlib.suppress(OSError):
                self.active.unlink()
            raise _refused(self.active, error) from None

    @property
    def size_bytes(self) -> int:
        """Size of the file so far, without the open chunk."""
        return self._size_bytes if self._stream.closed else self._stream.tell()

    def read(self, read: Read) -> None:
        """Append one read from the port."""
        self._add(self._raw, read.arrival_s + read.unix_offset_s, contents.RAW.encode(vars(read)))

    def input(self, entry: Input) -> None:
        """Append another input of the pipeline."""
        self._add(self._input, entry.time_s + entry.unix_offset_s, contents.INPUT.encode(vars(entry)))

    def event(self, event: Event, board: str, unix_offset_s: float, origin: Origin) -> None:
        """Append an event."""
        key = (event.topic, origin)
        if key not in self._ids:
            topic = f"{contents.TOPICS}{event.topic}"
            self._ids[key] = self._channel(topic, contents.SCHEMAS[event.topic], origin)
        data = contents.encode_event(RecordedEvent(event, board, unix_offset_s, origin))
        self._add(self._ids[key], event.time_s + unix_offset_s, data)

    def sync(self) -> None:
        """Close the open chunk and sync the file to disk."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Finish and sync the file, and rename it to its final name."""
        try:
            # A second copy: without its description, a file could not be read at all.
            self._writer.add_metadata(contents.METADATA, self._header.to_metadata())
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            os.fsync(self._stream.fileno())
            if self.path.exists():  # it came after the start
                raise FileExistsError(errno.EEXIST, f"{self.path.name} exists already")
            self.active.rename(self.path)
            sync_directory(self.path.parent)
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is, under its `.active` name, after a write error."""
        with contextlib.suppress(OSError):
            if not self._stream.closed:
                self._size_bytes = os.fstat(self._stream.fileno()).st_size
        with contextlib.suppress(OSError):  # closing writes what is buffered, which may fail once more
            self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _begin(self) -> None:
        """Write and sync the description before any data; the first chunk then describes the channels."""
        self._writer.start(profile="ros2", library=f"tactiled {__version__}")
        self._writer.add_metadata(contents.METADATA, self._header.to_metadata())
        self._raw = self._channel(contents.RAW_TOPIC, contents.RAW, "pipeline")
        self._input = self._channel(contents.INPUT_TOPIC, contents.INPUT, "pipeline")
        self.sync()
        sync_directory(self.path.parent)

    def _channel(self, topic: str, schema: Schema, origin: Origin) -> int:
        schema_id = self._writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        return self._writer.register_channel(topic, "cdr", schema_id, {"origin": origin})

    def _add(self, channel: int, unix_s: float, data: bytes) -> None:
        stamp_ns = max(int(unix_s * 1e9), 0)
        sequence = self._sequence.get(channel, 0)
        self._sequence[channel] = sequence + 1
        self._writer.add_message(channel, stamp_ns, data, stamp_ns, sequence)


def _create(path: Path, active: Path) -> BinaryIO:
    """Create and lock the new ``.active`` file."""
    try:
        if path.exists():
            raise DataError(f"{path}: exists already; choose another name or move it away")
        stream = active.open("xb")
    except FileExistsError:
        if is_being_written(active):
            raise DataError(f"{active}: another recorder is writing it; choose another name") from None
        raise DataError(
            f"{active}: left behind by a recorder that died; first run: tactiled recover {active}"
        ) from None
    except OSError as error:
        raise _refused(active, error) from None
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:  # another process tests the lock at this moment, or the file system has no locks
        stream.close()
        active.unlink()
        raise _refused(active, error) from None
    return stream


def _refused(active: Path, error: OSError) -> DataError:
    return DataError(
        f"{active}: cannot be written ({error.strerror}); choose a place that has room and that "
        "this user may write to"
    )


def is_taken(path: Path) -> bool:
    """Return True where a recording of this name exists, finished or not."""
    return path.exists() or path.with_name(path.name + ACTIVE).exists()


def is_being_written(active: Path) -> bool:
    """Return True while a running recorder holds the lock of this file."""
    try:
        with active.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # unreadable for this user: reported when it is opened
        return False
    return False


def sync_directory(directory: Path) -> None:
    """Sync a directory so that new names survive a power cut, where the file system supports it."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with contextlib.suppress(OSError):  # some network and FUSE file systems refuse
            os.fsync(descriptor)
    finally:
        os.close(descriptor)
