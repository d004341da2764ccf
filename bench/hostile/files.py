"""Files of others: sizes that lie, tables that expand."""

import math
import struct
import zipfile
from pathlib import Path

import zstandard
from mcap.opcode import Opcode

from bench.hostile.attack import Attack, Outcome
from bench.hostile.process import Done, tactiled
from tactiled.array import Grid
from tactiled.recording.contents import Header, Read, RecordedBoard, load_board
from tactiled.recording.writer import RecordingWriter

_CLAIMED_BYTES = 2_100_000_000
_MOST_MB = 150.0  # a command takes 60 to 80 MB, and the largest chunk that is read adds at most 30
# What is held for the median period and the summary has a fixed size, reached within half an hour.
_GROWTH_MB = 20.0
_BLOCK = bytes(1 << 20)
_WIDE = 200_000_000
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


def _npz(folder: Path, scale: float) -> Outcome:
    path = folder / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, shape in (("time_s", (_NPZ_ROWS,)), ("volts", (_NPZ_ROWS, 36))):
            head = repr({"descr": "<f8", "fortran_order": False, "shape": shape}).ljust(117) + "\n"
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                stream.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode())
                for _ in range(int(math.prod(shape) * 8 * scale) >> 20):
                    stream.write(_BLOCK)
    found = _seen({"detect": tactiled("detect", str(path))})
    return Outcome(f"{path.stat().st_size / 1e6:.0f} MB on disk; {found.seen}", found.held)


def _wide_row(folder: Path, scale: float) -> Outcome:
    path = folder / "wide.npz"
    n = int(_WIDE * scale)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, kind, shape, n_bytes in (("time_s", "<f8", (1,), 8), ("volts", "|b1", (1, n), n)):
            head = repr({"descr": kind, "fortran_order": False, "shape": shape}).ljust(117) + "\n"
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                stream.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode())
                for at in range(0, n_bytes, len(_BLOCK)):
                    stream.write(_BLOCK[: n_bytes - at])
    return _seen({"detect": tactiled("detect", str(path))})


def _described_array(folder: Path, _: float) -> Outcome:
    path, board = folder / "array.mcap", load_board("board-v1", "wang2019-3x3")
    places = [float(k) for k in range(256)]
    grids = [Grid.model_construct(x_mm=places, y_mm=places)]
    array_file = board.array_file.model_copy(update={"grids": grids})
    with RecordingWriter(path, Header(RecordedBoard(board.layout_file, array_file))) as writer:
        writer.read(Read(0.0, 1.7e9, b"read"))
    return _seen({"detect": tactiled("detect", str(path)), "replay": tactiled("replay", str(path))})


def _long_table(folder: Path, scale: float) -> Outcome:
    """Measure two tables of one kind, the second four times as long."""
    peaks = []
    for hours in (0.5 * scale, 2 * scale):
        path = folder / f"{hours:g}h.csv"
        row = ",".join(["1.0"] * 36)
        with path.open("w") as stream:
            stream.write("time_s," + ",".join(f"c{k}" for k in range(36)) + "\n")
            stream.writelines(f"{k / 100:.2f},{row}\n" for k in range(int(hours * 360_000)))
        done = tactiled("detect", str(path), "--only", "contact")
        peaks.append(done.peak_mb)
    return Outcome(
        f"{0.5 * scale:g} h {peaks[0]:.0f} MB, {2 * scale:g} h {peaks[1]:.0f} MB",
        held=peaks[1] < peaks[0] + _GROWTH_MB,
    )


def _broken(folder: Path, _: float) -> Outcome:
    (folder / "broken.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(1000))
    (folder / "empty.mcap").write_bytes(b"")
    tried = {name: tactiled("detect", str(folder / name)) for name in ("", "broken.mcap", "empty.mcap")}
    words = [done.err.strip().rpartition(": ")[2] for done in tried.values()]
    return Outcome(
        "; ".join(words), all(d.is_tidy and d.code == 2 and "rosbags" not in d.err for d in tried.values())
    )


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
    Attack(
        "bomb, npz",
        "an npz of 17 MB whose array claims 3.7 GB; detect",
        f"refused below {_MOST_MB:g} MB",
        _npz,
        0.001,
    ),
    Attack(
        "bomb, a row of an npz",
        "an npz of 195 kB with one row of 200 million channels; detect",
        f"refused below {_MOST_MB:g} MB",
        _wide_row,
        0.01,
    ),
    Attack(
        "bomb, array of a recording",
        "a recording of 20 kB whose array has 256 x 256 taxels, 192 GB of weights; detect, replay",
        f"refused below {_MOST_MB:g} MB",
        _described_array,
        1.0,
    ),
    Attack(
        "long table",
        "a CSV of half an hour and one of 2 h, 36 channels at 100 Hz; detect",
        f"at most {_GROWTH_MB:g} MB more for the longer one",
        _long_table,
        None,
    ),
    Attack(
        "broken files",
        "a folder, an MCAP of zeros and an empty one; detect",
        "exit code 2, and what is wrong with each",
        _broken,
    ),
)
