"""``python -m tactiled.child VERB ...``: a tactiled command that ends with the process that started it.

Its standard input is a pipe whose writing end only the parent has. The kernel closes that end however the
parent ends, also when it is killed.
"""

import os
import runpy
import signal
import subprocess
import sys
import threading
from typing import Any

_END_S = 5.0  # from SIGTERM to SIGKILL


def start(*arguments: str, **options: Any) -> "subprocess.Popen[Any]":
    """Start a verb of tactiled that ends with this process, or at `end`; options are those of `Popen`."""
    command = [sys.executable, "-m", __name__, *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, **options)


def end(process: "subprocess.Popen[Any]") -> None:
    """End a process that was started here, and wait for it."""
    process.terminate()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _end_with_parent() -> None:
    while os.read(0, 1):  # empty once the parent has ended
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    runpy.run_module("tactiled", run_name="__main__", alter_sys=True)
