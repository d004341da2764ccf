"""Example firmware and daemon: resets, scans for which the board has no room, a hung board, attacks."""

import os
import signal
import socket
import subprocess
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import serial
from patience import PATIENCE_S

from bench.machine.board_in_qemu import (
    LAYOUT,
    BoardInQemu,
    DaemonOnBoard,
    SentFrames,
    accounts,
    compile_firmware,
    daemon_on,
    reset_often,
)
from tactiled.errors import OperatorError
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Scan

pytestmark = pytest.mark.system
FAULTS = ("scans_missed", "frames_dropped", "frames_corrupt", "octets_dropped")  # as in firmware.h


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        return compile_firmware(tmp_path_factory.mktemp("firmware"))
    except OperatorError as missing:
        if "TACTILED_CI" in os.environ:
            raise
        pytest.skip(str(missing))


def scans_in(board: BoardInQemu) -> list[Scan]:
    """Read the scans that the UART sent."""
    return [item for item in Decoder(LAYOUT).feed(board.sent.read_bytes()) if isinstance(item, Scan)]


def check_accounts(board: BoardInQemu, daemon: DaemonOnBoard, resets: int) -> SentFrames:
    """Stop the board's time, and compare what it sent with what was published and counted."""
    sent, aims = accounts(board, daemon, resets)
    assert [aim for aim in aims if aim.verdict != "met"] == []
    assert sent.boots == resets + 1
    return sent


def faults(board: BoardInQemu, image: Path) -> dict[str, int]:
    """Read the counters of faults that the firmware keeps for its debugger."""
    line = f"xp /4wd 0x{address(image, 'firmware_faults')}"
    text = board.qmp("human-monitor-command", **{"command-line": line})
    numbers = [int(word) for line in text.splitlines() for word in line.split(":")[1].split()]
    return dict(zip(FAULTS, numbers, strict=True))


def address(image: Path, name: str) -> str:
    """Return the address of a symbol."""
    symbols = subprocess.check_output(["arm-none-eabi-nm", image], text=True)
    return {symbol: place for place, _, symbol in map(str.split, symbols.splitlines())}[name]


def hang(image: Path, socket_of_debugger: Path) -> None:
    """Let the main loop hang where it feeds the watchdog, with interrupts as before.

    A debugger writes an endless loop there; a reset loads the program anew.
    """
    with socket.socket(socket.AF_UNIX) as debugger:
        debugger.settimeout(PATIENCE_S)
        debugger.connect(str(socket_of_debugger))
        for packet in (f"M{address(image, 'port_feed_watchdog')},2:fee7", "D"):  # write; detach
            debugger.sendall(f"${packet}#{sum(packet.encode()) % 256:02x}".encode())
            answer = b""
            while b"OK#9a" not in answer:
                answer += debugger.recv(64)
            debugger.sendall(b"+")


def test_every_scan_is_accounted_for_over_resets(image: Path, tmp_path: Path) -> None:
    with BoardInQemu(image, tmp_path) as board, daemon_on(board, tmp_path) as daemon:
        reset_often(board, daemon, 8, 40)
        sent = check_accounts(board, daemon, 8)
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
        while faults(board, image)["frames_dropped"] < 20:
            assert time.monotonic() < until_s, faults(board, image)
            time.sleep(0.05)
        daemon.process.send_signal(signal.SIGCONT)
        daemon.until(lambda: daemon.status["scans_missing"] >= 20, "missing scans are counted")
        daemon.until(lambda: daemon.status["valid"], "the backlog is over")
        until_s = time.monotonic() + PATIENCE_S
        # On a busy host it may have missed scans since the newest one: the next one tells the daemon.
        while (behind := missed_behind(board, daemon, image)) > 0:
            assert time.monotonic() < until_s, behind
            board.qmp("cont")
            daemon.until_more_scans(10)
        assert behind == 0
        assert daemon.status["restarts"] == 0


def missed_behind(board: BoardInQemu, daemon: DaemonOnBoard, image: Path) -> int:
    """Stop the board's time; return how many scans it has missed that its newest one could not tell of."""
    board.qmp("stop")
    # The file of qemu is no full witness here: it holds the octet twice at which the pty was full.
    attempted = scans_in(board)[-1].sequence + 1
    daemon.until(lambda: daemon.status["scans"] + daemon.status["scans_missing"] >= attempted, "all scans")
    assert daemon.status["scans"] + daemon.status["scans_missing"] == attempted
    counted = faults(board, image)
    return counted["frames_dropped"] + counted["scans_missed"] - int(daemon.status["scans_missing"])


def test_a_hung_board_is_reset_by_its_watchdog_and_started_again(image: Path, tmp_path: Path) -> None:
    debugger = tmp_path / "debugger"
    with (
        BoardInQemu(image, tmp_path, "-gdb", f"unix:{debugger},server=on,wait=off") as board,
        daemon_on(board, tmp_path) as daemon,
    ):
        daemon.until_more_scans(40)
        hang(image, debugger)
        daemon.until(lambda: daemon.status["restarts"] == 1, "the watchdog resets the board")
        daemon.until_more_scans(40)
        check_accounts(board, daemon, 1)


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
        board.qmp("cont")
        assert ask(line, Command("start", 1)) == "ok"
        for token, rate_hz in enumerate([0.0, 0.099, 128.9, 4e6], start=2):
            assert ask(line, Command("set_rate", token, rate_hz)) == "bad_argument"
        for _ in range(200):
            line.write(rng.bytes(int(rng.integers(1, 100))))
        assert ask(line, Command("ping", 6)) == "ok"
        assert faults(board, image)["frames_corrupt"] > 0
        for token in range(1000, 1400):
            line.write(Encoder(LAYOUT).encode(Command("ping", token)))
        assert ask(line, Command("ping", 7)) == "ok"
        assert ask(line, Command("stop", 8)) == "ok"
        scans = scans_in(board)
        assert len(scans) > 0
        assert all(before.sequence < after.sequence for before, after in pairwise(scans))
        assert all(before.ticks < after.ticks for before, after in pairwise(scans))  # type: ignore[operator]
