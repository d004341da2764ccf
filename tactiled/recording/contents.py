"""Content of a recording: metadata, channels and message types, shared by writer and reader.

::

    metadata  tactiled       layout, array, parameters and versions: the file describes itself
    channel   /tactile/raw    every read from the port: bytes and arrival time
    channel   /tactile/input  other pipeline inputs: a lost port, commands; and where reads are missing
    channel   /tactile/scan, /tactile/slip, ... events of the pipeline: origin "pipeline"
    channel   /tactile/status, ...              events of the daemon itself: origin "daemon"

The raw and input channels, in file order, are the complete input of the pipeline, so a replay reproduces the
pipeline's events bit for bit. A rotated recording is a chain of such files with one `run` and growing `part`.
"""

import hashlib
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import TypeAdapter

from tactiled import resources, tomlfile
from tactiled.array import Array, ArrayFile, build
from tactiled.errors import DataError
from tactiled.events.types import EVENT_TYPES, Event
from tactiled.outside import json_of, shown
from tactiled.pipeline import PipelineParams, check_hello
from tactiled.recording.cdr import HEAD, Schema, fields_of
from tactiled.version import __version__
from tactiled.wire.frames import Hello
from tactiled.wire.layout import Layout, compile_layout
from tactiled.wire.schema import LayoutFile

METADATA = "tactiled"
Origin = Literal["pipeline", "daemon"]


@dataclass(frozen=True)
class RecordedBoard:
    """Layout and array of the recorded board, as files and compiled."""

    layout_file: LayoutFile
    array_file: ArrayFile

    @property
    def layout(self) -> Layout:
        """Compiled frame layout."""
        return compile_layout(self.layout_file)

    @property
    def array(self) -> Array:
        """Array built from its file."""
        return build(self.array_file)


def load_board(protocol: str, array: str) -> RecordedBoard:
    """Load layout and array files by name or path."""
    return RecordedBoard(
        tomlfile.load(resources.find(protocol, "protocols"), LayoutFile),
        tomlfile.load(resources.find(array, "config/arrays"), ArrayFile),
    )


@dataclass(frozen=True)
class Header:
    """Description of one file."""

    source: RecordedBoard
    # Parameters with which the events in the file were computed
    pipeline: PipelineParams = field(default_factory=PipelineParams)
    run: str = ""  # identifier shared by all parts of a rotated recording
    part: int = 1  # from 1
    # The pipeline was new where this file begins; otherwise its state can be reproduced only by replaying the
    # earlier parts, if they exist
    fresh: bool = True
    # The board as it was known before this file began, with its measured rate where it does not state one;
    # None where none was known
    hello: Hello | None = None
    sync_s: float = 0.0  # interval of syncs to disk: the longest loss in a power cut
    computed_with: str = ""  # libraries and processor of the live run (`numerics_words`)

    def to_metadata(self) -> dict[str, str]:
        """MCAP metadata with a checksum, because MCAP has none for metadata."""
        text = _HEADER.dump_json(self).decode()
        checksum = hashlib.sha256(text.encode()).hexdigest()
        return {"version": __version__, "channels": FIRST_CHANNELS, "header": text, "sha256": checksum}

    @staticmethod
    def from_metadata(metadata: Mapping[str, str]) -> "Header":
        """Parse MCAP metadata; `DataError` where it is damaged, `KeyError` or `ValueError` if not valid."""
        text = metadata["header"]
        if metadata["sha256"] != hashlib.sha256(text.encode()).hexdigest():
            raise DataError("the description is damaged")
        header = _HEADER.validate_json(text)
        in_frames, in_array = header.source.layout.n_channels, header.source.array_file.n_channels
        if in_frames != in_array:  # before anything of its size is made
            raise ValueError(f"{in_frames} channels in the frames, {in_array} in the array")
        if header.hello is not None:
            _check_known(header.hello, header.source)
        return header


def _check_known(hello: Hello, source: RecordedBoard) -> None:
    """Refuse with a ValueError a board that no frame can have described, as the codec and the pipeline do."""
    for name in ("board_serial", "array_id", "firmware_version"):
        text = getattr(hello, name)
        if not text.isprintable():  # it would reach terminals and names of topics
            raise ValueError(f"hello.{name}: {shown(text)} is not printable")
    n_offsets, n_channels = len(hello.channel_offset_s), source.layout.n_channels
    if n_offsets not in (0, n_channels):
        raise ValueError(f"hello.channel_offset_s: {n_offsets} offsets for {n_channels} channels")
    if not all(math.isfinite(offset_s) for offset_s in hello.channel_offset_s):
        raise ValueError("hello.channel_offset_s: not all are finite")
    if fault := check_hello(hello, source.layout, source.array):
        raise ValueError(f"hello: {fault}")


_HEADER = TypeAdapter(Header)


@dataclass(frozen=True)
class Read:
    """One read from the port; `arrival_s` is host monotonic time, `arrival_s + unix_offset_s` epoch time."""

    arrival_s: float
    unix_offset_s: float
    data: bytes


@dataclass(frozen=True)
class Input:
    """Input of the pipeline other than a read, or a mark where input is missing.

    `name` is "disconnected" (the port was lost), "dropped" (reads that the disk was too slow to take),
    "damaged" (the file cannot be read there), or a command of `Pipeline.command`. `arguments` is a JSON
    object. After "dropped" or "damaged", events cannot be reproduced bit for bit.
    """

    time_s: float
    unix_offset_s: float
    name: str
    arguments: str = "{}"

    def values(self) -> dict[str, Any]:
        """Return the arguments by name; `DataError` where a recording of others has none."""
        loaded = json_of(self.arguments)
        if not isinstance(loaded, dict):
            raise DataError(f"input {shown(self.name)}: its arguments are no JSON object")
        return loaded

    def count(self, name: str) -> int:
        """Return an argument that is a number; `DataError` where a recording of others has none."""
        value = self.values().get(name)
        if not isinstance(value, int):
            raise DataError(f"input {shown(self.name)}: it does not state the number of {name}")
        return value


@dataclass(frozen=True)
class RecordedEvent:
    """Event as it was recorded."""

    event: Event
    board: str
    unix_offset_s: float
    origin: Origin


Item = Read | Input | RecordedEvent

RAW = Schema("RawBytes", fields_of(Read))
INPUT = Schema("Input", fields_of(Input))
TOPICS = "/tactile/"
RAW_TOPIC = f"{TOPICS}raw"
INPUT_TOPIC = f"{TOPICS}input"
FIRST_CHANNELS = f"{RAW_TOPIC} {INPUT_TOPIC}"  # topics of the channels 1 and 2, named in the metadata


_READ = struct.Struct("<4sddI")  # of `RAW`: head, arrival_s, unix_offset_s, bytes of the data


def decode_read(data: bytes) -> Read:
    """Decode a message of `RAW`, in a fifth of the time of `Schema.decode`; raises as that method."""
    if len(data) >= _READ.size:
        head, arrival_s, unix_offset_s, n_bytes = _READ.unpack_from(data)
        if head == HEAD and len(data) == _READ.size + n_bytes:
            return Read(arrival_s, unix_offset_s, data[_READ.size :])
    return Read(**RAW.decode(data))


def schema_of(kind: type[Event]) -> Schema:
    """Schema of an event in a recording: the event's fields, its board and its epoch offset."""
    stamp = {"board": str, "unix_offset_s": float}
    return Schema(kind.__name__.removesuffix("Event"), stamp | fields_of(kind))


SCHEMAS = {topic: schema_of(kind) for topic, kind in EVENT_TYPES.items()}


def encode_event(recorded: RecordedEvent) -> bytes:
    """Encode an event as CDR; equal bytes mean bit-identical events."""
    stamp = {"board": recorded.board, "unix_offset_s": recorded.unix_offset_s}
    return SCHEMAS[recorded.event.topic].encode(stamp | vars(recorded.event))


def decode_event(topic: str, data: bytes, origin: Origin) -> RecordedEvent:
    """Decode a recorded message into its event; `DataError` if it is none of this topic."""
    values = SCHEMAS[topic].decode(data)
    board, unix_offset_s = values.pop("board"), values.pop("unix_offset_s")
    return RecordedEvent(EVENT_TYPES[topic](**values), board, unix_offset_s, origin)
