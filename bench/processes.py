"""Processes of a measurement: how they are started and ended, and the processor time and memory they take."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tactiled import child
from tactiled.errors import OperatorError

PYTHON = (sys.executable, "-m")
TACTILED = (*PYTHON, child.__name__)
"""A command of tactiled that ends with this process, at the latest."""
START_S = 120.0  # a cold start of the interpreter on a busy machine
_CONFIG = '[port]\nurl = "{port}"\n[publish]\nendpoints = ["{endpoint}"]\n[metrics]\nport = 0\n'


def need_programs(packages: Mapping[str, str]) -> None:
    """Raise `OperatorError` with the Debian packages of the programs that are missing."""
    if missing := [package for program, package in packages.items() if shutil.which(program) is None]:
        raise OperatorError(f"this needs more programs: sudo apt install {' '.join(missing)}")


def compile_program(folder: Path, source: Path, *flags: str) -> Path:
    """Compile a program in C or C++ into a folder; flags follow its source, as libraries must."""
    compiler = "cc" if source.suffix == ".c" else "c++"
    need_programs({compiler: "gcc g++"})
    program = folder / source.stem
    command = [compiler, "-O2", "-Wall", "-Wextra", "-Werror", "-o", str(program), str(source), *flags]
    subprocess.run(command, check=True)
    return program


@contextmanager
def running(*command: str | Path, ready: str = "", **options: Any) -> Iterator["subprocess.Popen[Any]"]:
    """Run a command, with options of `subprocess.Popen`, until the end of the block.

    The first line of its output must have the words `ready`, and is waited for.
    """
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(list(map(str, command)), text=True, **streams | options)
    try:
        if ready and ready not in (line := next_line(process)):
            raise OperatorError(f"{command[0]} did not start: {line!r}")
        yield process
    finally:
        child.end(process)
        if process.stdout is not None:
            process.stdout.close()


def next_line(process: "subprocess.Popen[Any]") -> str:
    """Wait for the next line that a process prints."""
    assert process.stdout is not None
    return str(process.stdout.readline())


def daemon_config(path: Path, port: Path | str, endpoint: str) -> Path:
    """Write the configuration of a daemon without metrics, and return its path."""
    path.write_text(_CONFIG.format(port=port, endpoint=endpoint))
    return path


def wait_for_path(path: Path) -> None:
    """Wait until a path exists."""
    until_s = time.monotonic() + START_S
    while not path.exists():
        if time.monotonic() > until_s:
            raise OperatorError(f"{path} did not appear in {START_S:g} s: is this machine too busy?")
        time.sleep(0.02)


def cpu_s(pid: int) -> float:
    """Processor time of a process with all its threads (proc(5): utime and stime)."""
    try:
        values = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return (int(values[11]) + int(values[12])) / os.sysconf("SC_CLK_TCK")


def rss_mb(pid: int) -> float:
    """Resident memory of a process in 10^6 bytes (proc(5): statm)."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def free_port() -> int:
    """Return a UDP port that is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
