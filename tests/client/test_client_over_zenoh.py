"""Endpoints of zenoh, and the order of messages where topics overtake each other. No network."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import msgpack
import pytest
from patience import PATIENCE_S

from tactiled.client import Lost, Message, Recovered
from tactiled.client.catchup import PATIENT_HOLD_S
from tactiled.client.inbox import Inbox
from tactiled.client.over_zenoh import ZenohAddress, parse_address, zenoh_chunk
from tactiled.errors import ConfigError


@pytest.mark.parametrize(
    ("endpoint", "expected"),
    [
        ("zenoh://router/robot7", ZenohAddress("tcp/router:7447", "robot7", None)),
        ("zenoh://10.0.0.1:7000/robot7", ZenohAddress("tcp/10.0.0.1:7000", "robot7", None)),
        ("zenoh://[::1]:7000/*", ZenohAddress("tcp/[::1]:7000", "*", None)),
        ("zenoh:///robot7", ZenohAddress("tcp/127.0.0.1:7447", "robot7", None)),
        ("zenoh:///robot7?config=a.json5", ZenohAddress("", "robot7", Path("a.json5"))),
        ("zenoh://router/robot7?config=a.json5", ZenohAddress("tls/router:7447", "robot7", Path("a.json5"))),
    ],
)
def test_endpoints(endpoint: str, expected: ZenohAddress) -> None:
    assert parse_address(endpoint) == expected


def test_the_keys_of_a_client_are_its_configuration() -> None:
    assert parse_address("zenoh://router/r", Path("k.json5")) == ZenohAddress(
        "tls/router:7447", "r", Path("k.json5")
    )


@pytest.mark.parametrize(
    "endpoint",
    [
        "zenoh://",
        "nonsense",
        "tcp://127.0.0.1:9872/x",
        "zenoh://router",
        "zenoh://r/a/b",
        "zenoh://r:x/a",
        "zenoh://r/a$b",
    ],
)
def test_endpoints_without_a_host_are_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="zenoh://"):
        parse_address(endpoint)


def test_boards_have_names_that_zenoh_takes() -> None:
    assert zenoh_chunk("a*b$c?d#e@f") == "a-b-c-d-e-f"


class Subscriber:
    """Inbox of a patient connection, at a time of its own."""

    def __init__(self, *topics: str) -> None:
        self.now_s = 100.0
        self.inbox = Inbox(topics, None, 0.5, self.now_s, can_ask=True, is_patient=True)

    def receive(
        self, topic: str, seq: int, thinned: frozenset[str] = frozenset(), **fields: Any
    ) -> list[Any]:
        head = {"v": 1, "timestamp": self.now_s, "detected": self.now_s, "seq": seq, "board": "B", "run": 7}
        parts = [f"tactile/B/{topic}".encode(), msgpack.packb(head | fields)]
        return self.inbox.receive(parts, self.now_s, self.now_s, thinned)

    def requests(self) -> list[dict[str, Any]]:
        asked = [request for request in self.inbox.catch_up.unsent if request["do"] == "events"]
        for request in self.inbox.catch_up.unsent:
            self.inbox.catch_up.sent(request)
        return asked


def test_a_program_that_forgets_to_close_a_client_without_a_router_ends() -> None:
    code = "from tactiled.client import Subscription; Subscription('zenoh://127.0.0.1:9/robot', ('slip',))"
    subprocess.run([sys.executable, "-c", code], timeout=PATIENCE_S, check=True)


def test_holes_are_requested_before_the_first_answer_of_the_daemon() -> None:
    subscriber = Subscriber("slip")
    subscriber.receive("slip", 3)
    assert subscriber.receive("slip", 6) == []
    [request] = subscriber.requests()
    assert (request["first_seq"], request["end_seq"]) == (4, 6)


def test_requests_are_repeated_while_nothing_is_received_and_given_up_otherwise() -> None:
    subscriber = Subscriber("slip")
    subscriber.receive("slip", 0)
    subscriber.receive("slip", 2)
    subscriber.requests()
    for _ in range(5):  # the line is cut
        subscriber.now_s += PATIENT_HOLD_S
        assert not [item for item in subscriber.inbox.tick(subscriber.now_s) if isinstance(item, Lost)]
        assert len(subscriber.requests()) == 1
    repeated, lost = 0, list[Any]()
    for seq in range(40):  # the line carries again, and nobody answers
        subscriber.now_s += 0.1 * PATIENT_HOLD_S
        items = subscriber.receive("status", seq, valid=True, sent={})
        repeated += len(subscriber.requests())
        lost += [(item.count, seq) for item in items if isinstance(item, Lost)]
    assert repeated == 2
    assert lost == [(1, 29)]


def test_a_status_that_overtook_a_message_makes_no_loss_of_it() -> None:
    subscriber = Subscriber("slip")
    subscriber.receive("slip", 0)
    subscriber.receive("status", 0, valid=True, sent={"slip": 2})
    assert subscriber.requests() == []
    [slip] = subscriber.receive("slip", 1)
    assert isinstance(slip, Message)
    subscriber.receive("status", 1, valid=True, sent={"slip": 3})
    subscriber.receive("status", 2, valid=True, sent={"slip": 3})
    [request] = subscriber.requests()
    assert (request["first_seq"], request["end_seq"]) == (2, 3)


def test_thinned_topics_have_no_holes() -> None:
    subscriber = Subscriber("scan")
    thinned = frozenset({"scan"})
    items = [item for seq in (0, 5, 10) for item in subscriber.receive("scan", seq, thinned)]
    for seq in range(3):
        items += subscriber.receive("status", seq, thinned, valid=True, sent={"scan": 10 + seq})
    assert [item.seq for item in items if isinstance(item, Message)] == [0, 5, 10]
    assert not [item for item in items if isinstance(item, Lost | Recovered)]
    assert subscriber.requests() == []
