"""What a recording holds: the words of the file, shared by its writer and its reader.

::

    metadata  tactiled        layout, array, parameters and versions: the file explains itself years later
    metadata  tactiled/board  what the board said of itself: when that is new, at most every 10 s
    channel   tactile/raw     every read of the port: bytes and arrival time
    channel   tactile/input   what else the pipeline was told: a lost port, commands; where reads are missing
    channel   tactile/scan, tactile/slip, ...   what the pipeline made of it: origin "pipeline"
    channel   tactile/status, ...               what the daemon said beside it: origin "daemon"

Raw and input in file order are all that ever went into the pipeline, so running them again gives the
pipeline's events bit by bit. A rotated recording is a chain of such files with one `run` and growing `part`.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

from tactiled import __version__, resources, tomlfile
from tactiled.array import Array, ArrayFile, build
from tactiled.events.types import EVENT_TYPES, Event
from tactiled.pipeline import PipelineParams
from tactiled.recording.cdr import Schema, fields_of
from tactiled.wire.layout import Layout, compile_layout
from tactiled.wire.schema import LayoutFile

METADATA = "tactiled"
BOARD_METADATA = "tactiled/board"
_CHECK = "sha256"
Origin = Literal["pipeline", "daemon"]


@dataclass(frozen=True)
class RecordedBoard:
    """What was at the other end of the line: the layout and the array, as files and compiled."""

    layout_file: LayoutFile
    array_file: ArrayFile

    @property
    def layout(self) -> Layout:
        return compile_layout(self.layout_file)

    @property
    def array(self) -> Array:
        return build(self.array_file)


def load_board(protocol: str, array: str) -> RecordedBoard:
    """Layout and array files by name or path."""
    return RecordedBoard(
        tomlfile.load(resources.find(protocol, "protocols"), LayoutFile),
        tomlfile.load(resources.find(array, "config/arrays"), ArrayFile),
    )


@dataclass(frozen=True)
class Header:
    """Description of one file.

    Attributes
    ----------
    source : RecordedBoard
    pipeline : PipelineParams
        With which the events in the file were made.
    config_sha256 : str
        Of the whole configuration as sorted JSON; says whether two recordings were made alike.
    run : str
        Same in all parts of a rotated recording.
    part : int
        Counts them from 1.
    fresh : bool
        The pipeline was new where this file begins; else only the parts before it, or nothing, can bring
        back what it knew.
    hello : bytes
        What the board had said of itself before this file began, as a frame; empty where it had not.
    sync_s : float
        The file was synced to disk so often: what a power cut can cost.
    """

    source: RecordedBoard
    pipeline: PipelineParams = field(default_factory=PipelineParams)
    config_sha256: str = ""
    run: str = ""
    part: int = 1
    fresh: bool = True
    hello: bytes = b""
    sync_s: float = 0.0

    def to_metadata(self) -> dict[str, str]:
        """As MCAP keeps it, with a checksum: MCAP has none for metadata."""
        metadata = {
            "version": __version__,
            "layout": self.source.layout_file.model_dump_json(),
            "array": self.source.array_file.model_dump_json(),
            "array_id": self.source.array_file.name,
            "protocol": self.source.layout_file.name,
            "pipeline": self.pipeline.model_dump_json(),
            "config_sha256": self.config_sha256,
            "run": self.run,
            "part": str(self.part),
            "fresh": str(self.fresh).lower(),
            "hello": self.hello.hex(),
            "sync_s": repr(self.sync_s),
        }
        return metadata | {_CHECK: _digest(metadata)}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> Self:
        """Raises KeyError or ValueError where it does not fit."""
        if metadata.get(_CHECK, digest := _digest(metadata)) != digest:
            raise ValueError("the description is damaged")
        return cls(
            source=RecordedBoard(
                LayoutFile.model_validate_json(metadata["layout"]),
                ArrayFile.model_validate_json(metadata["array"]),
            ),
            pipeline=PipelineParams.model_validate_json(metadata["pipeline"]),
            config_sha256=metadata["config_sha256"],
            run=metadata["run"],
            part=int(metadata["part"]),
            fresh=metadata["fresh"] == "true",
            hello=bytes.fromhex(metadata["hello"]),
            sync_s=float(metadata["sync_s"]),
        )


def _digest(metadata: Mapping[str, str]) -> str:
    described = sorted(entry for entry in metadata.items() if entry[0] != _CHECK)
    return hashlib.sha256(json.dumps(described).encode()).hexdigest()


@dataclass(frozen=True)
class Read:
    """One read of the port; seconds of the host's monotonic clock, `+ unix_offset_s` is epoch time."""

    arrival_s: float
    unix_offset_s: float
    data: bytes


@dataclass(frozen=True)
class Input:
    """Something else that the pipeline was told, or should have been.

    `name` is "disconnected" (the port was lost), "dropped" (reads that the disk was too slow for: what
    comes behind cannot be computed again bit by bit), "damaged" (the file cannot be read there: neither can
    it), or a command of `Pipeline.command`. `arguments` is a JSON object.
    """

    time_s: float
    unix_offset_s: float
    name: str
    arguments: str = "{}"

    def values(self) -> dict[str, Any]:
        """The arguments by name."""
        loaded: dict[str, Any] = json.loads(self.arguments)
        return loaded


def damage_mark(first_unix_s: float, n_bytes: int, duration_s: float) -> Input:
    """What stands where a file cannot be read; its instant is epoch time, for what else it was is lost."""
    return Input(first_unix_s, 0.0, "damaged", json.dumps({"bytes": n_bytes, "duration_s": duration_s}))


@dataclass(frozen=True)
class RecordedEvent:
    """An event as it was recorded."""

    event: Event
    board: str
    unix_offset_s: float
    origin: Origin


Item = Read | Input | RecordedEvent

RAW = Schema("RawBytes", fields_of(Read))
INPUT = Schema("Input", fields_of(Input))
RAW_TOPIC = "tactile/raw"
INPUT_TOPIC = "tactile/input"


def schema_of(kind: type[Event]) -> Schema:
    """Schema of an event in a recording: the event's fields, whose event it is, and its epoch."""
    stamp = {"board": str, "unix_offset_s": float}
    return Schema(kind.__name__.removesuffix("Event"), stamp | fields_of(kind))


SCHEMAS = {topic: schema_of(kind) for topic, kind in EVENT_TYPES.items()}


def encode_event(said: RecordedEvent) -> bytes:
    """CDR message of an event; equal bytes mean an equal event, bit by bit."""
    stamp = {"board": said.board, "unix_offset_s": said.unix_offset_s}
    return SCHEMAS[said.event.topic].encode(stamp | vars(said.event))


def decode_event(topic: str, data: bytes, origin: Origin) -> RecordedEvent:
    """Event of a recorded message.

    Raises
    ------
    DataError
        The bytes are no such event.
    """
    values = SCHEMAS[topic].decode(data)
    board, unix_offset_s = values.pop("board"), values.pop("unix_offset_s")
    return RecordedEvent(EVENT_TYPES[topic](**values), board, unix_offset_s, origin)
