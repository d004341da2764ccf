"""Inbox: items from messages and from silence, in simulated time."""

import math
import time
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages import anything

from tactiled.client import Fresh, Item, Lost, Malformed, Message, Restarted, Stale
from tactiled.client.inbox import Inbox

UNIX_S = 1.7e9  # offset of the wall clock to the monotonic one, here


class Daemon:
    """Messages of a daemon, as it would send them, and the inbox that reads them."""

    def __init__(self, topics: tuple[str, ...] = (), board: str | None = None) -> None:
        self.now_s = 1000.0
        self.inbox = Inbox(topics, board, 0.5, self.now_s)
        self.board = "TS0001"
        self.restart()

    def restart(self) -> None:
        self.run = getattr(self, "run", 100) + 1
        self.started_s = self.now_s
        self.seq: dict[str, int] = {}

    def make(self, topic: str, **fields: Any) -> list[bytes]:
        seq = self.seq.get(topic, 0)
        self.seq[topic] = seq + 1
        head = {"v": 1, "timestamp": self.now_s + UNIX_S, "seq": seq, "board": self.board, "run": self.run}
        message = {**head, **({"detected": head["timestamp"]} if topic == "slip" else {}), **fields}
        return [f"tactile/{self.board or '-'}/{topic}".encode(), msgpack.packb(message)]

    def make_status(self, **fields: Any) -> list[bytes]:
        known = {"state": "running", "valid": True, "reason": "", "age_s": 0.01}
        return self.make("status", **known | {"uptime_s": self.now_s - self.started_s} | fields)

    def read(self, parts: list[bytes]) -> list[Item]:
        return self.inbox.receive(parts, self.now_s, self.now_s + UNIX_S)

    def status(self, **fields: Any) -> list[Item]:
        return self.read(self.make_status(**fields))

    def wait(self, duration_s: float) -> list[Item]:
        self.now_s += duration_s
        return self.inbox.tick(self.now_s)

    @property
    def fresh(self) -> bool:
        return self.inbox.is_fresh(self.now_s)


def kinds(items: list[Item]) -> list[str]:
    return ["Message" if isinstance(item, Message) else type(item).__name__ for item in items]


def test_a_message_carries_what_was_sent() -> None:
    daemon = Daemon()
    (message,) = daemon.read(daemon.make("slip", state="onset"))
    assert isinstance(message, Message)
    assert (message.topic, message.board, message.seq) == ("slip", "TS0001", 0)
    assert message.timestamp == 1000.0 + UNIX_S
    assert message.data["state"] == "onset"


def test_nothing_is_fresh_before_a_valid_status() -> None:
    daemon = Daemon()
    assert not daemon.fresh
    assert kinds(daemon.read(daemon.make("scan"))) == ["Message"]
    assert not daemon.fresh
    assert kinds(daemon.status()) == ["Fresh", "Message"]
    assert daemon.fresh
    assert kinds(daemon.status()) == ["Message"]


def test_silence_is_reported_once_and_ends_with_a_status() -> None:
    daemon = Daemon(topics=("slip",))
    assert daemon.status() == [Fresh()]
    assert daemon.wait(0.4) == []
    assert daemon.inbox.deadline_s == pytest.approx(1000.5)
    (stale,) = daemon.wait(0.1)
    assert isinstance(stale, Stale)
    assert stale.silent_s == pytest.approx(0.5)
    assert daemon.inbox.deadline_s == math.inf
    assert daemon.wait(10.0) == []
    assert daemon.status() == [Fresh()]


@pytest.mark.parametrize("state", ["no-device", "syncing", "stalled", "fault"])
def test_a_board_that_does_not_run_is_stale_with_its_reason(state: str) -> None:
    daemon = Daemon(topics=("slip",))
    daemon.status()
    (stale,) = daemon.status(state=state, valid=False, reason="unplugged", age_s=3.0)
    assert stale == Stale(f"{state}: unplugged", 3.0)
    assert not daemon.fresh
    assert daemon.status(state=state, valid=False, reason="unplugged") == []


def test_a_status_without_words_is_stale_for_an_unknown_reason() -> None:
    daemon = Daemon(topics=("slip",))
    assert daemon.status(state=3, valid=False, reason=None, age_s=3.0) == [Stale("unknown: unknown", 3.0)]


def test_after_a_sleep_the_backlog_is_stale_before_its_first_message() -> None:
    daemon = Daemon(topics=("slip", "scan"))
    daemon.status()
    queued = [daemon.make("slip", state="onset")]
    for _ in range(600):
        daemon.now_s += 0.1
        queued += [daemon.make("scan"), daemon.make_status()]
    assert not daemon.fresh  # asked before anything was read
    items = [item for parts in queued for item in daemon.read(parts)]
    assert kinds(items[:2]) == ["Stale", "Message"]
    fresh_at = kinds(items).index("Fresh")
    behind = [item for item in items[:fresh_at] if isinstance(item, Message)]
    assert all(daemon.now_s + UNIX_S - m.timestamp > 0.4 for m in behind)
    assert kinds(items).count("Lost") == 0


@given(lost=st.lists(st.integers(0, 5), min_size=1, max_size=30))
def test_every_missing_number_is_counted(lost: list[int]) -> None:
    daemon = Daemon(topics=("scan",))
    daemon.read(daemon.make("scan"))
    told = 0
    for n in lost:
        for _ in range(n):
            daemon.make("scan")
        items = daemon.read(daemon.make("scan"))
        told += sum(item.count for item in items if isinstance(item, Lost))
    assert told == daemon.inbox.catch_up.lost == sum(lost)


def test_a_restart_is_noticed_although_numbers_have_overtaken_and_missed_messages_count_as_lost() -> None:
    daemon = Daemon(topics=("slip", "scan"))
    for _ in range(5):
        daemon.now_s += 0.1
        daemon.status()
        daemon.read(daemon.make("scan"))
    daemon.now_s += 20.0
    daemon.restart()
    for _ in range(300):  # not heard: our connection came back late
        daemon.now_s += 0.1
        daemon.make_status()
        daemon.make("scan")
    items = daemon.status()
    assert kinds(items) == ["Stale", "Restarted", "Fresh"]
    assert kinds(daemon.read(daemon.make("scan"))) == ["Lost", "Message"]
    assert daemon.inbox.catch_up.lost == 300


def test_a_status_reveals_messages_that_never_arrived() -> None:
    daemon = Daemon(topics=("slip",))
    daemon.status(sent={"slip": 7, "scan": 900})  # joined here: what was before is no loss
    assert daemon.status(sent={"slip": 7, "scan": 910}) == []
    assert daemon.status(sent={"slip": 9, "scan": 920}) == [Lost("slip", "TS0001", 2)]
    assert daemon.status(sent={"slip": 9, "scan": 930}) == []


@pytest.mark.parametrize(
    "sent", [None, [], 7, {"slip": -1}, {"slip": 1.5}, {"slip": True}, {b"slip": 3}, {"slip": 2**64 - 1}]
)
def test_invalid_counts_of_sent_messages_are_ignored(sent: Any) -> None:
    daemon = Daemon(topics=("slip",))
    daemon.status(sent={"slip": 0})
    assert daemon.status(sent=sent) == []


def test_a_status_from_the_future_is_stale_and_no_restart() -> None:
    daemon = Daemon(topics=("slip",))
    daemon.status()
    daemon.now_s += 0.1
    assert daemon.status(timestamp=daemon.now_s + UNIX_S + 0.4) == []
    assert daemon.fresh
    (stale,) = daemon.status(timestamp=daemon.now_s + UNIX_S + 3600.0)
    assert stale == Stale("status from 3600.0 s ahead: the clocks differ", 0.0)


def test_a_status_from_a_second_ahead_is_stale() -> None:
    daemon = Daemon(topics=("slip",))
    (stale,) = daemon.status(timestamp=daemon.now_s + UNIX_S + 1.0)
    assert stale == Stale("status from 1.0 s ahead: the clocks differ", 0.0)
    assert not daemon.fresh


@pytest.mark.parametrize("valid", [None, 0, 1, "true"])
def test_a_status_that_does_not_say_that_data_are_valid_is_stale(valid: Any) -> None:
    daemon = Daemon(topics=("slip",))
    assert kinds(daemon.status(valid=valid)) == ["Stale"]
    assert not daemon.fresh


def test_a_backlog_is_stale_although_the_wall_clock_was_set_back_meanwhile() -> None:
    daemon = Daemon(topics=("slip",))
    daemon.status()
    queued = []
    for _ in range(160):
        daemon.now_s += 0.1
        queued += [daemon.make_status(), daemon.make("slip", state="onset")]
    back_s = 60.0
    items = []
    for parts in queued:
        items += daemon.inbox.receive(parts, daemon.now_s, daemon.now_s + UNIX_S - back_s)
        old = [i for i in items[-1:] if isinstance(i, Message) and i.data.get("state") == "onset"]
        if old and daemon.now_s + UNIX_S - old[0].timestamp > 0.6:
            assert not daemon.fresh
    assert kinds(items)[0] == "Stale"


@given(st.floats(-200e-6, 200e-6), st.lists(st.floats(0.0, 0.2), min_size=2, max_size=300))
def test_crystals_that_differ_are_no_backlog(part: float, delays_s: list[float]) -> None:
    inbox = Inbox(("slip",), None, 0.5, 0.0)
    for hour, delay_s in enumerate(delays_s):
        status = {"run": 1, "uptime_s": hour * 3600.0 * (1 + part)}
        assert inbox._behind_s(status, hour * 3600.0 + delay_s, is_recent=True) <= 0.2  # noqa: SLF001  the estimate alone, at 16 h and more
    assert inbox._behind_s(status, hour * 3600.0 + 16.0, is_recent=False) > 15.0  # noqa: SLF001  the estimate alone, at 16 h and more


def test_boards_and_topics_are_chosen() -> None:
    daemon = Daemon(topics=("slip",), board="TS0001")
    assert kinds(daemon.read(daemon.make("slip"))) == ["Message"]
    assert daemon.read(daemon.make("scan")) == []
    daemon.board = "TS0002"
    assert daemon.read(daemon.make("slip")) == []
    daemon.board = ""  # a daemon that has not met its board yet
    assert kinds(daemon.status(state="no-device", valid=False, reason="no such port")) == ["Stale"]


def test_all_boards_that_are_heard_must_run() -> None:
    """Two fingers: the loss of one is reported once, by name, however often the other says that it runs."""
    daemon = Daemon(topics=("slip",))
    assert daemon.status() == [Fresh()]
    daemon.board = "TS0002"
    lost = {"state": "no-device", "valid": False, "reason": "unplugged", "age_s": 3.0}
    assert daemon.status(**lost) == [Stale("board TS0002: no-device: unplugged", 3.0)]
    for board in ("TS0001", "TS0002", "TS0001"):
        daemon.wait(0.1)
        daemon.board = board
        assert daemon.status(**(lost if board == "TS0002" else {})) == []
        assert not daemon.fresh
    daemon.board = "TS0002"
    assert daemon.status() == [Fresh()]


def test_a_board_that_falls_silent_beside_another_is_stale() -> None:
    daemon = Daemon(topics=("slip",))
    items: list[Item] = []
    for k in range(20):
        for board in ("TS0001", "TS0002") if k < 10 or k == 19 else ("TS0002",):
            daemon.board = board
            items += daemon.status()
        daemon.now_s += 0.1
    reasons = [item.reason if isinstance(item, Stale) else "fresh" for item in items]
    assert reasons == ["fresh", "board TS0001: no status read for 0.5 s", "fresh"]


def test_a_board_that_a_restarted_daemon_does_not_read_is_forgotten_at_once() -> None:
    daemon = Daemon(topics=("slip",))
    daemon.board = "TS0002"
    lost = {"state": "no-device", "valid": False, "reason": "unplugged", "age_s": 3.0}
    assert kinds(daemon.status(**lost)) == ["Stale"]
    daemon.restart()  # by a configuration that names one board
    daemon.board = "TS0001"
    assert daemon.status() == [Fresh()]


def test_late_messages_of_the_run_before_are_not_handed_on() -> None:
    daemon = Daemon(topics=("slip",))
    daemon.read(daemon.make("slip"))
    late = daemon.make("slip")
    daemon.restart()
    assert daemon.status() == [Restarted("TS0001"), Fresh()]
    assert daemon.read(late) == []
    assert kinds(daemon.read(daemon.make("slip"))) == ["Message"]
    assert daemon.inbox.catch_up.lost == 0


def test_a_board_that_was_exchanged_is_forgotten() -> None:
    daemon = Daemon(topics=("slip",))
    daemon.board = ""
    assert kinds(daemon.status(state="syncing", valid=False, reason="no hello")) == ["Stale"]
    daemon.board = "TS0001"
    assert daemon.status() == [Fresh()]  # it had no name before
    daemon.board = ""
    (stale,) = daemon.status(state="syncing", valid=False, reason="no hello", age_s=1.0)
    assert stale == Stale("board without a name: syncing: no hello", 1.0)
    daemon.board = "TS0002"
    assert daemon.status() == [Fresh()]
    daemon.board = "TS0001"
    assert kinds(daemon.status(state="stalled", valid=False, reason="no bytes")) == ["Stale"]
    daemon.board = "TS0003"  # in its place
    items: list[Item] = []
    for _ in range(6):
        daemon.now_s += 0.1
        items += daemon.status()
    assert items == [Fresh()]


def test_a_nameless_board_beside_the_chosen_one_does_not_count() -> None:
    daemon = Daemon(topics=("slip",), board="TS0001")
    assert daemon.status() == [Fresh()]
    for _ in range(3):
        daemon.board = ""
        assert daemon.status(state="no-device", valid=False, reason="no such port") == []
        daemon.board = "TS0001"
        assert daemon.status() == []
    assert daemon.fresh


GOOD: dict[Any, Any] = {"v": 1, "timestamp": 1.0, "seq": 0, "board": "TS0001", "run": 1, "detected": 1.0}


@pytest.mark.parametrize(
    "parts",
    [
        [],
        [b"tactile/b/slip"],
        [b"tactile/b/slip", b"\x80", b"1721.5"],
        [b"\xff\xfe", msgpack.packb(GOOD)],
        [b"tactile/slip", msgpack.packb(GOOD)],
        [b"tactile/b/slip", b""],
        [b"tactile/b/slip", b"\xc1"],
        [b"tactile/b/slip", b"\x91" * 100_000],
        [b"tactile/b/slip", b"\xdf\xff\xff\xff\xff"],
        [b"tactile/b/slip", msgpack.packb([1, 2])],
        [b"tactile/b/slip", msgpack.packb({**GOOD, 1: 2})],
        [b"tactile/b/slip", msgpack.packb({b"v": 1})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"v": 2})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"v": [1]})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"v": True})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"v": 1.0})],
        [b"tactile/b/\xff", msgpack.packb(GOOD)],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"seq": -1})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"seq": 1.0})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"seq": 2**63})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"seq": True})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"timestamp": math.nan})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"timestamp": "now"})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"board": None})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"run": "a"})],
        [b"tactile/b/slip", msgpack.packb(GOOD | {"run": -1})],
        [b"tactile/b/slip", msgpack.packb({**GOOD, "run": None})],
        *([b"tactile/b/slip", msgpack.packb({**GOOD, "detected": at})] for at in (None, 3, math.nan, "now")),
        [b"tactile/b/slip", msgpack.packb(GOOD) + b"\0"],
    ],
)  # fmt: skip
def test_foreign_messages_are_reported(parts: list[bytes]) -> None:
    inbox = Inbox((), None, 0.5, 0.0)
    (item,) = inbox.receive(parts, 0.1, 1.0)
    assert isinstance(item, Malformed)
    assert inbox.malformed == 1


plain = anything(st.text() | st.integers(0, 9))
KEYS = ["v", "seq", "timestamp", "board", "run", "valid", "sent", "age_s", "state", "reason"]


@given(
    messages=st.lists(
        st.tuples(
            st.sampled_from([b"tactile/TS0001/status", b"tactile/TS0001/slip"]) | st.binary(max_size=30),
            st.binary(max_size=60)
            | st.dictionaries(st.sampled_from(KEYS), plain).map(lambda extra: msgpack.packb(GOOD | extra)),
        ),
        max_size=12,
    )
)
def test_a_hostile_publisher_never_raises(messages: list[tuple[bytes, bytes]]) -> None:
    inbox = Inbox((), None, 0.5, 0.0)
    now_s = 0.0
    for parts in messages:
        now_s += 0.2
        for item in inbox.receive(list(parts), now_s, 1.0 + now_s) + inbox.tick(now_s):
            assert isinstance(item, Item)
        assert inbox.is_fresh(now_s) in (True, False)


@pytest.mark.parametrize(("topic", "evidence"), [("slip", "detected"), ("texture", "answered")])
def test_the_age_of_a_message_is_that_of_its_evidence(topic: str, evidence: str) -> None:
    """An onset is back-dated: what was found 10 ms ago may have begun 400 ms ago."""
    daemon = Daemon()
    now_s = daemon.now_s + UNIX_S
    parts = daemon.make(topic, **{"timestamp": now_s - 0.4, evidence: now_s - 0.01})
    (message,) = daemon.read(parts)
    assert isinstance(message, Message)
    ages_s = message.age_s, message.onset_age_s, message.age_s
    held_s = ages_s[2] - ages_s[0] + 1e-6  # ages grow while they are read; epoch seconds have steps of 0.2 us
    assert ages_s[1] - ages_s[0] == pytest.approx(0.39, abs=held_s)
    assert ages_s[0] + message.received_s <= 0.01 + time.monotonic() + 1e-6


def test_the_age_of_other_messages_is_that_of_their_timestamp() -> None:
    daemon = Daemon()
    (message,) = daemon.read(daemon.make("grip", timestamp=daemon.now_s + UNIX_S - 0.3))
    assert isinstance(message, Message)
    first_s = message.age_s
    assert first_s <= message.onset_age_s <= message.age_s


def test_names_without_end_are_refused_from_a_thousand_boards_on() -> None:
    daemon = Daemon(topics=("slip",))
    for number in range(2000):
        daemon.board = f"TS{number}"
        daemon.status()
    assert 900 < daemon.inbox.malformed < 1000


def test_restart_forgets_only_that_board() -> None:
    daemon = Daemon()
    daemon.read(daemon.make("scan"))
    daemon.board = "TS0002"
    daemon.restart()
    for _ in range(3):
        daemon.read(daemon.make("scan"))
    daemon.restart()
    assert Restarted("TS0002") in daemon.read(daemon.make("scan"))
    daemon.board, daemon.seq, daemon.run = "TS0001", {"scan": 4}, 101
    assert Lost("scan", "TS0001", 3) in daemon.read(daemon.make("scan"))
