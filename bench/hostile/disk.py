"""Disks and clocks: recordings that must not be deleted."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from bench.hostile.attack import Attack, Outcome
from tactiled.recording.age import FILE
from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.directory import new_name
from tactiled.recording.writer import RecordingWriter

_DAY_S = 86400.0
_KEEP_DAYS = 30
_REASON = "by the clock of this host"
_WAIT_S = 20.0  # for the daemon's first check of its directory, on a busy host


def _written(directory: Path, began_unix_s: float, up_s: float) -> Path:
    """Write a finished recording of a minute that begins `up_s` after the start of its host."""
    path = directory / new_name(datetime.fromtimestamp(began_unix_s, UTC))
    with RecordingWriter(path, Header(load_board("board-v1", "wang2019-3x3"))) as writer:
        for at_s in (0.0, 60.0):
            writer.read(Read(up_s + at_s, began_unix_s - up_s, b"read"))
    os.utime(path, (began_unix_s + 60, began_unix_s + 60))
    return path


@contextlib.contextmanager
def _daemon(folder: Path, records: Path) -> Iterator[Path]:
    """Run a daemon without a board that keeps its recordings for 30 days; yield its log."""
    config = folder / "board.toml"
    config.write_text(
        f'[port]\nurl = "socket://127.0.0.1:9"\n[record]\ndirectory = "{records}"\nkeep_days = {_KEEP_DAYS}\n'
        f'min_free_mb = 0\n[publish]\nendpoints = ["ipc://{folder}/events"]\ncontrol_endpoints = ["ipc://{folder}/control"]\n'
    )
    log = folder / "log"
    with log.open("wb") as stream:
        command = [sys.executable, "-m", "tactiled", "run", "--config", str(config)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stream)
        try:
            yield log
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=_WAIT_S)


def _until(log: Path, words: str) -> bool:
    end_s = time.monotonic() + _WAIT_S
    while time.monotonic() < end_s:
        if words in log.read_text(errors="replace"):
            return True
        time.sleep(0.05)
    return False


def _looks(records: Path, paths: list[Path]) -> bool:
    """Wait until the daemon has counted the ages of recordings, and removed what it would."""
    end_s = time.monotonic() + _WAIT_S
    while time.monotonic() < end_s:
        with contextlib.suppress(OSError):
            counted = json.loads((records / FILE).read_text())["ages_s"]
            if all(path.name in counted for path in paths):
                time.sleep(0.5)
                return True
        time.sleep(0.05)
    return False


def _clock_ahead(folder: Path, _: float) -> Outcome:
    # A clock that is 31 days ahead sees recordings of this minute as these are seen by a clock that is right.
    begin_s = time.time() - 31 * _DAY_S
    records = folder / "records"
    records.mkdir()
    paths = [_written(records, begin_s + 60 * k, 1000.0 + 60 * k) for k in range(5)]
    with _daemon(folder, records) as log:
        is_said = _until(log, _REASON)
    n_left = sum(path.exists() for path in paths)
    return Outcome(f"{n_left} of 5 left, reason in the log: {is_said}", held=n_left == 5 and is_said)


def _recorded(folder: Path, days: float) -> Outcome:
    """Keep 5 recordings of a clock that was right, and 5 of the same clock when it is some days off."""
    records = folder / "records"
    records.mkdir()
    now_s = time.time()
    paths = [_written(records, now_s + 60 * k, 1000.0 + 60 * k) for k in range(-10, -5)]
    with _daemon(folder, records):
        looked = _looks(records, paths)
    paths += [_written(records, now_s + days * _DAY_S + 60 * k, 1400.0 + 60 * k) for k in range(-5, 0)]
    with _daemon(folder, records):
        looked = _looks(records, paths) and looked
    n_left = sum(path.exists() for path in paths)
    return Outcome(f"{n_left} of 10 left, the daemon looked: {looked}", held=n_left == 10 and looked)


def _recorded_ahead(folder: Path, _: float) -> Outcome:
    return _recorded(folder, 31.0)


def _recorded_behind(folder: Path, _: float) -> Outcome:
    return _recorded(folder, -3650.0)


def _month_passed(folder: Path, _: float) -> Outcome:
    records = folder / "records"
    records.mkdir()
    now_s = time.time()
    old = _written(records, now_s - 31 * _DAY_S, 1000.0)
    new = _written(records, now_s - 60, 1000.0 + 31 * _DAY_S)
    ages_s = {old.name: 31 * _DAY_S, new.name: 0.0}
    (records / FILE).write_text(
        json.dumps({"ages_s": ages_s, "saved_unix_s": now_s, "saved_s": 0.0, "boot": ""})
    )
    with _daemon(folder, records) as log:
        is_said = _until(log, "removed the 1 oldest")
    return Outcome(
        f"old one {'kept' if old.exists() else 'removed'}, new one {'kept' if new.exists() else 'removed'}",
        held=is_said and not old.exists() and new.exists(),
    )


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "clock ahead",
        "5 recordings of the last minutes, the clock 31 days ahead, keep_days = 30; tactiled run",
        "5 of 5 left, and the log says why",
        _clock_ahead,
    ),
    Attack(
        "clock ahead, recorded",
        "5 recordings, and 5 more that were made 31 days ahead; two runs of the daemon",
        "10 of 10 left, which the daemon has looked at",
        _recorded_ahead,
    ),
    Attack(
        "clock behind, recorded",
        "5 recordings, and 5 more that were made with a clock ten years behind; two runs of the daemon",
        "10 of 10 left, which the daemon has looked at",
        _recorded_behind,
    ),
    Attack(
        "a month that passed",
        "two recordings, one of which the daemon has run beside for 31 days, keep_days = 30",
        "the old one is removed, the new one kept",
        _month_passed,
    ),
)
