"""Real processes: `tactiled run` between an emulated board on a pty and `tactiled listen`."""

import json
import os
import queue
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from patience import PATIENCE_S

from tactiled.client import Message, Subscription

pytestmark = pytest.mark.system


class Setup:
    """Configuration and endpoints of one daemon, and the processes around it."""

    def __init__(self, tmp_path: Path, session: str = "") -> None:
        self.link = tmp_path / "board"
        self.endpoint = f"ipc://{tmp_path}/events.ipc"
        self.config = tmp_path / "tactiled.toml"
        self.config.write_text(
            f'[port]\nurl = "{self.link}"\n[publish]\nendpoints = ["{self.endpoint}"]\n[session]\n{session}\n'
        )
        self.notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.notify.bind(str(tmp_path / "notify"))
        self._messages: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        self.environ = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "2000000"}
        self.environ.pop("WATCHDOG_PID", None)

    def _read(self) -> None:
        """Take every message at once, as systemd does: the kernel keeps ten of them."""
        while message := self.notify.recv(4096):
            self._messages.put(message.decode())

    def close(self) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"", self.notify.getsockname())
        self._reader.join()
        self.notify.close()

    def told(self, text: str) -> None:
        """Wait until the service manager was told so."""
        until_s, message = time.monotonic() + PATIENCE_S, ""
        while text not in message:
            try:
                message = self._messages.get(timeout=max(0.0, until_s - time.monotonic()))
            except queue.Empty:
                raise AssertionError(f"systemd was never told {text}, last {message}") from None

    @contextmanager
    def process(self, *arguments: str) -> Iterator["subprocess.Popen[str]"]:
        command = [sys.executable, "-m", "tactiled", *arguments]
        with subprocess.Popen(
            command, env=self.environ, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as child:
            try:
                yield child
            finally:
                if child.poll() is None:
                    child.kill()

    def run(self) -> AbstractContextManager["subprocess.Popen[str]"]:
        return self.process("run", "--config", str(self.config))

    def emulate(self) -> AbstractContextManager["subprocess.Popen[str]"]:
        return self.process("emulate", "--scene", "rest", "--link", str(self.link))

    def listen(self, *arguments: str) -> list[dict[str, object]]:
        done = subprocess.run(
            [sys.executable, "-m", "tactiled", "listen", self.endpoint, "--timeout", "60", *arguments],
            capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture
def setup(tmp_path: Path) -> Iterator[Setup]:
    made = Setup(tmp_path)
    yield made
    made.close()


def end(child: "subprocess.Popen[str]", number: signal.Signals = signal.SIGTERM) -> str:
    """Signal the process; it must end well, without a traceback; gives what it said."""
    child.send_signal(number)
    _, words = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 0, words
    assert "Traceback" not in words
    return words


def test_from_the_board_to_json_lines_and_back_after_an_unplug(setup: Setup) -> None:
    with setup.run() as daemon:
        setup.told("READY=1")
        setup.told("no such port")
        with setup.emulate():
            setup.told("running: 100 Hz")
            scans = setup.listen("--topic", "scan", "--count", "20")
            assert [row["topic"] for row in scans] == ["scan"] * 20
            assert len(scans[0]["volts"]) == 36  # type: ignore[arg-type]
        setup.told("no-device")
        (status,) = setup.listen("--topic", "status", "--count", "1")
        assert (status["state"], status["valid"]) == ("no-device", False)
        setup.link.unlink(missing_ok=True)
        with setup.emulate():
            setup.told("running: 100 Hz")
            setup.listen("--topic", "scan", "--count", "5")
            words = end(daemon)
        setup.told("STOPPING=1")
    assert "running: 100 Hz" in words


def test_the_watchdog_is_fed_with_and_without_a_board(setup: Setup) -> None:
    with setup.run() as daemon:
        setup.told("WATCHDOG=1")
        setup.told("no such port")
        setup.told("WATCHDOG=1")
        with setup.emulate():
            setup.told("running")
            setup.told("WATCHDOG=1")
            end(daemon, signal.SIGINT)


def test_a_second_daemon_is_refused_in_one_line(setup: Setup) -> None:
    with setup.run() as first:
        setup.told("READY=1")
        with setup.run() as second:
            _, words = second.communicate(timeout=PATIENCE_S)
        assert second.returncode == 1  # worth trying again: the first may end
        assert len(words.splitlines()) == 1
        assert "in use by another tactiled" in words
        end(first)


def test_a_recording_of_the_run_finds_the_slip_again(setup: Setup, tmp_path: Path) -> None:
    """Bytes recorded beside the live service give the live events when they are run again."""
    recording = tmp_path / "run.mcap"
    with setup.process("run", "--config", str(setup.config), "--record", str(recording)) as daemon:
        setup.told("READY=1")
        with (
            Subscription(setup.endpoint, topics=("slip",)) as subscription,
            setup.process("emulate", "--scene", "prescribed", "--link", str(setup.link)),
        ):
            until_s = time.monotonic() + PATIENCE_S
            while not isinstance(slip := subscription.next_item(until_s), Message):
                assert slip is not None
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(PATIENCE_S) == 0
    with setup.process("detect", str(recording)) as again:
        out, _ = again.communicate(timeout=PATIENCE_S)
    onset = next(e for e in map(json.loads, out.splitlines()) if e["topic"] == "slip")
    assert {name: onset[name] for name in ("state", "direction_deg", "statistic")} == {
        name: slip.data[name] for name in ("state", "direction_deg", "statistic")
    }


STORM = """
import os, sys, time, zmq
with zmq.Context() as context, context.socket(zmq.SUB) as sock:
    sock.sndhwm = sock.linger = 0
    sock.connect(sys.argv[1])
    for _ in range(40_000):
        sock.subscribe(os.urandom(125).hex())
    time.sleep(60)
"""


@pytest.mark.alone
def test_a_storm_of_subscriptions_under_a_memory_limit_costs_others_nothing(setup: Setup) -> None:
    """The daemon bounds what a client may subscribe to: it stays within its memory, and no scan is lost."""
    scans: list[Message] = []
    with setup.emulate(), Subscription(setup.endpoint) as subscription, setup.run() as daemon:
        setup.told("READY=1")
        limit = int(_status_of(daemon, "VmData")) * 1024 + 200_000_000
        resource.prlimit(daemon.pid, resource.RLIMIT_DATA, (limit, limit))
        with subprocess.Popen([sys.executable, "-c", STORM, setup.endpoint]) as storm:
            until_s = time.monotonic() + PATIENCE_S
            while len(scans) < 1000 and (item := subscription.next_item(until_s)) is not None:
                if isinstance(item, Message) and item.topic == "scan":
                    scans.append(item)
            storm.kill()
        assert daemon.poll() is None
        end(daemon)
    assert len(scans) == 1000
    assert len({scan.data["run"] for scan in scans}) == 1
    assert subscription.lost == 0


def _status_of(child: "subprocess.Popen[str]", name: str) -> str:
    """A value of /proc/PID/status."""
    lines = Path(f"/proc/{child.pid}/status").read_text().splitlines()
    return next(line.split()[1] for line in lines if line.startswith(f"{name}:"))
