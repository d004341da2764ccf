"""Messages of the ROS 2 driver in C++, over structures made by ROS's own generators (rosidl, of Debian).

The driver and `tactiled ros2` make the same messages of the same input; every field of tactiled_msgs is
compared, and that of the wrench. Diagnostics have keys of their own.
"""

import itertools
import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from cpp import HEADERS, ROOT, WARNINGS
from messages import STATUS
from ruamel.yaml import YAML

from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Event, ForceEvent
from tactiled.ros2 import convert
from tactiled.ros2.definitions import STANDARD
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


STATUS_MAP = message(STATUS)
INVALID = STATUS_MAP | {"valid": False, "state": "no-device", "reason": "the cable is unplugged"}


@pytest.mark.parametrize(
    ("fields", "level", "text"),
    [
        ({"is_active": False}, 3, "the node is not active"),
        ({}, 3, "no status was received: is tactiled running?"),
        ({"status": STATUS_MAP, "is_fresh": True}, 0, STATUS_MAP["state"]),
        ({"status": STATUS_MAP | {"warning": "clock"}, "is_fresh": True}, 1, "clock"),
        ({"status": INVALID}, 2, "the cable is unplugged"),
        ({"status": INVALID | {"reason": ""}}, 2, "no-device"),
        ({"status": INVALID, "status_s": 99.4, "reason": "no status read"}, 3, "no status read"),
        ({"status": STATUS_MAP, "reason": "reading 2.0 s behind"}, 3, "reading 2.0 s behind"),
    ],
)
def test_diagnostics_say_why_nothing_comes(play: Play, fields: dict[str, Any], level: int, text: str) -> None:
    line = {"topic": "diagnostics", "is_active": True, "is_fresh": False, "reason": "", "status_s": 99.9}
    (found,) = play([line | fields])
    (entry,) = found["status"]
    assert entry["message"] == text
    assert int(entry["level"]) == level
    assert entry["hardware_id"] == "TS0001"
    assert found["header"]["stamp"] == {"sec": 1, "nanosec": 500_000_000}


@pytest.mark.parametrize("is_lost", [True, False])
def test_latched_contact_is_that_of_the_bridge(play: Play, is_lost: bool) -> None:
    status = STATUS_MAP | {"contact": "sliding"}
    (found,) = play([{"topic": "lost contact", "data": status, "is_lost": is_lost}])
    expected = convert.contact_from_status(status | {"timestamp": 1.5}, "holding", lost=is_lost)
    assert found == convert.own_message(expected, FRAME)
