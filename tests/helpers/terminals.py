"""A terminal of 80 columns in which a verb runs."""

import contextlib
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from fcntl import ioctl
from pathlib import Path

COLUMNS = 80
_BAR = "━"
_ESCAPE = re.compile(r"\x1b\[[?0-9;]*[A-Za-z]")


def in_terminal(*arguments: str, cwd: Path) -> tuple[int, list[str]]:
    """Run a verb of tactiled with both outputs in a terminal; return its exit code and its lines."""
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, COLUMNS, 0, 0))
    command = [sys.executable, "-m", "tactiled", *arguments]
    with subprocess.Popen(command, stdout=theirs, stderr=theirs, cwd=cwd) as child:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # EIO: the child, which held the other end, has ended
            while part := os.read(ours, 65536):
                shown += part
        os.close(ours)
    lines = [_ESCAPE.sub("", line) for line in shown.decode().splitlines()]
    return child.returncode, [line for line in lines if line and _BAR not in line]
