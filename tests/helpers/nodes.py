"""Node of ROS 2 without DDS, for tests of the bridge."""

from typing import Any

from tactiled.ros2.cdr import encode
from tactiled.ros2.definitions import STANDARD, parse_types
from tactiled.ros2.own_types import own_definitions

TYPES = parse_types({**STANDARD, **own_definitions()})


class FakeWriter:
    """Writer that encodes and notes what is published, and has subscribers."""

    is_wanted = True
    refused = 0

    def __init__(self, written: list[tuple[str, Any]], topic: str, kind: str) -> None:
        self.written, self.topic, self.kind = written, topic, kind

    def write(self, values: Any) -> None:
        encode(self.kind, TYPES, values)
        self.written.append((self.topic, values))


class FakeNode:
    """Node with everything that was published, by topic."""

    def __init__(self) -> None:
        self.written: list[tuple[str, Any]] = []

    def writer(self, topic: str, kind: str, _: str) -> FakeWriter:
        return FakeWriter(self.written, topic, kind)
