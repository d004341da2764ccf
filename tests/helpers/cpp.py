"""Compiler of C++, for tests of the headers in protocols/cpp."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HEADERS = ROOT / "protocols" / "cpp"
WARNINGS = "-std=c++17", "-Wall", "-Wextra", "-Werror", "-pedantic"
_PACKAGES = {
    "/usr/include/zmq.hpp": "cppzmq-dev",
    "/usr/include/zmq.h": "libzmq3-dev",
}


def need_native(*programs: str) -> None:
    """Skip where the client of C++ cannot be compiled, or a program is missing; never in CI."""
    missing = [package for path, package in _PACKAGES.items() if not Path(path).exists()]
    missing += [program for program in ("c++", *programs) if shutil.which(program) is None]
    if missing and "TACTILED_CI" not in os.environ:
        pytest.skip(f"needs {' and '.join(missing)}")


def compile_native(source: Path, program: Path, *flags: str) -> Path:
    """Compile a program with the client of C++."""
    command = ["c++", *WARNINGS, *flags, f"-I{HEADERS}", str(source), "-o", str(program), "-lzmq"]
    subprocess.run(command, check=True, timeout=240)
    return program
