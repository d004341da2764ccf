"""Conversion of received frames to items: messages, losses, staleness, malformed data. No I/O.

Two conditions make old data look new. *Silence*: daemon, cable or board is gone, and the last message stays
the newest. *Backlog*: the client has paused, and messages wait in a queue, each of which was fresh when it
was sent. Freshness is therefore not inferred from the arrival of a message: the daemon must state ``valid``
in a status, and that status must be recent by both clocks. Where several boards are heard, that holds for
each of them. Messages that wait for a lost one are stale after 0.2 s, too (`WAITS_S`).

Ages compare the publisher's clock with the client's: on one host they are the same, between hosts NTP must
keep them together. Monotonic clocks stand still while a host sleeps: where they alone say for 10 s that each
status is old, and the wall clock says that it is recent, they are compared anew.
"""

import math
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Any, Literal, NamedTuple

from tactiled.client.catchup import WAITS_S, CatchUp
from tactiled.client.items import Fresh, Item, Malformed, Message, Recovered, Stale
from tactiled.client.parse import is_count, message_of, parse_map

_CLOCKS_PART = 5e-4  # largest difference in rate of two hosts' crystals: five times the 100 ppm of a bad one
_ASLEEP_S = 10.0  # a backlog that the wall clock does not show, because it was set, is read within this time

_WAITS = "messages wait for a lost one, which was requested"

_MOST_BOARDS = 1024  # bounds the memory that invalid names of boards can occupy


class _Heard(NamedTuple):
    """Newest status of a board."""

    run: int
    at_s: float
    fault: str  # why its data may be old; empty where they are fresh
    silent_s: float  # age of its newest data
    since_s: float  # time of its first status


class Inbox:
    """Convert raw frames and passing time to items.

    Parameters
    ----------
    topics, board, stale_after_s
        As for `Client`. Statuses are always evaluated, whether handed on or not.
    now_s : float
        Monotonic clock at the start.
    can_ask : bool
        There is a daemon to ask for missed messages: `catch_up` has the requests, `answer` takes the replies.
    is_patient : bool
        As for `CatchUp`.
    """

    def __init__(
        self,
        topics: Sequence[str],
        board: str | None,
        stale_after_s: float,
        now_s: float,
        can_ask: bool = False,
        *,
        is_patient: bool = False,
    ) -> None:
        self._topics = frozenset(topics)
        self._board = board
        self._stale_after_s = stale_after_s
        self.malformed = 0
        self.catch_up = CatchUp(can_ask, now_s, is_patient=is_patient)
        self._status_s = now_s
        self._received_s = now_s
        self._sent_before: dict[str, tuple[int, dict[str, int]]] = {}
        self._state: Literal["unknown", "fresh", "stale"] = "unknown"
        self._heard: dict[str, _Heard] = {}
        self._lead: tuple[object, float, float] = (None, 0.0, now_s)  # run, least lead, when
        self._differ_s = math.inf  # since then, the monotonic clocks alone say that each status is old

    def is_fresh(self, now_s: float) -> bool:
        """Return True while the last status of each board is valid and recent: its data may be acted on."""
        return self._state == "fresh" and now_s < min(self._silence_due_s, self._wait_due_s)

    @property
    def deadline_s(self) -> float:
        """Time of the next `tick`, monotonic seconds."""
        return min(self.catch_up.deadline_s, self._silence_due_s, self._wait_due_s)

    @property
    def _silence_due_s(self) -> float:
        """Time at which silence counts as stale; inf when that was reported already."""
        return math.inf if self._state == "stale" else self._status_s + self._stale_after_s

    @property
    def _wait_due_s(self) -> float:
        """Time at which messages behind a hole count as stale; inf when that was reported already."""
        return math.inf if self._state == "stale" else self.catch_up.waits_from_s + WAITS_S

    def receive(
        self, parts: Sequence[bytes], now_s: float, unix_s: float, thinned: AbstractSet[str] = frozenset()
    ) -> list[Item]:
        """Return the items from topic and payload of a message; never raises, whatever it contains.

        Not every message of the topics `thinned` is sent on this connection: their holes are no losses.
        """
        items = self.tick(now_s)  # after a pause, stale comes before the messages that waited
        message = self._parse(parts, now_s, unix_s)
        if isinstance(message, Message) and not self.catch_up.has_room(message):
            message = Malformed(f"{message.topic}: more boards and topics than any daemon has")
        if isinstance(message, Malformed):
            self.malformed += 1
            return [*items, message]
        if message is None or self.catch_up.is_of_old_run(message):
            return items
        items += self.catch_up.watch_run(message)
        self._received_s = now_s
        if message.topic == "status":
            items += self._watch_age(message, now_s, unix_s)
            for topic, count in self._surely_sent(message).items():
                if self._is_wanted(topic) and topic not in thinned:
                    items += self.catch_up.expect((message.board, topic), count, now_s)
            items += filter(self._is_for_us, self.catch_up.status_read(message.board))
        if message.topic in thinned:
            items.append(message)
        elif self._is_wanted(message.topic):
            items += self.catch_up.place(message, now_s)
        return items

    def answer(self, payload: bytes, now_s: float, unix_s: float) -> list[Item]:
        """Return the items from a reply of the daemon; never raises, whatever it contains."""
        reply = parse_map(payload, "reply")
        if isinstance(reply, Malformed):
            self.malformed += 1
            return [reply]
        return [item for item in self.catch_up.answer(reply, now_s, unix_s) if self._is_for_us(item)]

    def tick(self, now_s: float) -> list[Item]:
        """Return the items that follow from silence and from passed deadlines."""
        items: list[Item] = []
        if now_s >= self._wait_due_s:  # before the messages that waited are handed on
            items += self._stale(_WAITS, now_s - self.catch_up.waits_from_s)
        items += self.catch_up.tick(now_s, now_s - self._received_s)
        if now_s >= self._silence_due_s:
            silent_s = now_s - self._status_s
            reason = f"no status read for {silent_s:.1f} s: is tactiled running, or is this client too slow?"
            items += self._stale(reason, silent_s)
        return items

    def _surely_sent(self, status: Message) -> dict[str, int]:
        """Numbers of messages by topic that have arrived by now, if they were not lost.

        Where topics overtake each other, a status may come before a message that was sent earlier. The counts
        of the status before it are taken then.
        """
        sent = _sent(status.data)
        if not self.catch_up.is_patient:
            return sent
        before = self._sent_before.get(status.board, (0, {}))
        if status.board in self._sent_before or len(self._sent_before) < _MOST_BOARDS:
            self._sent_before[status.board] = (status.data["run"], sent)
        return before[1] if before[0] == status.data["run"] else {}

    def _is_wanted(self, topic: str) -> bool:
        return not self._topics or topic in self._topics

    def _is_for_us(self, item: Item) -> bool:
        """Return False for a recovered message of a topic or board that was not subscribed."""
        if not isinstance(item, Recovered):
            return True
        message = item.message
        return self._is_wanted(message.topic) and self._board in (None, message.board)

    def _parse(self, parts: Sequence[bytes], now_s: float, unix_s: float) -> Message | Malformed | None:
        """Message, None for one that was not subscribed, or the reason why it is malformed."""
        if len(parts) != 2:
            return Malformed(f"{len(parts)} frames, not 2")
        try:
            path = parts[0].decode().split("/")
        except UnicodeDecodeError:
            return Malformed("topic is not UTF-8")
        if len(path) != 3 or path[0] != "tactile":
            return Malformed(f"topic {path[0][:40]!r} is not tactile/BOARD/TOPIC")
        topic = path[2]
        if topic != "status" and not self._is_wanted(topic):
            return None
        data = parse_map(parts[1], topic)
        message = data if isinstance(data, Malformed) else message_of(topic, data, now_s, unix_s)
        if isinstance(message, Malformed):
            return message
        # Until the daemon has a hello of its board, its status has no board name.
        if self._board not in (None, message.board) and (message.board, topic) != ("", "status"):
            return None
        return message

    def _watch_age(self, status: Message, now_s: float, unix_s: float) -> list[Item]:
        self._status_s = now_s
        ahead_s = status.timestamp - unix_s
        behind_s = self._behind_s(status.data, now_s, is_recent=abs(ahead_s) <= self._stale_after_s)
        age_s, fault = max(-ahead_s, behind_s), ""
        if ahead_s > self._stale_after_s:
            fault = f"status from {ahead_s:.1f} s ahead: the clocks differ"
        elif age_s > self._stale_after_s:
            fault = f"reading {age_s:.1f} s behind: messages wait, or the clocks differ"
        elif status.data.get("valid") is not True:
            known_s = status.data.get("age_s")
            age_s = known_s if isinstance(known_s, float) else age_s
            fault = f"{_text(status.data, 'state')}: {_text(status.data, 'reason')}"
        self._hear(status.board, _Heard(status.data["run"], now_s, fault, age_s, now_s))
        for board, heard in sorted(self._heard.items()):
            silent_s = now_s - heard.at_s
            is_silent = silent_s >= self._stale_after_s
            if heard.fault or is_silent:
                fault = f"no status read for {silent_s:.1f} s" if is_silent else heard.fault
                whose = f"board {board or 'without a name'}: " if len(self._heard) > 1 else ""
                return self._stale(whose + fault, silent_s if is_silent else heard.silent_s)
        if now_s >= self.catch_up.waits_from_s + WAITS_S:
            return []  # `tick` has reported it
        if self._state == "fresh":
            return []
        self._state = "fresh"
        return [Fresh()]

    def _hear(self, board: str, heard: _Heard) -> None:
        """Keep the newest status of a board; a silent one is dropped if a new name has appeared since.

        A daemon sends the status of each of its boards, ten times a second, without a name until it has a
        hello of the board.
        """
        known = {name: of for name, of in self._heard.items() if of.run == heard.run}
        if board in known:
            heard = heard._replace(since_s=known[board].since_s)
        new_s = max([heard.since_s, *(of.since_s for of in known.values())])
        due_s = heard.at_s - self._stale_after_s
        self._heard = {b: of for b, of in known.items() if of.at_s > due_s or (b and of.at_s >= new_s)}
        if board not in self._heard:
            self._heard.pop("", None)  # it is the one that had no name, or that will be heard again
        if self._board is not None:
            if not board and self._board in self._heard:
                return  # of another board
            self._heard.clear()
        if board in self._heard or len(self._heard) < _MOST_BOARDS:
            self._heard[board] = heard

    def _behind_s(self, status: dict[str, Any], now_s: float, *, is_recent: bool) -> float:
        """Seconds that a status waited to be read, by the monotonic clocks of daemon and client.

        `is_recent`: by the wall clock, it did not wait.
        """
        uptime_s, run = status.get("uptime_s"), status.get("run")
        if not isinstance(uptime_s, float):
            return 0.0
        lead_s = now_s - uptime_s  # offset of both clocks plus the waiting time of this status
        known_run, least_s, at_s = self._lead
        allowed_s = least_s + _CLOCKS_PART * (now_s - at_s)
        differ = is_recent and lead_s - allowed_s > self._stale_after_s
        self._differ_s = min(self._differ_s, now_s) if differ else math.inf
        if run != known_run or lead_s < allowed_s or now_s >= self._differ_s + _ASLEEP_S:
            self._lead = (run, lead_s, now_s)
            return 0.0
        return lead_s - allowed_s

    def _stale(self, reason: str, silent_s: float) -> list[Item]:
        if self._state == "stale":
            return []
        self._state = "stale"
        return [Stale(reason, silent_s)]


def _text(status: dict[str, Any], key: str) -> str:
    """Text in a field of a status, which an invalid status may lack."""
    text = status.get(key)
    return text if isinstance(text, str) else "unknown"


def _sent(status: dict[str, Any]) -> dict[str, int]:
    """Numbers of messages by topic from a status; empty where they are invalid."""
    sent = status.get("sent")
    if not isinstance(sent, dict):
        return {}
    return {topic: count for topic, count in sent.items() if isinstance(topic, str) and is_count(count)}
