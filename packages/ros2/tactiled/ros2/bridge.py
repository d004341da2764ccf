"""Process behind ``tactiled ros2``: from daemons to the topics of one ROS 2 node."""

import asyncio
import contextlib
import signal
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from tactiled.client import Client, Message
from tactiled.errors import ContractError, OperatorError, TactiledError
from tactiled.events.incoming import checked_map
from tactiled.events.types import EVENT_TYPES
from tactiled.ros2 import convert
from tactiled.ros2.freshness import BoardFreshness, Level
from tactiled.ros2.names import frame_id, name_of_board
from tactiled.ros2.own_types import PACKAGE, type_name
from tactiled.ros2.participant import Delivery, Node, TopicWriter

_DIAGNOSTICS_S = 1.0
_WATCH_S = 0.1  # period of looking for silence: that of the status
_DELIVERY: dict[str, Delivery] = {
    "scan": "sensor", "force": "sensor", "grip": "sensor",
    "contact": "latched", "info": "repeated",  # for late subscribers
}  # fmt: skip
# Fields of the status in the diagnostics; the topic `status` has them all.
_STATUS_VALUES = ("state", "contact", "rate_hz", "scans", "scans_missing", "frames_corrupt")
DiagnosticsRow: TypeAlias = tuple[str, str, Level, str, Mapping[str, Any]]
Report = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class BridgeParams:
    """Parameters of a bridge."""

    endpoints: Sequence[str]  # endpoints for events of the daemons
    namespace: str = "tactile"  # namespace of node and topics, without leading slash
    # ``frame_id`` by serial number of a board; ``tactile_`` and the number where it has none
    frames: Mapping[str, str] = field(default_factory=dict)
    keys: Path | None = None  # file of this client from `tactiled keys make`


class BoardTopics:
    """Topics of one board on ROS 2, with what decides about their freshness."""

    def __init__(self, node: Node, board: str, params: BridgeParams) -> None:
        self.freshness = BoardFreshness()
        self.name = f"/{params.namespace}/{name_of_board(board)}"
        self.set_board(board, params)
        self._own = {
            topic: node.writer(
                f"{self.name}/{topic}", f"{PACKAGE}/msg/{type_name(topic)}", _DELIVERY.get(topic, "event")
            )
            for topic in EVENT_TYPES
        }
        self._wrench = node.writer(f"{self.name}/wrench", "geometry_msgs/msg/WrenchStamped", "sensor")
        self._cloud = node.writer(f"{self.name}/taxels", "sensor_msgs/msg/PointCloud2", "sensor")
        self._contact = "unknown"
        self.calibration = "none"
        """Calibration of the newest force; without a real one there are no `wrench` and `taxels`."""
        self._was_fresh = False

    def set_board(self, board: str, params: BridgeParams) -> None:
        """Take the frame of a board, the first one or another with the same name in ROS."""
        self._frame = params.frames.get(board) or frame_id(board)
        self._info: Mapping[str, Any] = {}

    @property
    def topics(self) -> list[str]:
        """Names of all topics."""
        return [f"{self.name}/{topic}" for topic in (*self._own, "wrench", "taxels")]

    @property
    def refused(self) -> int:
        """Number of messages that DDS did not take."""
        return sum(writer.refused for writer in (*self._own.values(), self._wrench, self._cloud))

    def take(self, topic: str, data: Mapping[str, Any], now_s: float, unix_s: float) -> None:
        """Publish a message of the daemon, if it is fresh."""
        if not self.freshness.admit(topic, data, now_s, unix_s):
            return
        if topic == "info":
            self._info = data
        elif topic == "contact":
            self._contact = data["state"]
        elif topic == "force":
            self.calibration = data["calibration"]
            _write(self._wrench, lambda: convert.wrench(data, self._frame))
            _write(self._cloud, lambda: convert.taxel_cloud(data, self._info, self._frame))
        _write(self._own[topic], lambda: convert.own_message(data, self._frame))
        if topic == "status":
            self.watch(now_s, unix_s)

    def watch(self, now_s: float, unix_s: float) -> None:
        """Replace the latched contact when the board becomes stale, and when it is fresh again."""
        fresh = self.freshness.is_fresh(now_s)
        if fresh == self._was_fresh:
            return
        self._was_fresh = fresh
        status = dict(self.freshness.status, timestamp=unix_s)
        contact = convert.contact_from_status(status, self._contact, lost=not fresh)
        self._contact = contact["state"]
        self._own["contact"].write(convert.own_message(contact, self._frame))


class Bridge:
    """Publish what daemons send, until stopped; `report` is called with each new board as a map."""

    def __init__(self, node: Node, params: BridgeParams, report: Report) -> None:
        self._node, self._params, self._report = node, params, report
        self._diagnostics = node.writer("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "event")
        self._boards: dict[tuple[str, str], BoardTopics] = {}
        self._refused: dict[tuple[str, str], tuple[str, float]] = {}  # words, when it was last heard
        self._unnamed = {endpoint: BoardFreshness() for endpoint in params.endpoints}
        self._malformed = 0

    async def run(self) -> None:
        """Run until cancelled."""
        async with asyncio.TaskGroup() as group:
            for endpoint in self._params.endpoints:
                group.create_task(self._listen(endpoint))
            group.create_task(self._diagnose())
            group.create_task(self._watch())

    async def _listen(self, endpoint: str) -> None:
        async with Client(endpoint, keys=self._params.keys) as client:
            async for item in client:
                if isinstance(item, Message):  # others are old (Recovered), or show in the diagnostics
                    self.take(endpoint, item)

    def take(self, endpoint: str, message: Message) -> None:
        """Publish a message from an endpoint, if it is fresh; count one that is malformed."""
        now_s, unix_s = time.monotonic(), time.time()
        if message.topic not in EVENT_TYPES:  # of a newer daemon
            return
        try:
            data = checked_map(message.topic, message.data)
        except ContractError:
            self._malformed += 1
            return
        if not message.board:
            self._unnamed[endpoint].admit(message.topic, data, now_s, unix_s)
            return
        key = (endpoint, message.board)
        if key not in self._boards and not self._admit_board(key, now_s):
            return
        try:
            self._boards[key].take(message.topic, data, now_s, unix_s)
        except struct.error:  # an integer that ROS's int64 cannot hold
            self._malformed += 1

    def _admit_board(self, key: tuple[str, str], now_s: float) -> bool:
        """Give topics to a new board; False while another board of the same name has them."""
        board = key[1]
        name = f"/{self._params.namespace}/{name_of_board(board)}"
        before = next((each for each, topics in self._boards.items() if topics.name == name), None)
        if before is None:
            topics = BoardTopics(self._node, board, self._params)
        elif self._boards[before].freshness.is_heard(now_s):
            self._refused[key] = (f"{name} belongs to board {before[1]} of {before[0]}", now_s)
            return False
        else:  # the board was moved, or has a successor: its topics stay, with one latched contact
            topics = self._boards.pop(before)
            topics.watch(now_s, time.time())  # ends the contact of before
            topics.set_board(board, self._params)
        self._refused.pop(key, None)
        self._boards[key] = topics
        self._report({"what": "board", "board": board, "topics": topics.topics})
        return True

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(_WATCH_S)
            for board in self._boards.values():
                board.watch(time.monotonic(), time.time())

    def diagnose(self) -> None:
        """Publish the diagnostics of all boards, and of endpoints without one."""
        rows: list[DiagnosticsRow] = [
            self._row(
                f"tactiled {board}", board, topics.freshness, topics.refused, calibration=topics.calibration
            )
            for (_, board), topics in self._boards.items()
        ]
        now_s = time.monotonic()
        self._refused = {key: why for key, why in self._refused.items() if now_s - why[1] < _DIAGNOSTICS_S}
        rows += [
            (f"tactiled {board} ({endpoint})", board, "error", words, {})
            for (endpoint, board), (words, _) in self._refused.items()
        ]
        for endpoint, freshness in self._unnamed.items():
            boards = [each for each in self._boards if each[0] == endpoint]
            if not boards or freshness.is_heard(time.monotonic()):
                rows.append(self._row(f"tactiled {endpoint}", "", freshness))
        self._diagnostics.write(convert.diagnostics(rows, time.time()))

    async def _diagnose(self) -> None:
        while True:
            self.diagnose()
            await asyncio.sleep(_DIAGNOSTICS_S)

    def _row(
        self, name: str, board: str, freshness: BoardFreshness, refused: int = 0, calibration: str = "none"
    ) -> DiagnosticsRow:
        level, text = freshness.level(time.monotonic())
        status = freshness.status
        values = {name: status[name] for name in _STATUS_VALUES} if status else {}
        counts = {
            "force_calibration": calibration,
            "messages_too_old": freshness.dropped,
            "messages_malformed": self._malformed,
            "messages_refused": refused,
        }
        return name, board, level, text, values | counts


def run_bridge(params: BridgeParams, make_node: Callable[[], Node], report: Report) -> None:
    """Run a bridge until SIGINT or SIGTERM."""

    async def main() -> None:
        node = make_node()
        try:
            task = asyncio.ensure_future(Bridge(node, params, report).run())
            for each in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(each, task.cancel)
            report({"what": "node", "name": f"/{params.namespace}/{node.name}", "domain": node.domain_id})
            with contextlib.suppress(asyncio.CancelledError):
                await task
        finally:
            node.close()

    try:
        asyncio.run(main())
    except* TactiledError as group:
        raise OperatorError(str(group.exceptions[0])) from None


def _write(writer: TopicWriter, make: Callable[[], Mapping[str, Any] | None]) -> None:
    """Convert and publish a message if anyone receives it."""
    if writer.is_wanted and (values := make()) is not None:
        writer.write(values)
