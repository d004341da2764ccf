"""What arrives, judged: messages, and between them what was lost, stale, malformed. No I/O.

Two things make old news look new, and both are caught here. *Silence*: the daemon, the cable or the board
is gone, and the last message stands for ever. *Backlog*: we slept, and messages wait in a queue, each of
them fresh when it was sent. So freshness is never inferred from a message having arrived: it is the daemon
saying ``valid`` in its status, and that status itself being young, by both clocks.

Ages compare the publisher's clock with ours: on one host they are the same; across hosts keep both to NTP.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import msgpack

from tactiled.events.codec import MESSAGE_VERSION

_MOST_TOPICS = 1024  # what a publisher of nonsense can make us remember
_SAME_RUN_S = 1.0  # how well the uptimes of two statuses agree with the time between them, in one run


@dataclass(frozen=True)
class Message:
    """One event.

    Attributes
    ----------
    topic : str
        ``"slip"``, ``"texture"``, ``"contact"``, ``"scan"``, ``"status"``, ``"info"``.
    board : str
        Serial number.
    seq : int
        Running number within board and topic.
    timestamp : float
        Instant that the event is about, epoch seconds.
    data : dict
        The whole map, as protocols/events/ describes it.
    received_s : float
        When we took it out of the socket, ``time.monotonic()``.
    """

    topic: str
    board: str
    seq: int
    timestamp: float
    data: dict[str, Any] = field(repr=False)
    received_s: float
    _age_received_s: float = field(repr=False)

    @property
    def age_s(self) -> float:
        """How long ago the event was, now: it grows while the message is held."""
        return self._age_received_s + time.monotonic() - self.received_s


@dataclass(frozen=True)
class Lost:
    """Messages of a topic that were sent and will never arrive here.

    When the daemon was restarted while nobody could tell, the count is that of the new run; `Restarted`
    follows with its first status, within 0.1 s.
    """

    topic: str
    board: str
    count: int


@dataclass(frozen=True)
class Restarted:
    """The daemon was started anew; how many messages fell in between cannot be known."""

    board: str


@dataclass(frozen=True)
class Stale:
    """From here on what is known may be old: do not act on touch until `Fresh`."""

    reason: str
    silent_s: float
    """Age of what is newest."""


@dataclass(frozen=True)
class Fresh:
    """The board runs, and what arrives is new."""


@dataclass(frozen=True)
class Malformed:
    """Something arrived that is not one of our messages."""

    reason: str


Item = Message | Lost | Restarted | Stale | Fresh | Malformed


class Inbox:
    """Raw frames and the passing of time to items.

    Parameters
    ----------
    topics : sequence of str
        Topics to hand on; empty for all. Status is always looked at, whether handed on or not.
    board : str, optional
        Only this board.
    stale_after_s : float
        Silence, or age of the newest status, that counts as stale.
    now_s : float
        Monotonic clock at the start.
    """

    def __init__(self, topics: Sequence[str], board: str | None, stale_after_s: float, now_s: float) -> None:
        self._topics = frozenset(topics)
        self._board = board
        self._stale_after_s = stale_after_s
        self.lost = 0
        """Messages known to be lost."""
        self.malformed = 0
        self._next_seq: dict[tuple[str, str], int] = {}
        self._last_status: dict[str, Message] = {}
        self._status_s = now_s
        self._state: Literal["unknown", "fresh", "stale"] = "unknown"

    def is_fresh(self, now_s: float) -> bool:
        """Whether touch may be acted on: said so by a status that is young even now."""
        return self._state == "fresh" and now_s < self._status_s + self._stale_after_s

    @property
    def deadline_s(self) -> float:
        """When `tick` is due; inf when silence has been reported already."""
        return math.inf if self._state == "stale" else self._status_s + self._stale_after_s

    def receive(self, parts: Sequence[bytes], now_s: float, unix_s: float) -> list[Item]:
        """Items that a message from the socket gives; never raises, whatever it holds."""
        items = self.tick(now_s)  # when we slept: stale before any of what waited
        message = self._parse(parts, now_s, unix_s)
        if isinstance(message, Malformed):
            self.malformed += 1
            return [*items, message]
        if message is None:
            return items
        if message.topic == "status":
            items += self._watch_run(message)
        items += self._watch_sequence(message)
        if message.topic == "status":
            items += self._watch_age(message, now_s, unix_s)
        if not self._topics or message.topic in self._topics:
            items.append(message)
        return items

    def tick(self, now_s: float) -> list[Item]:
        """Items that follow from nothing having come."""
        if now_s < self.deadline_s:
            return []
        silent_s = now_s - self._status_s
        return self._stale(
            f"no status read for {silent_s:.1f} s: is tactiled running, are we keeping up?", silent_s
        )

    def _parse(self, parts: Sequence[bytes], now_s: float, unix_s: float) -> Message | Malformed | None:
        """A message, None when it is not for us, or why it is none of ours."""
        if len(parts) != 2:
            return Malformed(f"{len(parts)} frames, not 2")
        path = parts[0].decode(errors="replace").split("/")
        if len(path) != 3 or path[0] != "tactile":
            return Malformed(f"topic {path[0][:40]!r} is not tactile/BOARD/TOPIC")
        topic = path[2]
        if self._topics and topic != "status" and topic not in self._topics:
            return None
        try:
            data = msgpack.unpackb(parts[1])
        except Exception as error:  # msgpack raises half a dozen kinds; a forged payload may find another
            return Malformed(f"{topic}: not msgpack ({type(error).__name__})")
        if not isinstance(data, dict) or not all(isinstance(key, str) for key in data):
            return Malformed(f"{topic}: not a map with string keys")
        if data.get("v") != MESSAGE_VERSION:
            return Malformed(
                f"{topic}: message version {data.get('v')!r:.20}, this client reads {MESSAGE_VERSION}"
            )
        seq, stamp, board = data.get("seq"), data.get("timestamp"), data.get("board")
        if type(seq) is not int or seq < 0 or type(stamp) is not float or not math.isfinite(stamp):
            return Malformed(f"{topic}: seq or timestamp is missing or no number")
        if not isinstance(board, str):
            return Malformed(f"{topic}: board is missing or no text")
        # Before the daemon knows which board it has, its status names none.
        if self._board is not None and board != self._board and (board, topic) != ("", "status"):
            return None
        if len(self._next_seq) >= _MOST_TOPICS and (board, topic) not in self._next_seq:
            return Malformed(f"{topic}: more than {_MOST_TOPICS} topics")
        return Message(topic, board, seq, stamp, data, now_s, unix_s - stamp)

    def _watch_run(self, status: Message) -> list[Item]:
        """Tell a daemon that was started anew by an uptime that does not fit the time that passed.

        Either clock may vouch for the passed time: ours errs while a backlog is read, the publisher's when
        it is set.
        """
        before = self._last_status.get(status.board)
        uptime_s = status.data.get("uptime_s")
        if not isinstance(uptime_s, float):
            return []
        self._last_status[status.board] = status
        if before is None:
            return []
        ran_s = uptime_s - before.data["uptime_s"]
        passed_s = (status.received_s - before.received_s, status.timestamp - before.timestamp)
        if ran_s >= 0 and min(abs(ran_s - passed) for passed in passed_s) < _SAME_RUN_S:
            return []
        return self._restarted(status.board)

    def _watch_sequence(self, message: Message) -> list[Item]:
        items: list[Item] = []
        key = (message.board, message.topic)
        expected = self._next_seq.get(key, message.seq)
        if message.seq < expected:
            items += self._restarted(message.board)
        elif message.seq > expected:
            self.lost += message.seq - expected
            items.append(Lost(message.topic, message.board, message.seq - expected))
        self._next_seq[key] = message.seq + 1
        return items

    def _restarted(self, board: str) -> list[Item]:
        for key in [key for key in self._next_seq if key[0] == board]:
            del self._next_seq[key]
        return [Restarted(board)]

    def _watch_age(self, status: Message, now_s: float, unix_s: float) -> list[Item]:
        self._status_s = now_s
        age_s = unix_s - status.timestamp
        if age_s > self._stale_after_s:
            return self._stale(f"reading {age_s:.1f} s behind: messages wait, or the clocks differ", age_s)
        if status.data.get("valid") is not True:
            known_s = status.data.get("age_s")
            reason = f"{status.data.get('state')}: {status.data.get('reason')}"
            return self._stale(reason, known_s if isinstance(known_s, float) else age_s)
        if self._state == "fresh":
            return []
        self._state = "fresh"
        return [Fresh()]

    def _stale(self, reason: str, silent_s: float) -> list[Item]:
        if self._state == "stale":
            return []
        self._state = "stale"
        return [Stale(reason, silent_s)]
