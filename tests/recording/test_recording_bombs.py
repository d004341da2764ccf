"""Files that claim gigabytes are refused, or read in part, before anything is allocated."""

import contextlib
import hashlib
import json
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
from bombs import chunk, recording_with, zeros_zstd
from mcap.opcode import Opcode
from recordings import HEADER, noise_read
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tactiled.errors import DataError
from tactiled.offline import detect_file
from tactiled.recording import chunks
from tactiled.recording.bag import MOST_CHUNK_BYTES, check_mcap, read_bag
from tactiled.recording.chunks import Extent
from tactiled.recording.contents import Header, Read
from tactiled.recording.npz_table import MOST_CHANNELS
from tactiled.recording.reader import read_header, read_items
from tactiled.recording.recover import recover
from tactiled.recording.replay import replay
from tactiled.recording.whole import read_table
from tactiled.recording.writer import RecordingWriter
from tactiled.web.replay import ReplayFile
from tactiled.wire.frames import Hello

CLAIMED = 200_000_000
MOST_BYTES = 40_000_000
MAGIC = b"\x89MCAP0\r\n"


@pytest.fixture(scope="module")
def bomb() -> bytes:
    return zeros_zstd(CLAIMED)


@pytest.mark.parametrize("declared", [CLAIMED, 1000, 2**63])
def test_a_chunk_that_claims_more_than_ours_hold_is_damage(
    tmp_path: Path, bomb: bytes, declared: int, memory: Callable[[], int]
) -> None:
    path = recording_with(tmp_path / "a.mcap", chunk(bomb, declared))
    extent = Extent()
    found = [item for item in read_items(path, extent) if isinstance(item, Read)]
    assert found == [noise_read(k) for k in range(3)]
    assert "are damaged" in extent.words()
    assert not replay([path], lambda _: None).is_good
    assert recover(path, tmp_path / "b.mcap").messages == 3
    with pytest.raises(DataError, match="has no events"):
        ReplayFile([path])
    with pytest.raises(DataError, match="no scans"):
        detect_file(path)
    assert memory() < MOST_BYTES


def test_a_frame_that_does_not_say_its_size_ends_where_the_chunk_claims(tmp_path: Path) -> None:
    path = recording_with(tmp_path / "a.mcap", chunk(zeros_zstd(CLAIMED, says_size=False), 1000))
    assert [item for item in read_items(path) if isinstance(item, Read)] == [noise_read(k) for k in range(3)]


def test_a_record_that_claims_more_than_ours_is_not_read(tmp_path: Path, memory: Callable[[], int]) -> None:
    path = recording_with(tmp_path / "a.mcap", struct.pack("<BQ", Opcode.CHUNK, CLAIMED) + bytes(CLAIMED))
    written = memory()
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    assert [item for item in read_items(path) if isinstance(item, Read)] == [noise_read(k) for k in range(3)]
    assert written > MOST_BYTES > memory() - before


def test_the_chunks_of_our_writer_are_below_the_limit(tmp_path: Path) -> None:
    path = recording_with(tmp_path / "a.mcap", b"", n_reads=20_000)  # 1 MB between two syncs
    extent = Extent()
    assert len(list(read_items(path, extent))) == 20_000
    assert extent.is_whole
    assert chunks.MOST_CHUNK_BYTES >= 8 * (1 << 18)


def of_others(path: Path, *records: bytes) -> Path:
    path.write_bytes(MAGIC + b"".join(records) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + MAGIC)
    return path


@pytest.mark.parametrize(
    ("compression", "declared"),
    [(b"zstd", CLAIMED), (b"zstd", 1000), (b"lz4", CLAIMED), (b"lz4", 1000), (b"", CLAIMED)],
)
def test_an_mcap_of_others_with_a_chunk_beyond_the_limit_is_refused(
    tmp_path: Path, bomb: bytes, compression: bytes, declared: int
) -> None:
    data = bomb
    if compression == b"lz4":
        data = lz4.frame.compress(bytes(CLAIMED), store_size=False)
    path = of_others(tmp_path / "a.mcap", chunk(data, declared, compression))
    with pytest.raises(DataError, match=rf"has a chunk of \d+ bytes at byte 8; at most {MOST_CHUNK_BYTES}"):
        read_bag(path, "/pad")
    with pytest.raises(DataError, match="has a chunk of"):
        detect_file(path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"PK garbage", "is no MCAP file"),
        (MAGIC, "is cut or damaged at byte 8"),
        (MAGIC + struct.pack("<BQ", Opcode.CHUNK, 1000) + bytes(100), "is cut or damaged at byte 8"),
        (MAGIC + struct.pack("<BQ", Opcode.CHUNK, 10) + bytes(100), "cannot be read"),
    ],
)
def test_a_broken_mcap_is_called_broken(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "broken.mcap"
    path.write_bytes(data)
    with pytest.raises(DataError, match=words):
        detect_file(path)


def test_a_whole_mcap_of_others_passes(tmp_path: Path) -> None:
    check_mcap(of_others(tmp_path / "a.mcap", chunk(zeros_zstd(1000), 1000)))
    small = lz4.frame.compress(bytes(1_000_000), store_size=False)
    check_mcap(of_others(tmp_path / "b.mcap", chunk(small, 1_000_000, b"lz4")))


def test_a_page_holds_no_more_messages_than_fit_into_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from recordings import record, simulated_reads

    record(tmp_path / "a.mcap", simulated_reads(0.5))
    ReplayFile([tmp_path / "a.mcap"])
    monkeypatch.setattr("tactiled.web.replay._MOST_TEXT_BYTES", 1000)
    with pytest.raises(DataError, match="name fewer parts"):
        ReplayFile([tmp_path / "a.mcap"])


def test_the_replay_of_a_recording_without_events_says_so(tmp_path: Path) -> None:
    verdict = replay([recording_with(tmp_path / "a.mcap", b"", n_reads=0)], lambda _: None)
    assert not verdict.is_good
    assert verdict.words() == "no events: nothing could be compared"


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (
            lambda path: np.savez_compressed(path, time_s=np.zeros(1), volts=np.zeros((1, 30_000), bool)),
            "30000",
        ),
        (lambda path: npz_of(path, zipfile.ZIP_LZMA, header(b"{'descr': '<f8'}")), "compressed as numpy"),
        (
            lambda path: npz_of(path, zipfile.ZIP_STORED, header(b"(" * 9000, version=2)),
            "cannot be read|numbers",
        ),
        (lambda path: npz_of(path, zipfile.ZIP_STORED, b"", volts="volts"), r"lacks the array volts; it has"),
    ],
    ids=["a row of many channels", "lzma", "brackets", "no suffix"],
)
def test_an_npz_that_is_no_log_of_numpy_is_refused(
    tmp_path: Path, write: Callable[[Path], None], words: str
) -> None:
    write(tmp_path / "a.npz")
    with pytest.raises(DataError, match=words):
        detect_file(tmp_path / "a.npz")


def header(text: bytes, version: int = 1) -> bytes:
    size = struct.pack("<H" if version == 1 else "<I", len(text))
    return b"\x93NUMPY" + bytes([version, 0]) + size + text


def npz_of(path: Path, method: int, member: bytes, volts: str = "volts.npy") -> None:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name in ("time_s.npy", volts):
            archive.writestr(name, member)


@pytest.mark.parametrize("mask", [0x01, 0xFF])
def test_a_damaged_byte_of_an_npz_raises_nothing_but_a_data_error(tmp_path: Path, mask: int) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, time_s=np.arange(8) / 100, volts=np.ones((8, 2)))
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ mask]) + whole[at + 1 :])
        with contextlib.suppress(DataError):
            read_table(path)


@pytest.mark.parametrize(
    ("channels", "n"), [(MOST_CHANNELS + 1, 2), (MOST_CHANNELS, 1000)], ids=["wide", "long"]
)
def test_a_bag_of_more_numbers_than_the_limit_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, channels: int, n: int
) -> None:
    monkeypatch.setattr("tactiled.recording.bag.MOST_BYTES", 8 * MOST_CHANNELS * 10)
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/UInt8MultiArray"
    layout = store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    message = store.types[kind](layout=layout, data=np.zeros(channels, dtype=np.uint8))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        at = bag.add_connection("/pad", kind, typestore=store)
        for k in range(n):
            bag.write(at, k + 1, store.serialize_cdr(message, kind))
    with pytest.raises(DataError, match=r"at most 16384 are read|more than"):
        read_bag(tmp_path / "bag", "/pad")


def test_a_recording_whose_array_is_not_that_of_its_frames_is_damaged() -> None:
    """Weights of an array grow with taxels times channels: 12 kB may claim gigabytes."""
    header = json.loads(HEADER.to_metadata()["header"])
    for side, words in (
        (30, "36 channels in the frames, 3600 in the array"),
        (90, "8100 taxels and 32400 channels; at most 4096 and 16384"),
    ):
        header["source"]["array_file"]["grids"][0] |= {"x_mm": [*range(side)], "y_mm": [*range(side)]}
        text = json.dumps(header)
        with pytest.raises(ValueError, match=words):
            Header.from_metadata({"header": text, "sha256": hashlib.sha256(text.encode()).hexdigest()})


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"channel_offset_s": (1e-4,)}, r"hello\.channel_offset_s: 1 offsets for 36 channels"),
        ({"board_serial": "\x1b[2J\n"}, r"hello\.board_serial: '\\x1b\[2J\\n' is not printable"),
        ({"firmware_version": "\x07"}, r"hello\.firmware_version: .* is not printable"),
        ({"rate_hz": 0.0}, "hello: board TS0001 reports 0 Hz"),
        ({"adc_bits": 100_000}, "hello: board TS0001 reports 100 Hz, 100000 bits"),
        ({"array_id": "other"}, "hello: board TS0001 carries the array 'other'"),
    ],
)
def test_a_recorded_hello_is_checked_as_one_on_the_line(
    tmp_path: Path, changed: dict[str, Any], words: str
) -> None:
    hello = Hello("TS0001", "wang2019-3x3", 100.0, 12, 3.0, (0.0,) * 36)
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, replace(HEADER, hello=hello)):
        pass
    assert read_header(path).hello == hello
    path.unlink()
    with RecordingWriter(path, replace(HEADER, hello=replace(hello, **changed))):
        pass
    with pytest.raises(DataError, match=rf"a\.mcap: .*{words}"):
        read_header(path)


def test_a_recorded_offset_beyond_all_numbers_is_refused() -> None:
    hello = Hello("TS0001", "wang2019-3x3", 100.0, 12, 3.0, (0.125,) * 36)
    text = replace(HEADER, hello=hello).to_metadata()["header"].replace("0.125", "1e999")
    with pytest.raises(ValueError, match=r"hello\.channel_offset_s: not all are finite"):
        Header.from_metadata({"header": text, "sha256": hashlib.sha256(text.encode()).hexdigest()})
