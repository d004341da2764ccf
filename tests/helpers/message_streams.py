"""Streams of messages, replies and passing time with faults, and what the inbox of Python makes of them.

A stream is drawn from its seed: the real codec, store and request handler of the daemon on one side, the
inbox on the other, and a way between them that loses, delays, duplicates and damages. It is recorded as lines
of text, which `native_inbox.cpp` plays to the inbox of C++.
"""

import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import msgpack
from messages import CONTACT, SLIP, STATUS

from tactiled.client import Fresh, Item, Lost, Malformed, Message, Recovered, Restarted, Stale, items
from tactiled.client.inbox import Inbox
from tactiled.daemon.zmq.control import Control
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import Requester
from tactiled.events import codec
from tactiled.events.types import Event, GripEvent, ScanEvent, TextureEvent

_NAME = "00c0ffee"  # in the ids of requests
BOARDS = "TS0001", "", "left hand", "Tastsensor-µ"
TOPICS = "slip", "contact", "scan", "grip", "texture", "status"
_SOMEONE = Requester("1", may_command=True)
_EVENTS: dict[str, Event] = {
    "slip": SLIP,
    "contact": CONTACT,
    "grip": GripEvent(time_s=0.0, state="sticking", utilisation=0.31, valid=True),
    "texture": TextureEvent(time_s=0.0, status="no-slip", answered_s=0.0),
    "scan": ScanEvent(
        time_s=0.0, index=1, volts=(1.5,) * 36, valid=(True,) * 36, time_sd_s=2e-5, age_s=0.004, late=False
    ),
}
_INSTANTS = "time_s", "onset_s", "detected_s", "answered_s"
_FIELDS = (
    "v",
    "seq",
    "timestamp",
    "board",
    "run",
    "valid",
    "sent",
    "age_s",
    "uptime_s",
    "state",
    "reason",
    "detected",
)
_REPLY_FIELDS = "v", "id", "do", "ok", "run", "messages", "next_seq", "more"


class RecordedInbox:
    """Inbox of Python whose input is recorded as lines for `native_inbox.cpp`, with the outcome of each.

    Parameters
    ----------
    board : str
        Empty for all; without blanks.
    """

    def __init__(
        self,
        topics: Sequence[str] = (),
        board: str = "",
        stale_after_s: float = 0.5,
        now_s: float = 100.0,
        catch_up: bool = True,
    ) -> None:
        self.now_s = now_s
        self.unix_offset_s = 1.7e9
        self.inbox = Inbox(topics, board or None, stale_after_s, now_s, catch_up)
        self.inbox.catch_up._name = _NAME  # noqa: SLF001  random outside of tests
        self.lines: list[str] = []
        self.outcomes: list[dict[str, Any]] = []
        words = ["inbox", _NAME, repr(stale_after_s), repr(now_s), str(int(catch_up)), board or "-", *topics]
        self._note(" ".join(words), [])

    @property
    def _unix_s(self) -> float:
        return self.now_s + self.unix_offset_s

    def receive(self, frames: Sequence[bytes]) -> None:
        """Read a message."""
        words = ["frames", repr(self.now_s), repr(self._unix_s), *(f"x{frame.hex()}" for frame in frames)]
        self._note(" ".join(words), self.inbox.receive(frames, self.now_s, self._unix_s))

    def answer(self, payload: bytes) -> None:
        """Read a reply."""
        found = self.inbox.answer(payload, self.now_s, self._unix_s)
        self._note(f"reply {self.now_s!r} {self._unix_s!r} x{payload.hex()}", found)

    def tick(self) -> None:
        """Let time pass."""
        self._note(f"tick {self.now_s!r}", self.inbox.tick(self.now_s))

    def send(self) -> list[dict[str, Any]]:
        """Let all requests leave; return them."""
        requests = self.inbox.catch_up.unsent
        for request in requests:
            self.inbox.catch_up.sent(request)
        if requests:
            self._note(f"sent {self.now_s!r} {len(requests)}", [])
        return requests

    def _note(self, line: str, found: Sequence[Item]) -> None:
        catch_up = self.inbox.catch_up
        self.lines.append(line)
        with patch.object(items, "time", SimpleNamespace(monotonic=lambda: self.now_s)):
            rows = [_row(item) for item in found]
        self.outcomes.append(
            {
                "items": rows,
                "unsent": [repr(request) for request in catch_up.unsent],
                "fresh": self.inbox.is_fresh(self.now_s),
                "deadline_s": self.inbox.deadline_s,
                "counts": [catch_up.lost, catch_up.recovered, self.inbox.malformed],
            }
        )


@dataclass(frozen=True)
class _Faults:
    """Probabilities, of a message unless stated otherwise."""

    lost: float
    delayed: float
    doubled: float
    damaged: float
    deaf: float
    """A request or its reply is lost."""
    restart: float
    """The daemon is restarted before a message."""
    pause: float
    """The client pauses before a message, and finds a backlog."""


def record(seed: int) -> RecordedInbox:
    """Draw a stream and play it to the inbox of Python."""
    way = _Way(random.Random(seed))
    way.play()
    return way.client


class _Way:
    """Daemon, client, and the way between them."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        scale = rng.choice([0.0, 0.3, 1.0])  # some streams are nearly without faults
        draw = rng.random
        self.faults = _Faults(
            lost=0.4 * scale * draw(), delayed=0.2 * scale * draw(), doubled=0.1 * scale * draw(),
            damaged=0.15 * scale * draw(), deaf=0.3 * scale * draw(), restart=0.04 * scale * draw(),
            pause=0.05 * scale * draw(),
        )  # fmt: skip
        self.late: list[tuple[int, Callable[[], None]]] = []
        """Deliveries that others overtake, with the number of steps until then."""
        self.boards = rng.sample(BOARDS, rng.choice([1, 1, 2]))
        self.history_mb = rng.choice([4.0, 4.0, 0.01])
        board = rng.choice(self.boards) if rng.random() < 0.3 else ""
        self.client = RecordedInbox(
            topics=rng.sample(TOPICS, rng.choice([0, 0, 1, 2, 4])),
            board="" if " " in board else board,
            stale_after_s=rng.choice([0.5, 0.5, 3.0]),
            catch_up=rng.random() < 0.85,
        )
        self.start()

    def start(self) -> None:
        """Start a daemon, whose store is empty."""
        self.publisher = Publisher(PublishParams(endpoints=(), history_mb=self.history_mb), n_boards=2)
        self.publisher.run = self.rng.getrandbits(53)
        self.control = Control(self.publisher, [])
        self.started_s = self.client.now_s
        self.sent: dict[tuple[str, str], int] = {}

    def play(self) -> None:
        """Publish what no client receives, then draw steps."""
        for _ in range(self.rng.choice([0, 0, 5])):
            self.frames(self.rng.choice(TOPICS))
        for _ in range(self.rng.randrange(20, 150)):
            self.step()

    # ---- the daemon ----------------------------------------------------------------------------------------

    def step(self) -> None:
        """One message after some time, with what was on its way."""
        rng, faults = self.rng, self.faults
        self.client.now_s += rng.choice([0.0, 0.001, 0.01, 0.1])
        if rng.random() < faults.restart:
            self.start()
            self.client.now_s += rng.choice([0.05, 2.0])
        if rng.random() < 0.1 * faults.pause:
            self.client.unix_offset_s += rng.choice([-3600.0, 3600.0, -0.3])  # somebody sets the clock
        if rng.random() < faults.pause:
            for _ in range(rng.randrange(30)):  # messages wait until the client goes on
                self.client.now_s += 0.1
                self.late.append((1, self.made(rng.choice(["status", *TOPICS]))))
        self.publish(rng.choice(["status", *TOPICS]))
        self.late = [(steps - 1, deliver) for steps, deliver in self.late]
        due = [deliver for steps, deliver in self.late if steps <= 0]
        self.late = [entry for entry in self.late if entry[0] > 0]
        for deliver in due:
            deliver()
        if rng.random() < 0.3:
            self.client.tick()
        if rng.random() < 0.7:
            self.exchange()

    def made(self, topic: str) -> Callable[[], None]:
        """Publish a message; return what delivers it."""
        frames = self.frames(topic)
        return lambda: self.client.receive(frames)

    def frames(self, topic: str) -> list[bytes]:
        """Frames of a new message, which is in the store."""
        rng, board = self.rng, self.rng.choice(self.boards)
        offset_s = self.client.unix_offset_s
        if topic != "status":
            offset_s -= rng.choice([0.0, 0.0, 0.2, 5.0])  # an event may be about an earlier instant
        event = self.status(board) if topic == "status" else _EVENTS[topic]
        instants = {name: self.client.now_s for name in _INSTANTS if hasattr(event, name)}
        event = replace(event, **instants)
        seq = self.sent.get((board, topic), 0)
        self.sent[board, topic] = seq + 1
        self.publisher.send(event, board=board, unix_offset_s=offset_s)
        return list(codec.encode(event, seq=seq, board=board, unix_offset_s=offset_s, run=self.publisher.run))

    def status(self, board: str) -> Event:
        uptime_s = self.client.now_s - self.started_s
        status = replace(STATUS, uptime_s=uptime_s, sent=self.publisher.sent(board))
        if self.rng.random() < 0.9:
            return status
        return replace(status, valid=False, state="stalled", reason="no bytes", age_s=0.7)

    def publish(self, topic: str) -> None:
        """Publish a message that may be lost, delayed, doubled or damaged."""
        rng, faults = self.rng, self.faults
        frames = self.frames(topic)
        if rng.random() < faults.lost:
            return
        if rng.random() < faults.damaged:
            frames = self.damaged(frames)
        if rng.random() < faults.delayed:
            self.late.append((rng.randrange(1, 6), lambda: self.client.receive(frames)))
        else:
            self.client.receive(frames)
        if rng.random() < faults.doubled:
            self.late.append((rng.randrange(1, 6), lambda: self.client.receive(frames)))

    # ---- damage --------------------------------------------------------------------------------------------

    def damaged(self, frames: Sequence[bytes]) -> list[bytes]:
        rng, topic, payload = self.rng, frames[0], frames[1]
        kind = rng.randrange(6)
        if kind == 0:
            return [topic, self.damaged_bytes(payload)]
        if kind == 1:
            return [self.damaged_bytes(topic), payload]
        if kind == 2:
            return [[topic], [topic, payload, b"1721.5"], [], [b"tactile/scan", payload]][rng.randrange(4)]
        if kind == 3:
            return [topic, msgpack.packb(self.anything(3))]
        message = msgpack.unpackb(payload)
        if kind == 4:
            del message[rng.choice(list(message))]
            return [topic, msgpack.packb(message)]
        odd = {rng.choice(_FIELDS): self.anything(2) for _ in range(rng.randrange(1, 3))}
        return [topic, msgpack.packb(message | odd)]

    def damaged_bytes(self, data: bytes) -> bytes:
        rng = self.rng
        place = rng.randrange(len(data) + 1)
        kind = rng.randrange(4)
        if kind == 0:
            return data[:place]
        if kind == 1:
            return data[:place] + rng.randbytes(rng.randrange(1, 4)) + data[place:]
        changed = bytearray(data or b"\0")
        for _ in range(rng.randrange(1, 3)):
            octet = rng.choice([rng.randrange(256), *b"\xc1\xc4\xd4\xd9\xff\x80"])
            changed[rng.randrange(len(changed))] = octet
        return bytes(changed)

    def anything(self, depth: int) -> Any:
        """Whatever msgpack can hold."""
        rng = self.rng
        plain: list[Any] = [
            None, True, False, 0, 1, 7, -1, 2**63 - 1, 2**63, 2**64 - 1, -(2**63), 0.0, 1.0, -2.5, 1e300,
            float("nan"), float("inf"), "", "slip", "µ", b"v", b"\xff", msgpack.ExtType(5, b"x"),
            msgpack.Timestamp(1, 2), [], {}, self.publisher.run,
        ]  # fmt: skip
        kind = rng.randrange(4) if depth else 3
        if kind == 0:
            return [self.anything(depth - 1) for _ in range(rng.randrange(4))]
        if kind == 1:
            keys = rng.choices([*_FIELDS, *TOPICS, b"v"], k=rng.randrange(4))
            return {key: self.anything(depth - 1) for key in keys}
        return rng.choice(plain)

    # ---- requests ------------------------------------------------------------------------------------------

    def exchange(self) -> None:
        """Send the requests that are there, and deliver those replies that are not lost, now or later."""
        rng, requests = self.rng, self.client.send()
        replies = [
            self.control.answer(msgpack.packb(request), _SOMEONE, self.client.now_s) for request in requests
        ]
        for reply in replies:
            if rng.random() < self.faults.deaf:
                continue
            given = self.damaged_reply(reply) if rng.random() < 2 * self.faults.damaged else reply
            for _ in range(2 if rng.random() < self.faults.doubled else 1):
                if rng.random() < self.faults.delayed:
                    self.late.append((rng.randrange(1, 9), lambda given=given: self.client.answer(given)))  # type: ignore[misc]
                else:
                    self.client.answer(given)

    def damaged_reply(self, reply: bytes) -> bytes:
        rng = self.rng
        if rng.random() < 0.2:
            return self.damaged_bytes(reply)
        data = msgpack.unpackb(reply)
        messages = data.get("messages")
        kind = rng.randrange(4)
        if kind == 0 and isinstance(messages, list):  # only some of them
            data["messages"] = rng.sample(messages, rng.randrange(len(messages) + 1))
        elif kind == 1 and isinstance(data.get("next_seq"), int):
            data["next_seq"] += rng.randrange(-3, 3)
            data["more"] = rng.random() < 0.5
        elif kind == 2 and messages:
            data["messages"] = (
                [*messages, self.anything(2)]
                if isinstance(messages, list)
                else messages | {"slip": self.anything(2)}
            )
        else:
            data |= {rng.choice(_REPLY_FIELDS): self.anything(2)}
        return bytes(msgpack.packb(data))


def _row(item: Item) -> list[Any]:
    """Item as plain values."""
    match item:
        case Recovered(message=message):
            return ["Recovered", *_row(message)[1:]]
        case Message():
            ages_s = item.age_s, item.onset_age_s
            head = item.topic, item.board, item.data["run"], item.seq, item.timestamp, item.received_s
            return ["Message", *head, *ages_s, _shown(item.data)]
        case Lost():
            return ["Lost", item.topic, item.board, item.count]
        case Restarted():
            return ["Restarted", item.board]
        case Stale():
            return ["Stale", item.reason, repr(item.silent_s)]
        case Fresh():
            return ["Fresh"]
        case Malformed():
            return ["Malformed", kind_of_fault(item.reason)]


def _shown(data: dict[str, Any]) -> str:
    """Fields as text, in which a float differs from an integer and NaN is equal to itself."""
    try:
        return repr(data)
    except RecursionError:  # nested as deeply as msgpack takes it
        return "deep"


def kind_of_fault(reason: str) -> str:
    """Reason without what a language quotes in its own way: names of exceptions, and received values."""
    reason = re.sub(r" \(\w+\)$", "", reason)
    reason = re.sub(r"version .*, this client", "version, this client", reason, flags=re.DOTALL)
    return re.sub(r"^topic ['\"].*['\"] is", "topic is", reason, flags=re.DOTALL)


def native_outcome(outcome: dict[str, Any]) -> dict[str, Any]:
    """Outcome of `native_inbox.cpp` in the form of `RecordedInbox.outcomes`."""
    rows = []
    for row in outcome["items"]:
        if row[0] in ("Message", "Recovered"):
            row[-1] = _shown(msgpack.unpackb(bytes.fromhex(row[-1])))
        elif row[0] == "Stale":
            row[-1] = repr(float(row[-1]))
        elif row[0] == "Malformed":
            row[-1] = kind_of_fault(row[-1])
        rows.append(row)
    unsent = [repr(msgpack.unpackb(bytes.fromhex(request))) for request in outcome["unsent"]]
    return {**outcome, "items": rows, "unsent": unsent}
