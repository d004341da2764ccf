"""Recordings read back: whole, cut anywhere, or damaged; what is whole and proves its checksum counts.

MCAP is a magic, then records (one byte of opcode, eight of length, the body), most of them chunks: so a file
that ends early, or whose end is garbage after a power cut, is good up to its last whole chunk.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from tactiled.errors import DataError
from tactiled.events.types import EVENT_TYPES
from tactiled.recording import contents
from tactiled.recording.contents import Header, Input, Item, Read

_RECORD_HEAD = struct.Struct("<BQ")
_DAMAGE = (McapError, ValueError, EOFError, struct.error, zstandard.ZstdError, MemoryError)


@dataclass
class Extent:
    """How far a file is good; filled while it is read.

    Attributes
    ----------
    good_bytes : int
        Up to the end of the last whole record that carries data.
    size_bytes : int
    is_complete : bool
        The end of the data was found: nothing is missing.
    torn_s : tuple of float, optional
        First and last instant (epoch) in the chunk that is not whole, if its head is there.
    """

    good_bytes: int = 0
    size_bytes: int = 0
    is_complete: bool = False
    torn_s: tuple[float, float] | None = None


def chunks(stream: BinaryIO, extent: Extent) -> Iterator[list[McapRecord]]:
    """Whole chunks, each as its records, and metadata, each alone; stops at the first damage."""
    extent.size_bytes = stream.seek(0, 2)
    stream.seek(0)
    at = len(MCAP0_MAGIC)
    if stream.read(at) != MCAP0_MAGIC:
        return
    while len(head := stream.read(_RECORD_HEAD.size)) == _RECORD_HEAD.size:
        opcode, length = _RECORD_HEAD.unpack(head)
        at += _RECORD_HEAD.size + length
        if opcode == Opcode.DATA_END and at <= extent.size_bytes:
            extent.is_complete, extent.good_bytes = True, at
            return
        if not opcode:
            return
        is_whole = at <= extent.size_bytes
        body = stream.read(min(length, extent.size_bytes))
        records = _records(opcode, body) if is_whole else None
        if records is None:
            extent.torn_s = _span_s(body) if opcode == Opcode.CHUNK else None
            return
        extent.good_bytes = at
        yield records


def _records(opcode: int, body: bytes) -> list[McapRecord] | None:
    """What is of use to us in a whole record; None where it is damaged."""
    try:
        if opcode == Opcode.CHUNK:
            return breakup_chunk(Chunk.read(ReadDataStream(BytesIO(body))), validate_crc=True)
        if opcode == Opcode.METADATA:
            return [Metadata.read(ReadDataStream(BytesIO(body)))]
    except _DAMAGE:
        return None
    return []


def _span_s(body: bytes) -> tuple[float, float] | None:
    """First and last log time, with which the body of a chunk begins."""
    if len(body) < 16:
        return None
    first_ns, last_ns = struct.unpack_from("<QQ", body)
    return (first_ns / 1e9, last_ns / 1e9) if 0 < first_ns <= last_ns else None


@dataclass
class _Channels:
    """Schemas and channels met so far, by number."""

    schemas: dict[int, str] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def item(self, record: McapRecord, path: Path) -> Item | None:
        """Item of a message; None for what is none of ours."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record.data.decode(errors="replace")
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Message) and (channel := self.channels.get(record.channel_id)) is not None:
            return self._decode(channel, record.data, path)
        return None

    def _decode(self, channel: Channel, data: bytes, path: Path) -> Item | None:
        topic = channel.topic.removeprefix("tactile/")
        if channel.topic == contents.RAW_TOPIC:
            schema = contents.RAW
        elif channel.topic == contents.INPUT_TOPIC:
            schema = contents.INPUT
        elif topic in EVENT_TYPES:
            schema = contents.SCHEMAS[topic]
        else:
            return None
        if channel.message_encoding != "cdr" or self.schemas.get(channel.schema_id) != schema.text:
            if schema not in (contents.RAW, contents.INPUT):
                return None  # an event as another version knew it: raw bytes are enough to make it anew
            raise DataError(
                f"{path}: {channel.topic} has another form here; use the tactiled it was made with"
            )
        try:
            if schema is contents.RAW:
                return Read(**schema.decode(data))
            if schema is contents.INPUT:
                return Input(**schema.decode(data))
            return contents.decode_said(topic, data, channel.metadata.get("origin") or "daemon")  # type: ignore[arg-type]
        except DataError as error:
            raise DataError(f"{path}: {error}") from None


def read_header(path: Path) -> Header:
    """Description of a recording.

    Raises
    ------
    DataError
        It cannot be read, or is no recording of ours.
    """
    with open_recording(path) as stream:
        for records in chunks(stream, Extent()):
            for record in records:
                if isinstance(record, Metadata) and record.name == contents.METADATA:
                    try:
                        return Header.from_metadata(record.metadata)
                    except (KeyError, ValueError) as error:
                        raise DataError(
                            f"{path}: a recording of another tactiled, which this one cannot read "
                            f"({type(error).__name__}: {str(error).splitlines()[0]})"
                        ) from None
    raise DataError(f"{path}: not a recording of tactiled, or cut before its description")


def read_items(path: Path) -> Iterator[Item]:
    """Everything in a recording, in the order of the file; an unfinished file ends at its last whole chunk.

    Raises
    ------
    DataError
        It cannot be read.
    """
    with open_recording(path) as stream:
        known = _Channels()
        for records in chunks(stream, Extent()):
            for record in records:
                if (item := known.item(record, path)) is not None:
                    yield item


def open_recording(path: Path) -> BinaryIO:
    """The file, to be read only; `DataError` when it cannot be."""
    try:
        return path.open("rb")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
