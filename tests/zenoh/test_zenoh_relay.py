"""Requests and replies are matched, and what is no request is refused."""

from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.zenoh.relay import Relay


class Daemon:
    def __init__(self, *, allow_commands: bool = True, is_there: bool = True) -> None:
        self.asked: list[dict[str, Any]] = []
        self.is_there = is_there
        self.relay = Relay(self.ask, allow_commands=allow_commands)

    def ask(self, payload: bytes) -> bool:
        if self.is_there:
            self.asked.append(msgpack.unpackb(payload))
        return self.is_there

    def request(self, now_s: float = 0.0, *, may_command: bool = True, **fields: Any) -> list[bytes]:
        heard: list[bytes] = []
        self.relay.request(msgpack.packb({"v": 1} | fields), heard.append, now_s, may_command=may_command)
        return heard

    def reply(self, id_: str, **fields: Any) -> bytes:
        payload: bytes = msgpack.packb({"v": 1, "id": id_, "ok": True} | fields)
        self.relay.reply(payload)
        return payload


def test_each_reply_goes_to_its_request() -> None:
    daemon = Daemon()
    first, second = daemon.request(id="a", do="state"), daemon.request(id="b", do="events", board="B")
    to_second, to_first = daemon.reply("b"), daemon.reply("a")
    assert (first, second) == ([to_first], [to_second])
    daemon.reply("a")
    assert first == [to_first]


def test_a_request_that_is_repeated_gets_every_reply() -> None:
    daemon = Daemon()
    heard = [daemon.request(id="a", do="mark", text="x") for _ in range(2)]
    payload = daemon.reply("a")
    assert heard == [[payload], [payload]]
    assert len(daemon.asked) == 1


def nested(do: str, depth: int) -> bytes:
    """Pack a request with lists in lists."""
    head: bytes = msgpack.packb({"v": 1, "id": "a", "do": do})
    return b"".join([b"\x84", head[1:], msgpack.packb("who"), b"\x91" * depth, b"\x01"])


@pytest.mark.parametrize("do", ["state", "mark"])
def test_requests_that_are_nested_deeply_end_nothing(do: str) -> None:
    daemon, heard = Daemon(), list[bytes]()
    for depth in (400, 1000, 1000):
        daemon.relay.request(nested(do, depth), heard.append, 0.0, may_command=True)
    daemon.reply("a")
    assert heard


def test_a_request_is_not_repeated_for_ever() -> None:
    daemon = Daemon()
    kept = [daemon.request(id="a", do="state") for _ in range(32)]
    assert daemon.request(id="a", do="state") == [b""]
    assert len(daemon.asked) == 1
    payload = daemon.reply("a")
    assert kept == [[payload]] * 32


@pytest.mark.parametrize(
    ("allow", "may_command", "fields", "reason"),
    [
        (False, True, {"do": "tare"}, "--allow-commands"),
        (True, False, {"do": "tare"}, "tactile/HOST/command"),
        # for a longer one the daemon would cut the connection
        (True, True, {"do": "mark", "text": "x" * 16_384}, "longer than"),
        (True, True, {"do": "state", "id": "waits", "board": "B"}, "another request"),
        (True, True, {"do": 5}, "id or do is missing"),
    ],
)
def test_requests_are_refused_with_the_reason(
    allow: bool, may_command: bool, fields: dict[str, Any], reason: str
) -> None:
    daemon = Daemon(allow_commands=allow)
    daemon.request(id="waits", do="state")
    [refusal] = daemon.request(may_command=may_command, **{"id": "a"} | fields)
    assert reason in msgpack.unpackb(refusal)["reason"]
    assert len(daemon.asked) == 1


def test_a_command_is_refused_that_becomes_longer_than_the_daemon_takes() -> None:
    """Numbers of 4 bytes are sent on with 8."""
    daemon, heard = Daemon(), list[bytes]()
    request = {"v": 1, "id": "a", "do": "motion", "acceleration_m_s2": [1.0] * 3000}
    payload = msgpack.packb(request, use_single_float=True)
    daemon.relay.request(payload, heard.append, 0.0, may_command=True)
    assert "longer than" in msgpack.unpackb(heard[0])["reason"]
    assert not daemon.asked


def test_a_command_says_that_it_came_through_zenoh() -> None:
    daemon = Daemon()
    daemon.request(id="a", do="tare", who="w" * 64)
    assert daemon.asked[0]["who"] == "w" * 58 + " zenoh"


def test_without_a_daemon_the_client_is_to_repeat() -> None:
    assert Daemon(is_there=False).request(id="a", do="state") == [b""]


def test_what_is_never_answered_is_forgotten() -> None:
    daemon = Daemon()
    lost = [daemon.request(now_s=0.0, id=str(number), do="state") for number in range(256)]
    assert daemon.request(now_s=1.0, id="x", do="state") == [b""]
    assert len(daemon.asked) == 256
    later = daemon.request(now_s=10.0, id="y", do="state")
    assert all(heard == [b""] for heard in lost)
    assert later == []


@given(st.binary(max_size=60))
def test_any_bytes_are_answered_or_ignored(payload: bytes) -> None:
    daemon, heard = Daemon(), list[bytes]()
    daemon.relay.request(payload, heard.append, 0.0, may_command=True)
    daemon.relay.reply(payload)
    assert len(heard) + len(daemon.asked) >= 1
