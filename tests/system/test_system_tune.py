"""`tactiled tune` beside a real daemon: an emulated board whose skin is held still all the time."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from held_scene import HELD
from patience import PATIENCE_S

from tactiled.client import Commander

pytestmark = pytest.mark.system


def test_a_hold_and_a_motion_are_recorded_from_a_daemon(tmp_path: Path) -> None:
    environ = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    for name in ("NOTIFY_SOCKET", "RUNTIME_DIRECTORY"):
        environ.pop(name, None)
    endpoint = f"ipc://{tmp_path}/events.ipc"
    config = tmp_path / "board.toml"
    config.write_text(f'port.url = "{tmp_path}/board"\npublish.endpoints = ["{endpoint}"]\n')

    def start(name: str, *arguments: str) -> "subprocess.Popen[bytes]":
        """Run a verb of tactiled, with its output in a file of this name."""
        with (tmp_path / name).open("wb") as out:
            return subprocess.Popen(
                [sys.executable, "-m", "tactiled", *arguments], cwd=tmp_path, env=environ,
                stdout=out, stderr=subprocess.DEVNULL,
            )  # fmt: skip

    def tune(*arguments: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [sys.executable, "-m", "tactiled", "tune", endpoint, *arguments], cwd=tmp_path, env=environ,
            capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip

    (tmp_path / "held.toml").write_text(HELD)
    board = start("board.out", "emulate", "--scene", "held.toml", "--link", "board")
    daemon = start("daemon.out", "run", "--config", str(config))
    try:
        until_s = time.monotonic() + PATIENCE_S
        while not (tmp_path / "events.ipc").exists() or not (tmp_path / "board").is_symlink():
            assert time.monotonic() < until_s
            time.sleep(0.05)
        wrong = tune("--array", "normal-4x4")
        with Commander(endpoint) as commander:
            while not (reply := commander.send("tare", timeout_s=PATIENCE_S, force=True)).ok:
                assert "ask again" in reply.reason  # after a gap, which a busy host makes
                time.sleep(0.05)
        tuner = tune("--quiet-s", "5", "--motion-s", "5")
    finally:
        for process in (daemon, board):
            process.terminate()
            process.wait(timeout=PATIENCE_S)
    assert wrong.returncode == 2
    assert wrong.stderr == "tactiled: --array: normal-4x4 has 16 channels, the board 36\n"
    said = tuner.stderr
    assert tuner.returncode == 0, said
    assert said.index("hold it still") < said.index("Now move") < said.index("[detect]")
    assert "the daemon was tared" in said
    (line,) = tuner.stdout.splitlines()
    found = json.loads(line)
    assert found["array"] == "wang2019-3x3"
    for phase in ("quiet", "motion"):
        assert 4.5 <= found[phase]["contact_s"] <= 5.5
        assert found["settings"]["balanced"][phase] == {"incipient": 0, "gross": 0}


def test_without_a_daemon_it_says_so(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tactiled", "tune", f"ipc://{tmp_path}/events.ipc"],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith(f"tactiled: no board at ipc://{tmp_path}/events.ipc within 5 s")
    assert "tactiled run" in done.stderr
    assert done.stdout == ""
