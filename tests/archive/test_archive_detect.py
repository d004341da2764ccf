"""Many files in one table: the same bytes on any number of cores, and one bad file is a row."""

import errno
import io
import json
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import pyarrow.parquet
import pytest
from patience import PATIENCE_S
from recordings import record, simulated_reads

from tactiled.archive.detect import (
    FILE_TOPIC,
    Outcome,
    analyse,
    detect_patterns,
    event_rows,
    file_row,
    in_order,
    matching,
    schema,
)
from tactiled.cli import main
from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.offline import Choices, detect_file

N_FILES = 4
MESSAGES = [{"topic": "slip", "seq": 3, "timestamp": 1.5, "valid": True, "taxels": [1, 2]}]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of a slide, each a little shorter, and a file that is none."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "left").mkdir()
    reads = simulated_reads(9.0, "demo")
    for k in range(N_FILES):
        record(folder / "left" / f"{k}.mcap", reads[: len(reads) - 40 * k])
    (folder / "bad.mcap").write_bytes(b"no recording at all")
    return folder


def detect(names: list[str], to: Path, n_workers: int, choices: Choices | None = None) -> Outcome:
    return detect_patterns(names, to, None, None, choices or Choices(), n_workers)


@pytest.fixture
def files_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let files vanish between the search for them and their analysis."""
    monkeypatch.setattr("tactiled.archive.detect.matching", list)


@pytest.fixture(scope="module")
def expected(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table as one process computes it."""
    to = tmp_path_factory.mktemp("one") / "events.parquet"
    detect([f"{runs}/**/*.mcap"], to, 1)
    return to.read_bytes()


def test_the_table_has_the_events_that_detect_prints(
    runs: Path, expected: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "events.parquet"
    path.write_bytes(expected)
    rows = pyarrow.parquet.read_table(path).to_pylist()
    detect_file(runs / "left" / "2.mcap")
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    found = [row for row in rows if row["file"] == f"{runs}/left/2.mcap" and row["topic"] != "file"]
    assert len(printed) == len(found) > 0
    for message, row in zip(printed, found, strict=True):
        known = {key: value for key, value in message.items() if key not in ("v", "board", "run")}
        assert known.items() <= row.items()
        assert all(row[key] is None for key in row.keys() - message.keys() - {"file"})


def test_a_bad_file_is_a_row_with_its_error(runs: Path, expected: bytes, tmp_path: Path) -> None:
    path = tmp_path / "events.parquet"
    path.write_bytes(expected)
    rows = [row for row in pyarrow.parquet.read_table(path).to_pylist() if row["topic"] == "file"]
    names = ["bad.mcap", *(f"left/{k}.mcap" for k in range(N_FILES))]
    assert [row["file"] for row in rows] == [f"{runs}/{name}" for name in names]
    assert rows[0]["error"].startswith(f"{runs}/bad.mcap: ")
    assert [row["error"] for row in rows[1:]] == [""] * N_FILES
    assert "Hz" in rows[1]["summary"]


def test_two_processes_write_the_same_bytes(runs: Path, expected: bytes, tmp_path: Path) -> None:
    outcome = detect([f"{runs}/**/*.mcap"], tmp_path / "events.parquet", 2)
    assert (tmp_path / "events.parquet").read_bytes() == expected
    assert [file for file, _ in outcome.failed] == [f"{runs}/bad.mcap"]


def test_a_process_that_ends_is_an_error_and_leaves_no_table(runs: Path, tmp_path: Path) -> None:
    def kill() -> None:
        while not (workers := multiprocessing.active_children()):
            time.sleep(0.001)
        workers[0].kill()

    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(OperatorError, match="its process ended, out of memory"):
        detect([f"{runs}/**/*.mcap"], tmp_path / "events.parquet", 1)
    killer.join()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("files_go")
def test_a_file_that_is_gone_and_a_name_that_is_not_utf8_are_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    odd = os.fsdecode(b"\xff.mcap")
    Path(odd).write_bytes(b"")
    outcome = detect(["gone.mcap", odd], tmp_path / "events.parquet", 1)
    assert outcome.failed[0] == ("gone.mcap", "no such file any more")
    rows = pyarrow.parquet.read_table(tmp_path / "events.parquet").to_pylist()
    assert [row["file"] for row in rows] == ["gone.mcap", "\\xff.mcap"]


def test_a_file_that_cannot_be_looked_at_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    stale = OSError(errno.ESTALE, "Stale file handle")
    monkeypatch.setattr(Path, "exists", mock.Mock(side_effect=stale))
    rows = pyarrow.parquet.read_table(io.BytesIO(analyse("a.npz", None, None, Choices()))).to_pylist()
    assert [row["error"] for row in rows] == ["cannot be read: Stale file handle"]


def test_a_file_is_found_once_however_it_is_spelled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "1.npz").touch()
    assert matching(["a/1.npz", "./a/1.npz", "a/../a/*.npz", f"{tmp_path}/a/1.npz"]) == ["a/1.npz"]


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    program = tmp_path / "parent.py"
    program.write_text(
        "import os, sys, time\nfrom tactiled.jobs import executor\n"
        "if __name__ == '__main__':\n"
        "    with executor(1) as pool:\n"
        "        print(pool.submit(os.getpid).result(), flush=True)\n"
        "        time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        parent.kill()
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s and is_alive(worker):
        time.sleep(0.02)
    assert not is_alive(worker)


def is_alive(pid: int) -> bool:
    """Return whether a process runs; one that has ended may wait for a parent that asks for its exit code."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_wrong_parameter_is_found_before_any_file(runs: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="setting"):
        detect([f"{runs}/bad.mcap"], tmp_path / "events.parquet", 1, Choices(setting="none"))
    assert list(tmp_path.iterdir()) == []


def test_options_that_do_not_fit_are_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, told in (
        (["a.csv", "b.csv"], "--to TABLE.parquet for many files"),
        (["a.csv", "--jobs", "2"], "--to TABLE.parquet"),
        (["a.csv", "--to", f"{tmp_path}/none/events.parquet"], "folder that exists"),
        (["a.csv", "--to", f"{tmp_path}/events.csv"], "name a .parquet"),
        ([f"{tmp_path}/*.mcap", "--to", f"{tmp_path}/events.parquet"], "no file matches"),
    ):
        with pytest.raises(SystemExit) as end:
            run_command_with(["detect", *words])
        assert end.value.code == 2
        assert told in capsys.readouterr().err


def run_command_with(words: list[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["tactiled", *words])
        main()


def test_patterns_name_each_file_once_and_sorted(tmp_path: Path) -> None:
    for name in ("b.mcap", "a.mcap", "sub/c.mcap", "[x].mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = matching([f"{tmp_path}/**/*.mcap", f"{tmp_path}/a.mcap", f"{tmp_path}/[x].mcap"])
    assert [str(Path(name).relative_to(tmp_path)) for name in found] == [
        "[x].mcap",
        "a.mcap",
        "b.mcap",
        "sub/c.mcap",
    ]
    with pytest.raises(DataError, match="no such file, and no file matches"):
        matching([f"{tmp_path}/a.mcap", f"{tmp_path}/*.csv"])


def rows_of(table: Any) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if value is not None} for row in table.to_pylist()]


def test_a_table_has_a_row_for_the_file_and_one_for_each_event() -> None:
    head, events = file_row("a.csv", "36 channels"), event_rows("a.csv", MESSAGES)
    assert head.schema == events.schema == schema()
    assert rows_of(head) == [{"file": "a.csv", "topic": FILE_TOPIC, "error": "", "summary": "36 channels"}]
    assert rows_of(events) == [{"file": "a.csv", **MESSAGES[0]}]


def test_a_name_that_is_no_utf8_is_escaped() -> None:
    assert rows_of(file_row(os.fsdecode(b"\xff.csv"), ""))[0]["file"] == "\\xff.csv"


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (Outcome(3, 7, ()), "t: 7 events of 3 files"),
        (Outcome(3, 7, (("a", "x"),)), "t: 7 events of 3 files; 1 files could not be analysed"),
    ],
)
def test_the_outcome_is_a_line(outcome: Outcome, words: str) -> None:
    assert outcome.words(Path("t")) == words


@pytest.mark.usefixtures("files_go")
def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(OperatorError, match="cannot be written: No such file"):
        detect(["a"], tmp_path / "none" / "events.parquet", 1)


@pytest.mark.usefixtures("files_go")
def test_a_second_run_into_one_table_is_refused_and_leaves_the_first_alone(tmp_path: Path) -> None:
    to, other = tmp_path / "events.parquet", tmp_path / "events.parquet.unfinished"
    other.write_bytes(b"of the first run")
    with pytest.raises(OperatorError, match=r"another run writes it, as .*unfinished exists"):
        detect(["gone.mcap"], to, 1)
    assert other.read_bytes() == b"of the first run"
    assert not to.exists()


def test_jobs_are_begun_only_a_little_ahead_of_the_table(tmp_path: Path) -> None:
    begun: list[str] = []

    def files() -> Iterator[str]:
        for k in range(10):
            begun.append(f"{tmp_path}/{k}.mcap")
            yield begun[-1]

    rows_of = partial(analyse, array=None, rate_hz=None, choices=Choices())
    found = []
    with ThreadPoolExecutor(2) as workers:
        for n_done, rows in enumerate(in_order(workers, rows_of, files(), 3)):
            assert len(begun) == min(n_done + 3, 10)
            found += pyarrow.parquet.read_table(io.BytesIO(rows))["file"].to_pylist()
    assert found == begun
