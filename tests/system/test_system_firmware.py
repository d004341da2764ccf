"""Firmware in the loop: the example firmware in qemu, its UART on a pty, `tactiled run` at the other end.

qemu writes down every byte that the UART sent. What the daemon published is compared with that file.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import serial
from board_in_qemu import BoardInQemu, compile_firmware
from numpy.typing import NDArray
from patience import PATIENCE_S

from tactiled.client import Fresh, Lost, Message, Recovered, Stale, Subscription
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Corrupt, Hello, Scan
from tactiled.wire.layout import load_layout

pytestmark = pytest.mark.system
LAYOUT = load_layout("board-v1")
RATE_HZ = 90.0  # not the firmware's default: the daemon must set it after each reset
OVERRUN = 1 << LAYOUT.file.flags["overrun"]
VOLTS_PER_COUNT = 3.0 / 4096


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_firmware(tmp_path_factory.mktemp("firmware"))


class SentBytes(NamedTuple):
    """What the UART sent: scans and their holes within each boot, boots, and damaged frames."""

    scans: list[Scan]
    missing: int  # sequence numbers between scans of one boot
    overrun: int  # the part of them that the firmware flagged
    boots: int
    truncated: int


def scans_in(board: BoardInQemu) -> list[Scan]:
    """Read the scans that the UART sent."""
    return [item for item in Decoder(LAYOUT).feed(board.sent.read_bytes()) if isinstance(item, Scan)]


def sent_by(board: BoardInQemu) -> SentBytes:
    """Read the file in which qemu wrote down what the UART sent."""
    runs: dict[int, list[Scan]] = {}
    truncated = 0
    boot = -1
    for item in Decoder(LAYOUT).feed(board.sent.read_bytes()):
        if isinstance(item, Hello):
            boot = item.boot_count
            runs.setdefault(boot, [])
        elif isinstance(item, Scan):
            runs[boot].append(item)
        truncated += isinstance(item, Corrupt)
    holes = [
        ((after.sequence - before.sequence - 1) % 65536, bool(after.flags & OVERRUN))
        for run in runs.values()
        for before, after in pairwise(run)
    ]
    return SentBytes(
        scans=[scan for run in runs.values() for scan in run],
        missing=sum(hole for hole, _ in holes),
        overrun=sum(hole for hole, flagged in holes if flagged),
        boots=len(runs),
        truncated=truncated,
    )


class DaemonOnBoard:
    """A running daemon and what it published.

    Attributes
    ----------
    volts : list of ndarray
        Readings of each published scan, in order.
    status : dict
        The newest status.
    """

    def __init__(self, process: "subprocess.Popen[bytes]", subscription: Subscription) -> None:
        self.process = process
        self._subscription = subscription
        self.volts: list[NDArray[np.float64]] = []
        self.status: dict[str, Any] = {}

    def until(self, reached: Callable[[], bool], what: str) -> None:
        """Receive messages until a condition holds."""
        until_s = time.monotonic() + PATIENCE_S
        while not reached():
            item = self._subscription.next_item(until_s)
            assert item is not None, f"never: {what}; {len(self.volts)} scans, status {self.status}"
            if isinstance(item, Message | Recovered):
                message = item.message if isinstance(item, Recovered) else item
                if message.topic == "scan":
                    self.volts.append(np.array(message.data["volts"]))
                elif isinstance(item, Message):
                    self.status = item.data
            else:
                assert isinstance(item, Stale | Fresh | Lost), item
                assert not isinstance(item, Lost) or item.topic != "scan", item

    def until_more_scans(self, n: int) -> None:
        """Receive so many more scans."""
        wanted = len(self.volts) + n
        self.until(lambda: len(self.volts) >= wanted, f"{n} more scans")


@contextmanager
def daemon_on(board: BoardInQemu, folder: Path) -> Iterator[DaemonOnBoard]:
    """Run `tactiled run` on the pty of a board, whose time stands still until the subscriber is connected."""
    endpoint = f"ipc://{folder}/events.ipc"
    config = folder / "tactiled.toml"
    config.write_text(
        f'[port]\nurl = "{board.port}"\n[session]\nboard_serial = "TB-EXAMPLE"\nrate_hz = {RATE_HZ}\n'
        f'[publish]\nendpoints = ["{endpoint}"]\n'
    )
    command = [sys.executable, "-m", "tactiled", "run", "--config", str(config)]
    board.command("stop")
    with (
        Subscription(endpoint, topics=("scan", "status")) as subscription,
        (folder / "log").open("wb") as log,
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log) as process,
    ):
        try:
            daemon = DaemonOnBoard(process, subscription)
            daemon.until(lambda: daemon.status != {}, "a status")
            board.command("cont")
            yield daemon
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    assert "Traceback" not in (folder / "log").read_text()


def check_accounts(board: BoardInQemu, daemon: DaemonOnBoard) -> SentBytes:
    """Stop the board's time, and compare what it sent with what was published and counted."""
    board.command("stop")
    sent = sent_by(board)
    daemon.until(
        lambda: min(len(daemon.volts), daemon.status["scans"]) >= len(sent.scans),
        f"{len(sent.scans)} scans, all that the board sent",
    )
    counts = np.array([scan.counts for scan in sent.scans])
    np.testing.assert_allclose(np.array(daemon.volts), counts * VOLTS_PER_COUNT, atol=1e-6)
    status = daemon.status
    assert (status["scans"], status["scans_duplicate"]) == (len(sent.scans), 0)
    assert (status["scans_missing"], status["scans_overrun"]) == (sent.missing, sent.overrun)
    assert status["restarts"] == sent.boots - 1
    assert status["rate_hz"] == pytest.approx(RATE_HZ, rel=1e-3)
    return sent


def test_every_scan_is_accounted_for_over_resets(image: Path, tmp_path: Path) -> None:
    with BoardInQemu(image, tmp_path) as board, daemon_on(board, tmp_path) as daemon:
        for boots in range(1, 10):
            daemon.until_more_scans(40)
            while sent_by(board).boots < boots:  # these were scans of the boot before, which came late
                daemon.until_more_scans(10)
            if boots < 9:
                board.reset_within_a_frame()
        sent = check_accounts(board, daemon)
        assert sent.boots == 9
        assert sent.truncated > 0
        # Input 9 * k + taxel of the multiplexer reads 1024 + 32 * input, and noise of 16 counts.
        offset = sent.scans[-1].counts.reshape(9, 4) - 1024 - 32 * (np.arange(9)[:, None] + 9 * np.arange(4))
        assert offset.min() >= 0
        assert offset.max() < 16


def test_scans_for_which_the_board_had_no_room_are_counted(image: Path, tmp_path: Path) -> None:
    with BoardInQemu(image, tmp_path) as board, daemon_on(board, tmp_path) as daemon:
        daemon.until_more_scans(40)
        daemon.process.send_signal(signal.SIGSTOP)  # nobody reads the pty: it fills, then the board's queue
        until_s = time.monotonic() + PATIENCE_S
        while board.faults()["frames_dropped"] < 20:
            assert time.monotonic() < until_s, board.faults()
            time.sleep(0.05)
        daemon.process.send_signal(signal.SIGCONT)
        daemon.until(lambda: daemon.status["scans_missing"] >= 20, "missing scans are counted")
        daemon.until(lambda: daemon.status["valid"], "the backlog is over")
        until_s = time.monotonic() + PATIENCE_S
        # On a busy host it may have missed scans since the newest one: the next one tells the daemon.
        while (behind := missed_behind(board, daemon)) > 0:
            assert time.monotonic() < until_s, behind
            board.command("cont")
            daemon.until_more_scans(10)
        assert behind == 0
        assert daemon.status["restarts"] == 0


def missed_behind(board: BoardInQemu, daemon: DaemonOnBoard) -> int:
    """Stop the board's time; return how many scans it has missed that its newest one could not tell of."""
    board.command("stop")
    # The file of qemu is no full witness here: it holds the octet twice at which the pty was full.
    attempted = scans_in(board)[-1].sequence + 1
    daemon.until(lambda: daemon.status["scans"] + daemon.status["scans_missing"] >= attempted, "all scans")
    assert daemon.status["scans"] + daemon.status["scans_missing"] == attempted
    faults = board.faults()
    return faults["frames_dropped"] + faults["scans_missed"] - int(daemon.status["scans_missing"])


def test_a_hung_board_is_reset_by_its_watchdog_and_started_again(image: Path, tmp_path: Path) -> None:
    with BoardInQemu(image, tmp_path) as board, daemon_on(board, tmp_path) as daemon:
        daemon.until_more_scans(40)
        board.hang()
        daemon.until(lambda: daemon.status["restarts"] == 1, "the watchdog resets the board")
        daemon.until_more_scans(40)
        assert check_accounts(board, daemon).boots == 2


ANSWER_S = 0.2  # after which a host repeats its command


def ask(line: serial.Serial, command: Command) -> str:
    """Send a command, also again, until it is answered, and return the result."""
    decoder = Decoder(LAYOUT)
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        line.write(b"\0" + Encoder(LAYOUT).encode(command))
        repeat_s = time.monotonic() + ANSWER_S
        while time.monotonic() < repeat_s:
            for item in decoder.feed(line.read(4096)):
                if isinstance(item, Acknowledge) and item.token == command.token:
                    return item.result
    raise AssertionError(f"no answer to {command}")


def test_an_attacked_line_costs_frames_and_nothing_else(image: Path, tmp_path: Path) -> None:
    """Send the board rates that it cannot keep, noise, and more pings than it can answer, while it scans."""
    rng = np.random.default_rng(3)
    with BoardInQemu(image, tmp_path) as board, serial.Serial(board.port, timeout=0.02) as line:
        assert ask(line, Command("start", 1)) == "ok"
        for token, rate_hz in enumerate([0.0, 0.099, 128.9, 4e6], start=2):
            assert ask(line, Command("set_rate", token, rate_hz)) == "bad_argument"
        for _ in range(200):
            line.write(rng.bytes(int(rng.integers(1, 100))))
        assert ask(line, Command("ping", 6)) == "ok"
        assert board.faults()["frames_corrupt"] > 0
        for token in range(1000, 1400):
            line.write(Encoder(LAYOUT).encode(Command("ping", token)))
        assert ask(line, Command("ping", 7)) == "ok"
        assert ask(line, Command("stop", 8)) == "ok"
        scans = scans_in(board)
        assert len(scans) > 0
        assert all(before.sequence < after.sequence for before, after in pairwise(scans))
        assert all(before.ticks < after.ticks for before, after in pairwise(scans))  # type: ignore[operator]
