"""Firmware in the loop: the example firmware in qemu, its UART on a pty, `tactiled run` at the other end.

qemu writes down every byte that the UART sends. What the daemon publishes is compared with that file, by
tests and by `./run bench machine --only firmware`.
"""

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.machine.qemu import Qemu
from bench.processes import START_S, TACTILED, daemon_config, need_programs, running
from bench.report import Aim, at_most, never
from tactiled import resources
from tactiled.array import FloatArray
from tactiled.client import Lost, Message, Recovered, Restarted, Subscription
from tactiled.errors import OperatorError
from tactiled.wire.codec import Decoder
from tactiled.wire.frames import Acknowledge, Corrupt, Hello, Scan
from tactiled.wire.layout import load_layout

RATE_HZ = 101.0  # not the firmware's default: the daemon must set it after each reset
LAYOUT = load_layout("board-v1")
PACKAGES = {"arm-none-eabi-gcc": "gcc-arm-none-eabi", "qemu-system-arm": "qemu-system-arm"}
# The last one keeps the compiler from calling memset, which a program without a library does not have.
_FLAGS = [
    "-std=c99", "-O2", "-g", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-mcpu=cortex-m3", "-mthumb",
    "-ffreestanding", "-nostdlib", "-fno-tree-loop-distribute-patterns",
]  # fmt: skip
_OVERRUN = 1 << LAYOUT.file.flags["overrun"]
_VOLTS_PER_COUNT = 3.0 / 4096
_READING_V = 1e-6  # a count has 730 times as much


def compile_firmware(folder: Path) -> Path:
    """Compile the firmware of protocols/c/example into a folder."""
    need_programs(PACKAGES)
    sources = resources.shipped("protocols", "c")
    example, image = sources / "example", folder / "firmware.elf"
    files = [example / "firmware.c", example / "mps2_an385.c", sources / "tactiled_board.c"]
    script = example / "mps2_an385.ld"
    subprocess.run(["arm-none-eabi-gcc", *_FLAGS, "-T", script, "-o", image, *files], check=True)
    return image


class BoardInQemu(Qemu):
    """Microcontroller (Cortex-M3) with a firmware, whose time begins with the command `cont`.

    Attributes
    ----------
    port : str
        Pty at the other end of the UART.
    sent : Path
        File of all bytes that the UART has sent, written by qemu.
    """

    def __init__(self, image: Path, folder: Path, *options: str) -> None:
        super().__init__()
        self.sent = folder / "sent.bin"
        line = ["-chardev", f"pty,id=line,logfile={self.sent}", "-serial", "chardev:line", "-monitor", "none"]
        self._start(
            ["qemu-system-arm", "-S", "-M", "mps2-an385", "-kernel", str(image), *line, *options], folder
        )
        try:
            names = {device["label"]: device["filename"] for device in self.qmp("query-chardev")}
            self.port = names["line"].removeprefix("pty:")
        except BaseException:
            self.cut_power()
            raise

    def reset(self, *, is_within_frame: bool) -> None:
        """Reset all but the memory, while a frame is on the line (as a brown-out may), or between frames."""
        until_s = time.monotonic() + START_S
        while (self._last_byte() == b"\0") == is_within_frame:  # only the end of a frame is zero
            if time.monotonic() > until_s:
                raise OperatorError("the board sends nothing")
        self.qmp("system_reset")

    def _last_byte(self) -> bytes:
        with self.sent.open("rb") as file:
            file.seek(-1, 2)
            return file.read()


class SentFrames(NamedTuple):
    """Contents of the file in which qemu wrote down what the UART sent."""

    scans: list[Scan]
    missing: int  # sequence numbers between scans of one boot
    overrun: int  # the part of them that the firmware flagged
    boots: int
    truncated: int
    # Boots in which it answered no `set_rate`, or no `ping`
    unanswered: int


def sent_by(board: BoardInQemu) -> SentFrames:
    """Read the file in which qemu wrote down what the UART sent."""
    runs: dict[int, list[Scan]] = {}
    answered: dict[int, set[str]] = {}
    boot, truncated = -1, 0
    for item in Decoder(LAYOUT).feed(board.sent.read_bytes()):
        if isinstance(item, Hello):
            boot = item.boot_count
            runs.setdefault(boot, [])
            answered.setdefault(boot, set())
        elif isinstance(item, Scan):
            runs[boot].append(item)
        elif isinstance(item, Acknowledge) and item.result == "ok":
            answered[boot].add(item.command)
        truncated += isinstance(item, Corrupt)
    holes = [
        ((after.sequence - before.sequence - 1) % 65536, bool(after.flags & _OVERRUN))
        for run in runs.values()
        for before, after in pairwise(run)
    ]
    return SentFrames(
        scans=[scan for run in runs.values() for scan in run],
        missing=sum(hole for hole, _ in holes),
        overrun=sum(hole for hole, flagged in holes if flagged),
        boots=len(runs),
        truncated=truncated,
        unanswered=sum(not {"set_rate", "ping"} <= commands for commands in answered.values()),
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
        self.volts: list[FloatArray] = []
        self.status: dict[str, Any] = {}

    def until(self, reached: Callable[[], bool], what: str) -> None:
        """Receive messages until a condition holds."""
        until_s = time.monotonic() + START_S
        while not reached():
            item = self._subscription.next_item(until_s)
            if item is None:
                raise OperatorError(f"never: {what}; {len(self.volts)} scans, status {self.status}")
            if isinstance(item, Message | Recovered):
                message = item.message if isinstance(item, Recovered) else item
                if message.topic == "scan":
                    self.volts.append(np.array(message.data["volts"]))
                elif isinstance(item, Message):
                    self.status = item.data
            elif isinstance(item, Restarted) or (isinstance(item, Lost) and item.topic == "scan"):
                raise OperatorError(f"the subscriber cannot have every scan: {item}")

    def until_more_scans(self, n: int) -> None:
        """Receive so many more scans."""
        wanted = len(self.volts) + n
        self.until(lambda: len(self.volts) >= wanted, f"{n} more scans")


@contextmanager
def daemon_on(board: BoardInQemu, folder: Path) -> Iterator[DaemonOnBoard]:
    """Run `tactiled run` on the pty of a board, whose time begins when subscriber and port are open."""
    endpoint, log = f"ipc://{folder}/events.ipc", folder / "log"
    config = daemon_config(folder / "tactiled.toml", board.port, endpoint)
    with config.open("a") as file:
        file.write(f'[session]\nboard_serial = "TB-EXAMPLE"\nrate_hz = {RATE_HZ}\n')
    with (
        Subscription(endpoint, topics=("scan", "status")) as subscription,
        log.open("wb") as errors,
        running(*TACTILED, "run", "--config", config, stderr=errors) as process,
    ):
        daemon = DaemonOnBoard(process, subscription)
        daemon.until(lambda: daemon.status.get("connects") == 1, "the port is open")
        board.qmp("cont")
        yield daemon
        process.terminate()
        process.wait(START_S)
    if process.returncode or "Traceback" in log.read_text():
        raise OperatorError(f"the daemon ended with {process.returncode}: {log.read_text()[-2000:]}")


def reset_often(board: BoardInQemu, daemon: DaemonOnBoard, resets: int, n_scans: int) -> None:
    """Reset the board after so many scans each, every other time within a frame."""
    for number in range(resets + 1):
        while daemon.status["restarts"] < number:  # these are scans of the boot before, which come late
            daemon.until_more_scans(1)
        daemon.until_more_scans(n_scans)
        if number < resets:
            board.reset(is_within_frame=number % 2 == 0)


def accounts(board: BoardInQemu, daemon: DaemonOnBoard, resets: int) -> tuple[SentFrames, list[Aim]]:
    """Stop the board's time, and compare what it sent with what was published and counted."""
    board.qmp("stop")
    sent = sent_by(board)
    with suppress(OperatorError):  # what does not come misses an aim
        n_sent = len(sent.scans)
        daemon.until(lambda: min(len(daemon.volts), daemon.status["scans"]) >= n_sent, "all scans")
    status, missing = daemon.status, daemon.status["scans_missing"]
    unaccounted = abs(len(sent.scans) - len(daemon.volts)) + abs(sent.missing - missing)
    causeless = sent.missing - sent.overrun + abs(missing - status["scans_overrun"])
    pairs = zip(daemon.volts, sent.scans, strict=False)
    differ = sum(bool(np.abs(v - s.counts * _VOLTS_PER_COUNT).max() > _READING_V) for v, s in pairs)
    return sent, [
        never("scans unaccounted for: sent and not published, or missing and not counted", unaccounted),
        never("missing scans without a cause, by the firmware's flags or the daemon's counts", causeless),
        never("published scans with other readings than were sent", differ),
        never("scans counted twice", status["scans_duplicate"]),
        never("cut frames that the daemon does not count", abs(sent.truncated - status["frames_corrupt"])),
        never("resets that the daemon does not count", abs(resets - status["restarts"])),
        at_most("rate: error in the status", 0.1, 1e2 * abs(status["rate_hz"] / RATE_HZ - 1), ".3f", " %"),
    ]
