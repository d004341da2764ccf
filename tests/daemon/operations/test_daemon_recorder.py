"""Recorder of the service: handing over never waits for the disk, and losses are reported."""

import errno
import itertools
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from patience import PATIENCE_S

from tactiled.daemon.operations import recorder as recorder_module
from tactiled.daemon.operations.recorder import Recorder
from tactiled.errors import DataError
from tactiled.events.types import RecordingEvent
from tactiled.recording import session
from tactiled.recording.contents import Header, Input, Item, Read, RecordedEvent, load_board
from tactiled.recording.reader import read_header, read_items
from tactiled.recording.recover import recover
from tactiled.recording.session import RecordParams
from tactiled.recording.writer import RecordingWriter

HEADER = Header(load_board("board-v1", "wang2019-3x3"))
PARAMS = RecordParams(sync_s=0.05, min_free_mb=0)
LATER_S = itertools.count(1000.0, 1000.0)


def read(k: int) -> Read:
    return Read(k * 0.01, 1.7e9, bytes([k % 256]) * 5)


def until(what: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def report(recorder: Recorder) -> RecordingEvent:
    """Return the recording event, also when it is not due."""
    event = recorder.report(next(LATER_S))
    assert event is not None
    return event


class StuckDisk:
    """`os.fsync` that does not return until it is released."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.free = threading.Event()
        self.entered = threading.Event()
        self._fsync = os.fsync
        monkeypatch.setattr(os, "fsync", self._stuck)

    def _stuck(self, descriptor: int) -> None:
        self.entered.set()
        self.free.wait(PATIENCE_S)
        self._fsync(descriptor)


def items(path: Path) -> list[Item]:
    return list(read_items(path))


def test_all_entries_are_in_the_file(tmp_path: Path) -> None:
    reads = [read(k) for k in range(1000)]
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        for item in reads:
            recorder.record(item, (), None)
        recorder.record(Input(10.0, 1.7e9, "disconnected"), (), None)
        recorder.record_event(report(recorder), "B1", 1.7e9)
    *got, lost, last = items(tmp_path / "a.mcap")
    assert got == reads
    assert isinstance(lost, Input)
    assert lost.name == "disconnected"
    assert isinstance(last, RecordedEvent)
    assert (last.board, last.event.topic, last.origin) == ("B1", "recording", "daemon")
    assert recorder.reads_dropped == 0


def overflow(recorder: Recorder, disk: StuckDisk) -> None:
    """Record more reads than the queue takes, while the disk is stuck: `record` returns all the same."""
    recorder.record(read(0), (), None)
    assert disk.entered.wait(PATIENCE_S)
    for k in range(1, 201):
        recorder.record(read(k), (), None)


def test_a_stuck_disk_delays_nothing_and_the_loss_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_module, "_QUEUE_ITEMS", 50)
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        disk = StuckDisk(monkeypatch)
        overflow(recorder, disk)
        dropped = recorder.reads_dropped
        assert dropped >= 150
        assert report(recorder).reads_dropped == dropped
        assert report(recorder).reads_waiting == 50
        disk.free.set()
        until(lambda: report(recorder).reads_waiting == 0)
        recorder.record(read(201), (), None)
    (mark,) = [item for item in items(tmp_path / "a.mcap") if isinstance(item, Input)]
    got = [item for item in items(tmp_path / "a.mcap") if isinstance(item, Read)]
    assert (mark.name, mark.values()) == ("dropped", {"reads": dropped, "bytes": 5 * dropped})
    assert got == [read(k) for k in range(201 - dropped)] + [read(201)]
    assert items(tmp_path / "a.mcap").index(mark) == len(got) - 1
    assert f"{dropped} more reads are in no file" in caplog.text


@pytest.mark.parametrize("is_switched_off", [True, False])
def test_a_loss_at_the_end_of_the_recording_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_switched_off: bool
) -> None:
    monkeypatch.setattr(recorder_module, "_QUEUE_ITEMS", 50)
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        disk = StuckDisk(monkeypatch)
        overflow(recorder, disk)
        disk.free.set()
        until(lambda: not is_switched_off or recorder.switch(False, None) == "")
    *got, mark = items(tmp_path / "a.mcap")
    dropped = recorder.reads_dropped
    assert isinstance(mark, Input)
    assert (mark.name, mark.values()) == ("dropped", {"reads": dropped, "bytes": 5 * dropped})
    assert len(got) == 201 - dropped


def test_close_returns_although_the_disk_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_module, "_CLOSE_S", 0.1)
    recorder = Recorder(PARAMS, HEADER, tmp_path / "a.mcap")
    disk = StuckDisk(monkeypatch)
    recorder.record(read(0), (), None)
    assert disk.entered.wait(PATIENCE_S)
    recorder.close()
    assert f"tactiled recover {tmp_path / 'a.mcap'}.active" in caplog.text
    disk.free.set()
    until(lambda: (tmp_path / "a.mcap").exists())
    recorder.close()


def test_disks_that_hang_are_waited_for_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "_CLOSE_S", 0.5)
    recorders = [Recorder(PARAMS, HEADER, tmp_path / f"{name}.mcap") for name in "abcdefgh"]
    disk = StuckDisk(monkeypatch)
    for recorder in recorders:
        recorder.record(read(0), (), None)
    assert disk.entered.wait(PATIENCE_S)
    began_s = time.monotonic()
    for recorder in recorders:
        recorder.finish()
    for recorder in recorders:
        recorder.close()
    assert time.monotonic() - began_s < 8 * 0.5  # as long as one after the other would take
    disk.free.set()
    until(lambda: all((tmp_path / f"{name}.mcap").exists() for name in "abcdefgh"))
    for recorder in recorders:
        recorder.close()


def test_a_disk_that_fails_later_is_reported_and_retried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        empty = report(recorder).bytes_written
        recorder.record(read(0), (), None)
        until(lambda: report(recorder).bytes_written > empty)  # it is synced

        def broken(_: int) -> None:
            raise OSError(30, "Read-only file system")

        monkeypatch.setattr(os, "fsync", broken)
        recorder.record(read(1), (), None)  # the thread takes it before or after the sync that fails
        until(lambda: report(recorder).state == "failed")
        assert "Read-only file system" in report(recorder).reason
        for k in range(2, 12):
            recorder.record(read(k), (), None)
        until(lambda: recorder.reads_dropped >= 11)
    assert recorder.reads_dropped == 11  # with the one that was not synced, which may be in the file
    assert caplog.text.count("not recording") == 1
    assert "Read-only file system" in caplog.text
    monkeypatch.undo()
    saved = recover(tmp_path / "a.mcap.active")
    kept = [item for item in items(saved.path) if isinstance(item, Read)]
    assert kept in ([read(0)], [read(0), read(1)])


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "No space left on device"),
        (errno.EIO, "Input/output error"),
        (errno.EROFS, "Read-only file system"),
        (errno.ESTALE, "Stale file handle"),
    ],
)
def test_a_disk_that_is_full_or_gone_is_named_as_such_when_it_takes_a_part_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int, words: str
) -> None:
    """Each new part is taken and fails soon after: the log comes while it is being recorded."""
    monkeypatch.setattr(session, "RETRY_S", 0.05)
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:

        def broken(_: int) -> None:
            raise OSError(number, os.strerror(number))

        with monkeypatch.context() as disk:
            disk.setattr(os, "fsync", broken)
            for k in range(100):
                recorder.record(read(k), (), None)
            numbers = itertools.count(100)

            def drops() -> bool:
                """Hand over a read; those that a new part takes before it fails are not dropped."""
                recorder.record(read(next(numbers)), (), None)
                return recorder.reads_dropped >= 10

            until(lambda: recorder.progress.state == "failed")
            until(drops)
        until(lambda: recorder.progress.state == "recording")
        report(recorder)
    (line,) = [record.getMessage() for record in caplog.records if "in no file" in record.getMessage()]
    assert words in line
    assert "too slow" not in line


def test_a_disk_that_does_not_answer_is_named_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_module, "_QUEUE_ITEMS", 50)
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        disk = StuckDisk(monkeypatch)
        recorder.record(read(0), (), None)
        assert disk.entered.wait(PATIENCE_S)
        assert report(recorder).state == "recording"
        monkeypatch.setattr(recorder_module, "_SILENT_S", 0.0)
        for k in range(100):
            recorder.record(read(k), (), None)
        event = report(recorder)
        assert (event.state, event.reason) == ("failed", f"{tmp_path / 'a.mcap'}: the disk does not answer")
        monkeypatch.undo()
        disk.free.set()
        until(lambda: report(recorder).state == "recording")
    (line,) = [record.getMessage() for record in caplog.records if "in no file" in record.getMessage()]
    assert "the disk does not answer" in line


def test_a_folder_that_goes_away_is_named_as_such(tmp_path: Path) -> None:
    place = tmp_path / "usb"
    place.mkdir()
    with Recorder(PARAMS, HEADER, place / "a.mcap") as recorder:
        shutil.rmtree(place)
        for k in range(10):
            recorder.record(read(k), (), None)
        until(lambda: recorder.progress.state == "failed")
        assert "is its disk gone?" in report(recorder).reason


def test_an_unwritable_path_is_reported_at_the_start() -> None:
    sysfs = Path("/sys")  # takes no files, not even from root
    with Recorder(PARAMS, HEADER, sysfs / "a.mcap") as recorder:
        assert report(recorder).state == "failed"
        with pytest.raises(DataError, match=r"/sys/a\.mcap\.active: cannot be written \(.*choose a place"):
            recorder.check()


def test_a_directory_that_appears_after_the_start_is_recorded_into(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(session, "RETRY_S", 0.1)
    place = tmp_path / "usb"
    with Recorder(PARAMS.model_copy(update={"directory": str(place)}), HEADER) as recorder:
        assert report(recorder).state == "failed"
        assert (
            "No such file or directory; make the directory, or choose another one" in report(recorder).reason
        )
        for k in range(10):
            recorder.record(read(k), (), None)
        until(lambda: recorder.reads_dropped == 10)
        time.sleep(0.3)  # tried again, and logged once
        place.mkdir()
        until(lambda: report(recorder).state == "recording")
        recorder.record(read(10), (), None)
    assert caplog.text.count("not recording") == 1
    (file,) = place.iterdir()
    mark, kept = items(file)
    assert isinstance(mark, Input)
    assert (mark.name, mark.values()["reads"]) == ("dropped", 10)
    assert kept == read(10)
    assert not read_header(file).fresh


def test_a_disk_without_room_at_the_start_is_recorded_onto_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room_mb = 100.0
    monkeypatch.setattr(session, "free_mb", lambda _: room_mb)
    params = RecordParams(sync_s=0.05, min_free_mb=500, directory=str(tmp_path))
    with Recorder(params, HEADER) as recorder:
        assert report(recorder).state == "no-room"
        assert "the free space fell below record.min_free_mb = 500" in report(recorder).reason
        room_mb = 600.0
        until(lambda: report(recorder).state == "recording")
        assert recorder.switch(False, None) == ""
        until(lambda: report(recorder).state == "off")


def test_a_hanging_disk_does_not_delay_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = StuckDisk(monkeypatch)
    began_s = time.monotonic()
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        assert time.monotonic() - began_s < PATIENCE_S / 2  # the disk hangs for longer
        assert report(recorder).state == "failed"
        assert "does not answer" in report(recorder).reason
        recorder.record(read(0), (), None)
        disk.free.set()
        until(lambda: report(recorder).state == "recording")
    assert items(tmp_path / "a.mcap") == [read(0)]
    assert read_header(tmp_path / "a.mcap").fresh


def test_switched_on_and_off_while_running(tmp_path: Path) -> None:
    params = PARAMS.model_copy(update={"directory": str(tmp_path)})
    with Recorder(params, HEADER) as recorder:
        recorder.record(read(0), (), None)
        assert recorder.switch(True, None) == ""  # it is on already
        assert recorder.switch(False, None) == ""
        recorder.record(read(1), (), None)
        until(lambda: report(recorder).state == "off")
        assert recorder.switch(True, None) == ""
        recorder.record(read(2), (), None)
        until(lambda: report(recorder).state == "recording")
        assert recorder.switch(True, None) == ""
    first, second = sorted(tmp_path.glob("*.mcap"))
    assert (items(first), items(second)) == ([read(0)], [read(2)])
    assert (read_header(first).fresh, read_header(second).fresh) == (True, False)
    with Recorder(PARAMS, HEADER) as recorder:
        assert "set record.directory" in recorder.switch(True, None)
        recorder.record(read(0), (), None)
        assert report(recorder).state == "off"


def test_reports_come_each_second_and_at_changes(tmp_path: Path) -> None:
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        assert recorder.report(100.0) is not None
        assert recorder.report(100.5) is None
        assert recorder.report(101.0) is not None
        recorder.switch(False, None)
        until(lambda: recorder.progress.state == "off")
        changed = recorder.report(101.1)
        assert changed is not None
        assert changed.state == "off"


def test_a_bug_ends_the_recording_and_not_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with Recorder(PARAMS, HEADER, tmp_path / "a.mcap") as recorder:
        may_fail = threading.Event()
        fail = lambda *_: may_fail.wait(PATIENCE_S) / 0  # noqa: E731
        monkeypatch.setattr(recorder._session, "take", fail)  # noqa: SLF001  a fault is put into the disk
        with caplog.at_level(logging.ERROR):
            for k in range(6):
                recorder.record(read(k), (), None)
            may_fail.set()
            until(lambda: report(recorder).state == "failed")
        for k in range(6, 11):
            recorder.record(read(k), (), None)
        assert (report(recorder).reads_dropped, report(recorder).reads_waiting) == (10, 0)
        assert recorder.switch(True, None) == "a fault of tactiled itself, see the log"
    assert "ZeroDivisionError" in caplog.text
    monkeypatch.undo()
    assert items(tmp_path / "a.mcap") == []


def test_a_directory_is_kept_within_its_limit_while_recording(tmp_path: Path) -> None:
    old = [tmp_path / f"tactile-20200101T00000{k}.000Z.mcap" for k in range(3)]
    for k, path in enumerate(old):
        path.write_bytes(bytes(1_000_000))
        os.utime(path, (1000.0 + k, 1000.0 + k))
    mine = tmp_path / "mine.mcap"
    mine.write_bytes(bytes(1_000_000))
    params = PARAMS.model_copy(update={"directory": str(tmp_path), "keep_mb": 1.5})
    with Recorder(params, HEADER) as recorder:
        until(lambda: not old[1].exists())
        assert not old[0].exists()
        recorder.record(read(0), (), None)
    assert old[2].exists()
    assert mine.exists()
    params = PARAMS.model_copy(update={"directory": str(tmp_path), "keep_mb": 0.001})
    with Recorder(params, HEADER, tmp_path / "named.mcap") as recorder:
        time.sleep(0.3)
        assert report(recorder).state == "recording"
    assert old[2].exists()  # of a file named by hand nobody expects that it removes others


def test_files_of_an_earlier_run_are_recovered_while_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "RETRY_S", 0.1)
    # At its own niceness, the process takes a minute or more where others fill the processors.
    monkeypatch.setattr(recorder_module, "_RECOVERY_NICE", 0)
    place = tmp_path / "records"
    name = "tactile-20200101T000000.000Z.mcap"
    params = PARAMS.model_copy(update={"directory": str(place)})
    with Recorder(params, HEADER) as recorder:  # the directory comes later, with a file in it
        (tmp_path / "made").mkdir()
        left = RecordingWriter(tmp_path / "made" / name, HEADER)
        for k in range(5):
            left.read(read(k))
        left.sync()
        left.abandon()
        (tmp_path / "made").rename(place)
        until(lambda: report(recorder).state == "recording")
        until(lambda: (place / name).exists() and not (place / f"{name}.active").exists())
        assert report(recorder).state == "recording"
        assert len(list(place.glob("*.active"))) == 1  # our own
    assert items(place / name) == [read(k) for k in range(5)]


def test_a_recovery_has_the_lowest_priority_and_close_does_not_wait_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = RecordingWriter(tmp_path / "tactile-20200101T000000.000Z.mcap", HEADER)
    left.abandon()
    slow, pid = tmp_path / "slow", tmp_path / "pid"
    slow.write_text(f"#!/bin/sh\necho $$ > {pid}\nexec sleep 600\n")
    slow.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(slow))
    with Recorder(PARAMS.model_copy(update={"directory": str(tmp_path)}), HEADER) as recorder:
        until(lambda: report(recorder).state == "recording")
        until(lambda: pid.exists() and pid.read_text().endswith("\n"))
        until(lambda: os.getpriority(os.PRIO_PROCESS, int(pid.read_text())) == 19)
        began_s = time.monotonic()
    assert time.monotonic() - began_s < PATIENCE_S
    assert left.active.exists()
