"""Removal by age: the time that the daemon has run counts, and a clock that is wrong does not."""

import json
import logging
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import HEADER

from tactiled.recording.age import FILE, PAUSE_PART, Ages
from tactiled.recording.directory import new_name
from tactiled.recording.retention import Retention
from tactiled.recording.rotation import RecordParams
from tactiled.recording.session import RecordingSession

DAY_S = 86400.0
START_S = 1.7e9  # epoch
RIGHT = 0.0  # error of the wall clock


class Host:
    """A daemon that records into a directory, on a host whose wall clock may be wrong."""

    def __init__(self, directory: Path, keep_days: float | None = 30.0, keep_mb: float | None = None) -> None:
        self.directory, self.keep = directory, (keep_mb, keep_days)
        self.true_s, self.n_boots = 0.0, 0
        self.start(RIGHT)

    def start(self, error_days: float, off_days: float = 0.0) -> None:
        """Start the host anew after a time in which it was off; its monotonic clock begins at 0."""
        self.true_s += off_days * DAY_S
        self.began_s, self.n_boots = self.true_s, self.n_boots + 1
        self.restart(error_days)

    def restart(self, error_days: float) -> None:
        """Start the daemon anew while the host goes on."""
        self.retention = Retention(self.directory, *self.keep, boot=f"boot {self.n_boots}")
        self.error_days = error_days
        self.check()

    def record(self) -> Path:
        """Write a recording of a minute."""
        self.true_s += 60.0
        wall_s = START_S + self.true_s + self.error_days * DAY_S
        path = self.directory / new_name(datetime.fromtimestamp(wall_s, UTC))
        path.write_bytes(bytes(1000))
        os.utime(path, (wall_s, wall_s))
        self.check()
        return path

    def run(self, days: float) -> None:
        """Run for days, an hour at a time."""
        for _ in range(round(24 * days)):
            self.true_s += 3600.0
            self.check()

    def check(self) -> list[Path]:
        """Check the directory, and return what was removed."""
        wall_s = START_S + self.true_s + self.error_days * DAY_S
        retained = self.retention.check(self.true_s - self.began_s, wall_s)
        self.unproven = retained.unproven
        return [file.path for file in retained.removed]


def test_a_recording_is_removed_when_the_daemon_has_run_for_30_days(tmp_path: Path) -> None:
    host = Host(tmp_path)
    old = host.record()
    host.run(15.0)
    new = host.record()
    host.run(14.9)
    assert old.exists()
    host.run(0.2)
    assert not old.exists()
    assert new.exists()
    assert host.unproven == ""


def test_daily_use_is_removed_after_30_days(tmp_path: Path) -> None:
    host = Host(tmp_path)
    first = host.record()
    for day in range(1, 32):
        host.run(0.25)
        host.start(RIGHT, off_days=0.75)
        host.record()
        assert first.exists() == (day < 30)


@pytest.mark.parametrize("error_days", [31.0, -60.0, 3650.0, -3650.0])
@pytest.mark.parametrize("is_new_start", [True, False])
def test_a_clock_that_jumps_removes_nothing(tmp_path: Path, error_days: float, is_new_start: bool) -> None:
    """Neither what was there before nor what is recorded after it, whichever way the clock jumps."""
    host = Host(tmp_path)
    for _ in range(3):
        host.record()
        host.run(9.0)
    if is_new_start:
        host.start(error_days)
    host.error_days = error_days
    for _ in range(5):
        host.record()
    assert len(list(tmp_path.glob("*.mcap"))) == 8


def test_a_daemon_that_starts_again_and_again_trusts_no_clock_within_a_boot(tmp_path: Path) -> None:
    """A crash loop while the clock jumps by days, and a host that learns the time after each boot."""
    host = Host(tmp_path)
    old = host.record()
    host.run(3.0)
    for flip in range(80):
        host.restart(3.0 * (flip % 2))
    for _ in range(40):
        host.start(-host.true_s / DAY_S - 19000.0)  # 1970, until a server has told the time
        host.true_s += 300.0
        host.check()
        host.restart(RIGHT)
    assert old.exists()
    host.record()
    host.run(26.8)
    assert old.exists()
    host.run(0.4)
    assert not old.exists()


def test_a_clock_that_was_a_year_ahead_and_is_corrected_removes_old_ones_alone(tmp_path: Path) -> None:
    host = Host(tmp_path)
    host.error_days = 365.0
    old = [host.record() for _ in range(3)]
    host.run(29.0)
    host.error_days = RIGHT
    new = [host.record() for _ in range(3)]
    host.run(1.5)
    assert [path.exists() for path in old + new] == [False] * 3 + [True] * 3


def test_a_host_without_a_clock_removes_nothing_of_its_newest_run(tmp_path: Path) -> None:
    """Each start begins at the same instant of the wall clock."""
    host = Host(tmp_path)
    host.record()
    host.run(29.0)
    host.start(-host.true_s / DAY_S + 0.01)  # a quarter of an hour later, so that names differ
    new = [host.record() for _ in range(5)]
    host.run(2.0)
    assert all(path.exists() for path in new)


def test_size_removes_what_was_there_first_whatever_its_date(tmp_path: Path) -> None:
    host = Host(tmp_path, keep_days=None, keep_mb=0.007)
    old = [host.record() for _ in range(5)]
    host.start(-3650.0)
    new = [host.record() for _ in range(5)]
    assert [path.exists() for path in old + new] == [False] * 3 + [True] * 7


@given(
    steps=st.lists(
        st.tuples(st.sampled_from(["record", "run", "start", "set"]), st.floats(-4000, 4000)), max_size=12
    )
)
def test_an_age_is_at_most_the_time_run_and_a_pause_for_each_boot(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[str, float]]
) -> None:
    host = Host(tmp_path_factory.mktemp("records"))
    begun: dict[str, tuple[float, int]] = {}
    ran_s, n_starts = 0.0, 0
    for what, value in steps:
        if what == "record":
            name = host.record().name
            ran_s += 60.0
            begun.setdefault(name, (ran_s, n_starts))
        elif what == "run":
            host.run(1.0)
            ran_s += DAY_S
        elif what == "start":
            host.start(value)
            n_starts += 1
        else:
            host.error_days = value
    host.check()
    ages_s = json.loads((host.directory / FILE).read_text())["ages_s"]
    for name, age_s in ages_s.items():
        at_s, starts = begun[name]
        assert 0 <= age_s <= ran_s - at_s + 30 * DAY_S * PAUSE_PART * (n_starts - starts) + 1e-3


@pytest.mark.parametrize(
    "text",
    [
        "", "[", "[]", "{}",
        '{"saved_unix_s": 1, "ages_s": {"a": 1}}', '{"saved_unix_s": 1, "ages_s": []}',
        '{"saved_unix_s": 1e999, "ages_s": {}}',
        '{"saved_unix_s": 1, "ages_s": {"a": -1}}', '{"saved_unix_s": 1, "ages_s": {"a": "x"}}', "[" * 5000,
        '{"saved_unix_s": 1, "ages_s": {"a": 1e999}}', f'{{"saved_unix_s": {"9" * 4000}, "ages_s": {{}}}}',
    ],
)  # fmt: skip
def test_a_file_of_ages_that_is_damaged_makes_recordings_new(tmp_path: Path, text: str) -> None:
    (tmp_path / FILE).write_text(text)
    assert Ages(tmp_path, 100.0, "now").advance(["a"], 5.0, START_S) == {"a": 0.0}
    saved = {"ages_s": {"a": 0.0}, "saved_unix_s": START_S, "saved_s": 5.0, "boot": "now"}
    assert json.loads((tmp_path / FILE).read_text()) == saved


def test_a_link_where_ages_are_written_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / FILE).with_suffix(".part").symlink_to(victim)
    Ages(tmp_path, 0.0, "").advance(["a"], 0.0, START_S)
    assert victim.read_text() == "mine"
    assert json.loads((tmp_path / FILE).read_text())["ages_s"] == {"a": 0.0}


def test_ages_that_cannot_be_written_are_counted_all_the_same(tmp_path: Path) -> None:
    (tmp_path / FILE).mkdir()
    ages = Ages(tmp_path, 0.0, "")
    ages.advance(["a"], 0.0, START_S)
    assert ages.advance(["a", "b"], 50.0, START_S) == {"a": 50.0, "b": 0.0}


def test_ages_are_written_every_ten_minutes_and_with_each_new_recording(tmp_path: Path) -> None:
    ages = Ages(tmp_path, 0.0, "")

    def saved() -> object:
        return json.loads((tmp_path / FILE).read_text())["ages_s"]

    ages.advance(["a"], 0.0, START_S)
    ages.advance(["a"], 599.0, START_S)
    assert saved() == {"a": 0.0}
    ages.advance(["a"], 600.0, START_S)
    assert saved() == {"a": 600.0}
    ages.advance(["a", "b"], 601.0, START_S)
    assert saved() == {"a": 601.0, "b": 0.0}


def test_the_session_says_once_why_recordings_are_kept(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    old = tmp_path / new_name(datetime.fromtimestamp(START_S, UTC))  # years before this test runs
    old.write_bytes(b"")
    os.utime(old, (START_S, START_S))
    params = RecordParams(directory=str(tmp_path), keep_days=30.0, min_free_mb=0)
    session = RecordingSession(params, HEADER, None, 0.0)
    with caplog.at_level(logging.WARNING):
        for now_s in (0.0, 61.0, 122.0):
            session.tick(now_s)
    session.end(123.0)
    assert old.exists()
    assert caplog.text.count("by the clock of this host") == 1
