"""Messages of the ROS 2 driver in C++, over structures made by ROS's own generators (rosidl, of Debian).

What they must hold is worked out here from the messages of the daemon.
"""

import itertools
import json
import math
import os
import random
import runpy
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from cpp import HEADERS, ROOT, WARNINGS
from messages import STATUS
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, ForceEvent
from tools.interfaces import schemas

FRAME = "tactile_TS_0001"
MESSAGES = ROOT / "ros2" / "tactiled_msgs" / "msg"
LAUNCH = ROOT / "ros2" / "tactiled_driver" / "launch" / "driver.launch.py"
RUNTIME = ("rosidl_runtime_cpp", "rosidl_runtime_c", "rosidl_typesupport_interface", "rcutils")
STANDARD = (
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/PointCloud2",
    "diagnostic_msgs/msg/DiagnosticArray",
)
EXAMPLE = ROOT / "ros2" / "tactiled_examples" / "scripts" / "grip_controller.py"
FRESH_S = 0.5
Play = Callable[[Sequence[Mapping[str, Any]]], list[Any]]

INSTANTS = ("onset", "detected", "answered")
MILLI = {  # fields in thousandths of SI units: name in ROS
    "tx_nmm": "tx_n_m", "ty_nmm": "ty_n_m", "tz_nmm": "tz_n_m", "x_mm": "x_m", "y_mm": "y_m",
    "torsion": "torsion_m", "speed_mm_s": "speed_m_s", "speed_sd_mm_s": "speed_sd_m_s",
    "period_mm": "period_m", "period_sd_mm": "period_sd_m",
    "period_min_mm": "period_min_m", "period_max_mm": "period_max_m",
}  # fmt: skip
DEGREES = {
    "direction_deg": "direction_rad", "direction_sd_deg": "direction_sd_rad",
    "angle_deg": "angle_rad", "angle_sd_deg": "angle_sd_rad", "stray_deg": "stray_rad",
}  # fmt: skip


def need_rosidl() -> None:
    """Skip where ROS's generators are missing; never in CI."""
    missing = [] if shutil.which("rosidl") else ["rosidl-tools", "python3-ament-index"]
    if not Path("/usr/include/rosidl_runtime_cpp").exists():
        missing.append("rosidl-generator-c-cpp")
    if not Path("/usr/include/nlohmann/json.hpp").exists():
        missing.append("nlohmann-json3-dev")
    if missing and "TACTILED_CI" not in os.environ:
        pytest.skip(f"needs {' and '.join(missing)} of Debian 12")


def write_standard_types(folder: Path) -> None:
    """Write the definitions of ROS's own types that the driver needs, and of those in them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in STANDARD:
        text, _ = store.generate_msgdef(name, ros_version=2)
        for part in f"MSG: {name}\n{text}".split("=" * 80 + "\n"):
            head, fields = part.split("\n", 1)
            package, bare = head.removeprefix("MSG: ").replace("/msg/", "/").split("/")
            file = folder / package / "msg" / f"{bare}.msg"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(fields)


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
    write_standard_types(sources)
    shutil.copytree(MESSAGES, sources / "tactiled_msgs" / "msg")
    for package in sources.iterdir():
        generate(made, sources, package.name)
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


def stamp(unix_s: float) -> dict[str, int]:
    """Return the time of ROS of a small number of seconds."""
    return {"sec": int(unix_s), "nanosec": round(unix_s % 1.0 * 1e9)}


def in_si(name: str, value: Any) -> tuple[str, Any]:
    """Return name and value that a field has in ROS (REP-103: metres, newton metres, radians)."""
    if isinstance(value, dict):
        return name, dict(in_si(*item) for item in value.items())
    if isinstance(value, list):
        items = [in_si(name, each) for each in value]
        return items[0][0], [item for _, item in items]
    if name in INSTANTS:
        return name, stamp(value)
    if name in MILLI:
        return MILLI[name], pytest.approx(value / 1000, rel=1e-15)
    return (
        (DEGREES[name], pytest.approx(math.radians(value), rel=1e-15)) if name in DEGREES else (name, value)
    )


def test_messages_have_all_fields_in_si_units(play: Play) -> None:
    data = {topic: distinct(schema, itertools.count(1)) for topic, schema in schemas().items()}
    found = play([{"topic": topic, "data": each} for topic, each in data.items()])
    assert len(found) == len(EVENT_TYPES)
    for each, ros in zip(data.values(), found, strict=True):
        header = {"stamp": stamp(each.pop("timestamp")), "frame_id": FRAME}
        assert ros == {"header": header} | in_si("", each)[1]


@pytest.mark.parametrize("unix_s", [math.nan, -3.0, 0.25, 1.7e9 + 0.25, 2.0**31 + 5.5])
def test_stamps_are_within_a_microsecond_and_the_range_of_ros(play: Play, unix_s: float) -> None:
    (time,) = play([{"topic": "instant", "data": repr(unix_s)}])
    assert 0 <= time["nanosec"] < 10**9
    expected_s = 2**31 - 0.5 if unix_s >= 2**31 else max(0.0, unix_s)  # 0 for NaN
    assert time["sec"] + time["nanosec"] * 1e-9 == pytest.approx(expected_s, abs=1e-6)


def force(**fields: Any) -> dict[str, Any]:
    made: dict[str, Any] = {
        "fx_n": 1.0,
        "fy_n": -2.0,
        "fz_n": 3.0,
        "tx_nmm": 10.0,
        "ty_nmm": 20.0,
        "tz_nmm": -30.0,
    }
    event = ForceEvent(time_s=5.25, **made | {"valid": True, "calibration": "left finger"} | fields)
    return codec.to_map(event, seq=7, board="TS-0001", unix_offset_s=0.0)


@pytest.mark.parametrize(
    ("valid", "calibration", "calibrated_only", "is_published"),
    [
        (True, "left finger", True, True),
        (True, "left finger", False, True),
        (True, "nominal", True, False),
        (True, "nominal", False, True),
        (True, "none", True, False),
        (True, "none", False, False),
        (False, "left finger", True, False),
        (False, "left finger", False, False),
    ],
)
def test_a_wrench_is_in_newtons_and_newton_metres(
    play: Play, valid: bool, calibration: str, calibrated_only: bool, is_published: bool
) -> None:
    data = force(valid=valid, calibration=calibration)
    (found,) = play([{"topic": "wrench", "data": data, "calibrated_only": calibrated_only}])
    expected = {
        "header": {"stamp": {"sec": 5, "nanosec": 250_000_000}, "frame_id": FRAME},
        "wrench": {"force": {"x": 1.0, "y": -2.0, "z": 3.0}, "torque": {"x": 0.01, "y": 0.02, "z": -0.03}},
    }
    assert found == (expected if is_published else None)


TAXELS = {"taxel_fx_n": (1.0, 2.0), "taxel_fy_n": (3.0, 4.0), "taxel_fz_n": (5.0, 6.0)}


def places(*x_mm: float) -> dict[str, Any]:
    """Return an `info` message with taxels at y = 8 mm."""
    info = distinct(schemas()["info"], itertools.count(1))
    return {**info, "x_mm": x_mm, "y_mm": (8.0,) * len(x_mm)}


def test_a_cloud_has_places_and_forces_of_the_taxels(play: Play) -> None:
    (found,) = play([{"topic": "taxels", "data": force(**TAXELS), "info": places(3.5, 7.0)}])
    assert found["header"] == {"stamp": {"sec": 5, "nanosec": 250_000_000}, "frame_id": FRAME}
    fields = [{"name": name, "offset": 4 * n, "datatype": 7, "count": 1} for n, name in enumerate(
        ("x", "y", "z", "fx", "fy", "fz")
    )]  # fmt: skip
    assert found["fields"] == fields
    shape = [found[name] for name in ("height", "width", "point_step", "row_step", "is_dense")]
    assert shape == [1, 2, 24, 48, True]
    numbers = struct.unpack(">12f" if found["is_bigendian"] else "<12f", bytes(found["data"]))
    expected = [0.0035, 0.008, 0.0, 1.0, 3.0, 5.0, 0.007, 0.008, 0.0, 2.0, 4.0, 6.0]
    assert numbers == pytest.approx(expected, rel=2**-24)


@pytest.mark.parametrize(
    ("taxels", "more"),
    [
        (TAXELS, {}),
        (TAXELS, {"info": places()}),
        (TAXELS, {"info": places(3.5)}),
        ({}, {"info": places(3.5, 7.0)}),
        (TAXELS | {"taxel_fy_n": (1.0,)}, {"info": places(3.5, 7.0)}),
    ],
)
def test_without_a_place_and_a_force_for_each_taxel_there_is_no_cloud(
    play: Play, taxels: dict[str, Any], more: dict[str, Any]
) -> None:
    assert play([{"topic": "taxels", "data": force(**taxels)} | more]) == [None]


NAMES = {
    "TS0001": "TS0001", "TS-0001": "TS_0001", "0001": "board_0001", "": "board", "--": "board",
    "-a--b_": "a_b", "Tür.3": "T_r_3", "左手": "board", "a\x00b": "a_b",
}  # fmt: skip


def test_frames_have_names_of_ros(play: Play) -> None:
    found = play([{"topic": "frame", "data": board} for board in NAMES])
    assert found == [f"tactile_{name}" for name in NAMES.values()]


def test_the_launch_file_starts_a_node_for_each_board(monkeypatch: pytest.MonkeyPatch) -> None:
    def configuration(name: str) -> Any:
        return SimpleNamespace(perform=lambda values: values[name])

    stubs = {
        "launch": MagicMock(),
        "launch.actions": MagicMock(),
        "launch.substitutions": SimpleNamespace(LaunchConfiguration=configuration),
        "launch_ros": MagicMock(),
        "launch_ros.actions": SimpleNamespace(LifecycleNode=dict),
        "launch_ros.parameter_descriptions": SimpleNamespace(ParameterValue=lambda value, **_: value),
    }
    for name, stub in stubs.items():
        monkeypatch.setitem(sys.modules, name, stub)
    launch = runpy.run_path(str(LAUNCH))
    nodes = launch["nodes_of_boards"]({"boards": ",".join(NAMES), "namespace": "hand/left"})
    assert [node["namespace"] for node in nodes] == [f"hand/left/{name}" for name in NAMES.values()]
    assert [node["parameters"][0]["board"] for node in nodes] == list(NAMES)


STATUS_MAP = codec.to_map(STATUS, seq=7, board="TS0001", unix_offset_s=1.7e9)
OK, WARN, ERROR, STALE = range(4)


@pytest.mark.parametrize(
    ("fields", "age_s", "now_s", "level", "words"),
    [
        ({}, 0.0, 0.1, OK, "running"),
        ({"warning": "a noisy line"}, 0.0, 0.1, WARN, "a noisy line"),
        ({"valid": False, "state": "no-device", "reason": "unplugged"}, 0.0, 0.1, ERROR, "unplugged"),
        ({"valid": False, "state": "no-device", "reason": ""}, 0.0, 0.1, ERROR, "no-device"),
        ({}, 0.0, 0.5, OK, "running"),
        ({}, 0.0, 0.6, STALE, "no status for 0.6 s: is tactiled running?"),
        ({"valid": False}, 0.0, 9.0, STALE, "no status for 9.0 s: is tactiled running?"),
        ({}, 0.4, 0.1, OK, "running"),
        ({}, 2.0, 0.1, STALE, "status is 2.0 s off: messages wait, or the clocks differ"),
        ({}, -2.0, 0.1, STALE, "status is 2.0 s off: messages wait, or the clocks differ"),
    ],
)
def test_diagnostics(
    play: Play, fields: dict[str, Any], age_s: float, now_s: float, level: int, words: str
) -> None:
    status = STATUS_MAP | fields
    (found,) = play(
        [{"topic": "diagnostics", "is_active": True, "status": status, "age_s": age_s, "now_s": now_s}]
    )
    assert found["is_fresh"] is (level in (OK, WARN))
    assert found["message"]["header"] == {"stamp": {"sec": 1, "nanosec": 500_000_000}, "frame_id": ""}
    (entry,) = found["message"]["status"]
    head = [entry["name"], entry["hardware_id"], int(entry["level"]), entry["message"]]
    assert head == ["tactiled TS0001", "TS0001", level, words]
    assert [(pair["key"], str(pair["value"])) for pair in entry["values"]] == [
        ("state", status["state"]),
        ("contact", "sliding"),
        ("rate_hz", "100"),
        ("scans", "1"),
        ("scans_missing", "0"),
        ("frames_corrupt", "0"),
        ("force_calibration", "none"),
        ("messages_too_old", str(int(abs(age_s) > FRESH_S))),
        ("messages_lost", "0"),
        ("messages_malformed", "0"),
        ("messages_refused", "0"),
    ]


@pytest.mark.parametrize(
    ("is_active", "malformed", "words"),
    [
        (False, 0, "the node is not active"),
        (True, 0, "no status was received: is tactiled running?"),
        (True, 3, "no status can be read: is tactiled of another version?"),
    ],
)
def test_diagnostics_without_a_status_say_why(
    play: Play, is_active: bool, malformed: int, words: str
) -> None:
    line = {"topic": "diagnostics", "is_active": is_active, "malformed": malformed, "lost": 5, "now_s": 0.1}
    (found,) = play([line])
    (entry,) = found["message"]["status"]
    assert (int(entry["level"]), entry["message"], found["is_fresh"]) == (STALE, words, False)
    counts = {pair["key"]: int(pair["value"]) for pair in entry["values"] if "messages" in pair["key"]}
    assert (counts["messages_malformed"], counts["messages_lost"]) == (malformed, 5)


def step(topic: str, now_s: float, age_s: float = 0.0, **fields: Any) -> dict[str, Any]:
    status = {"data": STATUS_MAP | fields} if topic == "status" else fields
    return {"topic": topic, "now_s": now_s, "age_s": age_s} | status


ALWAYS = ("status", "info", "recording", "command")
SKIN = ("scan", "slip", "contact", "grip", "force", "texture")


def test_nothing_about_the_skin_is_published_without_a_young_valid_status(play: Play) -> None:
    rng = random.Random(5)
    steps: list[dict[str, Any]] = []
    expected: list[tuple[str, bool, int]] = []
    now_s, too_old, newest_s, is_trusted = 0.0, 0, 0.0, False
    for _ in range(2000):
        now_s += rng.choice((0.0, 0.1, 0.3, 0.5, 0.7))
        topic, age_s = rng.choice(("status", *ALWAYS, *SKIN)), rng.choice((-0.6, -0.5, 0.0, 0.2, 0.5, 0.6))
        valid, is_young = rng.random() < 0.8, abs(age_s) <= FRESH_S
        steps.append(step(topic, now_s, age_s, valid=valid, state="running"))
        if topic == "status":
            newest_s, is_trusted = now_s, valid and is_young
        is_fresh = is_trusted and now_s - newest_s <= FRESH_S
        is_admitted = is_young and (topic in ALWAYS or is_fresh)
        too_old += not is_admitted
        expected.append((topic, is_admitted, too_old))
    (found,) = play([{"topic": "steps", "steps": steps}])
    assert [(row["is_admitted"], row["too_old"]) for row in found] == [row[1:] for row in expected]
    assert {is_admitted for topic, is_admitted, _ in expected if topic in SKIN} == {True, False}


def test_the_latched_contact_follows_silence_and_return(play: Play) -> None:
    steps = [
        step("contact", 0.0, state="sliding"),  # no status yet
        step("status", 0.1, contact="holding"),
        step("contact", 0.2, state="sliding"),
        step("scan", 0.3),
        step("scan", 0.7),
        step("scan", 2.0),
        step("status", 5.0, valid=False, contact="holding"),
        step("status", 5.1, contact="holding"),
    ]
    (found,) = play([{"topic": "steps", "steps": steps}])
    contacts = {number: row["contact"] for number, row in enumerate(found) if "contact" in row}
    states = {number: (each["state"], each["previous"], each["valid"]) for number, each in contacts.items()}
    assert states == {
        1: ("holding", "unknown", True),
        4: ("unknown", "sliding", False),
        7: ("holding", "unknown", True),
    }
    for each in contacts.values():
        assert each["header"] == {"stamp": {"sec": 1, "nanosec": 500_000_000}, "frame_id": FRAME}
        assert (each["board"], each["seq"], each["taxels"]) == ("TS0001", -1, [])


def test_a_lost_contact_is_replaced_by_that_of_the_next_status(play: Play) -> None:
    """What subscribers know is what the newest status says, and nothing is said twice."""
    rng = random.Random(6)
    steps: list[dict[str, Any]] = []
    actual, contacts = "none", ("none", "holding", "sliding")
    for n in range(1000):
        if rng.random() < 0.5:
            actual = rng.choice(contacts)
            if rng.random() < 0.6:  # others are lost
                steps.append(step("contact", n / 10, state=actual))
        steps.append(step("status", n / 10, contact=actual))
    (found,) = play([{"topic": "steps", "steps": steps}])
    known, n_made = "unknown", 0
    for sent, row in zip(steps, found, strict=True):
        if sent["topic"] == "contact" and row["is_admitted"]:
            known = sent["state"]
        if "contact" in row:
            made = row["contact"]
            assert (made["previous"], made["valid"], made["state"] == known) == (known, True, False)
            known, n_made = made["state"], n_made + 1
        assert sent["topic"] == "contact" or sent["data"]["contact"] == known
    assert n_made > 100


class Node:
    """What the example takes from ROS's class."""

    def __init__(self, _: str) -> None:
        self.create_publisher = self.create_subscription = self.get_logger = MagicMock()


@pytest.mark.parametrize(
    ("valid", "silent_s", "age_s", "tightens"),
    [
        (True, 0.0, 0.1, True),
        (True, 0.2, 0.1, True),
        (True, 0.4, 0.1, False),
        (False, 0.0, 0.1, False),
        (True, 0.0, 0.3, False),
        (True, 0.0, -0.3, False),
    ],
)
def test_the_example_tightens_at_young_slips_while_the_board_is_fresh(
    monkeypatch: pytest.MonkeyPatch, valid: bool, silent_s: float, age_s: float, tightens: bool
) -> None:
    """Freshness is by the monotonic clock, so that no clock that is set prolongs it."""
    packages = ("rclpy", "rclpy.qos", "std_msgs", "std_msgs.msg", "tactiled_msgs", "tactiled_msgs.msg")
    stubs: dict[str, Any] = {name: MagicMock() for name in packages}
    stubs["rclpy.node"] = SimpleNamespace(Node=Node)
    for name, stub in stubs.items():
        monkeypatch.setitem(sys.modules, name, stub)
    controller = runpy.run_path(str(EXAMPLE))["GripController"]
    onset = stubs["tactiled_msgs.msg"].Slip.STATE_ONSET
    monotonic_s, unix_s = 50.0, 1.7e9
    monkeypatch.setattr("time.monotonic", lambda: monotonic_s)
    monkeypatch.setattr("time.time", lambda: unix_s)
    node = controller()
    node.on_status(SimpleNamespace(valid=valid))
    monotonic_s += silent_s
    detected = SimpleNamespace(**stamp(unix_s - age_s))
    node.on_slip(SimpleNamespace(valid=True, state=onset, kind="gross", direction_rad=0.0, detected=detected))
    assert node.force_n == (2.5 if tightens else 2.0)
