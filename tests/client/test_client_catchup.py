"""Catching up, in simulated time: the daemon's own store and control answer, any message may be lost."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import CONTACT, SLIP, STATUS, anything

from tactiled.client import Item, Lost, Malformed, Message, Recovered, Restarted
from tactiled.client.catchup import HOLD_S, PROBE_S, WAITS_S
from tactiled.client.inbox import Inbox
from tactiled.daemon.zmq.control import Control
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import Requester
from tactiled.events import codec
from tactiled.events.types import Event, ScanEvent

SOMEONE = Requester("1", may_command=True)
UNIX_S = 1.7e9


class World:
    """A daemon without sockets, a client without sockets, and a way between them that may lose anything."""

    def __init__(self, history_mb: float = 4.0, topics: tuple[str, ...] = ("slip", "contact")) -> None:
        self.now_s = 100.0
        self.history_mb = history_mb
        self.items: list[Item] = []
        self.deaf = False  # requests go nowhere
        self.start()
        self.subscribe(*topics)
        self.exchange()

    def start(self) -> None:
        self.publisher = Publisher(PublishParams(endpoints=(), history_mb=self.history_mb))
        self.control = Control(self.publisher, [])
        self.sent: dict[str, int] = {}
        self.runs = [*getattr(self, "runs", []), self.publisher.run]

    def subscribe(self, *topics: str) -> None:
        """Replace the client by a new one."""
        self.inbox = Inbox(topics, None, 1e9, self.now_s, can_ask=True)
        self.items = self.inbox.tick(self.now_s)

    def play(self, *steps: str) -> None:
        """Do the steps of which the streams below consist."""
        for step in steps:
            self._act(step)

    def _act(self, step: str) -> None:
        if step in ("heard", "missed"):
            self.publish(SLIP, heard=step == "heard")
        elif step in ("status", "missed-status"):
            self.status(heard=step == "status")
        elif step == "contact":
            self.publish(CONTACT, heard=True)
        elif step == "answered":
            self.deaf = False
            self.exchange()
        elif step == "deaf":
            self.deaf = True
        elif step == "restart":
            self.start()
        elif step == "new-client":
            self.subscribe("slip")
        else:
            self.wait({"wait": 0.01, "hold": HOLD_S, "probe": PROBE_S}[step])

    def publish(self, event: Event, *, heard: bool, board: str = "b") -> None:
        seq = self.sent.get(event.topic, 0)
        self.sent[event.topic] = seq + 1
        self.publisher.send(event, board=board, unix_offset_s=UNIX_S)
        frames = codec.encode(event, seq=seq, board=board, unix_offset_s=UNIX_S, run=self.publisher.run)
        if heard:
            self.items += self.inbox.receive(frames, self.now_s, self.now_s + UNIX_S)

    def status(self, *, heard: bool = True) -> None:
        self.publish(replace(STATUS, time_s=self.now_s, sent=self.publisher.sent("b")), heard=heard)

    def exchange(self) -> None:
        """Let requests and replies travel until there are none."""
        while not self.deaf and self.inbox.catch_up.unsent:
            self.exchange_once()

    def exchange_once(self) -> None:
        """Answer the requests that are there now."""
        for request in self.inbox.catch_up.unsent:
            self.inbox.catch_up.sent(request)
            reply = self.control.answer(msgpack.packb(request), SOMEONE, self.now_s)
            self.items += self.inbox.answer(reply, self.now_s, self.now_s + UNIX_S)

    def wait(self, duration_s: float) -> None:
        self.now_s += duration_s
        self.items += self.inbox.tick(self.now_s)

    def story(self, topic: str = "slip") -> list[int | str]:
        """Items of a topic as text: numbers of live messages, ``r7`` recovered, ``lost 3``, restarts."""
        out: list[int | str] = []
        for item in self.items:
            match item:
                case Message(topic=t, seq=seq) if t == topic:
                    out.append(seq)
                case Recovered(message=Message(topic=t, seq=seq)) if t == topic:
                    out.append(f"r{seq}")
                case Lost(topic=t, count=count) if t == topic:
                    out.append(f"lost {count}")
                case Restarted():
                    out.append("restarted")
        return out


def numbers(story: Iterable[int | str]) -> list[int]:
    """Message numbers in the order they were yielded, live or recovered."""
    return [int(str(s).removeprefix("r")) for s in story if str(s).removeprefix("r").isdigit()]


def lost(story: Iterable[int | str]) -> int:
    return sum(int(str(s).removeprefix("lost ")) for s in story if str(s).startswith("lost "))


@pytest.mark.parametrize(
    ("steps", "story"),
    [
        # a gap is filled before what is newer, and of several gaps only what is missing is fetched
        ("heard heard missed answered missed answered heard answered", "0, 1, r2, r3, 4"),
        ("heard missed heard missed heard missed heard answered", "0, r1, 2, r3, 4, r5, 6"),
        # a status reveals a loss at the end of a topic
        ("heard missed answered", "0"),
        ("heard missed answered status answered", "0, r1"),
        # a daemon that does not answer is given up once, then nothing waits until it answers again
        ("heard deaf missed heard missed heard", "0"),
        ("heard deaf missed heard missed heard hold", "0, lost 1, r2, lost 1, r4"),
        ("heard deaf missed heard hold missed heard", "0, lost 1, r2, lost 1, 4"),
        ("heard deaf missed heard hold probe answered missed heard answered", "0, lost 1, r2, r3, 4"),
        # nothing waits before the daemon has answered once
        ("new-client heard missed heard", "0, lost 1, 2"),
        ("new-client heard missed heard probe answered missed heard answered", "0, lost 1, 2, r3, 4"),
        # a late subscriber gets the newest message and no loss, and never after a newer one
        ("missed contact missed missed new-client answered heard status", "r2, 3"),
        ("missed new-client heard answered", "1"),
        # of a new run everything is fetched from its beginning; a gap of the old run is given up
        ("heard heard restart missed missed heard answered", "0, 1, restarted, r0, r1, 2"),
        ("heard missed heard restart answered", "0, lost 1, 2"),
        ("heard missed heard restart answered heard answered", "0, lost 1, 2, restarted, 0"),
        ("heard missed heard restart heard answered", "0, lost 1, 2, restarted, 0"),
        # an answer of the new run, whose message has the number of the missing one, does not fill the gap
        ("heard missed heard restart missed missed answered", "0, lost 1, 2"),
    ],
)  # fmt: skip
def test_what_becomes_of_missed_messages(steps: str, story: str) -> None:
    world = World()
    world.play(*steps.split())
    assert ", ".join(map(str, world.story())) == story
    assert world.inbox.catch_up.lost == story.count("lost 1")
    assert "new-client" not in steps or world.story("contact") == []


def test_a_recovered_message_is_a_separate_item_with_its_age() -> None:
    world = World()
    world.publish(SLIP, heard=True)
    world.now_s = 130.0
    world.play("missed", "heard")
    world.exchange()
    (old,) = [item for item in world.items if isinstance(item, Recovered)]
    assert not isinstance(old, Message)
    assert old.message.age_s >= 130.0  # its instant is 0


def test_other_topics_do_not_wait_for_one() -> None:
    world = World()
    world.play("heard", "missed", "heard")
    world.publish(CONTACT, heard=True)
    assert world.story("contact") == [0]
    assert world.story() == [0]
    world.exchange()
    assert world.story() == [0, "r1", 2]


def test_of_a_new_run_also_a_topic_without_earlier_messages_is_fetched_from_its_beginning() -> None:
    world = World()
    world.play("heard", "restart", "heard")
    world.publish(CONTACT, heard=False)
    world.publish(CONTACT, heard=True)
    world.exchange()
    assert world.story("contact") == ["restarted", "r0", 1]


def test_a_late_subscriber_gets_no_scan_of_before() -> None:
    world = World()
    scan = ScanEvent(time_s=0.0, index=0, volts=(1.5,), valid=(True,), time_sd_s=2e-5, age_s=0.0, late=False)
    world.publish(scan, heard=False)
    world.publish(SLIP, heard=False)
    world.subscribe("scan", "slip")
    world.status()
    world.exchange()
    assert world.story("slip") == ["r0"]
    assert world.story("scan") == []


def test_messages_of_another_board_are_not_recovered() -> None:
    world = World()
    for board in ("b", "c"):
        world.publish(SLIP, heard=False, board=board)
    world.inbox = Inbox(("slip",), "b", 1e9, world.now_s, can_ask=True, is_patient=True)
    world.items = world.inbox.tick(world.now_s)
    world.exchange()
    assert [item.message.board for item in world.items if isinstance(item, Recovered)] == ["b"]


def test_data_are_not_fresh_while_messages_have_waited_for_a_lost_one() -> None:
    world = World()
    world.status()
    world.play("heard", "missed", "heard")
    assert world.inbox.is_fresh(world.now_s)
    assert not world.inbox.is_fresh(world.now_s + WAITS_S)  # asked before anything else was read


def test_what_has_waited_for_a_late_answer_is_no_present_message() -> None:
    world = World()
    world.play("heard", "missed", "heard")
    world.wait(WAITS_S + 0.1)
    world.exchange()
    assert world.story() == [0, "r1", "r2"]


def test_while_no_request_can_be_sent_only_the_newest_question_waits() -> None:
    world = World()
    world.deaf = True
    world.subscribe("slip")
    world.play("probe", "probe", "probe")
    assert len(world.inbox.catch_up.unsent) == 1


def test_a_reply_that_is_no_message_is_reported_and_counted() -> None:
    world = World()
    (item,) = world.inbox.answer(b"\xc1", world.now_s, world.now_s)
    assert isinstance(item, Malformed)
    assert world.inbox.malformed == 1


def test_messages_dropped_by_the_store_are_counted_as_lost() -> None:
    world = World(history_mb=0.01)
    world.publish(SLIP, heard=True)
    for _ in range(500):
        world.publish(SLIP, heard=False)
    world.publish(SLIP, heard=True)
    world.exchange()
    story = world.story()
    kept = len(story) - 3
    assert kept > 5
    assert story == [0, f"lost {500 - kept}", *[f"r{seq}" for seq in range(501 - kept, 501)], 501]
    assert world.inbox.catch_up.lost == 500 - kept


def test_a_hole_of_several_replies_is_filled_in_order() -> None:
    world = World(history_mb=16.0)
    n_missed = 3000  # a reply has 128 kB of messages at most
    world.publish(SLIP, heard=True)
    for _ in range(n_missed):
        world.publish(SLIP, heard=False)
    world.publish(SLIP, heard=True)
    n_requests = 0
    while requests := world.inbox.catch_up.unsent:
        n_requests += len(requests)
        world.exchange_once()
    assert world.story() == [0, *[f"r{seq}" for seq in range(1, n_missed + 1)], n_missed + 1]
    assert n_requests > 3
    assert world.inbox.catch_up.recovered == n_missed


def test_a_late_answer_changes_nothing() -> None:
    world = World()
    world.play("heard", "missed", "heard")
    (request,) = world.inbox.catch_up.unsent
    world.inbox.catch_up.sent(request)
    world.wait(HOLD_S)
    reply = world.control.answer(msgpack.packb(request), SOMEONE, world.now_s)
    world.items += world.inbox.answer(reply, world.now_s, 0.0)
    assert world.story() == [0, "lost 1", "r2"]


@pytest.mark.parametrize("topic", ["slip", "contact"])
def test_a_reply_that_overtakes_waiting_messages_hides_none_of_them(topic: str) -> None:
    world = World()
    world.start()
    world.inbox = Inbox((topic,), None, 1e9, world.now_s, can_ask=True)
    world.items = world.inbox.tick(world.now_s)
    receive, waiting = world.inbox.receive, []
    world.inbox.receive = lambda *args: waiting.append(args) or []  # type: ignore[method-assign, func-returns-value]
    event = SLIP if topic == "slip" else CONTACT
    world.status()
    for _ in range(3):
        world.publish(event, heard=True)
    world.exchange()  # the reply has number 2, and the subscriber has read nothing yet
    world.items += [item for args in waiting for item in receive(*args)]
    assert world.story(topic) == [0, 1, 2]


@pytest.mark.parametrize("is_known", [True, False])
def test_a_reply_that_overtakes_messages_of_a_board_without_a_status_hides_none_of_them(
    is_known: bool,
) -> None:
    world = World(topics=("slip",))
    if is_known:
        world.status()
    world.subscribe("slip")
    for _ in range(3):
        world.publish(SLIP, heard=False)
    reply = world.control.answer(msgpack.packb(world.inbox.catch_up.unsent[0]), SOMEONE, world.now_s)
    world.items += world.inbox.answer(reply, world.now_s, world.now_s + UNIX_S)
    for seq in range(3):
        frames = codec.encode(SLIP, seq=seq, board="b", unix_offset_s=UNIX_S, run=world.publisher.run)
        world.items += world.inbox.receive(frames, world.now_s, world.now_s + UNIX_S)
    world.status()
    assert world.story() == [0, 1, 2]


steps = st.lists(
    st.sampled_from([*3 * ["heard", "missed"], "contact", "status", "missed-status", "answered", "wait"]),
    max_size=80,
)


@given(steps=steps)
@settings(deadline=None, max_examples=60)
def test_within_the_store_everything_comes_once_and_in_order(steps: list[str]) -> None:
    world = World()
    world.play("heard", "contact", *steps, "answered", "status", "answered")
    assert numbers(world.story("slip")) == list(range(world.sent["slip"]))
    assert numbers(world.story("contact")) == list(range(world.sent["contact"]))
    assert world.inbox.catch_up.lost == 0
    live = [seq for seq in world.story("slip") if isinstance(seq, int)]
    assert live == sorted(live)


@given(steps=steps, restarts=st.lists(st.integers(0, 79), max_size=2))
@settings(deadline=None, max_examples=60)
def test_with_a_small_store_every_message_is_delivered_or_counted_as_lost(
    steps: list[str], restarts: list[int]
) -> None:
    """In each run: what came and what is lost are all that there was, and numbers only grow."""
    world = World(history_mb=0.01, topics=("slip",))
    world.play("heard")
    totals = []
    for place, step in enumerate(steps):
        if place in restarts:
            world.status()
            totals.append(world.sent.get("slip", 0))
            world.start()
            world.status()
        n_times = 21 if place % 7 == 0 else 1
        world.play(*n_times * ["deaf" if step == "contact" else step])
    world.play("answered", "status", "answered")
    totals.append(world.sent.get("slip", 0))
    runs: list[list[int | str]] = [[]]
    for entry in world.story("slip"):
        if entry == "restarted":
            runs.append([])
        else:
            runs[-1].append(entry)
    assert len(runs) == len(totals)
    for run, total in zip(runs, totals, strict=True):
        assert numbers(run) == sorted(set(numbers(run)))
        assert len(numbers(run)) + lost(run) == total


plain = anything(st.sampled_from(["seq", "run", "board", "timestamp", "v"]), max_size=5)
FIELDS = ["v", "id", "do", "ok", "run", "messages", "next_seq", "more"]


@given(replies=st.lists(st.binary(max_size=40) | st.dictionaries(st.sampled_from(FIELDS), plain), max_size=8))
@settings(deadline=None)
def test_a_hostile_daemon_never_raises(replies: list[Any]) -> None:
    world = World()
    world.publish(SLIP, heard=True)
    for reply in replies:
        world.publish(SLIP, heard=False)
        world.publish(SLIP, heard=True)
        ids = [request["id"] for request in world.inbox.catch_up.unsent]
        good = {"v": 1, "id": ids[0] if ids else "", "do": "events", "ok": True, "run": world.publisher.run}
        payload = reply if isinstance(reply, bytes) else msgpack.packb({**good, **reply})
        world.items += world.inbox.answer(payload, world.now_s, world.now_s)
    world.wait(HOLD_S)
    assert all(isinstance(item, Item) for item in world.items)
    assert numbers(world.story())[-1] == 2 * len(replies)


@pytest.mark.parametrize("catch_up", [False, True])
def test_many_gaps_use_bounded_memory(catch_up: bool) -> None:
    world = World()
    world.inbox = Inbox(("slip",), None, 1e9, world.now_s, can_ask=catch_up)
    world.inbox.tick(world.now_s)
    world.exchange()
    world.deaf = True
    for heard in [True, False] * 6000:
        world.publish(SLIP, heard=heard)
    line = world.inbox.catch_up._lines["b", "slip"]  # noqa: SLF001  the bound on held messages has no public sign
    assert len(line.held) <= 4001
    assert len(world.inbox.catch_up.unsent) <= 2
