"""A recording in parts: each part stands alone, together they are one; a disk that refuses is survived."""

import contextlib
import errno
import os
import resource
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from recordings import HEADER, items, simulated_reads

from tactiled.pipeline import Pipeline
from tactiled.recording import session as session_module
from tactiled.recording.contents import Header, Input, Read, RecordedEvent, load_board
from tactiled.recording.reader import read_header
from tactiled.recording.recover import recover
from tactiled.recording.session import RETRY_S, RecordEntry, RecordingSession, RecordParams, part_path
from tactiled.recording.steps import Replay
from tactiled.recording.writer import RecordingWriter
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Hello, Scan

NO_GUARD = {"min_free_mb": 0.0}


def noise(n_bytes: int, time_s: float) -> Read:
    """Bytes that do not compress."""
    return Read(time_s, 0.0, os.urandom(n_bytes))


def new(path: Path, params: RecordParams, now_s: float = 0.0) -> RecordingSession:
    return RecordingSession(params, HEADER, path, now_s)


def write_all(target: RecordingSession, reads: list[Read]) -> list[bool]:
    taken = []
    for read in reads:
        dropped = target.dropped
        target.take(RecordEntry(read, (), None, "", 0.0), read.arrival_s)
        taken.append(target.dropped == dropped)
        target.tick(read.arrival_s)
    return taken


def state(target: RecordingSession) -> str:
    return target.progress.state


def reads_of(path: Path) -> list[Read]:
    return [item for item in items(path) if isinstance(item, Read)]


def parts_of(path: Path) -> list[Path]:
    return [part for k in range(1, 100) if (part := part_path(path, k)).exists()]


def test_a_name_that_a_clock_set_back_gives_again_is_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_module, "new_name", lambda _: "tactiled-20260101T000000.000Z.mcap")
    params = RecordParams(directory=str(tmp_path), **NO_GUARD)
    for k in range(3):
        target = RecordingSession(params, HEADER, None, 0.0)
        assert write_all(target, [noise(100, k)]) == [True]
        target.end(1.0)
    assert [len(reads_of(path)) for path in sorted(tmp_path.glob("*.mcap"))] == [1, 1, 1]


def test_parts_by_time_are_one_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    reads = simulated_reads(3.0)
    start_s = reads[0].arrival_s
    target = new(path, RecordParams(max_file_s=1.0, sync_s=0.2, **NO_GUARD), start_s)
    assert all(write_all(target, reads))
    target.end(reads[-1].arrival_s)
    parts = parts_of(path)
    assert [part.name for part in parts] == ["a.mcap", "a.002.mcap", "a.003.mcap"]
    headers = [read_header(part) for part in parts]
    assert [(h.part, h.fresh) for h in headers] == [(1, True), (2, False), (3, False)]
    assert len({h.run for h in headers}) == 1
    assert [item for part in parts for item in items(part)] == reads
    assert sorted(tmp_path.iterdir()) == sorted(parts)


def test_a_measured_rate_is_known_in_the_next_part(tmp_path: Path) -> None:
    source = load_board("magnetometers-5", "magnetometers-5")
    pipeline, encoder = Pipeline(source.layout, source.array), Encoder(source.layout)
    params = RecordParams(max_file_s=3.0, sync_s=0.2, **NO_GUARD)
    session = RecordingSession(params, Header(source, sync_s=0.2), tmp_path / "a.mcap", 0.0)
    for k in range(450):
        scan = Scan(0, np.array([k % 7 + c + 0.5 for c in range(15)], dtype=np.float64))
        read = Read(k / 90, 0.0, encoder.encode(scan))
        outputs = pipeline.receive_data(read.data, read.arrival_s)
        session.take(RecordEntry(read, outputs, pipeline.hello, "", 0.0), read.arrival_s)
        session.tick(read.arrival_s)
    session.end(5.0)
    first, second = parts_of(tmp_path / "a.mcap")
    assert read_header(first).hello is None
    hello = read_header(second).hello
    assert hello is not None
    assert hello.rate_hz == pytest.approx(90, rel=0.01)
    replayed = Replay([second])
    list(replayed)
    n_reads = sum(isinstance(item, Read) for item in items(second))
    # None is spent on measuring; the framer gives up the first frame of a stream.
    assert replayed.pipeline.health().scans == n_reads - 1 > 150


def test_parts_by_size(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    target = new(path, RecordParams(max_file_mb=0.05, sync_s=0.1, **NO_GUARD), 0.0)
    reads = [noise(2000, k * 0.1) for k in range(100)]
    assert all(write_all(target, reads))
    progress = target.progress
    target.end(10.0)
    parts = parts_of(path)
    assert len(parts) == progress.parts > 3
    assert all(part.stat().st_size < 70_000 for part in parts)
    assert sum(part.stat().st_size for part in parts) == target.progress.bytes_written
    assert [item for part in parts for item in items(part)] == reads


def test_recording_pauses_on_a_full_disk_and_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room_mb = 1000.0
    monkeypatch.setattr(session_module, "free_mb", lambda _: room_mb)
    target = new(tmp_path / "a.mcap", RecordParams(min_free_mb=500.0))
    first = [noise(10, k * 0.5) for k in range(4)]
    assert all(write_all(target, first))
    room_mb = 499.0
    assert write_all(target, [noise(10, 3.5)]) == [True]  # seen only when it is synced
    assert state(target) == "no-room"
    assert "the free space fell below record.min_free_mb = 500; " in target.progress.reason
    assert target.progress.free_mb == 499.0
    assert (tmp_path / "a.mcap").exists()
    room_mb = 540.0  # not yet a tenth more
    reason = target.progress.reason
    assert write_all(target, [noise(10, 5.0), noise(10, 6.0)]) == [False, False]
    assert (target.progress.free_mb, target.progress.reason) == (540.0, reason)
    room_mb = 560.0
    assert write_all(target, [noise(10, 7.5), noise(10, 8.0)]) == [False, True]
    assert (state(target), target.progress.reason) == ("recording", "")
    target.end(9.0)
    assert state(target) == "off"
    assert len(reads_of(tmp_path / "a.002.mcap")) == 1
    room_mb = 1.0
    from_the_start = new(tmp_path / "b.mcap", RecordParams(), 0.0)
    assert state(from_the_start) == "no-room"
    assert "recording continues above 550 MB" in from_the_start.progress.reason
    room_mb = 549.0
    assert write_all(from_the_start, [noise(10, 1.5), noise(10, 2.0)]) == [False, False]
    room_mb = 551.0
    assert write_all(from_the_start, [noise(10, 3.0), noise(10, 4.5)]) == [False, True]
    from_the_start.end(5.0)
    assert (read_header(tmp_path / "b.mcap").part, read_header(tmp_path / "b.mcap").fresh) == (1, False)


@contextlib.contextmanager
def limited_by_size(directory: Path) -> Iterator[Path]:
    """A place where no file may grow beyond 100 kB: writes fail as on a full disk, for any user."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))  # Python ignores SIGXFSZ: EFBIG it is
    try:
        yield directory
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextlib.contextmanager
def small_disk(directory: Path) -> Iterator[Path]:
    """A tmpfs of 256 kB; where this user may not mount one, `limited_by_size`."""
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tactiled-test", str(directory)]
    if os.geteuid() != 0 or subprocess.run(mount, check=False, capture_output=True).returncode:
        with limited_by_size(directory):
            yield directory
        return
    try:
        yield directory
    finally:
        subprocess.run(["umount", "-l", str(directory)], check=True)


@pytest.mark.parametrize("full_disk", [limited_by_size, small_disk])
def test_a_full_disk_loses_only_unsynced_data(
    tmp_path: Path, full_disk: "type[contextlib.AbstractContextManager[Path]]"
) -> None:
    directory = tmp_path / "disk"
    directory.mkdir()
    with full_disk(directory) as place:  # type: ignore[call-arg]
        path = place / "a.mcap"
        target = new(path, RecordParams(sync_s=1.0, **NO_GUARD), 0.0)
        reads = [noise(5000, k * 0.1) for k in range(100)]
        taken = write_all(target, reads)
        assert state(target) == "failed"
        assert "tactiled recover" in target.progress.reason
        n_taken = taken.index(False)
        assert not any(taken[n_taken:])
        saved = recover(part_path(path, 1).with_name("a.mcap.active"), tmp_path / "saved.mcap")
        again = items(saved.path)
        assert again == reads[: len(again)]
        assert n_taken - 11 <= len(again) <= n_taken  # what came since the last sync, 1 s before
        (place / "a.mcap.active").unlink()  # someone made room
        assert write_all(target, [noise(10, 10.0 + RETRY_S), noise(10, 11.0 + RETRY_S)]) == [False, True]
        assert state(target) == "recording"
        target.end(30.0)
        assert len(reads_of(place / "a.002.mcap")) == 1


def test_a_disk_that_is_full_from_the_start_is_tried_again_and_left_clean(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
    try:
        target = new(tmp_path / "a.mcap", RecordParams(**NO_GUARD), 0.0)
        assert state(target) == "failed"
        assert "a.mcap.active: cannot be written" in target.progress.reason
        assert not list(tmp_path.iterdir())
        assert write_all(target, [noise(10, RETRY_S), noise(10, RETRY_S + 1.0)]) == [False, False]
        assert not list(tmp_path.iterdir())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    reads = [noise(10, 2 * RETRY_S + 1.0), noise(10, 2 * RETRY_S + 2.0)]
    assert write_all(target, reads) == [False, True]
    target.end(30.0)
    assert reads_of(tmp_path / "a.mcap") == reads[1:]


def test_a_directory_that_goes_away_is_a_failure_that_ends(tmp_path: Path) -> None:
    place = tmp_path / "usb"
    place.mkdir()
    params = RecordParams(max_file_s=1.0, sync_s=0.5, **NO_GUARD)
    target = new(place / "a.mcap", params, 0.0)
    assert write_all(target, [noise(10, 0.0)]) == [True]
    place.rename(tmp_path / "gone")
    taken = write_all(target, [noise(10, 1.0), noise(10, 2.0)])
    assert taken == [True, False]
    assert state(target) == "failed"
    (tmp_path / "gone").rename(place)
    assert write_all(target, [noise(10, 2.5 + RETRY_S), noise(10, 3.0 + RETRY_S)]) == [False, True]
    target.end(20.0)
    assert state(target) == "off"


def refuse(*_: object) -> None:
    raise OSError(errno.EIO, "Input/output error")


def test_a_failed_sync_loses_all_reads_since_the_last_one_and_counts_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = new(tmp_path / "a.mcap", RecordParams(sync_s=1.0, **NO_GUARD))
    reads = [noise(10, k * 0.1) for k in range(16)]
    target.take(RecordEntry(reads[0], (), None, "", 0.0, (3, 30)), 0.0)  # 3 were dropped by the queue
    assert all(write_all(target, reads[1:10]))
    with monkeypatch.context() as then:
        then.setattr(RecordingWriter, "sync", refuse)
        target.tick(1.0)
    assert (state(target), target.dropped) == ("failed", 10)
    assert "Input/output error" in target.dropped_because
    target.tick(1.0 + RETRY_S)
    assert all(write_all(target, [noise(10, 11.1)]))
    target.end(12.0)
    assert not items(recover(tmp_path / "a.mcap.active").path)
    mark, _ = items(tmp_path / "a.002.mcap")
    assert isinstance(mark, Input)
    assert (mark.name, mark.values()) == ("dropped", {"reads": 13, "bytes": 130})


def test_the_board_is_known_after_its_hello_was_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hello falls into a time without room, or into reads that the queue dropped."""
    reads = simulated_reads(1.0)
    room_mb = 0.0
    monkeypatch.setattr(session_module, "free_mb", lambda _: room_mb)
    for case in ("no-room", "dropped"):
        room_mb = 0.0 if case == "no-room" else 1000.0
        target = new(tmp_path / f"{case}.mcap", RecordParams(sync_s=0.1), reads[0].arrival_s)
        pipeline = Pipeline(HEADER.source.layout, HEADER.source.array)
        dropped = (0, 0)
        for read in reads:
            outputs = pipeline.receive_data(read.data, read.arrival_s)
            is_hello = any(isinstance(output, Hello) for output in outputs)
            if is_hello and case == "dropped":
                dropped = (1, len(read.data))
                continue
            entry = RecordEntry(read, outputs, pipeline.hello, "", 0.0, dropped)
            target.take(entry, read.arrival_s)
            room_mb = 1000.0 if is_hello else room_mb
            target.tick(read.arrival_s)
            dropped = (0, 0)
        target.end(9.0)
        found = items(tmp_path / f"{case}.mcap")
        assert {item.board for item in found if isinstance(item, RecordedEvent)} == {"TS0001"}


def test_a_part_whose_name_is_taken_gets_the_next_number(tmp_path: Path) -> None:
    (tmp_path / "a.002.mcap").write_bytes(b"mine")
    (tmp_path / "a.003.mcap.active").write_bytes(b"mine")
    target = new(tmp_path / "a.mcap", RecordParams(max_file_s=1.0, sync_s=0.1, **NO_GUARD))
    reads = [noise(10, k * 0.1) for k in range(25)]
    assert all(write_all(target, reads))
    target.end(3.0)
    parts = [tmp_path / name for name in ("a.mcap", "a.004.mcap", "a.005.mcap")]
    assert [read_header(part).part for part in parts] == [1, 2, 3]
    assert [item for part in parts for item in items(part)] == reads
    assert (tmp_path / "a.002.mcap").read_bytes() == b"mine"


def test_a_recording_that_cannot_be_finished_is_off_and_says_why(tmp_path: Path) -> None:
    target = new(tmp_path / "a.mcap", RecordParams(**NO_GUARD))
    assert all(write_all(target, [noise(10, 0.1)]))
    (tmp_path / "a.mcap").write_bytes(b"mine")  # another program took the name
    target.end(1.0)
    assert state(target) == "off"
    assert "a.mcap exists already; recover its data" in target.progress.reason
    assert target.dropped == 1
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"
    assert len(reads_of(tmp_path / "a.mcap.active")) == 1
