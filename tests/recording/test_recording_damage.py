"""A byte that flips in a chunk costs that chunk, and everyone who reads says what is missing."""

import json
import logging
import struct
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from recordings import HEADER, UNIX_OFFSET_S, items, record, simulated_reads

from tactiled.errors import DataError
from tactiled.offline import detect_file
from tactiled.recording.chunks import Extent, chunks
from tactiled.recording.contents import Input, Item, Read
from tactiled.recording.directory import new_name
from tactiled.recording.export import export_csv
from tactiled.recording.reader import read_header, read_items
from tactiled.recording.recover import recover, recover_directory
from tactiled.recording.replay import ReplayComparison, replay
from tactiled.recording.writer import RecordingWriter

CHUNKS = 6
READS = 5  # in each
NAME = new_name(datetime(2026, 1, 1, tzinfo=UTC))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes, list[Item], list[int]]:
    """A finished file of a few chunks, its items, and where each chunk and its index end."""
    path = tmp_path_factory.mktemp("small") / "a.mcap"
    ends = []
    with RecordingWriter(path, HEADER) as writer:
        ends.append(writer.size_bytes)
        for k, read in enumerate(simulated_reads(0.29)[: CHUNKS * READS], 1):
            writer.read(read)
            if k % READS == 0:
                writer.sync()
                ends.append(writer.size_bytes)
    return path, path.read_bytes(), items(path), ends


def damaged(path: Path, data: bytes, at: int, mask: int) -> Path:
    out = path.with_name("damaged.mcap")
    out.write_bytes(data[:at] + bytes([data[at] ^ mask]) + data[at + 1 :])
    return out


def check(small: tuple[Path, bytes, list[Item], list[int]], at: int, mask: int) -> None:
    """All other chunks are read in order, and missing data is marked and reported.

    What is damaged before the first chunk of reads, or at or behind the last, may end the file.
    """
    path, data, whole, ends = small
    flipped = damaged(path, data, at, mask)
    extent = Extent()
    found = list(read_items(flipped, extent))
    if not extent.is_complete:
        assert at < ends[0] or at >= ends[-2]
        assert found == whole[: len(found)]
        assert extent.words()
        return
    assert read_header(flipped) == read_header(path)
    hit = next((k for k, end in enumerate(ends) if at < end), len(ends))  # 0: before the first read
    spared = [item for k, item in enumerate(whole) if k // READS + 1 != hit]
    reads = [item for item in found if isinstance(item, Read)]
    assert reads in (whole, spared)
    marks = [item for item in found if isinstance(item, Input)]
    assert len(marks) == len(extent.damages)
    if len(reads) < len(whole):
        assert not extent.is_whole
        (mark,) = marks
        assert mark.name == "damaged"
        before = found[: found.index(mark)]
        assert before == whole[: (hit - 1) * READS]
        assert 0 < mark.values()["bytes"] <= len(data)
        assert "bytes in one place are damaged" in extent.words()
    assert bool(extent.words()) != extent.is_whole


@pytest.mark.parametrize("byte", range(9))
@pytest.mark.parametrize("mask", [0x01, 0x07, 0x09, 0x0A, 0x80, 0xFF])
def test_a_damaged_head_costs_one_chunk(
    small: tuple[Path, bytes, list[Item], list[int]], byte: int, mask: int
) -> None:
    """Opcode or length of the second chunk of reads is damaged: the next head is looked for.

    With the first four masks the opcode is that of an index, a header, the end of the data, and metadata.
    """
    path, data, whole, ends = small
    assert data[ends[1]] == Opcode.CHUNK
    extent = Extent()
    found = list(read_items(damaged(path, data, ends[1] + byte, mask), extent))
    assert [item for item in found if isinstance(item, Read)] == whole[:READS] + whole[2 * READS :]
    (damage,) = extent.damages
    assert 0 < damage.n_bytes <= ends[2] - ends[1]


@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.METADATA])
def test_a_length_that_leads_to_a_later_record_costs_one_record(
    small: tuple[Path, bytes, list[Item], list[int]], opcode: Opcode
) -> None:
    """The wrong length ends exactly at the third chunk of reads, which must not hide those before it."""
    path, data, whole, ends = small
    head = len(MCAP0_MAGIC)
    at = ends[1] if opcode == Opcode.CHUNK else head + 9 + int.from_bytes(data[head + 1 : head + 9], "little")
    assert data[at] == opcode
    wrong = data[: at + 1] + struct.pack("<Q", ends[2] - at - 9) + data[at + 9 :]
    out = path.with_name("wrong.mcap")
    out.write_bytes(wrong)
    extent = Extent()
    with out.open("rb") as stream:
        n_found = [len(part) for part in chunks(stream, extent) if isinstance(part, list)]
    n_lost = READS if opcode == Opcode.CHUNK else 0
    assert sum(n_found) >= len(whole) - n_lost
    assert len(extent.damages) == 1


class CountingStream(BytesIO):
    """Stream that counts the bytes that are read."""

    n_read = 0

    def read(self, size: int | None = -1, /) -> bytes:
        part = super().read(size)
        self.n_read += len(part)
        return part


@pytest.mark.parametrize("n_heads", [100, 1000, 10_000])
@pytest.mark.parametrize("is_nested", [False, True], ids=["a byte between", "each reaches to the end"])
def test_fake_heads_are_read_in_proportion_to_the_file(n_heads: int, is_nested: bool) -> None:
    """Heads whose two lengths agree cannot make a reader read each byte again and again."""
    size, heads = 57, b""
    for k in range(n_heads):
        n_data = (n_heads - k - 1) * size if is_nested else size - 54
        heads += struct.pack("<BQQQQII4sQ", Opcode.CHUNK, n_data + 44, 1, 1, 100, 0, 4, b"zstd", n_data)
        heads += b"\0" * (size - 53)
    stream = CountingStream(MCAP0_MAGIC + heads + b"garbage")
    assert list(chunks(stream, Extent())) == []
    assert stream.n_read < 300 * len(heads)


@pytest.mark.parametrize("at", range(15))
def test_a_damaged_index_costs_nothing(small: tuple[Path, bytes, list[Item], list[int]], at: int) -> None:
    """Byte `at` of the index behind the second chunk of reads: opcode, length, channel or size."""
    path, data, whole, ends = small
    index_at = ends[2] - 15 - READS * 16
    assert data[index_at] == Opcode.MESSAGE_INDEX
    extent = Extent()
    assert list(read_items(damaged(path, data, index_at + at, 0xFF), extent)) == whole
    assert extent.is_whole


@pytest.mark.parametrize(
    ("hit", "at"),
    [(1, 60), (2, 60), (3, 60)],
    ids=["data before the step", "data behind it", "data later"],
)
def test_damage_costs_one_chunk_where_the_wall_clock_was_set_back(tmp_path: Path, hit: int, at: int) -> None:
    """The clock is set back by an hour between chunks 1 and 2; byte `at` of a chunk is damaged."""
    writer = RecordingWriter(tmp_path / NAME, HEADER)
    reads, ends = [], [writer.size_bytes]
    for k in range(CHUNKS * READS):
        offset_s = UNIX_OFFSET_S if k < 2 * READS else UNIX_OFFSET_S - 3600.0
        reads.append(Read(k * 0.1, offset_s, bytes([k]) * 50))
        writer.read(reads[-1])
        if k % READS == READS - 1:
            writer.sync()
            ends.append(writer.size_bytes)
    writer.abandon()
    data = bytearray(writer.active.read_bytes())
    data[ends[hit] + at] ^= 0x40
    writer.active.write_bytes(data)
    assert [is_recovered for is_recovered, _ in recover_directory(tmp_path)] == [True]
    kept = [item for item in items(tmp_path / NAME) if isinstance(item, Read)]
    assert kept == reads[: hit * READS] + reads[(hit + 1) * READS :]


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_any_byte_of_the_file_may_flip(
    small: tuple[Path, bytes, list[Item], list[int]], data: st.DataObject
) -> None:
    at = data.draw(st.integers(0, len(small[1]) - 1))
    check(small, at, data.draw(st.integers(1, 255)))


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_many_damages_raise_nothing_but_a_data_error(
    small: tuple[Path, bytes, list[Item], list[int]], data: st.DataObject
) -> None:
    path, text = small[0], bytearray(small[1])
    for _ in range(data.draw(st.integers(2, 30))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    flipped = path.with_name("many.mcap")
    flipped.write_bytes(bytes(text))
    extent = Extent()
    reads = [item for item in read_items(flipped, extent) if isinstance(item, Read)]
    assert all(read in small[2] for read in reads)
    assert len(reads) == len(small[2]) or not extent.is_whole


def test_an_attachment_of_another_tool_is_no_damage(
    small: tuple[Path, bytes, list[Item], list[int]], tmp_path: Path
) -> None:
    _, data, whole, ends = small
    path, extent = tmp_path / "a.mcap", Extent()
    attachment = struct.pack("<BQ", Opcode.ATTACHMENT, 100) + bytes(100)
    path.write_bytes(data[: ends[3]] + attachment + data[ends[3] : ends[-1]])
    assert list(read_items(path, extent)) == whole[: CHUNKS * READS]
    assert not extent.damages
    assert not extent.lost_chunks


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """A recording with its events; and the middle of the third second's chunk."""
    path = tmp_path_factory.mktemp("long") / "a.mcap"
    sizes = record(path, simulated_reads(6.0), sync_every=100)
    return path, (sizes[2] + sizes[3]) // 2


def verify(path: Path) -> tuple[ReplayComparison, list[str]]:
    lines: list[str] = []
    return replay([path], lines.append, topics=("scan",)), lines


def test_replay_recover_and_reader_report_what_is_missing_in_the_middle(
    long: tuple[Path, int], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, at = long
    _, whole = verify(path)
    flipped = damaged(path, path.read_bytes(), at, 0xFF)
    verdict, scans = verify(flipped)
    assert not verdict.is_good
    assert "bit for bit" not in verdict.words()
    assert "compared up to the place where" in verdict.words()
    assert "damaged.mcap: " in verdict.words()
    assert verdict.compared < len(whole)
    # A second is missing and what came behind it is there, with the same indices.
    assert len(whole) - 105 < len(scans) < len(whole) - 90
    assert json.loads(scans[-1])["index"] == json.loads(whole[-1])["index"]
    says = "bytes in one place are damaged: about 1."
    caplog.clear()
    export_csv([flipped], tmp_path / "a.csv")
    assert says in caplog.text
    caplog.clear()
    detect_file(flipped)
    assert says in caplog.text


def test_recover_continues_after_the_damage_and_marks_it(long: tuple[Path, int], tmp_path: Path) -> None:
    path, at = long
    flipped = damaged(path, path.read_bytes(), at, 0xFF)
    saved = recover(flipped, tmp_path / "saved.mcap")
    assert saved.extent.is_complete
    assert "bytes in one place are damaged: about 1." in saved.words()
    assert "the end is complete" in saved.words()
    assert items(saved.path) == items(flipped)
    extent = Extent()
    list(read_items(saved.path, extent))
    assert extent.is_whole
    verdict, scans = verify(saved.path)
    assert scans == verify(flipped)[1]
    assert not verdict.is_good
    assert "bit for bit" not in verdict.words()


def test_a_truncated_file_fails_verification_and_an_unfinished_one_is_verified_to_its_end(
    long: tuple[Path, int], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, at = long
    for name, good in (("cut.mcap", False), ("cut.mcap.active", True)):
        cut = tmp_path / name
        cut.write_bytes(path.read_bytes()[:at])
        caplog.clear()
        verdict, scans = verify(cut)
        assert (verdict.is_good, len(scans) > 200) == (good, True)
        assert ("bit for bit" in verdict.words()) == good
        assert f"{name}: the file was not finished or was truncated" in verdict.words()
        assert "the file was not finished or was truncated" in caplog.text


def test_an_unfinished_file_with_damage_in_its_middle_gives_what_is_behind(
    long: tuple[Path, int], tmp_path: Path
) -> None:
    path, at = long
    data = bytearray(path.read_bytes())
    data[at] ^= 0xFF
    killed = tmp_path / "killed.mcap.active"
    killed.write_bytes(data[: at + (len(data) - at) // 2])
    verdict, _ = verify(killed)
    assert not verdict.is_good
    saved = recover(killed)
    assert not saved.extent.is_complete
    assert "bytes in one place are damaged" in saved.words()
    assert "missing: " in saved.words()
    instants_s = [item.arrival_s for item in items(saved.path) if isinstance(item, Read)]
    assert max(instants_s) > 3.9 + instants_s[0]


def test_damage_at_either_end_of_a_finished_file(tmp_path: Path) -> None:
    """The time of a lost last chunk is that of the summary; that of a lost first one is not known."""
    path = tmp_path / "a.mcap"
    sizes = record(path, simulated_reads(2.5), sync_every=50)
    for at, says in (
        ((sizes[-2] + sizes[-1]) // 2, "are damaged: about 0.5"),
        (sizes[0] // 2, "are damaged: the time missing is unknown"),
    ):
        extent = Extent()
        list(read_items(damaged(path, path.read_bytes(), at, 0xFF), extent))
        assert says in extent.words()


def test_messages_whose_channel_is_lost_are_counted(long: tuple[Path, int], tmp_path: Path) -> None:
    """The first chunk of an unfinished file, which alone describes the channels of events, is damaged."""
    data = bytearray(long[0].read_bytes()[: long[1]])
    at = data.index(b"zstd") + 30
    data[at] ^= 0xFF
    killed = tmp_path / "killed.mcap.active"
    killed.write_bytes(data)
    extent = Extent()
    reads = [item for item in items(long[0]) if isinstance(item, Read)]
    found = [item for item in read_items(killed, extent) if isinstance(item, Read)]
    assert len(found) > 150
    assert found == reads[reads.index(found[0]) :][: len(found)]  # the metadata names their channel
    assert extent.orphans > 150
    assert not extent.is_whole
    lost = f"{extent.orphans} messages are left out: the description of their channel is lost"
    assert lost in extent.words()
    verdict, _ = verify(killed)
    assert not verdict.is_good
    assert lost in verdict.words()
    assert lost in recover(killed).words()


def test_a_description_that_is_damaged_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    record(path, simulated_reads(0.1))
    changed = path.read_bytes().replace(b"wang2019-3x3", b"wang2019-3x4")
    path.write_bytes(changed)
    with pytest.raises(DataError, match=r"a\.mcap: the description is damaged$"):
        read_header(path)


def test_a_complete_file_is_read_without_a_log_line(
    long: tuple[Path, int], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG):
        verdict, _ = verify(long[0])
    assert verdict.is_good
    assert not caplog.text
