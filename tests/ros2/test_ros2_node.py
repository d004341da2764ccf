"""Descriptions of types: a reader that has one of its own, as new versions of ROS 2 have, still matches.

The descriptions are those of rmw_cyclonedds (dyntype.cpp): plain field names.
"""

import os
import socket
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as kinds
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from patience import PATIENCE_S

from tactiled.ros2.participant import Node, TopicWriter

# Of this process: others on this network may test, too. From 102 on, its ports may be taken by connections.
DOMAIN = 1 + os.getpid() % 101


def struct(package: str, bare: str, /, **fields: Any) -> Any:
    return make_idl_struct(bare, f"{package}.dds_.{bare}_", fields)


def until(take: Callable[[], Any]) -> Any:
    """Return what is taken, as soon as there is any."""
    end_s = time.monotonic() + PATIENCE_S
    while not (found := take()) and time.monotonic() < end_s:
        time.sleep(0.02)
    assert found
    return found


@pytest.fixture
def node() -> Iterator[Node]:
    made = Node(DOMAIN, "tactiled", "tactile", loopback=True)
    yield made
    made.close()


@pytest.fixture
def others() -> DomainParticipant:
    return DomainParticipant(DOMAIN)


def test_a_subscriber_that_stops_reading_stops_nothing() -> None:
    class Full:
        def write(self, _: object) -> None:
            raise DDSException(-10)

    writer = TopicWriter(Full(), dict, "event")
    writer.write({"sec": 1, "nanosec": 2})
    assert writer.refused == 1


def test_readers_with_their_own_descriptions_match(node: Node, others: DomainParticipant) -> None:
    stamp = struct("builtin_interfaces.msg", "Time", sec=kinds.int32, nanosec=kinds.uint32)
    header = struct("std_msgs.msg", "Header", stamp=stamp, frame_id=str)
    entry = struct("diagnostic_msgs.msg", "KeyValue", key=str, value=str)
    status = struct(
        "diagnostic_msgs.msg", "DiagnosticStatus",
        level=kinds.uint8, name=str, message=str, hardware_id=str, values=kinds.sequence[entry],
    )  # fmt: skip
    array = struct("diagnostic_msgs.msg", "DiagnosticArray", header=header, status=kinds.sequence[status])
    gid = struct("rmw_dds_common.msg", "Gid", data=kinds.array[kinds.uint8, 16])
    entities = struct(
        "rmw_dds_common.msg", "NodeEntitiesInfo",
        node_namespace=kinds.bounded_str[256], node_name=kinds.bounded_str[256],
        reader_gid_seq=kinds.sequence[gid], writer_gid_seq=kinds.sequence[gid],
    )  # fmt: skip
    info = struct(
        "rmw_dds_common.msg", "ParticipantEntitiesInfo",
        gid=gid, node_entities_info_seq=kinds.sequence[entities],
    )  # fmt: skip
    written = node.writer("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "event")
    diagnostics = DataReader(others, Topic(others, "rt/diagnostics", array))
    discovery = DataReader(others, Topic(others, "ros_discovery_info", info))
    assert until(lambda: diagnostics.matched_pub and discovery.matched_pub)
    written.write({"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "f"}, "status": []})
    (found,) = until(partial(diagnostics.take, 1))
    assert (found.header.stamp.nanosec, found.header.frame_id) == (2, "f")


@pytest.mark.usefixtures("node")
def test_the_discovery_of_nodes_has_its_type_hash(others: DomainParticipant) -> None:
    """Without it every rmw_cyclonedds on the network warns; the hash is that of ROS 2 Iron and Jazzy."""
    reader: Any = BuiltinDataReader(others, BuiltinTopicDcpsPublication)
    (info,) = until(lambda: [each for each in reader.take(16) if each.topic_name == "ros_discovery_info"])
    hash_ = b"RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
    assert bytes(info.qos[Policy.Userdata].data) == b"typehash=" + hash_ + b";"


def test_packets_that_are_no_dds_write_nothing(node: Node, capfd: pytest.CaptureFixture[str]) -> None:
    assert node.domain_id == DOMAIN
    first = 7400 + 250 * DOMAIN + 10  # RTPS 2.5, 9.6.2: ports of the first participants
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for number in range(100):
            packet = b"RTPS\x02\x01\x01\x10" + os.urandom(12) + b"\x15\x05\x04\x00abcd"
            sock.sendto(packet, ("127.0.0.1", first + number % 8))
    time.sleep(0.3)  # while they are read
    assert capfd.readouterr().err == ""


def test_writers_keep_and_repeat_what_their_delivery_says(node: Node, others: DomainParticipant) -> None:
    reader: Any = BuiltinDataReader(others, BuiltinTopicDcpsPublication)
    deliveries: tuple[Any, ...] = ("sensor", "event", "latched", "repeated")
    writers = [node.writer(f"/{name}", "builtin_interfaces/msg/Time", name) for name in deliveries]
    found: dict[str, Any] = {}

    def has_all() -> bool:
        found.update((each.topic_name, each.qos) for each in reader.take(64))
        return {f"rt/{name}" for name in deliveries} <= found.keys()

    until(has_all)
    for name, writer in zip(deliveries, writers, strict=True):
        qos, is_kept = found[f"rt/{name}"], name in ("latched", "repeated")
        wanted = Policy.Reliability.BestEffort if name == "sensor" else Policy.Reliability.Reliable(0)
        assert type(qos[Policy.Reliability]) is type(wanted)
        assert qos[Policy.Durability] == (
            Policy.Durability.TransientLocal if is_kept else Policy.Durability.Volatile
        )
        life = 3_000_000_000 if name == "repeated" else duration(infinite=True)
        assert qos[Policy.Lifespan].lifespan == life
        assert writer.is_wanted is is_kept  # nobody listens yet
