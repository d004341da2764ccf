"""A machine that qemu emulates, with its monitor (QMP)."""

import json
import re
import socket
import subprocess
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from tactiled.errors import OperatorError

PATIENCE_S = 900.0  # without KVM everything is some twenty times slower, an installation most of all


class Qemu:
    """Machine that is off until a subclass starts it; the end of a block cuts its power."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._sockets = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.cut_power()

    def cut_power(self) -> None:
        """Kill the machine, if it runs."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        self._sockets.close()

    def qmp(self, name: str, **arguments: Any) -> Any:
        """Give qemu a command of its monitor, and return the answer."""
        self._monitor.sendall(json.dumps({"execute": name, "arguments": arguments}).encode() + b"\n")
        while "return" not in (answer := json.loads(self._answers.readline())):
            if "error" in answer:
                raise OperatorError(f"qemu, {name}: {answer['error']['desc']}")
        return answer["return"]

    def _start(self, command: Sequence[str], folder: Path) -> None:
        """Run qemu with its monitor in a folder."""
        path = folder / "monitor"
        path.unlink(missing_ok=True)
        options = ["-display", "none", "-qmp", f"unix:{path},server=on,wait=off"]
        self._process = subprocess.Popen(
            [*command, *options], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
        self._monitor = self._connect(path)
        self._answers = self._sockets.enter_context(self._monitor.makefile())
        self._answers.readline()  # the greeting
        self.qmp("qmp_capabilities")

    def _connect(self, path: Path) -> socket.socket:
        """Connect to a socket that qemu opens."""
        until_s = time.monotonic() + PATIENCE_S
        link = self._sockets.enter_context(socket.socket(socket.AF_UNIX))
        while link.connect_ex(str(path)):
            assert self._process is not None
            if self._process.poll() is not None or time.monotonic() > until_s:
                raise OperatorError("qemu did not start; its error is above")
            time.sleep(0.05)
        return link


def version(program: str) -> str:
    """Return ``qemu 7.2.22``."""
    words = subprocess.check_output([program, "--version"], text=True).splitlines()[0]
    return re.sub(r" \(.*", "", words.replace("QEMU emulator version", "qemu"))
