"""Reader of recordings, item by item; logs what cannot be read.

`chunks` parses the bytes: it finds whole chunks, damage, and where to resume after it.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, TypeVar

from mcap.records import Metadata

from tactiled.errors import DataError
from tactiled.recording import contents
from tactiled.recording.cdr import Schema
from tactiled.recording.chunks import ChannelMessage, Damage, Extent, chunks, topics_of_summary
from tactiled.recording.contents import Header, Input, Item

logger = logging.getLogger(__name__)
T = TypeVar("T")

Reached = Callable[[float], None]
"""Called with the completed fraction of the work, 0 to 1."""


@lru_cache(maxsize=64)  # 16 channels of ours; a file of others may have any number
def _schema(topic: str, encoding: str, text: bytes) -> Schema | None:
    """Schema of our own that the messages of a channel have; None for a channel of others."""
    name = topic.removeprefix(contents.TOPICS)
    ours = {contents.RAW_TOPIC: contents.RAW, contents.INPUT_TOPIC: contents.INPUT}.get(topic)
    schema = contents.SCHEMAS.get(name) if ours is None else ours
    if schema is not None and (encoding, text.decode(errors="replace")) != ("cdr", schema.text):
        raise DataError(f"{topic} has the schema of another tactiled version; use that version")
    return schema


def _item(entry: ChannelMessage, *, with_events: bool) -> Item | None:
    """Decode a message; None where it is left out."""
    channel, data = entry.channel, entry.message.data
    schema = _schema(channel.topic, channel.message_encoding, entry.schema.data)
    if schema is contents.RAW:
        return contents.decode_read(data)
    if schema is contents.INPUT:
        return Input(**schema.decode(data))
    if schema is None or not with_events:
        return None
    topic = channel.topic.removeprefix(contents.TOPICS)
    return contents.decode_event(topic, data, channel.metadata.get("origin") or "daemon")  # type: ignore[arg-type]


def read_header(path: Path) -> Header:
    """Read the description of a recording; `DataError` if there is none that can be read."""
    fault = ""
    for metadata in _descriptions(path):
        try:
            return Header.from_metadata(metadata)
        except DataError as error:  # damaged: a finished file has a copy
            fault = fault or str(error)
        except (KeyError, ValueError) as error:
            fault = fault or (
                "a recording of another tactiled version, which this one cannot read "
                f"({type(error).__name__}: {str(error).splitlines()[0]})"
            )
    raise DataError(f"{path}: {fault or 'not a recording of tactiled, or cut before its description'}")


def is_recording(path: Path) -> bool:
    """Return True for a recording of tactiled of any version; `DataError` if it cannot be opened."""
    with open_recording(path) as stream:
        topics = topics_of_summary(stream)
    if topics and not any(topic.startswith(contents.TOPICS) for topic in topics):
        return False  # without reading it whole
    return any(True for _ in _descriptions(path))


def _descriptions(path: Path) -> Iterator[dict[str, str]]:
    with open_recording(path) as stream:
        for found in readable_chunks(path, stream, Extent()):
            if isinstance(found, Metadata) and found.name == contents.METADATA:
                yield found.metadata


def in_order(paths: Sequence[Path]) -> list[tuple[Path, Header]]:
    """Return recordings with their headers, parts of one run by part number; raises as `read_header`."""
    headers = [(path, read_header(path)) for path in paths]
    runs = [header.run for _, header in headers]
    return sorted(headers, key=lambda entry: (runs.index(entry[1].run), entry[1].part))


def read_items(
    path: Path, extent: Extent | None = None, reached: Reached | None = None, *, with_events: bool = True
) -> Iterator[Item]:
    """Yield everything in a recording in file order; an unfinished file ends at its last whole chunk.

    An unreadable stretch in the middle becomes an `Input` "damaged". At the end, what could not be read is
    logged. Events take most of the time of reading. `DataError` if it cannot be read.
    """
    extent = extent or Extent()
    with open_recording(path) as stream:
        for found in readable_chunks(path, stream, extent):
            if reached is not None:
                reached(extent.share_read)
            if isinstance(found, Damage):
                yield found.mark()
            elif isinstance(found, list):
                for entry in found:
                    try:
                        item = _item(entry, with_events=with_events)
                    except DataError as error:
                        raise DataError(f"{path}: {error}") from None
                    if item is not None:
                        yield item
    if not extent.is_whole:
        logger.warning("%s: %s", path, extent.words())


def batches(items: Iterator[T], joins: Callable[[T], bool], most: int) -> Iterator[list[T]]:
    """Yield consecutive items for which `joins` is true together, at most `most`, and every other item alone.

    What was read before a `DataError` is yielded before that is raised.
    """
    batch: list[T] = []
    try:
        for item in items:
            is_joined = joins(item)
            if batch and not (is_joined and len(batch) < most):
                yield batch
                batch = []
            if is_joined:
                batch.append(item)
            else:
                yield [item]
    except DataError:
        if batch:
            yield batch
        raise
    if batch:
        yield batch


def open_recording(path: Path) -> BinaryIO:
    """Open a file read-only; `DataError` when it cannot be opened."""
    try:
        return path.open("rb")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def readable_chunks(
    path: Path, stream: BinaryIO, extent: Extent
) -> Iterator[list[ChannelMessage] | Metadata | Damage]:
    """Yield the `chunks` of a file; `DataError` where the disk does not give them."""
    try:
        yield from chunks(stream, extent)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
