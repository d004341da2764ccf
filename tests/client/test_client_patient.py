"""Order of messages on a patient connection, where topics overtake each other. No network."""

from typing import Any

import msgpack

from tactiled.client import Lost, Message, Recovered
from tactiled.client.catchup import PATIENT_HOLD_S
from tactiled.client.inbox import Inbox


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
