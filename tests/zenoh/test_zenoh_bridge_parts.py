"""Parts of the bridge without a network: waiting for a router, thinning, tokens of boards."""

import itertools
import os
import time
from typing import Any

import pytest
import zenoh

from tactiled.zenoh import bridge as module
from tactiled.zenoh.bridge import ZenohBridge, ZenohBridgeParams, host_name, wait_for_session


class Token:
    def __init__(self, key: str, there: set[str]) -> None:
        self.key, self.there = key, there
        there.add(key)

    def undeclare(self) -> None:
        self.there.discard(self.key)


class FakeSession:
    """Session that keeps what is put, by key, and the tokens that are there."""

    def __init__(self) -> None:
        self.tokens: set[str] = set()
        self.put: list[tuple[str, bytes, bytes | None]] = []
        self.queryables: set[str] = set()

    def liveliness(self) -> "FakeSession":
        return self

    def get(self, _key: str) -> list[Any]:
        return []

    def declare_token(self, key: str) -> Token:
        return Token(key, self.tokens)

    def declare_queryable(self, key: str, _take: object) -> Token:
        return Token(key, self.queryables)


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> FakeSession:
    made = FakeSession()

    def publish(_session: object, key: str, *_: object) -> Any:
        return lambda payload, attachment: made.put.append((key, payload, attachment))

    monkeypatch.setattr(module, "_publisher", publish)
    return made


def bridge_of(session: FakeSession, scan_rate_hz: float | None, tmp_path: object) -> ZenohBridge:
    params = ZenohBridgeParams(f"ipc://{tmp_path}/events.ipc", "h", scan_rate_hz)
    return ZenohBridge(params, session)  # type: ignore[arg-type]


def forward(bridge: ZenohBridge, topic: str, now_s: float, payload: bytes = b"x") -> None:
    bridge._forward(topic.encode(), payload, now_s)  # noqa: SLF001  what its loop does with each message


def test_topics_of_each_scan_are_thinned_to_the_rate_that_was_asked_for(
    session: FakeSession, tmp_path: object
) -> None:
    bridge = bridge_of(session, 10.0, tmp_path)
    for number in range(1001):  # 10 s at 100 Hz, two boards
        for board in ("A", "B"):
            forward(bridge, f"tactile/{board}/scan", 50.0 + number / 100)
        forward(bridge, "tactile/A/slip", 50.0)
    bridge.close()
    sent = [key for key, _, _ in session.put]
    assert 100 <= sent.count("tactile/h/A/scan") <= 102
    assert sent.count("tactile/h/B/scan") == sent.count("tactile/h/A/scan")
    assert sent.count("tactile/h/A/slip") == 1001
    assert {attachment for key, _, attachment in session.put if key.endswith("scan")} == {b"scan,grip,force"}
    assert {attachment for key, _, attachment in session.put if key.endswith("slip")} == {None}


def test_a_pause_is_not_made_up_for(session: FakeSession, tmp_path: object) -> None:
    bridge = bridge_of(session, 10.0, tmp_path)
    for at_s in (50.0, 60.0, 60.01, 60.02, 60.03, 60.11):
        forward(bridge, "tactile/A/scan", at_s)
    bridge.close()
    assert 3 <= len(session.put) <= 4


@pytest.mark.parametrize(("rate_hz", "n_sent"), [(0.0, 0), (None, 5)])
def test_none_or_every_scan_is_sent(
    rate_hz: float | None, n_sent: int, session: FakeSession, tmp_path: object
) -> None:
    bridge = bridge_of(session, rate_hz, tmp_path)
    for _ in range(5):
        forward(bridge, "tactile/A/scan", 50.0)
    bridge.close()
    assert len(session.put) == n_sent


@pytest.mark.parametrize("topic", ["tactile/A", "tactile//slip", "tactile/A/b/slip", "", "a//"])
def test_what_is_no_topic_goes_nowhere(topic: str, session: FakeSession, tmp_path: object) -> None:
    bridge = bridge_of(session, None, tmp_path)
    for _ in range(2):
        forward(bridge, topic, 50.0)
    bridge.close()
    assert session.put == []


def test_a_router_that_comes_later_is_found(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    tried: list[float] = []

    def open_(_: object) -> str:
        tried.append(time.monotonic())
        if len(tried) < 3:
            raise zenoh.ZError("nobody there")
        return "session"

    monkeypatch.setattr(module, "_RETRY_S", 0.2)
    monkeypatch.setattr(zenoh, "open", open_)
    config: Any = None
    assert wait_for_session(config) == "session"  # type: ignore[comparison-overlap]
    assert all(later - earlier >= 0.2 for earlier, later in itertools.pairwise(tried))
    assert len(caplog.messages) == 1  # one line for one reason


@pytest.mark.parametrize(("node", "name"), [("robot7.lab.example", "robot7"), ("", "host")])
def test_the_name_of_a_host_is_a_part_of_keys(node: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Uname:
        nodename = node

    monkeypatch.setattr(os, "uname", Uname)
    assert host_name() == name
