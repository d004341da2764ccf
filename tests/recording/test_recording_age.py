"""Removal by age: recordings prove that time has passed, and a clock that is wrong does not."""

import logging
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import HEADER

from tactiled.recording import age
from tactiled.recording.age import Instant, RecordedSpan, SpanCache, proven_ages_s, span_of
from tactiled.recording.contents import Read
from tactiled.recording.directory import finished, new_name
from tactiled.recording.retention import Retention
from tactiled.recording.rotation import RecordParams
from tactiled.recording.session import RecordingSession
from tactiled.recording.writer import RecordingWriter

DAY_S = 86400.0
START_S = 1.7e9  # epoch


def place(directory: Path, day: float, up_s: float = 100.0, last_s: float = 60.0) -> Path:
    """Write a recording of `last_s` seconds that begins `up_s` after the start of the host."""
    begun_s = START_S + day * DAY_S
    path = directory / new_name(datetime.fromtimestamp(begun_s, UTC))
    with RecordingWriter(path, HEADER) as writer:
        for at_s in (0.0, last_s / 2, last_s):
            writer.read(Read(up_s + at_s, begun_s - up_s, b"read"))
            writer.sync()
    os.utime(path, (begun_s + last_s, begun_s + last_s))
    return path


def check(directory: Path, day: float, keep_days: float = 30.0) -> tuple[list[Path], str]:
    """Check the directory at a time of the wall clock; return what was removed, and why nothing was."""
    retained = Retention(directory, None, keep_days).check(START_S + day * DAY_S)
    return [file.path for file in retained.removed], retained.unproven


def test_a_clock_that_is_31_days_ahead_removes_none_of_five_recordings(tmp_path: Path) -> None:
    paths = [place(tmp_path, k / 1440, up_s=100.0 + 60 * k) for k in range(5)]
    removed, unproven = check(tmp_path, 31.0)
    assert removed == []
    assert all(path.exists() for path in paths)
    assert "5 recordings" in unproven
    assert "which may be wrong" in unproven
    assert check(tmp_path, 1.0) == ([], "")


@pytest.mark.parametrize("up_s", [500.0, 50.0])  # the clock was set while the host ran, or it was restarted
def test_a_recording_made_with_the_wrong_clock_removes_none_either(tmp_path: Path, up_s: float) -> None:
    for k in range(5):
        place(tmp_path, k / 1440, up_s=100.0 + 60 * k)
    place(tmp_path, 31.0, up_s)
    assert check(tmp_path, 31.0)[0] == []


def test_a_new_start_with_a_clock_behind_removes_none_of_its_recordings(tmp_path: Path) -> None:
    """The host ran for 40 days with a right clock; after a new start its clock is 60 days behind."""
    place(tmp_path, 60.0, up_s=39 * DAY_S)
    place(tmp_path, 61.0, up_s=40 * DAY_S)
    new = [place(tmp_path, 1.0 + k / 1440, up_s=100.0 + 60 * k) for k in range(4)]
    removed, _ = check(tmp_path, 1.1)
    assert removed == []
    assert all(path.exists() for path in new)


def test_a_clock_that_is_set_within_a_recording_removes_none(tmp_path: Path) -> None:
    first = place(tmp_path, 0.0)
    with RecordingWriter(tmp_path / new_name(datetime.fromtimestamp(START_S + 300, UTC)), HEADER) as writer:
        writer.read(Read(400.0, START_S - 100, b"before"))
        writer.read(Read(401.0, START_S - 100 + 31 * DAY_S, b"after"))
    assert check(tmp_path, 31.0)[0] == []
    assert first.exists()


def test_daily_recordings_are_removed_after_30_days(tmp_path: Path) -> None:
    paths = [place(tmp_path, float(day)) for day in range(33)]
    retention = Retention(tmp_path, None, 30.0)
    for _ in range(1 + 33 // age.MOST_READ):
        retained = retention.check(START_S + 32 * DAY_S)
    assert [path for path in paths if not path.exists()] == paths[:2]
    assert retained.unproven == ""


def test_a_host_that_runs_on_proves_a_pause_without_recordings(tmp_path: Path) -> None:
    first = place(tmp_path, 0.0, up_s=100.0)
    place(tmp_path, 31.0, up_s=100.0 + 31 * DAY_S)
    assert check(tmp_path, 31.0)[0] == [first]


def test_files_that_hold_no_times_are_kept(tmp_path: Path) -> None:
    for k, data in enumerate((b"", b"garbage", bytes(1000))):
        path = tmp_path / new_name(datetime.fromtimestamp(START_S + k, UTC))
        path.write_bytes(data)
        os.utime(path, (START_S, START_S))
        assert span_of(path) is None
    place(tmp_path, 31.0, up_s=31 * DAY_S)
    assert check(tmp_path, 40.0)[0] == []


def test_a_span_is_read_from_both_ends_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = place(tmp_path, 0.0, up_s=100.0, last_s=60.0)
    cache = SpanCache()
    expected = RecordedSpan(Instant(START_S, 100.0), Instant(START_S + 60.0, 160.0))
    assert cache.of(finished(tmp_path)) == {path: expected}
    monkeypatch.setattr(age, "span_of", lambda _: None)
    assert cache.of(finished(tmp_path)) == {path: expected}


clocks = st.builds(Instant, st.floats(0, 1e10), st.floats(0, 1e8))


@given(spans=st.lists(st.builds(RecordedSpan, clocks, clocks), max_size=8), pause_s=st.floats(0, 1e6))
def test_an_age_is_never_more_than_the_wall_clock_says_nor_below_zero(
    spans: list[RecordedSpan], pause_s: float
) -> None:
    named = {Path(str(k)): span for k, span in enumerate(spans)}
    newest_s = max((max(s.first.unix_s, s.last.unix_s) for s in spans), default=0.0)
    for path, age_s in proven_ages_s(named, pause_s).items():
        assert 0 <= age_s <= (newest_s - named[path].last.unix_s) * (1 + 1e-9)


@given(
    days=st.lists(st.floats(0, 1), min_size=2, max_size=8),
    jumps=st.lists(st.floats(0, 1000), max_size=3),
)
def test_each_error_of_the_clock_counts_at_most_one_pause(days: list[float], jumps: list[float]) -> None:
    """Recordings of one start of the host, whose wall clock jumps ahead between some of them."""
    true_s = sorted(day * DAY_S for day in days)
    shift_s = [sum(jumps[: k + 1]) * DAY_S if jumps else 0.0 for k in range(len(true_s))]
    spans = {
        Path(str(k)): RecordedSpan(Instant(t + shift, t), Instant(t + shift, t))
        for k, (t, shift) in enumerate(zip(true_s, shift_s, strict=True))
    }
    ages_s = proven_ages_s(spans, DAY_S)
    for k, t in enumerate(true_s):
        assert ages_s[Path(str(k))] <= true_s[-1] - t + DAY_S * len(jumps) + 1e-3


def test_the_session_says_once_why_recordings_are_kept(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    old = place(tmp_path, 0.0)  # years before this test runs
    place(tmp_path, 0.1)
    params = RecordParams(directory=str(tmp_path), keep_days=30.0, min_free_mb=0)
    session = RecordingSession(params, HEADER, None, 0.0)
    with caplog.at_level(logging.WARNING):
        for now_s in (0.0, 61.0, 122.0):
            session.tick(now_s)
    session.end(123.0)
    assert old.exists()
    assert caplog.text.count("by the clock of this host") == 1


@pytest.mark.parametrize(("stepped_s", "counts"), [(0.9, True), (-0.9, True), (30.0, False)])
def test_a_clock_that_a_time_server_steps_by_less_than_a_second_runs_on(
    stepped_s: float, counts: bool
) -> None:
    first, last = Instant(START_S, 10.0), Instant(START_S + 100.0 + stepped_s, 110.0)
    spans = {Path("old"): RecordedSpan(first, first), Path("new"): RecordedSpan(last, last)}
    assert proven_ages_s(spans, pause_s=0.0)[Path("old")] == pytest.approx(100.0 if counts else 0.0, abs=1.0)
