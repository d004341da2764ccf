"""A recording cut at any byte gives all that was synced before the cut, and nothing else."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import pytest
from recordings import HEADER, items, record, simulated_reads

from tactiled.errors import DataError
from tactiled.recording import reader
from tactiled.recording.chunks import Extent, chunks
from tactiled.recording.contents import Item, Read
from tactiled.recording.reader import read_header
from tactiled.recording.recover import default_name, recover
from tactiled.recording.writer import RecordingWriter


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Item], list[tuple[int, int]]]:
    """A small recording: its bytes, its items, and after each sync its size and how many items it held."""
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    synced = []
    with RecordingWriter(path, HEADER) as writer:
        for k, read in enumerate(simulated_reads(0.08), 1):
            writer.read(read)
            if k % 2 == 0:
                writer.sync()
                synced.append((writer.size_bytes, k))
    return path.read_bytes(), items(path), synced


def test_cut_at_any_byte(
    tmp_path: Path,
    whole: tuple[bytes, list[Item], list[tuple[int, int]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)  # thousands of files need not outlive a power cut
    data, all_items, synced = whole
    cut, out = tmp_path / "cut.mcap.active", tmp_path / "cut.mcap"
    cut.write_bytes(data)
    described = len(data)
    step = 7  # no record is shorter, so each is cut somewhere
    for size in range(len(data) - 1, -1, -step):
        os.truncate(cut, size)
        if described == min(size + step, len(data)):
            with contextlib.suppress(DataError):
                read_header(cut)
                described = size
        if size < described:
            with pytest.raises(DataError, match="cut before its description"):
                recover(cut)
            assert not out.exists()
            continue
        saved = recover(cut)
        got = items(out)
        assert got == all_items[: len(got)]
        assert len(got) == saved.messages
        assert len(got) in {0, *(count for _, count in synced), len(all_items)}
        # Everything that was synced before the cut is there.
        assert len(got) >= max((count for end, count in synced if end <= size), default=0)
        assert 0 <= saved.lost_bytes <= size
        assert cut.read_bytes() == data[:size]
        out.unlink()
    assert 0 < described < synced[0][0]
    assert [path.name for path in tmp_path.iterdir()] == ["cut.mcap.active"]


def test_garbage_at_the_end_is_skipped(
    tmp_path: Path, whole: tuple[bytes, list[Item], list[tuple[int, int]]]
) -> None:
    """After a power cut the unsynced end may be zeros, old blocks or a chunk with flipped bits."""
    data, all_items, synced = whole
    (before, count), (end, _) = synced[2], synced[3]
    for tail in (bytes(3000), b"\xff" * 3000, data[100:2000], _flipped(data[before:end])):
        path = tmp_path / "a.mcap.active"
        path.write_bytes(data[:before] + tail)
        saved = recover(path)
        assert items(saved.path) == all_items[:count]
        assert saved.lost_bytes == len(tail)
        saved.path.unlink()


def _flipped(chunk: bytes) -> bytes:
    middle = len(chunk) // 2
    return chunk[:middle] + bytes([chunk[middle] ^ 0x10]) + chunk[middle + 1 :]


def test_the_report_names_what_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    sizes = record(path, simulated_reads(2.0), sync_every=50)
    data = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: sizes[2] + 200])
    saved = recover(cut)
    assert saved.path == tmp_path / "cut.recovered.mcap"
    assert saved.lost_bytes == 200
    words = saved.words()
    assert "missing: an incomplete chunk of 200 bytes, and all later data" in words
    assert "up to 0.5 s;" in words
    complete = recover(path, tmp_path / "again.mcap")
    assert complete.extent.is_complete
    assert "nothing is missing" in complete.words()
    assert items(tmp_path / "again.mcap") == items(path)
    assert read_header(tmp_path / "again.mcap") == read_header(path)


def test_a_file_in_use_and_a_name_in_use_are_left_alone(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap", HEADER)
    with pytest.raises(DataError, match="a recorder is writing it"):
        recover(writer.active)
    writer.read(Read(1.0, 0.0, b"x"))
    writer.sync()
    writer.abandon()
    assert default_name(writer.active) == tmp_path / "a.mcap"
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(DataError, match=r"a\.mcap: exists already; choose another name with --out"):
        recover(writer.active)
    assert (tmp_path / "a.mcap").read_text() == "mine"
    with pytest.raises(DataError, match="cannot be written"):
        recover(writer.active, tmp_path / "none" / "b.mcap")


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    for name, data in (("empty", b""), ("text", b"hello"), ("zeros", bytes(5000))):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(DataError, match=f"{name}: not a recording of tactiled"):
            recover(tmp_path / name)
    with pytest.raises(DataError, match="No such file"):
        recover(tmp_path / "none")


def test_an_error_names_the_file_that_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap", HEADER)
    writer.read(Read(1.0, 0.0, b"x"))
    writer.sync()
    writer.abandon()

    def refuse(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    def unreadable(stream: BinaryIO, extent: Extent) -> Iterator[object]:
        yield next(chunks(stream, extent))  # the description
        refuse()

    with monkeypatch.context() as then:
        then.setattr(reader, "chunks", unreadable)
        for read in (recover, items):
            with pytest.raises(DataError, match=r"a\.mcap\.active: cannot be read: Input/output error"):
                read(writer.active)
    assert not (tmp_path / "a.mcap").exists()
    with monkeypatch.context() as then:
        then.setattr(Path, "unlink", refuse)
        with pytest.raises(
            DataError, match=r"a\.mcap\.active: cannot be removed: .*; recovered as .*a\.mcap"
        ):
            recover(writer.active, replace_original=True)
    assert len(items(tmp_path / "a.mcap")) == 1
