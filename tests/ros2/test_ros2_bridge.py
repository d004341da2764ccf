"""Bridge without DDS: hostile publishers, diagnostics; and the options of the command."""

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
from tactiled.client.parse import message_of
from tactiled.commands.ros2 import ros2
from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Event
from tactiled.ros2.bridge import Bridge, BridgeParams

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


def bridge_of(node: FakeNode) -> Bridge:
    bridge = Bridge(node, BridgeParams((LEFT, RIGHT), frames={"A": "palm"}), lambda _: None)  # type: ignore[arg-type]
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


def test_messages_have_the_frame_of_their_board() -> None:
    node = FakeNode()
    bridge_of(node)
    frames = {topic: values["header"]["frame_id"] for topic, values in node.written if "status" in topic}
    assert frames == {"/tactile/A/status": "palm", "/tactile/B/status": "tactile_B"}


def test_each_board_is_reported_once() -> None:
    heard: list[dict[str, Any]] = []
    bridge = Bridge(FakeNode(), BridgeParams((LEFT,)), heard.append)  # type: ignore[arg-type]
    for _ in range(2):
        bridge.take(LEFT, now(STATUS, "A"))
    ((report),) = heard
    assert (report["what"], report["board"]) == ("board", "A")
    assert {"/tactile/A/slip", "/tactile/A/wrench", "/tactile/A/taxels"} <= set(report["topics"])


def test_a_board_whose_name_is_taken_is_reported_while_it_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    node = FakeNode()
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
    node = FakeNode()
    bridge = bridge_of(node)
    began_s = time.monotonic()
    run(bridge, lambda: [topic for topic, _ in node.written].count("/diagnostics") == 2)
    assert time.monotonic() - began_s >= 0.99
    (_, first), (_, second) = [one for one in node.written if one[0] == "/diagnostics"]
    assert {entry["name"] for entry in first["status"]} == {"tactiled A", "tactiled B"}
    assert {entry["hardware_id"] for entry in second["status"]} == {"A", "B"}
