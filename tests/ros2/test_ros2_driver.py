"""Messages of the ROS 2 driver in C++, over structures made by ROS's own generators (rosidl, of Debian).

The driver and `tactiled ros2` make the same messages of the same input; every field is compared.
"""

import itertools
import json
import os
import runpy
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
from cpp import HEADERS, ROOT, WARNINGS
from messages import STATUS
from nodes import FakeNode
from ruamel.yaml import YAML

from tactiled.client import Message
from tactiled.client.parse import message_of
from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Event, ForceEvent
from tactiled.ros2 import convert
from tactiled.ros2.bridge import Bridge, BridgeParams
from tactiled.ros2.definitions import STANDARD
from tactiled.ros2.names import frame_id, name_of_board
from tools.interfaces import schemas

FRAME = "tactile_TS_0001"
MESSAGES = ROOT / "ros2" / "tactiled_msgs" / "msg"
RUNTIME = ("rosidl_runtime_cpp", "rosidl_runtime_c", "rosidl_typesupport_interface", "rcutils")
Play = Callable[[Sequence[Mapping[str, Any]]], list[Any]]


def need_rosidl() -> None:
    """Skip where ROS's generators are missing; never in CI."""
    missing = [] if shutil.which("rosidl") else ["rosidl-tools", "python3-ament-index"]
    if not Path("/usr/include/rosidl_runtime_cpp").exists():
        missing.append("rosidl-generator-c-cpp")
    if not Path("/usr/include/nlohmann/json.hpp").exists():
        missing.append("nlohmann-json3-dev")
    if missing and "TACTILED_CI" not in os.environ:
        pytest.skip(f"needs {' and '.join(missing)} of Debian 12")


def generate(folder: Path, sources: Path, package: str) -> None:
    """Generate the structures of a package of messages, as colcon does."""
    files = [f"{sources / package}:msg/{file.name}" for file in sorted((sources / package / "msg").iterdir())]
    command = ["rosidl", "generate", "-t", "cpp", "-o", str(folder / package), "-I", str(sources), package]
    # The interpreter of the system has the generators: not one of an environment in front of it.
    environ = {**os.environ, "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        [*command, *files], env=environ, capture_output=True, text=True, check=False, timeout=240
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def play(tmp_path_factory: pytest.TempPathFactory) -> Play:
    """Function that passes JSON lines through the driver's conversions."""
    need_rosidl()
    folder = tmp_path_factory.mktemp("driver")
    sources, made = folder / "src", folder / "include"
    for name, text in STANDARD.items():
        file = sources / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    constants = "".join(
        f"byte {word}={level}\n" for level, word in enumerate(("OK", "WARN", "ERROR", "STALE"))
    )
    file = sources / "diagnostic_msgs" / "msg" / "DiagnosticStatus.msg"
    file.write_text(constants + file.read_text())
    shutil.copytree(MESSAGES, sources / "tactiled_msgs" / "msg")
    for package in ("builtin_interfaces", "std_msgs", "geometry_msgs", "diagnostic_msgs", "tactiled_msgs"):
        generate(made, sources, package)
    include = [f"-I{HEADERS}", f"-I{ROOT / 'ros2' / 'tactiled_driver' / 'include'}"]
    system = [f"-isystem{path}" for path in (made, *(Path("/usr/include") / name for name in RUNTIME))]
    program = folder / "driver_messages"
    source = Path(__file__).parent / "driver_messages.cpp"
    command = ["c++", *WARNINGS, "-O0", *include, *system, str(source), "-o", str(program)]
    subprocess.run(command, check=True, timeout=240)

    def run(lines: Sequence[Mapping[str, Any]]) -> list[Any]:
        text = "".join(json.dumps(line) + "\n" for line in lines)
        done = subprocess.run([program], input=text, capture_output=True, text=True, check=True, timeout=60)
        return [YAML(typ="safe", pure=True).load(row) for row in done.stdout.split("\n")[:-1]]

    return run


def message(event: Event) -> dict[str, Any]:
    return codec.to_map(event, seq=7, board="TS-0001", unix_offset_s=1.7e9)


def distinct(schema: Mapping[str, Any], count: Iterator[int]) -> Any:
    """Value of a schema in which no two fields are equal, flags apart."""
    kind = schema["type"]
    if kind == "object":
        return {name: distinct(field, count) for name, field in schema["properties"].items()}
    if kind == "array":
        return [distinct(schema["items"], count) for _ in range(2)]
    number = next(count)
    values = {
        "integer": number,
        "number": number + 0.3,
        "string": f'"{number}" \\',
        "boolean": number % 2 == 0,
    }
    return values[kind]


def test_driver_and_bridge_make_the_same_messages(play: Play) -> None:
    data = {topic: distinct(schema, itertools.count(1)) for topic, schema in schemas().items()}
    found = play([{"topic": topic, "data": each} for topic, each in data.items()])
    assert len(found) == len(EVENT_TYPES)
    for each, ros in zip(data.values(), found, strict=True):
        assert ros == convert.own_message(each, FRAME)


def force(**fields: Any) -> dict[str, Any]:
    return message(ForceEvent(time_s=1.0, fx_n=1.0, fz_n=3.0, tx_nmm=10.0, **fields))


@pytest.mark.parametrize("valid", [True, False])
@pytest.mark.parametrize("calibration", ["none", "nominal", "left finger"])
def test_wrench_is_that_of_the_bridge(play: Play, valid: bool, calibration: str) -> None:
    data = force(valid=valid, calibration=calibration)
    strict, loose = play(
        [{"topic": "wrench", "data": data, "calibrated_only": only} for only in (True, False)]
    )
    assert strict == convert.wrench(data, FRAME)
    assert (loose is not None) is (valid and calibration != "none")


BOARDS = "TS0001", "TS-0001", "0001", "", "--", "-a--b_", "Tür.3", "左手", "a\x00b"


def test_frames_are_those_of_the_bridge(play: Play) -> None:
    assert play([{"topic": "frame", "data": board} for board in BOARDS]) == [*map(frame_id, BOARDS)]


def test_namespaces_of_the_launch_file_are_those_of_the_bridge(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("", ".actions", ".substitutions"):
        monkeypatch.setitem(sys.modules, f"launch{module}", MagicMock())
    for module in ("", ".actions", ".parameter_descriptions"):
        monkeypatch.setitem(sys.modules, f"launch_ros{module}", MagicMock())
    launch = runpy.run_path(str(ROOT / "ros2" / "tactiled_driver" / "launch" / "driver.launch.py"))
    assert [*map(launch["name_of_board"], BOARDS)] == [*map(name_of_board, BOARDS)]


STATUS_MAP = message(STATUS)


@contextmanager
def clocks(now_s: float, unix_s: float) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "monotonic", lambda: now_s)
        patch.setattr(time, "time", lambda: unix_s)
        yield


@pytest.mark.parametrize(
    ("fields", "age_s", "now_s"),
    [
        ({}, 0.0, 0.1),
        ({"warning": "a noisy line"}, 0.0, 0.1),
        ({"valid": False, "state": "no-device", "reason": "the cable is unplugged"}, 0.0, 0.1),
        ({"valid": False, "state": "no-device", "reason": ""}, 0.0, 0.1),
        ({}, 0.0, 0.5),
        ({}, 0.0, 0.6),
        ({"valid": False}, 0.0, 9.0),
        ({}, 0.4, 0.1),
        ({}, 2.0, 0.1),
        ({}, -2.0, 0.1),  # of a clock that was set back
    ],
)
def test_freshness_and_diagnostics_are_those_of_the_bridge(
    play: Play, fields: dict[str, Any], age_s: float, now_s: float
) -> None:
    node, data = FakeNode(), STATUS_MAP | {"board": "TS0001"} | fields
    bridge = Bridge(node, BridgeParams(("",)), lambda _: None)  # type: ignore[arg-type]
    received = message_of("status", data, 0.0, data["timestamp"] + age_s)
    assert isinstance(received, Message)
    with clocks(0.0, data["timestamp"] + age_s):
        bridge.take("", received)
    with clocks(now_s, 1.5):
        bridge.diagnose()
    (found,) = play(
        [{"topic": "diagnostics", "is_active": True, "status": data, "age_s": age_s, "now_s": now_s}]
    )
    expected = node.written[-1][1]
    assert [found["message"]["header"], len(found["message"]["status"])] == [expected["header"], 1]
    (entry,) = found["message"]["status"]
    entry |= {"level": int(entry["level"]), "values": [texts(pair) for pair in entry["values"]]}
    assert [entry] == expected["status"]
    assert found["is_fresh"] is (entry["level"] in (0, 1))


def texts(pair: Mapping[str, Any]) -> dict[str, str]:
    """Key and value of the diagnostics, of which a YAML reader makes numbers."""
    return {name: str(value) for name, value in pair.items()}


@pytest.mark.parametrize(
    ("is_active", "words"),
    [(False, "the node is not active"), (True, "no status was received: is tactiled running?")],
)
def test_diagnostics_without_a_status_say_why(play: Play, is_active: bool, words: str) -> None:
    (found,) = play([{"topic": "diagnostics", "is_active": is_active, "now_s": 0.1}])
    (entry,) = found["message"]["status"]
    assert (int(entry["level"]), entry["message"], found["is_fresh"]) == (3, words, False)


@pytest.mark.parametrize("is_lost", [True, False])
def test_latched_contact_is_that_of_the_bridge(play: Play, is_lost: bool) -> None:
    status = STATUS_MAP | {"contact": "sliding"}
    (found,) = play([{"topic": "lost contact", "data": status, "is_lost": is_lost}])
    expected = convert.contact_from_status(status | {"timestamp": 1.5}, "holding", lost=is_lost)
    assert found == convert.own_message(expected, FRAME)
