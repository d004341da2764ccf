"""Bridge without DDS: hostile publishers, diagnostics, services; and the options of the command."""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from messages import CONTACT, STATUS, anything
from nodes import FakeNode
from patience import PATIENCE_S

from tactiled.client import Message
from tactiled.client.commander import Reply
from tactiled.client.parse import message_of
from tactiled.commands.ros2 import ros2
from tactiled.errors import OperatorError
from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Event
from tactiled.ros2 import bridge as module
from tactiled.ros2.bridge import BoardServices, Bridge, BridgeParams
from tactiled.ros2.participant import ServiceRequest

ENDPOINT = "ipc:///tmp/events.ipc"


def bridge_with(node: FakeNode) -> Bridge:
    return Bridge(node, BridgeParams((ENDPOINT,)), lambda _: None)  # type: ignore[arg-type]


def now(event: Event, board: str = "TS0001", **fields: Any) -> Message:
    data = codec.to_map(event, seq=1, board=board, unix_offset_s=time.time())
    message = message_of(event.topic, data | fields, time.monotonic(), time.time())
    assert isinstance(message, Message)
    return message


def entries(node: FakeNode) -> list[tuple[str, int, str]]:
    newest = [values for topic, values in node.written if topic == "/diagnostics"][-1]
    return [(entry["name"], entry["level"], entry["message"]) for entry in newest["status"]]


def test_diagnostics_from_nothing_to_a_board() -> None:
    node = FakeNode()
    bridge = bridge_with(node)
    bridge.diagnose()
    assert entries(node) == [(f"tactiled {ENDPOINT}", 3, "no status was received: is tactiled running?")]
    bridge.take(ENDPOINT, now(STATUS, "", valid=False, reason="no such port"))
    bridge.diagnose()
    assert entries(node) == [(f"tactiled {ENDPOINT}", 2, "no such port")]
    bridge.take(ENDPOINT, now(STATUS, warning="a noisy line"))
    bridge.diagnose()
    assert ("tactiled TS0001", 1, "a noisy line") in entries(node)


FIELDS = st.sampled_from(["valid", "reason", "taxels", "volts", "sent", "state"])


@given(
    topic=st.sampled_from([*EVENT_TYPES, "topic-of-a-later-version"]),
    fields=st.dictionaries(FIELDS, anything(st.text()) | st.lists(st.integers(0, 2**64))),
    base=st.sampled_from([STATUS, CONTACT]),
)
def test_whatever_a_publisher_sends_is_encoded_or_counted(
    topic: str, fields: dict[str, Any], base: Event
) -> None:
    node = FakeNode()
    bridge = bridge_with(node)
    bridge.take(ENDPOINT, now(STATUS))
    message = now(base)
    bridge.take(
        ENDPOINT, Message(topic, "TS0001", 1, message.timestamp, message.data | fields, 0.0, 0.0, 0.0)
    )
    bridge.diagnose()


def test_an_integer_that_ros_cannot_hold_is_counted() -> None:
    node = FakeNode()
    bridge = bridge_with(node)
    bridge.take(ENDPOINT, now(STATUS))
    bridge.take(ENDPOINT, now(CONTACT, taxels=[2**63]))
    bridge.take(ENDPOINT, now(CONTACT, taxels="none"))
    bridge.diagnose()
    (entry,) = [values["status"][0] for topic, values in node.written if topic == "/diagnostics"]
    assert {"key": "messages_malformed", "value": "2"} in entry["values"]


@pytest.mark.parametrize("second", [(ENDPOINT, "TS_0001"), ("ipc:///tmp/other.ipc", "TS-0001")])
def test_two_boards_of_one_name_never_share_topics(
    second: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = FakeNode()
    bridge = bridge_with(node)
    bridge.take(ENDPOINT, now(STATUS, "TS-0001"))
    bridge.take(second[0], now(STATUS, second[1], frames_corrupt=77))
    sent = [values for topic, values in node.written if topic == "/tactile/TS_0001/status"]
    assert [values["board"] for values in sent] == ["TS-0001"]
    bridge.diagnose()
    words = f"/tactile/TS_0001 belongs to board TS-0001 of {ENDPOINT}"
    assert (f"tactiled {second[1]} ({second[0]})", 2, words) in entries(node)
    later_s = time.monotonic() + 5
    monkeypatch.setattr(time, "monotonic", lambda: later_s)
    bridge.take(second[0], now(STATUS, second[1], frames_corrupt=78))  # the first one has gone
    assert [v["frames_corrupt"] for t, v in node.written if t == "/tactile/TS_0001/status"][1:] == [78]
    bridge.diagnose()
    assert [(name, level) for name, level, _ in entries(node) if "TS" in name] == [
        (f"tactiled {second[1]}", 0)
    ]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--namespace", "1st"], "letters, digits and single underscores"),
        (["--frame", "TS0001"], "give BOARD=FRAME"),
        (["--domain", "233"], "233 is not in the range"),
    ],
)
def test_wrong_options(arguments: list[str], says: str) -> None:
    done = CliRunner().invoke(ros2, arguments)
    assert done.exit_code == 2
    assert says in done.output


def test_the_message_package_is_written(tmp_path: Path) -> None:
    done = CliRunner().invoke(ros2, ["--messages", str(tmp_path / "src")])
    assert done.exit_code == 0, done.output
    written = {path.name for path in (tmp_path / "src" / "tactiled_msgs" / "msg").iterdir()}
    assert {"Slip.msg", "Candidate.msg"} <= written
    assert (tmp_path / "src" / "tactiled_msgs" / "package.xml").exists()
    (tmp_path / "file").touch()
    done = CliRunner().invoke(ros2, ["--messages", str(tmp_path / "file" / "src")])
    assert "cannot be written" in str(done.exception)


LEFT, RIGHT = "ipc:///tmp/left.ipc", "ipc:///tmp/right.ipc"


class ServingNode(FakeNode):
    """Node without DDS that has requests, and keeps their replies."""

    def __init__(self, *requests: ServiceRequest) -> None:
        super().__init__()
        self.waiting = list(requests)
        self.served: dict[str, str] = {}
        self.replies: list[tuple[int, bool, str]] = []

    def serve(self, service: str, kind: str) -> None:
        self.served[service] = kind

    def requests(self) -> list[ServiceRequest]:
        asked, self.waiting = self.waiting, []
        return asked

    def reply(self, request: ServiceRequest, *, success: bool, message: str) -> None:
        self.replies.append((request.number, success, message))


class FakeCommander:
    """Commander of a daemon that refuses marks of nothing, does not answer to `tare`, and does the rest."""

    made: list["FakeCommander"] = []

    def __init__(self, endpoint: str, who: str, keys: object) -> None:
        self.endpoint, self.who, self.keys = endpoint, who, keys
        self.sent: list[tuple[str, dict[str, Any]]] = []
        self.busy = self.closed = False
        FakeCommander.made.append(self)

    async def send(self, do: str, **arguments: Any) -> Reply:
        assert not self.busy  # one at a time
        self.busy = True
        await asyncio.sleep(0.001)
        self.busy = False
        self.sent.append((do, arguments))
        if do == "tare":
            raise OperatorError("no answer")
        ok = arguments.get("text") != ""
        return Reply(ok, "" if ok else "a mark of nothing", {})

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def commanders(monkeypatch: pytest.MonkeyPatch) -> list[FakeCommander]:
    FakeCommander.made = []
    monkeypatch.setattr(module, "AsyncCommander", FakeCommander)
    return FakeCommander.made


def bridge_of(node: FakeNode, *, allow_commands: bool = True) -> Bridge:
    params = BridgeParams((LEFT, RIGHT), frames={"A": "palm"})
    services = BoardServices(node, None) if allow_commands else None  # type: ignore[arg-type]
    bridge = Bridge(node, params, lambda _: None, services)  # type: ignore[arg-type]
    bridge.take(LEFT, now(STATUS, "A"))
    bridge.take(RIGHT, now(STATUS, "B"))
    return bridge


def run(bridge: Bridge, is_done: Callable[[], bool]) -> None:
    async def main() -> None:
        running = asyncio.create_task(bridge.run())
        async with asyncio.timeout(PATIENCE_S):
            while not is_done():
                await asyncio.sleep(0.005)
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running

    asyncio.run(main())


def ask(number: int, service: str, **values: Any) -> ServiceRequest:
    return ServiceRequest(f"/tactile/{service}", values, 1, number)


def test_requests_reach_the_daemon_of_their_board_and_replies_come_back(
    commanders: list[FakeCommander],
) -> None:
    node = ServingNode(
        ask(1, "A/inhibit", duration_s=0.4, surplus=3),
        ask(2, "B/mark", text="here"),
        ask(3, "A/mark", text=""),
    )
    run(bridge_of(node), lambda: len(node.replies) == 3)
    assert sorted(node.replies) == [(1, True, ""), (2, True, ""), (3, False, "a mark of nothing")]
    by_endpoint = {one.endpoint: one for one in commanders}
    assert by_endpoint[LEFT].sent == [
        ("inhibit", {"timeout_s": 2.0, "board": "A", "duration_s": 0.4}),
        ("mark", {"timeout_s": 2.0, "board": "A", "text": ""}),
    ]
    assert by_endpoint[RIGHT].sent == [("mark", {"timeout_s": 2.0, "board": "B", "text": "here"})]
    assert [one.who for one in commanders] == ["ros2", "ros2"]
    assert all(one.closed for one in commanders)


def test_a_daemon_that_does_not_answer_is_a_failure_with_words(commanders: list[FakeCommander]) -> None:
    node = ServingNode(ask(1, "A/tare"))
    run(bridge_of(node), lambda: bool(node.replies))
    assert node.replies == [(1, False, "no answer")]
    assert len(commanders) == 1


@pytest.mark.usefixtures("commanders")
def test_more_requests_than_may_wait_are_refused() -> None:
    node = ServingNode(*(ask(number, "A/mark", text="x") for number in range(40)))
    run(bridge_of(node), lambda: len(node.replies) == 40)
    assert sum(success for _, success, _ in node.replies) == 32
    refused = {message for _, success, message in node.replies if not success}
    assert refused == {"too many requests: ask again later"}


@pytest.mark.parametrize(("length", "is_sent"), [(1000, True), (1001, False)])
def test_the_longest_text(length: int, *, is_sent: bool, commanders: list[FakeCommander]) -> None:
    node = ServingNode(ask(1, "A/mark", text="x" * length))
    run(bridge_of(node), lambda: bool(node.replies))
    assert node.replies[0][1] is is_sent
    assert len(commanders) == is_sent


def test_services_are_offered_only_where_commands_are_allowed() -> None:
    node = ServingNode()
    bridge_of(node)
    kinds = {
        "tare": "std_srvs/srv/Trigger",
        "inhibit": "tactiled_msgs/srv/Inhibit",
        "mark": "tactiled_msgs/srv/Mark",
    }
    assert node.served == {f"/tactile/{board}/{name}": kinds[name] for board in "AB" for name in kinds}
    closed = ServingNode(ask(1, "A/mark", text="x"))
    bridge = bridge_of(closed, allow_commands=False)
    assert closed.served == {}
    run(bridge, lambda: any(topic == "/diagnostics" for topic, _ in closed.written))
    assert closed.replies == []
    assert len(closed.waiting) == 1  # nobody looked


def test_messages_have_the_frame_of_their_board() -> None:
    node = ServingNode()
    bridge_of(node)
    frames = {topic: values["header"]["frame_id"] for topic, values in node.written if "status" in topic}
    assert frames == {"/tactile/A/status": "palm", "/tactile/B/status": "tactile_B"}


def test_each_board_is_reported_once() -> None:
    heard: list[dict[str, Any]] = []
    bridge = Bridge(ServingNode(), BridgeParams((LEFT,)), heard.append)  # type: ignore[arg-type]
    for _ in range(2):
        bridge.take(LEFT, now(STATUS, "A"))
    ((report),) = heard
    assert (report["what"], report["board"]) == ("board", "A")
    assert {"/tactile/A/slip", "/tactile/A/wrench", "/tactile/A/taxels"} <= set(report["topics"])


def test_a_board_whose_name_is_taken_is_reported_while_it_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    node = ServingNode()
    bridge = bridge_of(node)
    bridge.take(RIGHT, now(STATUS, "A"))

    def refused() -> list[str]:
        bridge.diagnose()
        return [entry["name"] for entry in node.written[-1][1]["status"] if "belongs" in entry["message"]]

    assert refused() == [f"tactiled A ({RIGHT})"]
    later_s = time.monotonic() + 1.1
    monkeypatch.setattr(time, "monotonic", lambda: later_s)
    assert refused() == []


def test_diagnostics_come_from_the_start_and_every_second() -> None:
    node = ServingNode()
    bridge = bridge_of(node)
    began_s = time.monotonic()
    run(bridge, lambda: [topic for topic, _ in node.written].count("/diagnostics") == 2)
    assert time.monotonic() - began_s >= 0.99
    (_, first), (_, second) = [one for one in node.written if one[0] == "/diagnostics"]
    assert {entry["name"] for entry in first["status"]} == {"tactiled A", "tactiled B"}
    assert {entry["hardware_id"] for entry in second["status"]} == {"A", "B"}
