"""Many files in one table: the same bytes whoever computes them, one bad file is a row, runs go on."""

import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest
from patience import PATIENCE_S
from recordings import record, simulated_reads

from tactiled.archive import detect
from tactiled.archive.detect import FileJob, analyse, detect_files, matching
from tactiled.cli import main
from tactiled.errors import ConfigError, OperatorError
from tactiled.offline import Choices, detect_file

N_FILES = 4


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


def jobs_of(runs: Path) -> list[FileJob]:
    names = matching([f"{runs}/**/*.mcap"])
    return [FileJob(str(Path(name).relative_to(runs)), Path(name), None, None, Choices()) for name in names]


@pytest.fixture(scope="module")
def expected(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table as one process computes it."""
    to = tmp_path_factory.mktemp("one") / "events.parquet"
    detect_files(jobs_of(runs), to, 1, None)
    return to.read_bytes()


@contextmanager
def once(is_ready: Callable[[], bool], act: Callable[[], None]) -> Iterator[None]:
    """Meanwhile, wait until something is ready and then act."""

    def watch() -> None:
        while not is_ready() and not is_over.is_set():
            time.sleep(0.01)
        if not is_over.is_set():
            act()

    is_over = threading.Event()
    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield
    finally:
        is_over.set()
        watcher.join()


def test_the_table_has_the_events_that_detect_prints(
    runs: Path, expected: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "events.parquet"
    path.write_bytes(expected)
    rows = pyarrow.parquet.read_table(path).to_pylist()
    detect_file(runs / "left" / "2.mcap")
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    found = [row for row in rows if row["file"] == "left/2.mcap" and row["topic"] != "file"]
    assert len(printed) == len(found) > 0
    for message, row in zip(printed, found, strict=True):
        known = {key: value for key, value in message.items() if key not in ("v", "board", "run")}
        assert known.items() <= row.items()
        assert all(row[key] is None for key in row.keys() - message.keys() - {"file"})


def test_a_bad_file_is_a_row_with_its_error(expected: bytes, tmp_path: Path) -> None:
    path = tmp_path / "events.parquet"
    path.write_bytes(expected)
    rows = [row for row in pyarrow.parquet.read_table(path).to_pylist() if row["topic"] == "file"]
    assert [row["file"] for row in rows] == ["bad.mcap", *(f"left/{k}.mcap" for k in range(N_FILES))]
    assert rows[0]["error"].startswith("bad.mcap: ")
    assert [row["error"] for row in rows[1:]] == [""] * N_FILES
    assert "Hz" in rows[1]["summary"]


def test_a_killed_process_costs_nothing(runs: Path, expected: bytes, tmp_path: Path) -> None:
    def at_work() -> list[int]:
        return [child.pid for child in multiprocessing.active_children() if child.pid]

    to = tmp_path / "events.parquet"
    parts = to.with_name("events.parquet.parts")
    killed: list[int] = []

    def kill() -> None:
        killed.append(at_work()[0])
        os.kill(killed[0], signal.SIGKILL)

    with once(lambda: parts.exists() and len(list(parts.iterdir())) > 0 and bool(at_work()), kill):
        outcome = detect_files(jobs_of(runs), to, 2, None)
    assert killed
    assert to.read_bytes() == expected
    assert [file for file, _ in outcome.failed] == ["bad.mcap"]
    assert not parts.exists()


def test_a_run_goes_on_where_it_was_interrupted(
    runs: Path, expected: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    to = tmp_path / "events.parquet"
    jobs = jobs_of(runs)

    def interrupted(*_: object) -> Iterator[tuple[int, bytes]]:
        for k in range(2):
            yield k, analyse(jobs[k])
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(detect, "_analysed", interrupted)
        with pytest.raises(KeyboardInterrupt):
            detect_files(jobs, to, 1, None)
    assert not to.exists()
    outcome = detect_files(jobs, to, 1, None)
    assert outcome.n_resumed == 2
    assert to.read_bytes() == expected


def test_another_run_into_the_same_table_is_refused(runs: Path, tmp_path: Path) -> None:
    to = tmp_path / "events.parquet"
    parts = to.with_name("events.parquet.parts")
    with detect.alone_in(parts), pytest.raises(OperatorError, match="another run"):
        detect_files(jobs_of(runs), to, 1, None)
    assert list(tmp_path.iterdir()) == []


def test_files_of_others_and_parts_without_contents_do_no_harm(runs: Path, tmp_path: Path) -> None:
    to = tmp_path / "events.parquet"
    job = jobs_of(runs)[0]
    parts = to.with_name("events.parquet.parts")
    parts.mkdir()
    (parts / "notes.txt").write_text("mine")
    (parts / f"{job.key()}.part").write_bytes(b"")  # as after a power failure
    assert detect_files([job], to, 1, None).n_resumed == 0
    assert [path.name for path in parts.iterdir()] == ["notes.txt"]


def test_a_file_that_is_gone_and_a_name_that_is_not_utf8_are_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    odd = os.fsdecode(b"\xff.mcap")
    Path(odd).write_bytes(b"")
    jobs = [FileJob.for_any_worker(name, None, None, Choices()) for name in ("gone.mcap", odd)]
    outcome = detect_files(jobs, tmp_path / "events.parquet", 1, None)
    assert outcome.failed[0] == ("gone.mcap", "no such file any more")
    rows = pyarrow.parquet.read_table(tmp_path / "events.parquet").to_pylist()
    assert [row["file"] for row in rows] == ["gone.mcap", "\\xff.mcap"]


def test_a_lost_scheduler_ends_the_run_and_makes_no_rows(runs: Path) -> None:
    class LostCluster(ThreadPoolExecutor):
        def submit(self, *_: object, **__: object) -> Future[Any]:
            lost: Future[Any] = Future()
            lost.cancel()
            lost.set_running_or_notify_cancel()
            return lost

    waiting = deque(enumerate(jobs_of(runs)))
    with (
        LostCluster(1) as workers,
        pytest.raises(OperatorError, match="goes on with the files that are left"),
    ):
        list(detect.completed(workers, waiting, 2))


def test_a_process_that_ends_makes_few_files_suspect(runs: Path) -> None:
    class BrokenPool(ThreadPoolExecutor):
        def submit(self, *_: object, **__: object) -> Future[Any]:
            broken: Future[Any] = Future()
            broken.set_exception(BrokenProcessPool())
            return broken

    waiting = deque(enumerate(jobs_of(runs)))
    with BrokenPool(1) as workers:
        found = list(detect.completed(workers, waiting, 2))
    assert [(index, rows) for index, _, rows in found] == [(0, None), (1, None)]
    assert len(waiting) == N_FILES + 1 - 2


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
    jobs = [FileJob("x", runs / "bad.mcap", None, None, Choices(setting="none"))]
    with pytest.raises(ConfigError, match="setting"):
        detect_files(jobs, tmp_path / "events.parquet", 1, None)
    assert list(tmp_path.iterdir()) == []


def test_a_worker_of_another_version_is_refused(runs: Path) -> None:
    job = jobs_of(runs)[0]
    with pytest.raises(OperatorError, match="install the same"):
        analyse(FileJob(job.file, job.path, None, None, job.choices, version="0.0.1"))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.system
def test_dask_gives_the_same_bytes_though_a_worker_is_killed(
    runs: Path, expected: bytes, tmp_path: Path
) -> None:
    address = f"tcp://127.0.0.1:{free_port()}"
    started: list[subprocess.Popen[bytes]] = []

    def start(*words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli." + words[0], *words[1:], "--no-dashboard"]
        started.append(subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL))
        return started[-1]

    try:
        start("dask_scheduler", "--host", "127.0.0.1", "--port", address.rsplit(":", 1)[1])
        worker = ["dask_worker", address, "--nthreads", "1", "--no-nanny", "--name"]
        first, _ = start(*worker, "first"), start(*worker, "second")
        to = tmp_path / "events.parquet"
        parts = to.with_name("events.parquet.parts")
        with once(lambda: parts.exists() and len(list(parts.iterdir())) > 0, first.kill):
            outcome = detect_files(jobs_of(runs), to, None, address)
        assert first.wait(10) == -signal.SIGKILL
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()
    assert to.read_bytes() == expected
    assert [file for file, _ in outcome.failed] == ["bad.mcap"]


def test_options_that_do_not_fit_are_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, told in (
        (["a.csv", "b.csv"], "--to TABLE.parquet for many files"),
        (["a.csv", "--dask", "tcp://127.0.0.1:1"], "--to TABLE.parquet"),
        (["a.csv", "--to", f"{tmp_path}/none/events.parquet"], "folder that exists"),
        (["a.csv", "--to", f"{tmp_path}/events.csv"], "name a .parquet"),
        (["a.csv", "--to", "a.parquet", "--jobs", "2", "--dask", "tcp://127.0.0.1:1"], "--jobs or --dask"),
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
