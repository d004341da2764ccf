"""Real processes: `tactiled ros2` between a daemon and an independent DDS (Fast DDS of Debian, in C++).

The peer (tests/ros2/peer.cpp) prints what it discovers and receives; rosbags decodes it.
"""

import json
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE_S
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tactiled import resources
from tactiled.client import Message, Subscription
from tactiled.ros2 import own_types
from tactiled.ros2.names import dds_type

pytestmark = pytest.mark.system
# Of this process: others on this network may test, too. From 102 on, its ports may be taken by connections.
DOMAIN = 1 + os.getpid() % 101
BOARD = "/tactile/TS0001"
PEER = Path(__file__).parents[1] / "ros2" / "peer.cpp"
SCENE = """
name = "ros2"
description = "a press and a slide"
contact = "mechanics"
[[phases]]
kind = "rest"
duration_s = 4.0
[[phases]]
kind = "press"
duration_s = 1.0
force_n = 15.0
[[phases]]
kind = "hold"
duration_s = 1.0
[[phases]]
kind = "slide"
duration_s = 2.0
speed_mm_s = 1.0
direction_deg = 0.0
[[phases]]
kind = "hold"
duration_s = 60.0
"""
TOPICS = {  # ROS topic: type, mode
    f"{BOARD}/wrench": ("geometry_msgs/msg/WrenchStamped", "sensor"),
    f"{BOARD}/taxels": ("sensor_msgs/msg/PointCloud2", "sensor"),
    f"{BOARD}/scan": ("tactiled_msgs/msg/Scan", "sensor"),
    f"{BOARD}/slip": ("tactiled_msgs/msg/Slip", "event"),
    f"{BOARD}/contact": ("tactiled_msgs/msg/Contact", "latched"),
    f"{BOARD}/info": ("tactiled_msgs/msg/Info", "latched"),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "event"),
}
INFO = ("ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo")


def oracle() -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in own_types.own_definitions().items():
        store.register(get_types_from_msg(text, name))
    return store


class Lines:
    """JSON lines of a process, read by a thread."""

    def __init__(self, child: "subprocess.Popen[str]") -> None:
        self.child = child
        self.rows: list[dict[str, Any]] = []
        self._queue: queue.Queue[dict[str, Any]] = queue.Queue()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        assert self.child.stdout is not None
        for line in self.child.stdout:
            self._queue.put(json.loads(line))

    def until(self, condition: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        """First row, from now on, for which the condition holds."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            try:
                row = self._queue.get(timeout=0.1)
            except queue.Empty:
                assert self.child.poll() is None, f"ended before: {what}"
                continue
            self.rows.append(row)
            if condition(row):
                return row
        raise AssertionError(f"never: {what}; {len(self.rows)} lines, last {self.rows[-1:]}")

    def drain(self, duration_s: float) -> list[dict[str, Any]]:
        """Rows of the next seconds."""
        time.sleep(duration_s)
        first = len(self.rows)
        while not self._queue.empty():
            self.rows.append(self._queue.get())
        return self.rows[first:]

    def end(self) -> None:
        self.child.kill()
        self.child.communicate()
        self._thread.join()


def peer_program(folder: Path) -> Path:
    """Compile the peer; skip where Fast DDS is missing, except in CI."""
    missing = [] if shutil.which("c++") else ["c++"]
    if not Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp").exists():
        missing.append("libfastrtps-dev")
    if missing and "TACTILED_CI" not in os.environ:
        pytest.skip(f"needs {' and '.join(missing)} of Debian 12")
    program = folder / "peer"
    command = ["c++", "-std=c++17", "-O0", "-o", str(program), str(PEER), "-lfastrtps", "-lfastcdr"]
    subprocess.run(command, check=True, timeout=240)
    return program


def calibrated(folder: Path) -> Path:
    """The nominal calibration as if it were one of this board: of a nominal one there is no wrench."""
    text = resources.shipped("config", "calibration", "wang2019-3x3.toml").read_text()
    file = folder / "calibration.toml"
    file.write_text(text.replace("nominal = true", "nominal = false").replace('"nominal"', '"measured"'))
    return file


class Robot:
    """Emulated board, daemon, bridge and peers."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self._stack = folder, stack
        self.endpoint = f"ipc://{folder}/events.ipc"
        self.store = oracle()
        (folder / "scene.toml").write_text(SCENE)
        (folder / "tactiled.toml").write_text(
            f'[port]\nurl = "{folder}/board"\n[publish]\nendpoints = ["{self.endpoint}"]\n'
            f'[board]\ncalibration = "{calibrated(folder)}"\n'
        )

    def process(self, *command: str) -> Lines:
        child = subprocess.Popen(command, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        lines = Lines(child)
        self._stack.callback(lines.end)
        return lines

    def tactiled(self, *arguments: str) -> Lines:
        return self.process(sys.executable, "-m", "tactiled", *arguments)

    def peer(self, program: Path, *topics: str) -> Lines:
        words = [str(program), str(DOMAIN)]
        for topic in topics:
            kind, mode = TOPICS[topic]
            words += [f"rt{topic}", dds_type(kind), mode]
        words += [INFO[0], dds_type(INFO[1]), "latched"]
        return self.process(*words)

    def decode(self, row: dict[str, Any], kind: str = "") -> Any:
        kind = kind or TOPICS[row["topic"].removeprefix("rt")][0]
        return self.store.deserialize_cdr(bytes.fromhex(row["data"]), kind)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with ExitStack() as stack:
        yield Robot(tmp_path, stack)


def is_message(topic: str) -> Callable[[dict[str, Any]], bool]:
    return lambda row: row["what"] == "message" and row["topic"] in (topic, f"rt{topic}")


def seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def test_an_independent_dds_sees_a_ros_node(robot: Robot) -> None:
    program = peer_program(robot.folder)
    daemon = robot.tactiled("run", "--config", str(robot.folder / "tactiled.toml"))
    bridge = robot.tactiled("ros2", "--events", robot.endpoint, "--domain", str(DOMAIN))
    bridge.until(lambda row: row["what"] == "node", "the node")
    peer = robot.peer(program, *TOPICS)
    peer.until(lambda row: row["what"] == "participant", "the bridge")
    scene = ("--scene", str(robot.folder / "scene.toml"))
    # Both subscribe before the board sends: on a slow host a slip could pass meanwhile.
    with Subscription(robot.endpoint, ("force", "slip")) as subscription:
        robot.tactiled("emulate", *scene, "--link", str(robot.folder / "board"))
        bridge.until(lambda row: row["what"] == "board", "the board")
        topics_match_what_the_daemon_sends(robot, peer, subscription)
    discovery_names_node_and_types(robot, peer)
    loss_of_the_daemon_is_silence(robot, peer, daemon, program)
    robot.tactiled("run", "--config", str(robot.folder / "tactiled.toml"))
    is_contact = is_message(f"{BOARD}/contact")
    peer.until(lambda row: is_contact(row) and robot.decode(row).valid, "the contact of the next daemon")
    peer.until(is_message(f"{BOARD}/wrench"), "forces of the next daemon")
    bridge.child.terminate()
    assert bridge.child.wait(PATIENCE_S) == 0


def topics_match_what_the_daemon_sends(robot: Robot, peer: Lines, subscription: Subscription) -> None:
    slip = robot.decode(peer.until(is_message(f"{BOARD}/slip"), "a slip"))
    sent: dict[tuple[str, int], Mapping[str, Any]] = {}
    until_s = time.monotonic() + PATIENCE_S
    while ("slip", slip.seq) not in sent:
        item = subscription.next_item(until_s)
        assert item is not None
        if isinstance(item, Message):
            sent[item.topic, round(item.timestamp * 1e6) if item.topic == "force" else item.seq] = item.data
    original = sent["slip", slip.seq]
    assert seconds(slip.onset) == pytest.approx(original["onset"], abs=1e-6)
    assert (slip.state, slip.kind, slip.valid) == (original["state"], original["kind"], original["valid"])
    assert slip.header.frame_id == "tactile_TS0001"
    rows = [row for row in peer.rows if row["what"] == "message"]
    compared = 0
    for row in rows:
        if row["topic"] == f"rt{BOARD}/wrench":
            wrench = robot.decode(row)
            force = sent.get(("force", round(seconds(wrench.header.stamp) * 1e6)))
            if force is not None:
                assert [wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z] == [
                    force["fx_n"], force["fy_n"], force["fz_n"]
                ]  # fmt: skip
                assert wrench.wrench.torque.z == pytest.approx(1e-3 * force["tz_nmm"])
                compared += 1
        if row["topic"] in (f"rt{BOARD}/wrench", f"rt{BOARD}/scan"):
            assert abs(row["at"] - seconds(robot.decode(row).header.stamp)) < PATIENCE_S
    assert compared >= 50
    topics = {row["topic"].removeprefix("rt") for row in rows}
    assert topics >= TOPICS.keys()
    cloud = robot.decode(next(row for row in rows if row["topic"] == f"rt{BOARD}/taxels"))
    assert (cloud.width, cloud.height) == (9, 1)


def discovery_names_node_and_types(robot: Robot, peer: Lines) -> None:
    ours = {row["guid"] for row in peer.rows if row["what"] == "participant" and row["user"] == "enclave=/;"}
    assert len(ours) == 1
    prefix = next(iter(ours))[:24]
    found = {
        (row["what"], row["topic"]): row
        for row in peer.rows
        if row["what"] in ("reader", "writer") and row["guid"].startswith(prefix)
    }
    for topic, (kind, mode) in TOPICS.items():
        writer = found["writer", f"rt{topic}"]
        assert writer["type"] == dds_type(kind)
        assert writer["user"] == f"typehash={robot.store.hash_rihs01(kind)};"
        assert (writer["reliable"], writer["latched"]) == (mode != "sensor", mode == "latched")
    message = [row for row in peer.rows if is_message(INFO[0])(row)][-1]
    info = robot.decode(message, INFO[1])
    assert bytes(info.gid.data).hex() in ours
    (node,) = info.node_entities_info_seq
    assert (node.node_namespace, node.node_name) == ("/tactile", "tactiled")
    for what, gids in (("writer", node.writer_gid_seq), ("reader", node.reader_gid_seq)):
        listed = {bytes(gid.data).hex() for gid in gids}
        assert listed == {row["guid"] for key, row in found.items() if key[0] == what and key[1] != INFO[0]}


def loss_of_the_daemon_is_silence(robot: Robot, peer: Lines, daemon: Lines, program: Path) -> None:
    def is_fresh(row: dict[str, Any]) -> bool:
        return is_message("/diagnostics")(row) and all(one.level != 3 for one in robot.decode(row).status)

    peer.drain(0.0)
    peer.until(is_fresh, "diagnostics: not stale")  # as the bridge may find a daemon on a busy host
    killed_unix_s = time.time()
    daemon.child.kill()

    def is_stale(row: dict[str, Any]) -> bool:
        if not is_message("/diagnostics")(row):
            return False
        # A byte is an octet: rosbags gives it as a number.
        return any(status.level == 3 and "no status" in status.message for status in robot.decode(row).status)

    peer.until(is_stale, "diagnostics: stale")
    peer.drain(0.5)  # what was on its way
    late = [row for row in peer.drain(2.0) if row["what"] == "message"]
    assert {row["topic"] for row in late} <= {"rt/diagnostics", f"rt{BOARD}/contact", INFO[0]}
    second = robot.peer(program, f"{BOARD}/info", f"{BOARD}/contact")
    contact = robot.decode(second.until(is_message(f"{BOARD}/contact"), "the latched contact"))
    assert (contact.state, contact.valid) == ("unknown", False)
    assert seconds(contact.header.stamp) > killed_unix_s
    second.drain(1.0)
    assert not [row for row in second.rows if is_message(f"{BOARD}/info")(row)]  # that of 3 s ago is gone
