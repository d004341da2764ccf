"""``tactiled recover``: copy the whole chunks of a cut or damaged recording into a new file."""

import contextlib
import fcntl
import filecmp
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from tactiled.errors import DataError
from tactiled.recording import contents
from tactiled.recording.chunks import FIRST_CHANNELS, ChannelMessage, Damage, Extent
from tactiled.recording.contents import Header
from tactiled.recording.directory import unfinished
from tactiled.recording.reader import Reached, open_recording, read_header, readable_chunks
from tactiled.recording.session import free_mb
from tactiled.recording.writer import ACTIVE, DAMAGED, sync_directory
from tactiled.version import __version__


@dataclass(frozen=True)
class RecoveryResult:
    """Outcome of `recover`: what was saved, and what is missing."""

    path: Path  # the finished file
    messages: int
    duration_s: float  # from the first to the last saved message
    extent: Extent  # what could be read of the original
    sync_s: float  # longest time of data that the recorder had not yet synced to disk
    kept: Path | None = None  # the original under its new name, where it was to be replaced but is damaged

    @property
    def lost_bytes(self) -> int:
        """Bytes of the original after its last whole chunk."""
        return 0 if self.extent.is_complete else self.extent.size_bytes - self.extent.good_bytes

    def words(self) -> str:
        """Describe the outcome for the user."""
        span = f"{self.messages} messages over {self.duration_s:.2f} s"
        damaged = replace(self.extent, is_complete=True).words()
        if damaged:
            span += f"; in the original {damaged} (replay reports where)"
        if self.kept is not None:
            span += f"; the original is kept as {self.kept.name}"
        if self.extent.is_complete:
            return f"{self.path}: {span}; {'the end is complete' if damaged else 'nothing is missing'}"
        torn = f"an incomplete chunk of {self.lost_bytes} bytes" if self.lost_bytes else "no incomplete chunk"
        return (
            f"{self.path}: {span}; missing: {torn}, and all later data. A recorder that was killed loses up "
            f"to {self.sync_s:g} s; of a truncated file the original length is unknown"
        )


def recover(
    path: Path, out: Path | None = None, reached: Reached | None = None, *, replace_original: bool = False
) -> RecoveryResult:
    """Copy all whole chunks into a finished file; the original is locked and only read.

    `DataError` if the original is being written, nothing can be saved, or the new file cannot be written.

    Parameters
    ----------
    out : Path, optional
        Default: the name without ``.active``; of other files, ``NAME.recovered.mcap``.
    replace_original : bool
        Remove the original once the new file is on disk, and copy its modification time to the new file.
        An original with damage is kept, as ``NAME.active.damaged``, unless only its last chunk is not whole.
        A new file that is there already, with the same bytes, is of a recovery that was killed before that.
    """
    out = out or default_name(path)
    extent, kept = Extent(), None
    with open_recording(path) as stream:
        if path.name.endswith(ACTIVE):
            _claim(stream, path, must_lock=replace_original)
        header = read_header(path)
        try:
            with _finished_file(out, may_repeat=replace_original) as target:
                copy = _Copy(target, header)
                for found in readable_chunks(path, stream, extent):
                    copy.take(found)
                    if reached is not None:
                        reached(extent.share_read)
                copy.finish()
            if replace_original:
                written_ns = os.fstat(stream.fileno()).st_mtime_ns
                os.utime(out, ns=(written_ns, written_ns))
        except OSError as error:
            raise DataError(f"{out}: cannot be written: {error.strerror}") from None
        if replace_original:
            try:
                if extent.is_damaged or extent.lost_chunks:
                    kept = path.rename(path.with_name(path.name + DAMAGED))
                else:
                    path.unlink()
            except OSError as error:
                raise DataError(f"{path}: cannot be removed: {error.strerror}; recovered as {out}") from None
    duration_s = (copy.last_ns - copy.first_ns) / 1e9
    return RecoveryResult(out, copy.messages, duration_s, extent, header.sync_s, kept)


def recover_directory(directory: Path, min_free_mb: float = 0.0) -> Iterator[tuple[bool, str]]:
    """Recover the unfinished recordings of earlier runs one by one, replacing all originals without damage.

    Files with other names than the daemon's are left alone. `DataError` if the directory cannot be read.

    Parameters
    ----------
    min_free_mb : float
        A file is skipped where its copy would leave less free space than this on the disk (10^6 bytes).

    Yields
    ------
    is_recovered, words : bool, str
        Of each file: what was recovered, or why it was not.
    """
    try:
        paths = unfinished(directory)
    except OSError as error:
        raise DataError(f"{directory}: cannot be read: {error.strerror}") from None
    for path in paths:
        try:
            # What a recovery left that was killed takes the room of the next.
            with contextlib.suppress(OSError, DataError), open_recording(path) as stream:
                _claim(stream, path, must_lock=True)  # another recovery may be writing it
                _part_of(default_name(path)).unlink()
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
    """Copy of messages into a new file, chunk by chunk."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        self._header = header
        self.messages = self.first_ns = self.last_ns = 0
        self._channels: dict[str, int] = {}  # in the new file, by topic and origin
        self._writer = Writer(stream, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"tactiled {__version__} recover")
        self._writer.add_metadata(contents.METADATA, header.to_metadata())
        for schema, channel in FIRST_CHANNELS:
            self._channel_id(schema, channel)

    def take(self, found: list[ChannelMessage] | Metadata | Damage) -> None:
        if isinstance(found, Damage):
            self._mark(found)
        elif isinstance(found, list):
            for entry in found:
                self._add(entry)
            self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        self._writer.add_metadata(contents.METADATA, self._header.to_metadata())
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _mark(self, damage: Damage) -> None:
        """Mark in the new file where data is missing."""
        schema, channel = FIRST_CHANNELS[1]
        stamp_ns = int(damage.first_unix_s * 1e9)
        data = contents.INPUT.encode(vars(damage.mark()))
        self._write(schema, channel, Message(0, stamp_ns, data, stamp_ns, 0))

    def _add(self, entry: ChannelMessage) -> None:
        self._write(*entry)
        log_ns = entry.message.log_time
        self.first_ns = min(self.first_ns, log_ns) if self.messages else log_ns
        self.last_ns = max(self.last_ns, log_ns)
        self.messages += 1

    def _write(self, schema: Schema, channel: Channel, message: Message) -> None:
        self._writer.add_message(
            self._channel_id(schema, channel), message.log_time, message.data, message.publish_time,
            message.sequence,
        )  # fmt: skip

    def _channel_id(self, schema: Schema, channel: Channel) -> int:
        key = f"{channel.topic} {channel.metadata.get('origin')}"
        if key not in self._channels:
            schema_id = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._channels[key] = self._writer.register_channel(
                channel.topic, channel.message_encoding, schema_id, channel.metadata
            )
        return self._channels[key]


def _part_of(out: Path) -> Path:
    return out.with_name(f"{out.name}.part")


def _check_name(out: Path, new: Path | None = None) -> None:
    """Raise `DataError` where there is a file of this name, other than one with the bytes of the new one."""
    if out.exists() and (new is None or not filecmp.cmp(new, out, shallow=False)):
        raise DataError(f"{out}: exists already; choose another name with --out")


@contextlib.contextmanager
def _finished_file(out: Path, *, may_repeat: bool) -> Iterator[BinaryIO]:
    """Open a new file that gets its name only once it is complete and on disk.

    With `may_repeat`, it may replace a file that has the same bytes.
    """
    if not may_repeat:
        _check_name(out)
    part = _part_of(out)
    try:
        with part.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        _check_name(out, part)
        part.rename(out)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    sync_directory(out.parent)
