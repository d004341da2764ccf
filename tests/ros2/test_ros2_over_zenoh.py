"""A node of ROS 2 over zenoh, against zenoh-ros2-sdk, an implementation of others."""

import time
from collections.abc import Iterator
from contextlib import closing

import pytest
import zenoh
from messages import CONTACT, STATUS
from patience import PATIENCE_S
from rosbags.typesys import Stores, get_typestore
from routers import free_port, router
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.discovery import get_topic_info, get_topic_names_and_types
from zenoh_ros2_sdk.keyexpr import topic_keyexpr
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.utils import get_type_hash
from zenoh_threads import zenoh_threads

from tactiled.client import Message
from tactiled.client.over_zenoh import open_session, parse_address, session_config
from tactiled.client.parse import message_of
from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Event
from tactiled.ros2 import convert
from tactiled.ros2.bridge import Bridge, BridgeParams
from tactiled.ros2.cdr import decode
from tactiled.ros2.definitions import STANDARD
from tactiled.ros2.zenoh_node import ZenohNode, add_timestamps

WRENCH = "geometry_msgs/msg/WrenchStamped"
FORCE = {
    "timestamp": 12.5, "valid": True, "calibration": "mine", "fx_n": 1.0, "fy_n": -2.0, "fz_n": 3.0,
    "fx_sd_n": 0.1, "fy_sd_n": 0.1, "fz_sd_n": 0.1, "tx_nmm": 10.0, "ty_nmm": 20.0, "tz_nmm": 30.0,
}  # fmt: skip

__all__ = ["zenoh_threads"]  # a fixture for every test here


@pytest.fixture
def port() -> Iterator[int]:
    port = free_port()
    with closing(router(port)):
        yield port
        if ZenohSession._instance is not None:  # noqa: SLF001  the sdk keeps its session for the process
            ZenohSession._instance.close()  # noqa: SLF001
            ZenohSession._instance = None  # noqa: SLF001


def test_another_implementation_finds_and_decodes_our_topics(port: int) -> None:
    address = parse_address(f"zenoh://127.0.0.1:{port}/x")
    heard: list[zenoh.Sample] = []
    with open_session(address) as ours, open_session(address) as theirs:
        node = ZenohNode(ours, 3, "tactiled", "tactile")
        writer = node.writer("/tactile/left/wrench", WRENCH, "sensor")
        values = convert.wrench(FORCE, "skin")
        assert values is not None
        assert not writer.is_wanted
        hash_ = get_type_hash(WRENCH, STANDARD[WRENCH], dict(STANDARD))
        key = topic_keyexpr(3, "/tactile/left/wrench", "geometry_msgs::msg::dds_::WrenchStamped_", hash_)
        theirs.declare_subscriber(key, heard.append)
        end_s = time.monotonic() + PATIENCE_S
        while len(heard) < 2 and time.monotonic() < end_s:
            if writer.is_wanted:
                writer.write(values)
            time.sleep(0.02)
        names = get_topic_names_and_types(3, "127.0.0.1", port)
        info = get_topic_info("/tactile/left/wrench", 3, "127.0.0.1", port, verbose=True)
        node.close()
        assert names == [("/tactile/left/wrench", [WRENCH])]
        assert info is not None
        [publisher] = info.publishers
        assert (publisher.node_name, publisher.node_namespace) == ("tactiled", "/tactile")
        assert publisher.type_hash == hash_
    first, second = (
        Attachment.from_bytes(sample.attachment.to_bytes()) for sample in heard[:2] if sample.attachment
    )
    assert (first.sequence_id, second.sequence_id) == (1, 2)
    assert abs(first.timestamp_ns / 1e9 - time.time()) < 60
    assert first.gid == second.gid
    assert len(first.gid) == 16
    wrench = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(heard[0].payload.to_bytes(), WRENCH)
    assert wrench.wrench.force.z == 3.0  # type: ignore[attr-defined]
    assert wrench.header.frame_id == "skin"  # type: ignore[attr-defined]


def now(event: Event) -> Message:
    data = codec.to_map(event, seq=1, board="TS0001", unix_offset_s=time.time())
    message = message_of(event.topic, data, time.monotonic(), time.time())
    assert isinstance(message, Message)
    return message


def test_a_board_has_all_topics_and_a_late_subscriber_its_contact(port: int) -> None:
    address = parse_address(f"zenoh://127.0.0.1:{port}/x")
    config = session_config(address)
    add_timestamps(config)
    came: list[bytes] = []
    with zenoh.open(config) as ours, open_session(address) as theirs:
        node = ZenohNode(ours, 4, "tactiled", "tactile")
        bridge = Bridge(node, BridgeParams(("ipc:///tmp/x",)), lambda _: None)
        bridge.take("ipc:///tmp/x", now(STATUS))
        bridge.take("ipc:///tmp/x", now(CONTACT))
        names = {topic for topic, _ in get_topic_names_and_types(4, "127.0.0.1", port)}
        late = zenoh.ext.declare_advanced_subscriber(
            theirs,
            "4/tactile/TS0001/contact/**",
            lambda sample: came.append(sample.payload.to_bytes()),
            history=zenoh.ext.HistoryConfig(),
        )
        end_s = time.monotonic() + PATIENCE_S
        while not came and time.monotonic() < end_s:
            time.sleep(0.02)
        late.undeclare()
        node.close()
    own = {f"/tactile/TS0001/{topic}" for topic in (*EVENT_TYPES, "wrench", "taxels")}
    assert names == own | {"/diagnostics"}
    assert decode("tactiled_msgs/msg/Contact", node.types, came[0])["state"] == CONTACT.state
