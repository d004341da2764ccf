"""Chunks of a recording that may be cut or damaged: every chunk with a valid checksum is read.

MCAP is a magic, then records (one byte of opcode, eight of length, the body), most of them chunks. A file
that ends early, or whose end is garbage after a power cut, can be read up to its last whole chunk. Damage in
the middle costs only the chunks that it hits: reading resumes where the length field of the damaged chunk
points or, if that is wrong too, at the next bytes that form a valid chunk. A finished file repeats its
schemas and channels after the data, so they survive the loss of the chunk in which they first appeared.
"""

import json
import mmap
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from tactiled.outside import shown
from tactiled.recording.contents import Input

_READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read, Opcode.STATISTICS: Statistics.read,
}  # fmt: skip
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, two times; then the data
_INDEX, _INDEX_ENTRY_BYTES = struct.Struct("<HI"), 16  # channel, bytes of the entries
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, start of its offsets, checksum
_DATA_END_BYTES = 4
# Bytes that every tactiled chunk holds after two times, a size and a checksum: they locate a chunk whose
# predecessor has a damaged length.
_ANCHOR = struct.pack("<I", 4) + b"zstd"
_ANCHOR_AT = _HEAD.size + 8 + 8 + 8 + 4
# A tactiled chunk is closed at 256 KiB and holds at most one message more; recovered ones are no larger, and
# other tools that rewrite a recording close theirs at 4 MiB. What claims more is passed over as damage,
# before anything is decompressed or allocated.
MOST_CHUNK_BYTES = 1 << 23
_MOST_RECORD_BYTES = MOST_CHUNK_BYTES + (1 << 16)  # with the head of a chunk, and data that do not compress
# Index of half a million chunks, six days at one each second; without its index a file can be read, too.
_MOST_SUMMARY_BYTES = 1 << 26
# What the libraries raise on damaged records; RuntimeError is that of lz4.
FAULTS = (
    McapError, ValueError, EOFError, struct.error, zstandard.ZstdError, MemoryError, OverflowError,
    RuntimeError,
)  # fmt: skip


@dataclass(frozen=True)
class Damage:
    """Unreadable stretch in the middle of a file."""

    n_bytes: int
    # first_unix_s, last_unix_s: epoch times of the messages before and after it; equal where the duration is
    # unknown
    first_unix_s: float
    last_unix_s: float

    @property
    def duration_s(self) -> float:
        """Time between the messages before and after it."""
        return max(self.last_unix_s - self.first_unix_s, 0.0)

    def mark(self) -> Input:
        """Return the `Input` that marks this stretch for the pipeline."""
        # Its time is epoch time, as the monotonic time is lost.
        values = {"bytes": self.n_bytes, "duration_s": self.duration_s}
        return Input(self.first_unix_s, 0.0, "damaged", json.dumps(values))


@dataclass
class Extent:
    """Readable extent of a file, updated while the file is read."""

    good_bytes: int = 0  # offset of the end of the last whole record that carries data
    size_bytes: int = 0
    is_complete: bool = False  # the end-of-data record was found: nothing is cut off
    damages: list[Damage] = field(default_factory=list)  # unreadable stretches before the end
    orphans: int = 0  # number of messages whose channel description is lost

    @property
    def share_read(self) -> float:
        """Fraction of the file that was read, 0 to 1."""
        return self.good_bytes / self.size_bytes if self.size_bytes else 0.0

    @property
    def is_whole(self) -> bool:
        """The file is complete and undamaged."""
        return self.is_complete and not self.is_damaged

    @property
    def is_damaged(self) -> bool:
        """Data before the end is missing."""
        return bool(self.damages or self.orphans)

    def words(self) -> str:
        """Describe what could not be read; empty where everything was read."""
        words = []
        if self.damages:
            n_bytes = sum(damage.n_bytes for damage in self.damages)
            duration_s = sum(damage.duration_s for damage in self.damages)
            places = "one place" if len(self.damages) == 1 else f"{len(self.damages)} places"
            words.append(f"{n_bytes} bytes in {places} are damaged: about {duration_s:.2f} s are missing")
        if self.orphans:
            words.append(f"{self.orphans} messages have no channel description")
        if not self.is_complete:
            rest = self.size_bytes - self.good_bytes
            words.append(
                f"the file was not finished or was truncated; {rest} bytes at its end cannot be read"
            )
        return "; ".join(words)


class ChannelMessage(NamedTuple):
    """Message with its schema and channel."""

    schema: Schema
    channel: Channel
    message: Message


def chunks(stream: BinaryIO, extent: Extent) -> Iterator[list[ChannelMessage] | Metadata | Damage]:
    """Yield the messages of each whole chunk, the metadata, and the damage between them."""
    size = extent.size_bytes = stream.seek(0, 2)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    n_damaged = at = 0  # n_damaged: bytes of a stretch that is not reported yet
    last_ns = newest_ns = 0  # ends of the chunk before, and of the latest: the wall clock may be set back
    while not extent.is_complete:
        record = _record_at(stream, at, size)
        if record is None:
            resumed = _resume(stream, at, size, last_ns)
            if resumed is None:
                break
            n_damaged += resumed - at
            at = resumed
            if (summary := _summary(stream, size)) is not None:
                _entries(summary.records, schemas, channels)
                extent.is_complete = at == summary.start
            continue
        at, records = record
        extent.is_complete = records is None
        entries = _entries(records or [], schemas, channels)
        extent.orphans += sum(isinstance(r, Message) for r in records or ()) - len(entries)
        instants_ns = [entry.message.log_time for entry in entries]
        if n_damaged and instants_ns:
            yield _damage(extent, n_damaged, last_ns or min(instants_ns), min(instants_ns))
            n_damaged = 0
        if not n_damaged:
            extent.good_bytes = at
        last_ns = max(instants_ns, default=last_ns)
        newest_ns = max(newest_ns, last_ns)
        yield from (record for record in records or () if isinstance(record, Metadata))
        if entries:
            yield entries
    if extent.is_complete:
        extent.good_bytes = at
        if n_damaged:
            summary = _summary(stream, size)
            end_ns = max(newest_ns, summary.end_ns if summary else 0)
            yield _damage(extent, n_damaged, newest_ns or end_ns, end_ns)


def _entries(
    records: Sequence[McapRecord], schemas: dict[int, Schema], channels: dict[int, Channel]
) -> list[ChannelMessage]:
    """Take schemas and channels, and return the messages whose channel is known."""
    entries: list[ChannelMessage] = []
    for record in records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.schema_id in schemas:
            channels[record.id] = record
        elif isinstance(record, Message) and (channel := channels.get(record.channel_id)) is not None:
            entries.append(ChannelMessage(schemas[channel.schema_id], channel, record))
    return entries


def _damage(extent: Extent, n_bytes: int, first_ns: int, last_ns: int) -> Damage:
    damage = Damage(n_bytes, first_ns / 1e9, last_ns / 1e9)
    extent.damages.append(damage)
    return damage


def _record_at(stream: BinaryIO, at: int, size: int) -> tuple[int, list[McapRecord] | None] | None:
    """Read the record at an offset: its end and its content; None where no whole record begins there.

    The content is None, not a list, at the end of the data. The magic counts as a record.
    """
    stream.seek(at)
    if at == 0:
        return (len(MCAP0_MAGIC), []) if stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC else None
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack(head)
    end = at + _HEAD.size + length
    if end > size or length > _MOST_RECORD_BYTES:
        return None
    if opcode == Opcode.DATA_END:
        return (end, None) if length == _DATA_END_BYTES else None
    body = ReadDataStream(BytesIO(stream.read(length)))
    try:
        if opcode == Opcode.CHUNK:
            records = _records_of(Chunk.read(body))
        elif opcode == Opcode.METADATA:
            records = [Metadata.read(body)]
        elif opcode == Opcode.MESSAGE_INDEX:
            index = body.read(length)
            n_bytes = _INDEX.unpack_from(index)[1]
            if n_bytes % _INDEX_ENTRY_BYTES or _INDEX.size + n_bytes != length:
                return None
            records = []
        elif opcode == Opcode.HEADER and at == len(MCAP0_MAGIC):
            return end, []
        else:  # tactiled writes no others: the opcode of a chunk is damaged
            return None
    except FAULTS:
        return None
    return (end, records) if body.count == length else None  # otherwise the length is damaged


def _records_of(chunk: Chunk) -> list[McapRecord]:
    """Read the records of a chunk."""
    _check_size(chunk)
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return _parsed(stream.read(size))


def _parsed(data: bytes) -> list[McapRecord]:
    """Parse records one behind the other; those of mcap's own reader, in a third of its time."""
    records: list[McapRecord] = []
    at = 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if at + length > len(data):
            raise McapError(f"a record of {length} bytes exceeds its chunk")
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, at)
            body = data[at + _MESSAGE.size : at + length]
            records.append(Message(channel, log_ns, body, publish_ns, sequence))
        elif opcode in _READERS:
            records.append(_READERS[opcode](ReadDataStream(BytesIO(data[at : at + length]))))
        at += length
    return records


def _check_size(chunk: Chunk) -> None:
    """Refuse a chunk that claims to be larger than ours are, or that holds more than it claims."""
    n_bytes = chunk.uncompressed_size
    if chunk.compression == "zstd":
        held = zstandard.get_frame_parameters(chunk.data).content_size
        if held not in (zstandard.CONTENTSIZE_UNKNOWN, n_bytes):  # the size that zstandard would allocate
            raise McapError(f"a chunk of {n_bytes} bytes holds {held}")
    elif chunk.compression:  # lz4 says no size; tactiled writes none
        raise McapError(f"a chunk with the compression {shown(chunk.compression)}")
    if n_bytes > MOST_CHUNK_BYTES:
        raise McapError(f"a chunk of {n_bytes} bytes, more than {MOST_CHUNK_BYTES}")


def _resume(stream: BinaryIO, at: int, size: int, last_ns: int) -> int | None:
    """Offset at which to resume after a damaged record; None where nothing whole follows.

    After a power cut, old disk blocks behind the end may hold chunks of other files: a chunk that ends before
    `last_ns` is therefore skipped. The chunk to which the length of the damaged record points is of this
    file, whatever its times: the wall clock may have been set back.
    """
    end = len(MCAP0_MAGIC)
    if at:
        stream.seek(at)
        head = stream.read(_HEAD.size)
        end = at + _HEAD.size + int(_HEAD.unpack(head)[1]) if len(head) == _HEAD.size else size
    # A damaged length may lead beyond chunks that are whole.
    is_whole = end < size and _record_at(stream, end, size) is not None
    chunk_at = _next_chunk(stream, at, end if is_whole else size, last_ns)
    if chunk_at is not None:
        return chunk_at
    if is_whole:
        return end
    summary = _summary(stream, size)
    return summary.start if summary is not None and summary.start > at else None


def _next_chunk(stream: BinaryIO, at: int, before: int, last_ns: int) -> int | None:
    """Offset of the next whole chunk that begins after `at` and before an offset."""
    size = stream.seek(0, 2)
    if not size:
        return None
    with mmap.mmap(stream.fileno(), size, access=mmap.ACCESS_READ) as view:
        last = before + _ANCHOR_AT + len(_ANCHOR) - 1
        found = view.find(_ANCHOR, at + 1 + _ANCHOR_AT, last)
        while found >= 0:
            start = found - _ANCHOR_AT
            (end_ns,) = struct.unpack_from("<Q", view, start + _HEAD.size + 8)
            is_later = view[start] == Opcode.CHUNK and end_ns >= last_ns
            if is_later and _record_at(stream, start, size) is not None:
                return start
            found = view.find(_ANCHOR, found + 1, last)
    return None


@dataclass(frozen=True)
class _Summary:
    """Summary of a finished file: its offset, schemas, channels and time of the last message."""

    start: int
    records: list[McapRecord]
    end_ns: int


def _summary(stream: BinaryIO, size: int) -> _Summary | None:
    """Read the summary; None where it is absent or its checksum is wrong (MCAP specification, Footer)."""
    footer_at = size - len(MCAP0_MAGIC) - _FOOTER.size
    if footer_at < 0:
        return None
    stream.seek(footer_at)
    footer = stream.read(_FOOTER.size)
    opcode, _, start, _, checksum = _FOOTER.unpack(footer)
    if opcode != Opcode.FOOTER or not 0 < start <= footer_at or footer_at - start > _MOST_SUMMARY_BYTES:
        return None
    stream.seek(start)
    text = stream.read(footer_at - start)
    if zlib.crc32(footer[:-4], zlib.crc32(text)) != checksum:
        return None
    try:
        records = _parsed(text)
    except FAULTS:
        return None
    ends_ns = [record.message_end_time for record in records if isinstance(record, Statistics)]
    return _Summary(start, records, max(ends_ns, default=0))
