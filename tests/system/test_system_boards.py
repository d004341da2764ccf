"""Real processes: one `tactiled run` for three emulated boards, each in a process of its own."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from patience import PATIENCE_S

from tactiled.client import Item, Message, Subscription

pytestmark = pytest.mark.system
SERIALS = ("TS0001", "TS0002", "TS0003")


@contextmanager
def process(words: Path, *arguments: object) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a command of tactiled whose stderr goes to a file."""
    command = [sys.executable, "-m", "tactiled", *map(str, arguments)]
    with (
        words.open("wb") as err,
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=err) as child,
    ):
        try:
            yield child
        finally:
            if child.poll() is None:
                child.terminate()


def run(*arguments: object) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "tactiled", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def command(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Run a command of a client; where a daemon on a busy host has not answered within 5 s, once more."""
    until_s = time.monotonic() + PATIENCE_S
    while True:
        done = run("command", *arguments)
        if "no answer" not in done.stderr or time.monotonic() > until_s:
            return done


def emulate(folder: Path, serial: str) -> "subprocess.Popen[bytes]":
    """Start a board; its pty is removed by the next one of this name."""
    (folder / serial).unlink(missing_ok=True)
    board = folder / f"{serial}-board.txt"
    board.write_text(f'board_serial = "{serial}"\n')
    return subprocess.Popen(
        [sys.executable, "-m", "tactiled", "emulate", "--scene", "rest", "--link", folder / serial,
         "--board", board],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def configure(folder: Path) -> Path:
    """Write a directory of three configurations, with an array beside them."""
    configs = folder / "configs"
    configs.mkdir()
    for serial in SERIALS:
        records = folder / "records" / serial
        records.mkdir(parents=True)
        (configs / f"{serial}.toml").write_text(
            f'[port]\nurl = "{folder / serial}"\n[session]\nboard_serial = "{serial}"\n'
            f'[publish]\nendpoints = ["ipc://{folder}/events.ipc"]\n'
            f'[record]\ndirectory = "{records}"\nmin_free_mb = 0\n'
        )
    (configs / "mine.toml").write_text('name = "mine"\n[[grids]]\nx_mm = [0.0]\ny_mm = [0.0]\n')
    return configs


def test_three_boards_in_one_process_and_one_unplugged(tmp_path: Path) -> None:
    configs = configure(tmp_path)
    with ExitStack() as stack:
        boards = {}

        def plug(serial: str) -> None:
            boards[serial] = stack.enter_context(emulate(tmp_path, serial))
            stack.callback(boards[serial].kill)

        log = tmp_path / "log"
        daemon = stack.enter_context(process(log, "run", "--config", configs))
        until_s = time.monotonic() + PATIENCE_S
        while not (tmp_path / "events.ipc").exists():
            assert time.monotonic() < until_s, "the daemon did not start"
            time.sleep(0.05)
        for serial in SERIALS:
            plug(serial)
        with Subscription(f"ipc://{tmp_path}/events.ipc") as subscription:
            heard: list[Message] = []

            def until(wanted: dict[str, str], n_scans: int) -> None:
                """Receive until each board had the state that is wanted, and then so many scans."""
                states: dict[str, str] = {}
                scans = dict.fromkeys((s for s in wanted if wanted[s] == "running"), 0)
                until_s = time.monotonic() + PATIENCE_S
                while wanted.items() - states.items() or min(scans.values()) < n_scans:
                    item: Item | None = subscription.next_item(until_s)
                    assert item is not None, (states, scans)
                    if not isinstance(item, Message):
                        continue
                    heard.append(item)
                    if item.topic == "status":
                        states[item.board] = str(item.data["state"])
                    elif item.topic == "scan" and item.board in scans:
                        scans[item.board] += 1

            until(dict.fromkeys(SERIALS, "running"), 50)
            seen = len(heard)
            boards["TS0002"].send_signal(signal.SIGKILL)
            until({"TS0001": "running", "TS0002": "no-device", "TS0003": "running"}, 100)
            others = [m for m in heard[seen:] if m.board != "TS0002"]
            states = {m.data["state"] for m in others if m.topic == "status"}
            assert states <= {"running", "stalled"}  # a busy host lets their boards wait
            if states == {"running"}:
                # Others than those that an emulated board has missed itself, for want of a processor.
                counts = [
                    (m.data["scans_missing"], m.data["scans_overrun"]) for m in others if m.topic == "status"
                ]
                assert [(missing, own) for missing, own in counts if missing != own] == []
            plug("TS0002")
            until(dict.fromkeys(SERIALS, "running"), 50)
        mark = ("mark", "text=here", "--endpoint", f"ipc://{tmp_path}/events.ipc")
        done = command(*mark)
        assert (done.returncode, "say which one is meant" in done.stderr) == (1, True), done.stderr
        done = command(*mark, "--board", "TS0003")
        assert done.returncode == 0, done.stderr
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(PATIENCE_S) == 0, log.read_text()
        assert "Traceback" not in log.read_text()
    for serial in SERIALS:
        files = sorted((tmp_path / "records" / serial).glob("*.mcap"))
        assert files
        done = run("replay", "--verify", *files)
        assert done.returncode == 0, done.stderr


def test_what_cannot_be_served_together_is_refused_before_anything_is_opened(tmp_path: Path) -> None:
    configs = configure(tmp_path)
    done = run("check-config", configs)
    assert done.returncode == 0, done.stderr
    served = [json.loads(line)["session"]["board_serial"] for line in done.stdout.splitlines()]
    assert served == list(SERIALS)
    for serial in SERIALS[:2]:
        file = configs / f"{serial}.toml"
        file.write_text(file.read_text().replace(f'"{tmp_path / serial}"', '"/dev/ttyUSB7"'))
    for verb in (("run", "--config", configs), ("check-config", configs)):
        done = run(*verb)
        assert done.returncode == 2
        both = f"{configs}/TS0001.toml and {configs}/TS0002.toml"
        assert f'port.url: "/dev/ttyUSB7" in both {both}' in done.stderr
    done = run("run", "--config", configs, "--record", tmp_path / "a.mcap")
    assert (done.returncode, list((tmp_path / "records" / SERIALS[0]).iterdir())) == (2, [])
