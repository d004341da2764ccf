"""Files of a few kilobytes that claim gigabytes."""

import struct
import zipfile
from pathlib import Path

import zstandard
from mcap.opcode import Opcode
from recordings import HEADER, noise_read

from tactiled.recording.writer import RecordingWriter

_BLOCK = bytes(1 << 20)


def zeros_zstd(n_bytes: int, *, says_size: bool = True) -> bytes:
    """Compress zeros; the frame says how many, or not."""
    compressor = zstandard.ZstdCompressor(level=1).compressobj(size=n_bytes if says_size else -1)
    parts = [compressor.compress(_BLOCK) for _ in range(n_bytes >> 20)]
    parts.append(compressor.compress(bytes(n_bytes & ((1 << 20) - 1))))
    return b"".join([*parts, compressor.flush()])


def chunk(data: bytes, declared: int, compression: bytes = b"zstd") -> bytes:
    """Return an MCAP chunk that declares a size, without a checksum."""
    body = struct.pack("<QQQII", 1, 2, declared, 0, len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def recording_with(path: Path, bomb: bytes, n_reads: int = 3) -> Path:
    """Write a recording, with a record of others between its first chunk and the next ones."""
    with RecordingWriter(path, HEADER) as writer:
        head = writer.size_bytes
        for k in range(n_reads):
            writer.read(noise_read(k))
    data = path.read_bytes()
    path.write_bytes(data[:head] + bomb + data[head:])
    return path


def npz_that_claims(path: Path, shape: tuple[int, ...], n_bytes: int) -> Path:
    """Write an npz whose array `volts` claims a shape, and holds fewer bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, claimed in (("time_s", shape[:1]), ("volts", shape)):
            head = repr({"descr": "<f8", "fortran_order": False, "shape": claimed}).encode()
            head += b" " * (117 - len(head)) + b"\n"
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                stream.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)
                for _ in range(n_bytes >> 20):
                    stream.write(_BLOCK)
    return path
