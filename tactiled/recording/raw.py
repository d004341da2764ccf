"""Recordings: the bytes of the line with their arrival times, in an MCAP file.

Bytes, not scans: a recording can be run again through a better decoder. One channel, ``tactile/raw``, holds
CDR messages of the type below, which PlotJuggler, Foxglove and rerun know how to open. The layout and the
array travel in the file's metadata, so a recording explains itself years later.
"""

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer

from tactiled import __version__, resources, tomlfile
from tactiled.array import Array, ArrayFile, build
from tactiled.errors import DataError
from tactiled.wire.layout import Layout, compile_layout
from tactiled.wire.schema import LayoutFile

TOPIC = "tactile/raw"
SCHEMA_NAME = "tactiled_msgs/msg/RawBytes"
SCHEMA_TEXT = b"float64 arrival_s  # host monotonic seconds\nuint8[] data\n"
# CDR (OMG DDSI-RTPS 2.5, 10.2): encapsulation CDR_LE, then fields aligned to their own size.
_CDR_HEAD = struct.Struct("<4sdI")
_CDR_LE = b"\x00\x01\x00\x00"


@dataclass(frozen=True)
class Source:
    """What was at the other end of the line: the layout and the array, as files and compiled."""

    layout_file: LayoutFile
    array_file: ArrayFile

    @property
    def layout(self) -> Layout:
        return compile_layout(self.layout_file)

    @property
    def array(self) -> Array:
        return build(self.array_file)


class RawWriter:
    """Writes a recording; ``FILE.active`` until `close` renames it to ``FILE``.

    Parameters
    ----------
    path : Path
        Name of the finished file.
    source : Source
    unix_offset_s : float
        Epoch seconds minus arrival clock, for viewers that want wall time.
    flush_s : float
        Between two flushes; what a killed recorder can lose.
    """

    def __init__(self, path: Path, source: Source, unix_offset_s: float, flush_s: float = 1.0) -> None:
        self._path = path
        self._active = path.with_name(path.name + ".active")
        if path.exists() or self._active.exists():
            raise DataError(f"{path}: exists already; choose another name or move it away")
        self._unix_offset_s = unix_offset_s
        self._flush_s = flush_s
        self._flushed_s = -1.0
        self._sequence = 0
        try:
            self._stream: BinaryIO = self._active.open("wb")
        except OSError as error:
            raise DataError(f"{self._active}: cannot be written: {error.strerror}") from None
        self._writer = Writer(self._stream, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"tactiled {__version__}")
        schema = self._writer.register_schema(SCHEMA_NAME, "ros2msg", SCHEMA_TEXT)
        self._channel = self._writer.register_channel(TOPIC, "cdr", schema)
        self._writer.add_metadata(
            "tactiled",
            {
                "version": __version__,
                "layout": source.layout_file.model_dump_json(),
                "array": source.array_file.model_dump_json(),
            },
        )

    def write(self, data: bytes, arrival_s: float) -> None:
        """Append one read of the port."""
        stamp_ns = max(int((arrival_s + self._unix_offset_s) * 1e9), 0)
        message = _CDR_HEAD.pack(_CDR_LE, arrival_s, len(data)) + data
        self._writer.add_message(self._channel, stamp_ns, message, stamp_ns, self._sequence)
        self._sequence += 1
        if arrival_s - self._flushed_s >= self._flush_s:
            self._flushed_s = arrival_s
            self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Finish the file, sync it to disk and give it its name."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self._active.rename(self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_source(path: Path) -> Source:
    """Layout and array that a recording was made with; `DataError` when it is no recording of ours."""
    with _open(path) as stream:
        try:
            for record in NonSeekingReader(stream).iter_metadata():
                if record.name == "tactiled":
                    return Source(
                        LayoutFile.model_validate_json(record.metadata["layout"]),
                        ArrayFile.model_validate_json(record.metadata["array"]),
                    )
        except (McapError, KeyError, ValueError, EOFError, struct.error) as error:
            raise DataError(
                f"{path}: not a recording of tactiled ({error or type(error).__name__})"
            ) from None
    raise DataError(f"{path}: an MCAP file, but not a recording of tactiled (no metadata 'tactiled')")


def read_raw(path: Path) -> Iterator[tuple[float, bytes]]:
    """Reads of the port in order: (arrival_s, data). An unfinished file ends at its last whole chunk."""
    with _open(path) as stream:
        try:
            for _, channel, message in NonSeekingReader(stream).iter_messages(TOPIC, log_time_order=False):
                if channel.message_encoding != "cdr":
                    raise DataError(f"{path}: topic {TOPIC} is not CDR")
                _, arrival_s, size = _CDR_HEAD.unpack_from(message.data)
                yield arrival_s, message.data[_CDR_HEAD.size : _CDR_HEAD.size + size]
        except (McapError, EOFError, struct.error):
            return  # cut off: what came before is good


def _open(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def load_source(protocol: str, array: str) -> Source:
    """Layout and array files by name or path."""
    return Source(
        tomlfile.load(resources.find(protocol, "protocols"), LayoutFile),
        tomlfile.load(resources.find(array, "config/arrays"), ArrayFile),
    )
