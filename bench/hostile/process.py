"""Run a command of tactiled as a process of its own: exit code, words, memory."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass

_KIB = 1024
# `wait4` counts the memory of the parent, too, which the child shares until it becomes another program.
_PROGRAM = """
import atexit, sys
peak = sys.argv.pop(1)
def note():
    with open("/proc/self/status") as status, open(peak, "w") as to:
        to.write(next(line.split()[1] for line in status if line.startswith("VmHWM")))
atexit.register(note)
from tactiled.cli.entry import main
main()
"""


@dataclass(frozen=True)
class Done:
    """Outcome of a process.

    Attributes
    ----------
    code : int
        Exit code; negative for a signal.
    out, err : str
        First megabyte of standard output and of standard error.
    peak_mb : float
        Largest resident memory, 10^6 bytes.
    """

    code: int
    out: str
    err: str
    peak_mb: float
    seconds: float

    @property
    def is_tidy(self) -> bool:
        """It ended by itself and without a traceback."""
        return self.code >= 0 and "Traceback" not in self.err


def tactiled(*arguments: str, environment: Mapping[str, str] | None = None) -> Done:
    """Run ``tactiled ARGUMENTS`` to its end."""
    began_s = time.monotonic()
    with (
        tempfile.NamedTemporaryFile("r") as peak,
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
    ):
        process = subprocess.run(
            [sys.executable, "-c", _PROGRAM, peak.name, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            env={**os.environ, **(environment or {})},
            check=False,
        )
        out.seek(0)
        err.seek(0)
        return Done(
            process.returncode,
            out.read(1_000_000).decode(errors="replace"),
            err.read(1_000_000).decode(errors="replace"),
            int(peak.read() or 0) * _KIB / 1e6,
            time.monotonic() - began_s,
        )
