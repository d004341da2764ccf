"""Check of an MCAP file of others, before a library decompresses it: whole, and no chunk too large."""

import os
import struct
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from tactiled.errors import DataError

# A chunk of rosbag2 has 768 KiB, one of others 1 to 4 MiB, or one message: a large picture has 50 MB.
MOST_CHUNK_BYTES = 1 << 27
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the name of the compression
_MOST_NAME_BYTES = 16  # "zstd" and "lz4" are the names there are
_FRAME_HEAD_BYTES = 18  # of zstd, at most (RFC 8878)
_LZ4_RATIO = 255  # an LZ4 block expands by no more


def check_mcap(path: Path) -> None:
    """Refuse a file that is no whole MCAP, or that would fill the memory.

    Raises
    ------
    DataError
        No MCAP, cut or damaged, or with a chunk of more than `MOST_CHUNK_BYTES`.
    """
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
        if opcode == Opcode.CHUNK:
            n_bytes = _chunk_bytes(stream, length)
            if n_bytes > MOST_CHUNK_BYTES:
                return f"has a chunk of {n_bytes} bytes at byte {at}; at most {MOST_CHUNK_BYTES} are read"
            if n_bytes < 0:
                return f"has a chunk at byte {at} that cannot be read"
        elif length > MOST_CHUNK_BYTES:
            return f"has a record of {length} bytes at byte {at}; at most {MOST_CHUNK_BYTES} are read"
        at = end


def _chunk_bytes(stream: BinaryIO, length: int) -> int:
    """Size that reading a chunk would allocate; -1 where its head is wrong."""
    if length < _CHUNK.size + 8:
        return -1
    fields: tuple[int, ...] = _CHUNK.unpack(stream.read(_CHUNK.size))
    declared, name_bytes = fields[2], fields[4]
    if name_bytes > _MOST_NAME_BYTES:
        return -1
    compression = stream.read(name_bytes)
    stream.read(8)  # length of the data, which end with the record
    n_data = length - _CHUNK.size - name_bytes - 8
    if compression == b"zstd":
        return max(declared, n_data, _zstd_bytes(stream.read(_FRAME_HEAD_BYTES)))
    if compression == b"lz4" and n_data <= MOST_CHUNK_BYTES < n_data * _LZ4_RATIO:
        return max(declared, _lz4_bytes(stream.read(n_data)))
    return max(declared, n_data)


def _zstd_bytes(frame_head: bytes) -> int:
    try:
        held: int = zstandard.get_frame_parameters(frame_head).content_size
    except zstandard.ZstdError:
        return 0  # rosbags says so
    return 0 if held == zstandard.CONTENTSIZE_UNKNOWN else held


def _lz4_bytes(data: bytes) -> int:
    """Decompress without keeping anything, up to the limit: the frame need not say its size."""
    decompressor = lz4.frame.LZ4FrameDecompressor()
    n_bytes = 0
    try:
        while not decompressor.eof and n_bytes <= MOST_CHUNK_BYTES:
            found = len(decompressor.decompress(data, max_length=1 << 20))
            n_bytes += found
            if not found and decompressor.needs_input:
                break
            data = b""
    except RuntimeError:
        return 0  # rosbags says so
    return n_bytes
