"""Chunks of a recording that may be cut or damaged: every chunk with a valid checksum is read.

MCAP is a magic, then records (one byte of opcode, eight of length, the body), most of them chunks. A file
that ends early, or whose end is garbage after a power cut, can be read up to its last whole chunk. A damaged
chunk costs itself: reading resumes where its length points, or, where its head is damaged, at the next
head of a chunk. Damage in an index behind a chunk costs nothing. A finished file repeats its schemas and
channels after the data, so they survive the loss of the chunk in which they first appeared. In an unfinished
file, those of reads and inputs do, because the metadata names them.
"""

import json
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
from tactiled.recording import contents
from tactiled.recording.contents import Input

_READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read, Opcode.STATISTICS: Statistics.read,
}  # fmt: skip
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, two times; then the data
# One index for each channel of a chunk (opcode, length, channel, bytes of the entries), one entry a message
_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = _HEAD.size + 6, 16
_CHECKSUM_BYTES = 4  # all that the end of the data has
# A chunk has two times, a size and a checksum, the name of its compression, and the length of its data.
_NAME_AT, _COMPRESSION = 28, struct.pack("<I4s", 4, b"zstd")
_COMPRESSION_AT, _CHUNK_HEAD_BYTES = _HEAD.size + _NAME_AT, _NAME_AT + len(_COMPRESSION) + 8
_MOST_METADATA_BYTES = 1 << 20  # texts of array, layout and calibration
_SEARCHED_BYTES, _MOST_SEARCHED_BYTES = 1 << 12, 1 << 20  # at once, for the next head: it is near, or far
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, start of its offsets, checksum
# Records that may follow the indexes of a chunk.
_BEHIND_INDEXES = (Opcode.METADATA, Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.DATA_END)
# A tactiled chunk is closed at 256 KiB and holds at most one message more; recovered ones are no larger, and
# other tools that rewrite a recording close theirs at 4 MiB. What claims more is passed over as damage,
# before anything is decompressed or allocated.
MOST_CHUNK_BYTES = 1 << 23
_MOST_RECORD_BYTES = MOST_CHUNK_BYTES + (1 << 16)  # with the head of a chunk, and data that do not compress
# Index of half a million chunks, six days at one each second; without its index a file can be read, too.
_MOST_SUMMARY_BYTES = 1 << 26
FIRST_CHANNELS = [
    (
        Schema(k, schema.text.encode(), "ros2msg", schema.name),
        Channel(k, topic, "cdr", {"origin": "pipeline"}, k),
    )
    for k, topic, schema in ((1, contents.RAW_TOPIC, contents.RAW), (2, contents.INPUT_TOPIC, contents.INPUT))
]
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
    orphans: int = 0  # messages whose channel is unknown, because its description is lost
    lost_chunks: int = (
        0  # whole chunks whose data are damaged, also at the end of a file that was not finished
    )

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
        """Data before the end are missing."""
        return bool(self.damages or self.orphans)

    def words(self) -> str:
        """Describe what could not be read; empty where everything was read."""
        words = []
        if self.damages:
            n_bytes = sum(damage.n_bytes for damage in self.damages)
            durations_s = [damage.duration_s for damage in self.damages]
            places = "one place" if len(self.damages) == 1 else f"{len(self.damages)} places"
            missing = f"{'about' if all(durations_s) else 'at least'} {sum(durations_s):.2f} s are missing"
            if not any(durations_s):
                missing = "the time missing is unknown"
            words.append(f"{n_bytes} bytes in {places} are damaged: {missing}")
        if self.orphans:
            words.append(f"{self.orphans} messages are left out: the description of their channel is lost")
        if not self.is_complete:
            rest = self.size_bytes - self.good_bytes
            words.append(
                "the file was not finished or was truncated, or its last length is damaged; "
                f"{rest} bytes at its end cannot be read"
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
    summary = _summary(stream, size)
    _entries(summary, schemas, channels)
    n_damaged = 0  # bytes of a stretch that is not reported yet
    last_ns = newest_ns = 0  # of the chunk before, and of all: the wall clock may be set back
    stream.seek(0)
    at = len(MCAP0_MAGIC) if stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC else size
    while at + _HEAD.size <= size and not extent.is_complete:
        stream.seek(at)
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        end = at + _HEAD.size + length
        is_damaged = end > size or not _is_record(stream, at, opcode, length)
        entries: list[ChannelMessage] = []
        if not is_damaged and opcode in (Opcode.CHUNK, Opcode.METADATA):
            stream.seek(at + _HEAD.size)
            begin = stream.read(min(length, _CHUNK_HEAD_BYTES))
            # A chunk has its length twice. Where both agree, what is wrong is in its data.
            is_trusted = opcode == Opcode.CHUNK and _lengths_agree(begin, length)
            is_readable = is_trusted or (opcode == Opcode.METADATA and length <= _MOST_METADATA_BYTES)
            records = _records(opcode, begin + stream.read(length - len(begin))) if is_readable else []
            is_damaged = not (records or is_trusted)
            for record in records:
                if isinstance(record, Metadata):
                    if not channels and record.metadata.get("channels") == contents.FIRST_CHANNELS:
                        _entries([one for pair in FIRST_CHANNELS for one in pair], schemas, channels)
                    yield record
            entries = _entries(records, schemas, channels)
            extent.orphans += sum(isinstance(record, Message) for record in records) - len(entries)
            if not records and not is_damaged:
                n_damaged += end - at
                extent.lost_chunks += 1
        if is_damaged:
            next_at = _next_chunk(stream, at + 1, size)
            if next_at < 0:
                break
            n_damaged, at = n_damaged + next_at - at, next_at
            continue
        extent.is_complete = opcode == Opcode.DATA_END
        at = end + _indexes_bytes(stream, end, size, records) if entries else end
        if entries:
            instants_ns = [entry.message.log_time for entry in entries]
            if n_damaged:
                yield _damage(extent, n_damaged, last_ns or min(instants_ns), min(instants_ns))
                n_damaged = 0
            last_ns = max(instants_ns)
            newest_ns = max(newest_ns, last_ns)
            yield entries
        if not n_damaged:
            extent.good_bytes = at
    if extent.is_complete:
        extent.good_bytes = at
        if n_damaged:
            ends_ns = [record.message_end_time for record in summary if isinstance(record, Statistics)]
            end_ns = max([newest_ns, *ends_ns])
            yield _damage(extent, n_damaged, newest_ns or end_ns, end_ns)


def topics_of_summary(stream: BinaryIO) -> set[str]:
    """Return the topics that a finished file names in its summary; none of any other file."""
    return {one.topic for one in _summary(stream, stream.seek(0, 2)) if isinstance(one, Channel)}


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


def _is_record(stream: BinaryIO, at: int, opcode: int, length: int) -> bool:
    """Return False where a head is damaged; chunks and metadata are judged by their content."""
    if opcode == Opcode.HEADER:
        return at == len(MCAP0_MAGIC)
    if opcode == Opcode.DATA_END:
        return length == _CHECKSUM_BYTES
    if opcode == Opcode.MESSAGE_INDEX:
        entries = stream.read(_INDEX_HEAD_BYTES - _HEAD.size)[2:]
        return int.from_bytes(entries, "little") == length - (_INDEX_HEAD_BYTES - _HEAD.size)
    return opcode in (Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT)


def _next_chunk(stream: BinaryIO, at: int, size: int) -> int:
    """Return where the next head of a chunk is, by the compression that it names; -1 for none."""
    n_bytes = _SEARCHED_BYTES
    while True:
        stream.seek(at)
        part = stream.read(n_bytes)
        found = part.find(_COMPRESSION, _COMPRESSION_AT)
        while found >= 0:
            head = found - _COMPRESSION_AT
            opcode, length = _HEAD.unpack_from(part, head)
            is_whole = at + head + _HEAD.size + length <= size
            if opcode == Opcode.CHUNK and is_whole and _lengths_agree(part[head + _HEAD.size :], length):
                return at + head
            found = part.find(_COMPRESSION, found + 1)
        if len(part) < n_bytes:
            return -1
        at += len(part) - _HEAD.size - _CHUNK_HEAD_BYTES
        n_bytes = min(4 * n_bytes, _MOST_SEARCHED_BYTES)


def _lengths_agree(chunk: bytes, length: int) -> bool:
    """Return True where the length of a record is that of the chunk in it, by its first bytes."""
    if len(chunk) < _CHUNK_HEAD_BYTES or length > _MOST_RECORD_BYTES:
        return False
    n_name = int.from_bytes(chunk[_NAME_AT : _NAME_AT + 4], "little")
    data_at = _NAME_AT + 4 + n_name
    n_data = int.from_bytes(chunk[data_at : data_at + 8], "little")
    return data_at + 8 + n_data == length


def _indexes_bytes(stream: BinaryIO, at: int, size: int, records: Sequence[McapRecord]) -> int:
    """Length of the indexes behind a chunk, from its messages; 0 where none are there.

    Most records of a file are such indexes. Reading needs none, and a damaged length in one costs nothing.
    """
    channels = [record.channel_id for record in records if isinstance(record, Message)]
    n_bytes = len(set(channels)) * _INDEX_HEAD_BYTES + len(channels) * _INDEX_ENTRY_BYTES
    stream.seek(at)
    here = stream.read(1)
    stream.seek(at + n_bytes)
    behind = stream.read(_HEAD.size)
    if len(behind) < _HEAD.size or here[0] in _BEHIND_INDEXES:  # cut here, or written without indexes
        return 0
    opcode, length = _HEAD.unpack(behind)
    return n_bytes if opcode in _BEHIND_INDEXES and at + n_bytes + _HEAD.size + length <= size else 0


def _damage(extent: Extent, n_bytes: int, first_ns: int, last_ns: int) -> Damage:
    damage = Damage(n_bytes, first_ns / 1e9, last_ns / 1e9)
    extent.damages.append(damage)
    return damage


def _records(opcode: int, body: bytes) -> list[McapRecord]:
    """Read a chunk or metadata; nothing where it is damaged."""
    try:
        stream = BytesIO(body)
        record = (Metadata if opcode == Opcode.METADATA else Chunk).read(ReadDataStream(stream))
        if stream.tell() != len(body):
            raise McapError("a record that is shorter than its length")
        if isinstance(record, Metadata):
            return [record]
        chunk = record
        _check_size(chunk)
        data, size = get_chunk_data_stream(chunk, validate_crc=True)
        return _parsed(data.read(size))
    except FAULTS:
        return []


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


def _summary(stream: BinaryIO, size: int) -> list[McapRecord]:
    """Read the summary of a finished file; nothing where its checksum (in the footer) is wrong."""
    footer_at = size - len(MCAP0_MAGIC) - _FOOTER.size
    if footer_at < 0:
        return []
    stream.seek(footer_at)
    footer = stream.read(_FOOTER.size)
    opcode, _, start, _, checksum = _FOOTER.unpack(footer)
    if opcode != Opcode.FOOTER or not 0 < start <= footer_at or footer_at - start > _MOST_SUMMARY_BYTES:
        return []
    stream.seek(start)
    text = stream.read(footer_at - start)
    if zlib.crc32(footer[:-4], zlib.crc32(text)) != checksum:
        return []
    try:
        return _parsed(text)
    except FAULTS:
        return []
