"""Files of others: sizes that lie, tables that expand."""

import struct
from pathlib import Path

import zstandard
from mcap.opcode import Opcode

from bench.hostile.attack import Attack, Outcome
from bench.hostile.process import Done, tactiled
from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.writer import RecordingWriter

_CLAIMED_BYTES = 2_100_000_000
_MOST_MB = 150.0  # a command takes 60 to 80 MB, and the largest chunk that is read adds at most 30
_BLOCK = bytes(1 << 20)
_NPZ_ROWS = 12_850_000  # of 36 channels: 3.7 GB


def _chunk_bomb(n_bytes: int) -> bytes:
    """Return an MCAP chunk of some 64 kB that holds zeros."""
    compressor = zstandard.ZstdCompressor(level=1).compressobj(size=n_bytes >> 20 << 20)
    data = b"".join([*(compressor.compress(_BLOCK) for _ in range(n_bytes >> 20)), compressor.flush()])
    body = struct.pack("<QQQII", 1, 2, n_bytes >> 20 << 20, 0, 4) + b"zstd" + struct.pack("<Q", len(data))
    return struct.pack("<BQ", Opcode.CHUNK, len(body) + len(data)) + body + data


def _bombed_recording(folder: Path, n_bytes: int) -> Path:
    path = folder / "bomb.mcap"
    with RecordingWriter(path, Header(load_board("board-v1", "wang2019-3x3"))) as writer:
        head = writer.size_bytes
        for k in range(3):
            writer.read(Read(float(k), 1.7e9, b"read"))
    data = path.read_bytes()
    path.write_bytes(data[:head] + _chunk_bomb(n_bytes) + data[head:])
    return path


def _seen(done: dict[str, Done], most_mb: float = _MOST_MB) -> Outcome:
    words = ", ".join(f"{name} {one.peak_mb:.0f} MB, exit code {one.code}" for name, one in done.items())
    return Outcome(
        words, all(one.is_tidy and one.code > 0 and one.peak_mb < most_mb for one in done.values())
    )


def _bomb(folder: Path, scale: float) -> Outcome:
    path = str(_bombed_recording(folder, int(_CLAIMED_BYTES * scale)))
    done = {
        "replay": tactiled("replay", path, "--verify"),
        "detect": tactiled("detect", path),
        "web --file": tactiled("web", "--file", path, "--port", "0"),
    }
    recovered = tactiled("recover", path, "--out", str(folder / "saved.mcap"))
    found = _seen(done)
    is_saved = recovered.is_tidy and recovered.code == 0 and recovered.peak_mb < _MOST_MB
    return Outcome(
        f"{found.seen}; recover {recovered.peak_mb:.0f} MB, the rest saved", found.held and is_saved
    )


def _bomb_of_others(folder: Path, scale: float) -> Outcome:
    magic = b"\x89MCAP0\r\n"
    path = folder / "bag.mcap"
    footer = struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0)
    path.write_bytes(magic + _chunk_bomb(int(_CLAIMED_BYTES * scale)) + footer + magic)
    return _seen({"detect": tactiled("detect", str(path))})


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "bomb, recording",
        "a chunk of 64 kB that holds 2.1 GB; replay, detect, web --file, recover",
        f"exit code above 0, the other chunks saved, below {_MOST_MB:g} MB",
        _bomb,
        0.1,
    ),
    Attack(
        "bomb, MCAP of others",
        "the same chunk in an MCAP of others; detect",
        f"refused below {_MOST_MB:g} MB",
        _bomb_of_others,
        0.1,
    ),
)
