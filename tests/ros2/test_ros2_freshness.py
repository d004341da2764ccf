"""What is passed on to ROS 2, and what a late subscriber is given."""

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages import CONTACT, SLIP, STATUS
from nodes import FakeNode

from tactiled.events import codec
from tactiled.events.types import Event
from tactiled.ros2.bridge import BoardTopics, BridgeParams
from tactiled.ros2.freshness import FRESH_S, BoardFreshness

UNIX_S = 1.7e9  # epoch time at monotonic 0


def made(event: Event, at_s: float, **fields: Any) -> dict[str, Any]:
    """Map of an event whose instants are all `at_s`, monotonic."""
    message = codec.to_map(event, seq=1, board="TS0001", unix_offset_s=UNIX_S + at_s)
    return message | fields


def heard(board: BoardFreshness, at_s: float, topic: str, data: Mapping[str, Any]) -> bool:
    return board.admit(topic, data, at_s, UNIX_S + at_s)


steps = st.lists(
    st.tuples(
        st.floats(0, 1.0),  # seconds since the step before
        st.sampled_from(["status", "contact", "slip"]),
        st.floats(-1.0, 2.0),  # age of the message
        st.booleans(),  # validity of a status
    ),
    max_size=30,
)


@given(steps)
def test_nothing_about_the_skin_is_passed_on_without_a_young_valid_status(steps: list[Any]) -> None:
    board, now_s, newest = BoardFreshness(), 0.0, None
    for wait_s, topic, age_s, valid in steps:
        now_s += wait_s
        event = {"status": STATUS, "contact": CONTACT, "slip": SLIP}[topic]
        data = made(event, now_s - age_s) | ({"valid": valid} if topic == "status" else {})
        admitted = heard(board, now_s, topic, data)
        if topic == "status":
            newest = (now_s, age_s, valid)
        elif admitted:
            assert newest is not None
            status_s, status_age_s, status_valid = newest
            assert status_valid
            assert now_s - status_s <= FRESH_S
            assert max(abs(status_age_s), abs(age_s)) <= FRESH_S + 1e-6


def test_a_slip_counts_from_its_detection() -> None:
    board = BoardFreshness()
    heard(board, 10.0, "status", made(STATUS, 10.0))
    slip = made(SLIP, 8.0, detected=UNIX_S + 9.9)  # it began 2 s before: found after a gap
    assert heard(board, 10.0, "slip", slip)
    assert not heard(board, 10.0, "slip", made(SLIP, 8.0))
    assert board.dropped == 1


@pytest.mark.parametrize(
    ("status", "at_s", "level", "words"),
    [
        (None, 0.0, "stale", "no status was received"),
        ({}, 0.1, "ok", "running"),
        ({"warning": "a noisy line"}, 0.1, "warn", "noisy"),
        ({"valid": False, "reason": "no bytes"}, 0.1, "error", "no bytes"),
        ({}, 3.0, "stale", "no status for 3.0 s"),
        ({}, 0.5, "ok", "running"),  # five periods of the status
        ({}, 0.6, "stale", "no status for 0.6 s"),
        ({"timestamp": UNIX_S - 0.5}, 0.1, "ok", "running"),
        ({"timestamp": UNIX_S - 0.6}, 0.1, "stale", "status is 0.6 s off"),
        ({"timestamp": UNIX_S - 9.0}, 0.1, "stale", "status is 9.0 s off"),
    ],
)
def test_diagnostics(status: dict[str, Any] | None, at_s: float, level: str, words: str) -> None:
    board = BoardFreshness()
    if status is not None:
        heard(board, 0.0, "status", made(STATUS, 0.0) | status)
    found = board.level(at_s)
    assert found[0] == level
    assert words in found[1]


def contacts(node: FakeNode) -> list[tuple[str, bool]]:
    found = [values for topic, values in node.written if topic == "/tactile/TS0001/contact"]
    return [(values["state"], values["valid"]) for values in found]


def test_the_latched_contact_follows_silence_and_return() -> None:
    node = FakeNode()
    board = BoardTopics(node, "TS0001", BridgeParams(()))  # type: ignore[arg-type]

    def take(topic: str, data: dict[str, Any], at_s: float) -> None:
        board.take(topic, data, at_s, UNIX_S + at_s)

    take("contact", made(CONTACT, 0.0), 0.0)
    assert not node.written  # no status yet
    take("status", made(STATUS, 0.1, contact="holding"), 0.1)
    take("contact", made(CONTACT, 0.2, state="sliding"), 0.2)
    assert contacts(node) == [("holding", True), ("sliding", True)]
    board.watch(0.3, UNIX_S + 0.3)
    board.watch(0.1 + FRESH_S + 0.01, UNIX_S + 1.0)
    board.watch(2.0, UNIX_S + 2.0)
    assert contacts(node)[2:] == [("unknown", False)]
    take("status", made(STATUS, 5.0, valid=False, contact="holding"), 5.0)
    assert len(contacts(node)) == 3
    take("status", made(STATUS, 5.1, contact="holding"), 5.1)
    assert contacts(node)[3:] == [("holding", True)]
