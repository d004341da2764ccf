"""Reader of recordings, item by item; logs what cannot be read.

`chunks` parses the bytes: it finds whole chunks, damage, and where to resume after it.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, TypeVar

from mcap.records import Channel, McapRecord, Message, Metadata
from mcap.records import Schema as SchemaRecord

from tactiled.errors import DataError
from tactiled.events.types import EVENT_TYPES
from tactiled.recording import contents
from tactiled.recording.cdr import Schema
from tactiled.recording.chunks import Damage, Extent, chunks
from tactiled.recording.contents import Header, Input, Item, Read

logger = logging.getLogger(__name__)
T = TypeVar("T")

Reached = Callable[[float], None]
"""Called with the completed fraction of the work, 0 to 1."""


@dataclass
class _Channels:
    """Schemas and channels read so far, by number."""

    with_events: bool = True
    schemas: dict[int, str] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    known: dict[int, Schema | None] = field(default_factory=dict)
    """Schema of our own that the messages of a channel have; None where they are left out."""

    def item(self, record: McapRecord, path: Path) -> Item | None:
        """Decode a message; None for other records and unknown channels."""
        if isinstance(record, Message):
            channel = self.channels.get(record.channel_id)
            return None if channel is None else self._decode(channel, record.data, path)
        if isinstance(record, SchemaRecord):
            self.schemas[record.id] = record.data.decode(errors="replace")
            self.known.clear()
        elif isinstance(record, Channel):
            self.channels[record.id] = record
            self.known.clear()
        return None

    def _decode(self, channel: Channel, data: bytes, path: Path) -> Item | None:
        if channel.id not in self.known:
            self.known[channel.id] = self._schema(channel, path)
        schema = self.known[channel.id]
        if schema is None:
            return None
        try:
            if schema is contents.RAW:
                return contents.decode_read(data)
            if schema is contents.INPUT:
                return Input(**schema.decode(data))
            topic = channel.topic.removeprefix(contents.TOPICS)
            return contents.decode_event(topic, data, channel.metadata.get("origin") or "daemon")  # type: ignore[arg-type]
        except DataError as error:
            raise DataError(f"{path}: {error}") from None

    def _schema(self, channel: Channel, path: Path) -> Schema | None:
        topic = channel.topic.removeprefix(contents.TOPICS)
        if channel.topic == contents.RAW_TOPIC:
            schema = contents.RAW
        elif channel.topic == contents.INPUT_TOPIC:
            schema = contents.INPUT
        elif topic in EVENT_TYPES:
            schema = contents.SCHEMAS[topic]
        else:
            return None
        if channel.message_encoding != "cdr" or self.schemas.get(channel.schema_id) != schema.text:
            raise DataError(
                f"{path}: {channel.topic} has the schema of another tactiled version; use that version"
            )
        return schema if self.with_events or schema in (contents.RAW, contents.INPUT) else None


def read_header(path: Path) -> Header:
    """Read the description of a recording.

    Raises
    ------
    DataError
        It cannot be read, or is not a tactiled recording.
    """
    fault = ""
    with open_recording(path) as stream:
        for found in chunks(stream, Extent()):
            for record in found if isinstance(found, list) else ():
                if isinstance(record, Metadata) and record.name == contents.METADATA:
                    try:
                        return Header.from_metadata(record.metadata)
                    except (KeyError, ValueError) as error:  # damaged: a finished file has a copy
                        fault = fault or f"{type(error).__name__}: {str(error).splitlines()[0]}"
    if fault:
        raise DataError(
            f"{path}: a recording of another tactiled version, which this one cannot read ({fault})"
        )
    raise DataError(f"{path}: not a recording of tactiled, or cut before its description")


def is_recording(path: Path) -> bool:
    """Return True for a recording of tactiled, of any version, and False for other MCAP files.

    Raises
    ------
    DataError
        It cannot be opened.
    """
    with open_recording(path) as stream:
        return any(
            isinstance(record, Metadata) and record.name == contents.METADATA
            for found in chunks(stream, Extent())
            for record in (found if isinstance(found, list) else ())
        )


def in_order(paths: Sequence[Path]) -> list[tuple[Path, Header]]:
    """Recordings with their headers; parts of one run sorted by part number, independent of file names.

    Raises
    ------
    DataError
        One cannot be read, or is not a tactiled recording.
    """
    headers = [(path, read_header(path)) for path in paths]
    runs = [header.run for _, header in headers]
    return sorted(headers, key=lambda entry: (runs.index(entry[1].run), entry[1].part))


def read_items(path: Path, extent: Extent | None = None, reached: Reached | None = None) -> Iterator[Item]:
    """Yield everything in a recording in file order; an unfinished file ends at its last whole chunk.

    An unreadable stretch in the middle becomes an `Input` "damaged". At the end, what could not be read is
    logged.

    Parameters
    ----------
    reached : callable, optional
        Called with the fraction of the file that has been read, 0 to 1.

    Raises
    ------
    DataError
        It cannot be read.
    """
    extent = Extent() if extent is None else extent
    return _read(path, extent, reached, _Channels())


def read_inputs(path: Path, reached: Reached | None = None) -> Iterator[Read | Input]:
    """Yield what `read_items` does, without the events, which take most of the time of reading."""
    for item in _read(path, Extent(), reached, _Channels(with_events=False)):
        if isinstance(item, Read | Input):
            yield item


def batches(items: Iterator[T], joins: Callable[[T], bool], most: int) -> Iterator[list[T]]:
    """Yield consecutive items for which `joins` is true together, at most `most`, and every other item alone.

    What was read before a `DataError` is yielded before that is raised.
    """
    batch: list[T] = []
    while True:
        failure: DataError | None = None
        item: T | None = None
        try:
            item = next(items, None)
        except DataError as error:
            failure = error
        is_joined = item is not None and joins(item)
        if batch and not (is_joined and len(batch) < most):
            yield batch
            batch = []
        if failure is not None:
            raise failure
        if item is None:
            return
        if is_joined:
            batch.append(item)
        else:
            yield [item]


def _read(path: Path, extent: Extent, reached: Reached | None, known: _Channels) -> Iterator[Item]:
    with open_recording(path) as stream:
        for found in chunks(stream, extent):
            if reached is not None:
                reached(extent.share_read)
            if isinstance(found, Damage):
                yield found.mark()
                continue
            for record in found:
                if (item := known.item(record, path)) is not None:
                    yield item
    if not extent.is_whole:
        logger.warning("%s: %s", path, extent.words())


def open_recording(path: Path) -> BinaryIO:
    """Open a file read-only; `DataError` when it cannot be opened."""
    try:
        return path.open("rb")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
