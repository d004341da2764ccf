"""Boards for the daemon's tests: one that only thinks (`SimBoard`), one on a real pty (`PtyBoard`).

Both are made of the wire codec alone, so that the daemon is not tested with its own emulator.
"""

import contextlib
import os
import pty
import select
import threading
import time
import tty
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from patience import PATIENCE_S

from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Frame, Hello, Scan
from tactiled.wire.layout import Layout, load_layout

LAYOUT = load_layout("board-v1")


class SimBoard:
    """Firmware as board-v1 wants it: state and answers, no I/O, no time."""

    def __init__(
        self, serial: str = "TS0001", array_id: str = "wang2019-3x3", rate_hz: float = 100.0
    ) -> None:
        self.serial, self.array_id = serial, array_id
        self.boot_count = 1
        self.default_rate_hz = self.rate_hz = rate_hz
        self.streaming = False
        self.protocol_version = 1
        self.refuses: dict[str, str] = {}
        """Result for commands that this board will not do."""
        self.commands: list[Command] = []
        self._sequence = 0

    def reboot(self) -> None:
        self.boot_count += 1
        self.rate_hz, self.streaming, self._sequence = self.default_rate_hz, False, 0

    def hello(self) -> Hello:
        return Hello(
            board_serial=self.serial,
            array_id=self.array_id,
            rate_hz=self.rate_hz,
            adc_bits=12,
            adc_reference_v=3.0,
            channel_offset_s=(0.0,) * LAYOUT.n_channels,
            protocol_version=self.protocol_version,
            firmware_version="test",
            boot_count=self.boot_count,
            streaming=self.streaming,
            ticks=0,
        )

    def answer(self, command: Command) -> list[Frame]:
        self.commands.append(command)
        result = self.refuses.get(command.name, "ok")
        acknowledge = Acknowledge(command.token, command.name, result, ticks=0)
        if result != "ok":
            return [acknowledge]
        if command.name == "identify":
            return [acknowledge, self.hello()]
        if command.name == "set_rate":
            assert command.rate_hz is not None
            self.rate_hz = command.rate_hz
        elif command.name in ("start", "stop"):
            self.streaming = command.name == "start"
        return [acknowledge]

    def scan(self, ticks: int) -> Scan:
        self._sequence = (self._sequence + 1) % 65536
        return Scan(self._sequence, np.full(LAYOUT.n_channels, 1000), ticks=ticks % 2**32)


class PtyBoard:
    """A `SimBoard` on a pty behind a link with a stable name; unplugged and plugged in like the real one."""

    def __init__(self, link: Path, sim: SimBoard | None = None, layout: Layout = LAYOUT) -> None:
        self.sim = sim or SimBoard()
        self.link = link
        self.silent = False
        self.received: list[str] = []
        self._encoder, self._layout = Encoder(layout), layout
        self._thread: threading.Thread | None = None
        self.plug()

    def plug(self) -> None:
        master, slave = pty.openpty()
        tty.setraw(slave)
        self.link.symlink_to(os.ttyname(slave))
        os.close(slave)  # who holds the slave open would keep a closed master from being noticed
        self._gone = threading.Event()
        self._thread = threading.Thread(target=self._live, args=(master, self._gone), daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        if self._thread is not None:
            self.link.unlink()
            self._gone.set()
            self._thread.join()
            self._thread = None

    def __enter__(self) -> "PtyBoard":
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def _live(self, master: int, gone: threading.Event) -> None:
        os.set_blocking(master, False)
        decoder = Decoder(self._layout, "host-to-board")
        started_s = next_s = time.monotonic()
        while not gone.is_set():
            readable, _, _ = select.select([master], [], [], max(0.0, min(0.01, next_s - time.monotonic())))
            data = b""
            if readable:
                with contextlib.suppress(OSError):  # EIO: nobody has opened the port yet
                    data = os.read(master, 4096)
                if not data:
                    time.sleep(0.002)
            replies: list[Frame] = []
            for frame in decoder.feed(data):
                if isinstance(frame, Command):
                    self.received.append(frame.name)
                    replies += self.sim.answer(frame)
            now_s = time.monotonic()
            if now_s >= next_s:
                next_s += 1 / self.sim.rate_hz
                if self.sim.streaming:
                    replies.append(self.sim.scan(round(1e6 * (now_s - started_s))))
            if not self.silent:
                self._send(master, replies)
        os.close(master)

    def _send(self, master: int, frames: Iterable[Frame]) -> None:
        for frame in frames:
            with contextlib.suppress(OSError):
                os.write(master, self._encoder.encode(frame))


def until_ports_are_tried() -> None:
    """Wait for the threads that open a port: a daemon that ends does not, since a dead host takes long."""
    for thread in threading.enumerate():
        if thread.name == "open-port":
            thread.join(PATIENCE_S)


def descriptors() -> list[str]:
    """Open descriptors of this process by their targets; a difference before and after is a leak."""
    found = []
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the descriptor of this very look
            found.append(str(entry.readlink()))
    return sorted(found)
