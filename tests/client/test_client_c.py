"""The C interface of the client: from Python's ctypes and from a C program, beside a real daemon."""

import ctypes
import math
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
from client_programs import Program, board, process
from cpp import HEADERS, ROOT, compile_native, need_native
from patience import PATIENCE_S

KINDS: dict[str, str] = dict(re.findall(r"TACTILED_(\w+) = (-?\d+)", (HEADERS / "tactiled.h").read_text()))
C_WARNINGS = "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"
pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with libtactiled.so."""
    need_native()
    folder = tmp_path_factory.mktemp("c")
    compile_native(HEADERS / "libtactiled.cpp", folder / "libtactiled.so", "-shared", "-fPIC")
    return folder


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Endpoint of a daemon whose board has an object that sticks and slips."""
    folder = tmp_path_factory.mktemp("daemon")
    address = f"ipc://{folder}/events.ipc"
    config = folder / "tactiled.toml"
    config.write_text(f'port.url = "{folder}/board"\npublish.endpoints = ["{address}"]\n')
    with board(folder), process("run", "--config", config):
        yield address


class Library:
    """libtactiled, and one client of it."""

    def __init__(self, folder: Path) -> None:
        self.c = ctypes.CDLL(str(folder / "libtactiled.so"))
        for name in ("open", "payload"):
            getattr(self.c, f"tactiled_{name}").restype = ctypes.c_void_p
        for name in ("error", "topic", "board", "reason", "text"):
            getattr(self.c, f"tactiled_{name}").restype = ctypes.c_char_p
        self.c.tactiled_age_s.restype = ctypes.c_double
        self.c.tactiled_numbers.restype = ctypes.c_long
        self.client = ctypes.c_void_p(None)

    def open(self, *texts: str | None) -> bool:
        found = self.c.tactiled_open(*(text if text is None else text.encode() for text in texts))
        self.client = ctypes.c_void_p(found)
        return found is not None

    def call(self, name: str, *arguments: Any) -> Any:
        result = getattr(self.c, f"tactiled_{name}")(self.client, *arguments)
        return result.decode() if isinstance(result, bytes) else result

    @property
    def error(self) -> str:
        return str(self.c.tactiled_error().decode())

    def next(self, wait_s: float) -> str:
        code = str(self.call("next", ctypes.c_double(wait_s)))
        return {value: name for name, value in KINDS.items()}[code]

    def until(self, kind: str, is_wanted: Callable[[], bool] = lambda: True) -> None:
        """Take items until one of a kind is what is wanted."""
        until_s = time.monotonic() + PATIENCE_S
        while self.next(0.1) != kind or not is_wanted():
            assert time.monotonic() < until_s, f"never a {kind}"

    def number(self, field: str) -> float | None:
        value = ctypes.c_double()
        return value.value if self.call("number", field.encode(), ctypes.byref(value)) == 0 else None


@pytest.fixture
def library(built: Path) -> Iterator[Library]:
    library = Library(built)
    yield library
    library.call("close")


def test_messages_are_read_field_by_field(library: Library, endpoint: str) -> None:
    assert library.open(endpoint, "scan slip", None, None)
    library.until("FRESH")
    # Not the first one: a busy host may hold up the daemon, and data are stale again.
    library.until("MESSAGE", lambda: library.call("topic") == "scan" and library.call("is_fresh") == 1)
    assert abs(library.call("age_s")) < PATIENCE_S
    assert library.call("board")
    values = (ctypes.c_double * 40)(*[math.nan] * 40)
    assert library.call("numbers", b"volts", values, 40) == 36
    assert [math.isnan(value) for value in values] == [False] * 36 + [True] * 4
    assert library.call("numbers", b"volts", values, 2) == 36  # no more are written than there is room for
    size = ctypes.c_size_t()
    payload = ctypes.string_at(library.call("payload", ctypes.byref(size)), size.value)
    scan = msgpack.unpackb(payload)
    assert [*values][:36] == scan["volts"]
    assert library.number("seq") == scan["seq"]
    assert library.number("late") == float(scan["late"])
    library.until("MESSAGE", lambda: library.call("topic") == "slip")
    assert library.call("text", b"state") in ("onset", "end")
    assert library.call("text", b"kind") in ("incipient", "gross")


def test_what_is_not_there_is_told(library: Library, endpoint: str) -> None:
    assert library.open(endpoint, "scan", None, None)
    assert library.number("seq") is None
    assert library.error == "the newest item is no message"
    library.until("MESSAGE")
    assert library.number("shear") is None
    assert library.error == "scan has no field shear"
    assert library.number("volts") is None
    assert library.call("text", b"seq") is None
    assert library.call("numbers", b"seq", None, 0) == -1
    assert library.error == "scan: field seq is of another type"


def test_commands_are_carried_out_or_refused(library: Library, endpoint: str) -> None:
    assert library.open(endpoint, "command", None, None)
    library.until("FRESH")
    assert library.call("command", b"inhibit", b"duration_s=0.5") == 0
    library.until("MESSAGE", lambda: library.call("text", b"command") == "inhibit")
    assert library.call("command", b"mark", b"text=a cup\n") == 0
    library.until("MESSAGE", lambda: library.call("text", b"arguments") == '{"text": "a cup"}')
    assert library.call("command", b"mark", b"text=12") == 1  # a number is no text
    assert library.call("command", b"mark", b'text="12"') == 0
    assert library.call("command", b"object-changed", None) == 0
    assert library.call("command", b"inhibit", b"duration_s=0.5\r\n\r\n") == 0  # lines of Windows
    assert library.call("command", b"inhibit", b"duration_s=-1") == 1
    assert "duration_s" in library.error
    assert library.call("command", b"inhibit", b"duration_s") == -1
    assert library.error == "fields: NAME=VALUE is wanted in each line, not duration_s"


@pytest.mark.parametrize("other", ["other", "00123", "1e5"])
def test_another_board_is_not_heard(library: Library, endpoint: str, other: str) -> None:
    assert library.open(endpoint, None, other, None)
    assert library.call("command", b"object-changed", None) == 1  # the board of the client goes with it
    assert other in library.error


def test_no_daemon_is_stale_and_no_mistake(library: Library, tmp_path: Path) -> None:
    assert library.open(f"ipc://{tmp_path}/nobody.ipc", None, None, None)
    library.until("STALE")
    assert library.call("reason")
    assert library.call("is_fresh") == 0
    assert math.isnan(library.call("age_s"))
    assert library.next(0.0) == "NONE"


@pytest.mark.parametrize("endpoint", [None, "nonsense", "tcp://"])
def test_a_wrong_endpoint_is_refused(library: Library, endpoint: str | None) -> None:
    assert not library.open(endpoint, None, None, None)
    assert (endpoint or "endpoint") in library.error


def test_an_unknown_topic_is_refused(library: Library) -> None:
    assert not library.open("tcp://127.0.0.1:1", "slip,grip", None, None)
    assert library.error.startswith("topics: no topic 'slip,grip'; there are: slip, contact, grip,")


def test_keys_that_are_not_there_are_refused(library: Library, tmp_path: Path) -> None:
    assert not library.open("tcp://127.0.0.1:1", None, None, str(tmp_path / "none.toml"))
    assert "none.toml" in library.error


@pytest.fixture(scope="module", params=["listen.c", "listen.rs", "listen_node.c"])
def example(built: Path, request: pytest.FixtureRequest) -> list[str | Path]:
    """Command of an example."""
    source, runs_with = ROOT / "examples" / request.param, f"-Wl,-rpath,{built}"
    program = built / str(request.param).replace(".", "-")
    linked = f"-I{HEADERS}", f"-L{built}", runs_with, "-ltactiled"
    command: list[str | Path] = [program]
    if source.suffix == ".rs":
        need_native("rustc")
        compile_it = [
            "rustc",
            "--edition=2021",
            "-Dwarnings",
            source,
            f"-L{built}",
            f"-Clink-arg={runs_with}",
        ]
    elif source.stem == "listen_node":
        need_native("node")
        need_node_headers()
        program = built / "listen.node"
        command = ["node", shutil.copy(ROOT / "examples" / "listen.js", built)]
        dialect = "-std=gnu99", *C_WARNINGS[1:]  # as Node's headers ask for
        compile_it = ["cc", *dialect, "-shared", "-fPIC", source, "-isystem/usr/include/node", *linked]
    else:
        compile_it = ["cc", *C_WARNINGS, source, *linked]
    subprocess.run([*compile_it, "-o", program], check=True)
    return command


def need_node_headers() -> None:
    """Skip where Node's headers are missing; never in CI."""
    if not Path("/usr/include/node/node_api.h").exists() and "TACTILED_CI" not in os.environ:
        pytest.skip("needs libnode-dev")


def test_the_example_tells_slips(example: list[str | Path], endpoint: str) -> None:
    listening = Program(*example, endpoint)
    try:
        listening.until(lambda lines: ["onset", "of", "a", "slip,", "gross"] in lines, "a gross slip")
    finally:
        listening.kill()


def test_the_example_says_what_is_wrong(example: list[str | Path]) -> None:
    done = subprocess.run([*example, "nowhere"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "nowhere: Invalid argument" in done.stderr


def test_the_example_with_ctypes_runs(built: Path, endpoint: str, tmp_path: Path) -> None:
    code = (ROOT / "examples" / "listen_ctypes.py").read_text()
    program = tmp_path / "listen.py"
    program.write_text(code.replace("libtactiled.so.0", str(built / "libtactiled.so")))
    listening = Program(sys.executable, program, endpoint)
    try:
        listening.until(lambda lines: ["gross"] in lines, "a gross slip")
    finally:
        listening.kill()
    wrong = subprocess.run([sys.executable, program, "nonsense"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 1
    assert wrong.stderr.startswith("nonsense: ")
