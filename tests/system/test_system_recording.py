"""Recordings by real processes: killed, recovered, run again, exported."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from patience import PATIENCE_S

from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.reader import read_items
from tactiled.recording.writer import RecordingWriter

HEADER = Header(load_board("board-v1", "wang2019-3x3"))
pytestmark = pytest.mark.system


class Bench:
    """A folder with an emulated board in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.board = folder / "board"
        self.environ = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
        for name in ("NOTIFY_SOCKET", "RUNTIME_DIRECTORY"):
            self.environ.pop(name, None)

    def command(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [sys.executable, "-m", "tactiled", *arguments], cwd=self.folder, env=self.environ,
            capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip

    @contextmanager
    def process(self, *arguments: str) -> Iterator["subprocess.Popen[str]"]:
        with subprocess.Popen(
            [sys.executable, "-m", "tactiled", *arguments], cwd=self.folder, env=self.environ,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        ) as child:  # fmt: skip
            try:
                yield child
            finally:
                child.kill()

    def until_there(self, port: Path) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while not port.is_symlink():
            assert time.monotonic() < until_s, f"{port} never came"
            time.sleep(0.02)

    def until_bigger_than(self, path: Path, n_bytes: int) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while not path.exists() or path.stat().st_size < n_bytes:
            assert time.monotonic() < until_s, f"{path} does not grow"
            time.sleep(0.02)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    with made.process("emulate", "--scene", "rest", "--link", str(made.board)):
        made.until_there(made.board)
        yield made


def test_killed_recovered_and_run_again(bench: Bench) -> None:
    file = bench.folder / "a.mcap"
    active = bench.folder / "a.mcap.active"
    with bench.process("record", "a.mcap", "--port", str(bench.board)) as recorder:
        bench.until_bigger_than(active, 60_000)  # some seconds, so several syncs
        refused = bench.command("record", "a.mcap", "--port", str(bench.board))
        assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
        assert "another recorder is writing it" in refused.stderr
        busy = bench.command("recover", "a.mcap.active")
        assert (busy.returncode, "a recorder is writing it" in busy.stderr) == (2, True)
        recorder.send_signal(signal.SIGKILL)
        recorder.wait(PATIENCE_S)
        killed_unix_s = time.time()
    before = active.read_bytes()
    recovered = bench.command("recover", "a.mcap.active")
    assert recovered.returncode == 0, recovered.stderr
    assert "loses up to 1 s" in recovered.stderr
    assert active.read_bytes() == before
    verified = bench.command("replay", "a.mcap", "--verify")
    assert (verified.returncode, verified.stdout) == (0, ""), verified.stderr
    assert "events reproduced bit for bit" in verified.stderr
    lines = [json.loads(line) for line in bench.command("replay", "a.mcap", "-t", "scan").stdout.splitlines()]
    assert [line["seq"] for line in lines] == list(range(len(lines)))
    # Lost is what came after the last sync; these are 1 s apart, or more on a machine that is busy.
    assert len(lines) > 60_000 / 600  # a scan takes about 300 bytes, more where reads are small
    assert 0 <= killed_unix_s - lines[-1]["timestamp"] < PATIENCE_S
    data = file.read_bytes()
    (bench.folder / "cut.mcap").write_bytes(data[: len(data) // 2])
    assert bench.command("recover", "cut.mcap").returncode == 0
    assert bench.command("replay", "cut.recovered.mcap", "--verify").returncode == 0


def test_recorded_for_a_while_and_exported(bench: Bench) -> None:
    done = bench.command("record", "a.mcap", "--port", str(bench.board), "--seconds", "3")
    assert done.returncode == 0, done.stderr
    exported = bench.command("export", "a.mcap", "--csv", "a.csv")
    assert exported.returncode == 0, exported.stderr
    scans = len((bench.folder / "a.csv").read_text().splitlines()) - 1
    assert f"a.csv: {scans} scans" in exported.stderr
    assert scans > 100
    assert bench.command("detect", "a.csv").returncode == 0


def test_without_a_board_it_says_so(tmp_path: Path) -> None:
    done = Bench(tmp_path).command("record", "a.mcap", "--port", str(tmp_path / "none"), "--seconds", "0.5")
    assert done.returncode == 1
    assert "no such port" in done.stderr
    assert "a.mcap: 0 scans" in done.stderr


def test_without_a_record_directory_it_senses_and_a_killed_run_is_recovered_by_the_next(bench: Bench) -> None:
    """No person comes: the directory appears late, the daemon is killed, another recorder is beside it."""
    records = bench.folder / "records"
    config = bench.folder / "t.toml"
    config.write_text(
        f'[port]\nurl = "{bench.board}"\n[publish]\nendpoints = ["ipc://{bench.folder}/events.ipc"]\n'
        f'[record]\ndirectory = "{records}"\nmin_free_mb = 0\n'
    )

    def active() -> set[Path]:
        return set(records.glob("*.active"))

    def until(what: Callable[[], bool], within_s: float = PATIENCE_S) -> None:
        until_s = time.monotonic() + within_s
        while not what():
            assert time.monotonic() < until_s
            time.sleep(0.05)

    with bench.process("run", "--config", "t.toml") as daemon:
        endpoint = f"ipc://{bench.folder}/events.ipc"
        heard = bench.command("listen", endpoint, "-t", "scan", "-n", "20", "--timeout", "50")
        assert len(heard.stdout.splitlines()) == 20, heard.stderr
        said = bench.command("listen", endpoint, "-t", "recording", "-n", "1", "--timeout", "50")
        assert json.loads(said.stdout)["state"] == "failed"
        records.mkdir()
        until(lambda: any(path.stat().st_size > 30_000 for path in active()))
        daemon.send_signal(signal.SIGKILL)
        daemon.wait(PATIENCE_S)
    (left,) = active()
    other = RecordingWriter(records / "tactile-20200101T000000.000Z.mcap", HEADER)  # of a process that lives
    other.read(Read(0.0, 0.0, b"x"))
    other.sync()
    before = other.active.read_bytes()
    with bench.process("run", "--config", "t.toml") as daemon:
        # At niceness 19, some seconds of computing take a seventieth of a processor that others fill.
        until(lambda: not left.exists() and len(active()) == 2, within_s=5 * PATIENCE_S)
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(PATIENCE_S) == 0
    assert other.active.read_bytes() == before
    other.close()
    recovered = records / left.name.removesuffix(".active")
    assert sum(isinstance(item, Read) for item in read_items(recovered)) > 50
