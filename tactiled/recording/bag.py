"""Logs of others in bags: rosbag2, ROS 1 and MCAP, read by the library rosbags."""

import dataclasses
import logging
import os
import struct
from array import array
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC

from tactiled.array import FloatArray
from tactiled.errors import ConfigError, DataError, OperatorError, install_command
from tactiled.recording.chunks import FAULTS
from tactiled.recording.npz_table import MOST_CHANNELS
from tactiled.recording.reader import is_recording
from tactiled.recording.table_times import MOST_BYTES

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

logger = logging.getLogger(__name__)

BAGS = (".mcap", ".db3", ".bag")

# Numbers in these are no readings.
_DESCRIPTIONS = (
    "std_msgs/msg/Header",
    "std_msgs/msg/MultiArrayLayout",
    "builtin_interfaces/msg/Time",
    "builtin_interfaces/msg/Duration",
)

# A chunk of rosbag2 has 768 KiB, one of others 1 to 4 MiB, or one message: a large picture has 50 MB.
MOST_CHUNK_BYTES = 1 << 27
_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_LZ4_RATIO = 255  # an LZ4 block expands by no more


def check_mcap(path: Path) -> None:
    """Refuse (`DataError`) a file that is no whole MCAP, or that would fill the memory."""
    try:
        with path.open("rb") as stream:
            fault = _fault(stream)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    if fault:
        raise DataError(f"{path}: {fault}")


def _fault(stream: BinaryIO) -> str:
    """Describe what is wrong; empty where nothing is."""
    size = os.fstat(stream.fileno()).st_size
    if not size:
        return "is empty"
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        return "is no MCAP file: it does not begin as one"
    at = len(MCAP0_MAGIC)
    while True:
        stream.seek(at)
        head = stream.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
        end = at + _HEAD.size + length
        if not opcode or end > size:
            return (
                f"is cut or damaged at byte {at} of {size}; try `tactiled recover` if tactiled recorded it, "
                "`mcap recover` if not"
            )
        if opcode == Opcode.FOOTER:
            return ""
        if length > MOST_CHUNK_BYTES:
            return f"has a record of {length} bytes at byte {at}; at most {MOST_CHUNK_BYTES} are read"
        if opcode == Opcode.CHUNK:
            try:
                n_bytes = _chunk_bytes(Chunk.read(ReadDataStream(BytesIO(stream.read(length)))))
            except FAULTS:
                return f"has a chunk at byte {at} that cannot be read"
            if n_bytes > MOST_CHUNK_BYTES:
                return f"has a chunk of {n_bytes} bytes at byte {at}; at most {MOST_CHUNK_BYTES} are read"
        at = end


def _chunk_bytes(chunk: Chunk) -> int:
    """Size that reading a chunk would allocate, whatever it declares; above the limit, any such number."""
    n_bytes = max(chunk.uncompressed_size, len(chunk.data))
    if chunk.compression == "zstd":
        held: int = zstandard.get_frame_parameters(chunk.data).content_size
        return n_bytes if held == zstandard.CONTENTSIZE_UNKNOWN else max(n_bytes, held)
    if chunk.compression == "lz4" and len(chunk.data) * _LZ4_RATIO > MOST_CHUNK_BYTES:
        # The frame need not say its size.
        held = len(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, MOST_CHUNK_BYTES + 1))
        return max(n_bytes, held)
    return n_bytes


def is_bag(path: Path, topic: str | None = None) -> bool:
    """Return True for a bag of ROS or an MCAP file of others, and False for our recordings and tables.

    `ConfigError` if a topic is named, but the file can be no bag.
    """
    if topic is not None and not (path.is_dir() or path.suffix in BAGS):
        raise ConfigError("command line", [f"--topic is for bags ({', '.join(BAGS)} or the folder of one)"])
    if path.suffix == ".mcap" and not path.is_dir():
        return topic is not None or (path.exists() and not is_recording(path))
    return path.is_dir() or path.suffix in BAGS


def read_bag(path: Path, topic: str | None, rate_hz: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Read the times (n,) in seconds and the readings (n, channels) of one topic of a bag.

    Times are the stamps in the headers of the messages where these grow from message to message, otherwise
    the times at which the messages were recorded; where no times grow, `rate_hz` spaces the messages.
    `DataError` if the bag cannot be read, or lacks the topic or field, with those that it has;
    `OperatorError` if rosbags is not installed.

    Parameters
    ----------
    path : Path
        Folder of a rosbag2, or a file ``.mcap``, ``.db3`` or ``.bag``.
    topic : str or None
        ``/name``, or ``/name.field`` for a message with several arrays; ``.`` between fields of fields. The
        numbers of a field, those of fields within it included, are the channels. None for the only topic
        with an array of numbers.
    """
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise DataError(f"{path}: a folder without metadata.yaml, so no rosbag2; name a file")
    for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
        if file.suffix == ".mcap":
            check_mcap(file)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise OperatorError(f"{path}: a bag needs rosbags: {install_command('rosbags')}") from None
    try:
        # Bags of older ROS 2 contain no definitions of their messages; standard types are known without.
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            return _read(path, bag, topic, rate_hz)
    except DataError:
        raise
    except Exception as error:  # rosbags raises many kinds on damaged files and unknown encodings
        reason = str(error) or type(error).__name__
        raise DataError(
            f"{path}: rosbags cannot read it: {reason}. A cut bag is mended by `ros2 bag reindex` or `mcap "
            "recover`; messages other than those of ROS (JSON, protobuf) must be exported as CSV"
        ) from None


def _read(
    path: Path, bag: "AnyReader", topic: str | None, rate_hz: float | None
) -> tuple[FloatArray, FloatArray]:
    name, _, field = (_only_topic(path, bag) if topic is None else topic).partition(".")
    connections = [c for c in bag.connections if c.topic.strip("/") == name.strip("/")]
    if not connections:
        raise DataError(f"{path}: no topic {name}; {_topics_in_words(bag)}")
    log_ns: list[int] = []
    stamps_ns: list[int] = []
    values = array("d")
    n_channels = 0
    for connection, recorded_ns, data in bag.messages(connections):
        if connection.msgtype not in bag.typestore.fielddefs:
            raise DataError(
                f"{path}: {name} has messages of {connection.msgtype}, which the bag does not define; record "
                "it as MCAP (`ros2 bag record -s mcap`), which does, or export it as CSV"
            )
        message = bag.deserialize(data, connection.msgtype)
        if not log_ns and not field:
            field = _only_field(path, name, message)
        row = _numbers(_field(path, name, message, field))
        if row is None or not row.size:
            raise DataError(f"{path}: {_named(name, field)} has no numbers in message {len(log_ns) + 1}")
        n_channels = n_channels or len(row)
        if len(row) != n_channels:
            raise DataError(
                f"{path}: {_named(name, field)} has {len(row)} numbers in message {len(log_ns) + 1}, but "
                f"{n_channels} in the first one; every message must be one scan"
            )
        if n_channels > MOST_CHANNELS:
            raise DataError(
                f"{path}: {_named(name, field)} has {n_channels} numbers; at most {MOST_CHANNELS} are read"
            )
        if 8 * (len(values) + n_channels) > MOST_BYTES:
            raise DataError(
                f"{path}: {_named(name, field)} has more than {MOST_BYTES / 1e9:g} GB of numbers, the most "
                "that is read of a bag; split it"
            )
        values.frombytes(row.tobytes())
        log_ns.append(recorded_ns)
        if (stamp := getattr(getattr(message, "header", None), "stamp", None)) is not None:
            stamps_ns.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
    if len(log_ns) < 2:
        raise DataError(f"{path}: {name} has {len(log_ns)} messages; at least two are needed for the rate")
    readings = np.frombuffer(values).reshape(len(log_ns), n_channels)
    readings[~np.isfinite(readings)] = np.nan
    return _times(path, name, stamps_ns, log_ns, rate_hz), readings


def _times(
    path: Path, topic: str, stamps_ns: Sequence[int], log_ns: Sequence[int], rate_hz: float | None
) -> FloatArray:
    """Return the times of the messages in seconds (n,), which differ by more than float64 rounds."""
    log_s: FloatArray = np.array(log_ns) * 1e-9
    if len(stamps_ns) == len(log_ns):
        stamps_s: FloatArray = np.array(stamps_ns) * 1e-9
        if (row := _first_not_growing(stamps_s)) is None:
            return stamps_s
        logger.warning(
            "%s: header stamps of %s do not grow at message %d; times of recording are used", path, topic, row
        )
    if (row := _first_not_growing(log_s)) is None:
        return log_s
    if rate_hz is None:
        raise DataError(
            f"{path}: times of {topic} do not grow at message {row}; space the messages evenly with --rate HZ"
        )
    return np.asarray(log_s[0] + np.arange(len(log_s)) / rate_hz)


def _first_not_growing(times_s: FloatArray) -> int | None:
    """Return the number, from 1, of the first message that is not later than the one before it."""
    backwards = np.flatnonzero(np.diff(times_s) <= 0)
    return int(backwards[0]) + 2 if backwards.size else None


def _only_topic(path: Path, bag: "AnyReader") -> str:
    """Return the only topic whose messages have an array of numbers."""
    topics = [topic for topic, message in _first_messages(bag) if any(_arrays(message))]
    if len(topics) != 1:
        raise DataError(f"{path}: say which topic with --topic TOPIC or TOPIC.FIELD; {_topics_in_words(bag)}")
    return topics[0]


def _first_messages(bag: "AnyReader") -> Iterator[tuple[str, object]]:
    """Yield each topic that has messages, with its first message; None for a type that is not defined."""
    for topic in sorted({connection.topic for connection in bag.connections}):
        of_topic = [c for c in bag.connections if c.topic == topic]
        for connection, _, data in bag.messages(of_topic):
            is_known = connection.msgtype in bag.typestore.fielddefs
            yield topic, bag.deserialize(data, connection.msgtype) if is_known else None
            break


def _topics_in_words(bag: "AnyReader") -> str:
    described = []
    for topic, message in _first_messages(bag):
        arrays = [f"{field} ({size})" for field, size in _arrays(message)]
        none = "a type that it does not define" if message is None else "no array of numbers"
        described.append(f"{topic} with {', '.join(arrays) or none}")
    return f"it has {'; '.join(described)}" if described else "it has no messages"


def _only_field(path: Path, topic: str, message: object) -> str:
    """Return the only array of numbers; empty for a message whose numbers are all in single fields."""
    arrays = list(_arrays(message))
    if len(arrays) > 1:
        found = ", ".join(f"--topic {_named(topic, field)} ({size} numbers)" for field, size in arrays)
        raise DataError(f"{path}: {topic} has several arrays; choose one: {found}")
    return arrays[0][0] if arrays else ""


def _arrays(message: object, prefix: str = "") -> Iterator[tuple[str, int]]:
    """Yield the name and the size of each field, or field of a field, that is an array of numbers."""
    for name, value in _fields(message):
        if isinstance(value, np.ndarray | list | tuple):
            numbers = _numbers(value)
            if numbers is not None and numbers.size:
                yield prefix + name, numbers.size
        else:
            yield from _arrays(value, f"{prefix}{name}.")


def _numbers(value: object) -> FloatArray | None:
    """Return all numbers of a field in the order of its definition (channels,); None where it has none."""
    if isinstance(value, np.ndarray):
        return value.ravel().astype(np.float64) if value.dtype.kind in "iuf" else None
    if isinstance(value, int | float) and not isinstance(value, bool):
        return np.array([float(value)])
    members = value if isinstance(value, list | tuple) else [member for _, member in _fields(value)]
    parts = [part for member in members if (part := _numbers(member)) is not None]
    return np.concatenate(parts) if parts else None


def _fields(message: object) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the fields that may be readings; none for what is no message."""
    if not dataclasses.is_dataclass(message) or isinstance(message, type):
        return
    for entry in dataclasses.fields(message):
        value = getattr(message, entry.name)
        if getattr(value, "__msgtype__", "") not in _DESCRIPTIONS:
            yield entry.name, value


def _field(path: Path, topic: str, message: object, field: str) -> object:
    value = message
    for part in field.split(".") if field else ():
        names = dict(_fields(value))
        if part not in names:
            has = ", ".join(names) or "no fields"
            raise DataError(f"{path}: {topic} has no field {field}: no {part} among {has}")
        value = names[part]
    return value


def _named(topic: str, field: str) -> str:
    return f"{topic}.{field}" if field else topic
