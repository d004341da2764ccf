"""The example firmware of protocols/c/example, compiled for a Cortex-M3 and run by qemu on a pty."""

import json
import os
import shutil
import socket
import subprocess
import time
from pathlib import Path
from typing import Any, Self

import pytest
from patience import PATIENCE_S

from tactiled import resources

SOURCES = resources.shipped("protocols", "c")
_PACKAGES = {"arm-none-eabi-gcc": "gcc-arm-none-eabi", "qemu-system-arm": "qemu-system-arm"}
# The last one keeps the compiler from calling memset, which a program without a library does not have.
FLAGS = [
    "-std=c99", "-O2", "-g", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-mcpu=cortex-m3", "-mthumb",
    "-ffreestanding", "-nostdlib", "-fno-tree-loop-distribute-patterns",
]  # fmt: skip


def compile_firmware(folder: Path) -> Path:
    """Compile the firmware; skip where the compiler or qemu is missing, except in CI."""
    missing = [package for program, package in _PACKAGES.items() if shutil.which(program) is None]
    if missing and "TACTILED_CI" not in os.environ:
        pytest.skip(f"needs {' and '.join(missing)}")
    example = SOURCES / "example"
    image = folder / "firmware.elf"
    sources = [example / "firmware.c", example / "mps2_an385.c", SOURCES / "tactiled_board.c"]
    script = example / "mps2_an385.ld"
    subprocess.run(["arm-none-eabi-gcc", *FLAGS, "-T", script, "-o", image, *sources], check=True)
    return image


FAULTS = ("scans_missed", "frames_dropped", "frames_corrupt", "octets_dropped")  # as in firmware.h


class BoardInQemu:
    """Emulated microcontroller as a context manager.

    Attributes
    ----------
    port : str
        Pty at the other end of the UART.
    sent : Path
        File of all bytes that the UART has sent, written by qemu.
    """

    def __init__(self, image: Path, folder: Path) -> None:
        self.sent = folder / "sent.bin"
        symbols = subprocess.check_output(["arm-none-eabi-nm", image], text=True)
        self._addresses = {name: address for address, _, name in map(str.split, symbols.splitlines())}
        self._debugger = folder / "debugger"
        monitor = folder / "monitor"
        self._child = subprocess.Popen(
            ["qemu-system-arm", "-M", "mps2-an385", "-display", "none", "-monitor", "none",
             "-kernel", image, "-qmp", f"unix:{monitor},server=on,wait=off",
             "-gdb", f"unix:{self._debugger},server=on,wait=off",
             "-chardev", f"pty,id=line,logfile={self.sent}", "-serial", "chardev:line"],
            stdout=subprocess.DEVNULL,
        )  # fmt: skip
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(PATIENCE_S)
        until_s = time.monotonic() + PATIENCE_S
        while self._socket.connect_ex(str(monitor)):
            assert self._child.poll() is None, "qemu ended; its error is above"
            assert time.monotonic() < until_s, "qemu did not open its monitor"
            time.sleep(0.05)
        self._lines = self._socket.makefile("r")
        self._lines.readline()  # the greeting
        self.command("qmp_capabilities")
        names = {device["label"]: device["filename"] for device in self.command("query-chardev")}
        self.port = names["line"].removeprefix("pty:")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._lines.close()
        self._socket.close()
        self._child.kill()
        self._child.wait()

    def command(self, name: str, **arguments: str) -> Any:
        """Give qemu a command, and return its answer."""
        self._socket.sendall(json.dumps({"execute": name, "arguments": arguments}).encode() + b"\n")
        while "return" not in (answer := json.loads(self._lines.readline())):
            assert "error" not in answer, answer
        return answer["return"]

    def faults(self) -> dict[str, int]:
        """Read the counters of faults that the firmware keeps for its debugger."""
        text = self.command(
            "human-monitor-command", **{"command-line": f"xp /4wd 0x{self._addresses['firmware_faults']}"}
        )
        numbers = [int(word) for line in text.splitlines() for word in line.split(":")[1].split()]
        return dict(zip(FAULTS, numbers, strict=True))

    def reset_within_a_frame(self) -> None:
        """Reset processor and peripherals while a frame is on the line; memory keeps its content."""
        until_s = time.monotonic() + PATIENCE_S
        while self._last_byte() == b"\0":  # only the end of a frame is zero
            assert time.monotonic() < until_s, "the board sends nothing"
        self.command("system_reset")

    def hang(self) -> None:
        """Let the main loop hang where it feeds the watchdog, with interrupts as before.

        A debugger writes an endless loop there; a reset loads the program anew.
        """
        with socket.socket(socket.AF_UNIX) as debugger:
            debugger.settimeout(PATIENCE_S)
            debugger.connect(str(self._debugger))
            for packet in (f"M{self._addresses['port_feed_watchdog']},2:fee7", "D"):  # write; detach
                debugger.sendall(f"${packet}#{sum(packet.encode()) % 256:02x}".encode())
                answer = b""
                while b"OK#9a" not in answer:
                    answer += debugger.recv(64)
                debugger.sendall(b"+")

    def _last_byte(self) -> bytes:
        with self.sent.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read()
