"""Order of the messages of each topic, and recovery of missed ones from the daemon. No I/O.

A hole shows in the sequence numbers of a topic, or in a status, which has the number of messages sent on
every topic. The daemon is asked for missing messages, and newer ones of that topic wait for its answer: a
millisecond on one host, at most `HOLD_S`. Messages that the daemon no longer has, or does not return in time,
are `Lost`. After that, and before the first answer of the daemon, nothing waits: where nobody answers, losses
are only reported. What has waited for longer than `WAITS_S` is `Recovered`: it is no present event.

Sequence numbers begin at 0 with each run of the daemon (`run` in every message). Holes of the old run then
count as lost, and the messages of the new run are expected from number 0.
"""

import math
import secrets
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from tactiled.client.items import Item, Key, Lost, Message, Recovered, Restarted
from tactiled.client.parse import is_count, message_of

# Longest delay of a message behind a hole, over ZeroMQ: more than a reconnection to the daemon takes (0.1 s),
# and little enough for a controller.
HOLD_S = 0.5
WAITS_S = 0.2  # the longest that a message waits and still counts as present: twenty scans, two statuses
# `HOLD_S` of a patient connection: after a line was cut, routers may need a second until requests find their
# way again, while messages flow already.
PATIENT_HOLD_S = 2.0
_REPEATS = 2  # of a patient connection: answers to a hundred boards may take longer than `PATIENT_HOLD_S`
PROBE_S = 1.0  # period of asking a daemon that does not answer
_MOST_HELD = 4000  # messages of one topic: 40 s of scans, far more than arrive within `HOLD_S`
_MOST_TOPICS = 1024  # bounds the memory that a publisher of invalid topics can occupy


@dataclass
class _Line:
    """State of one topic of one board."""

    next_seq: int
    end_seq: int = 0  # of the sequence numbers that are known to have been sent
    hole_end: int = 0  # of the hole that was requested; 0 for none
    asked: str = ""  # id of that request
    until_s: float = math.inf
    n_repeated: int = 0  # times that the request was repeated although messages are received
    held: deque[Message] = field(default_factory=deque)
    given: bool = False  # any message of the topic was handed on


class CatchUp:
    """Put messages in order and fill holes.

    `can_ask`: there is a daemon to send requests to. `is_patient`: for connections on which topics overtake
    each other and requests find no way for a time. Then holes are requested also before the daemon has
    answered anything, and what was not answered in a time in which nothing was received is requested again,
    instead of counting it as lost: data are stale then anyway. While messages are received, a request is
    repeated twice.
    """

    def __init__(self, can_ask: bool, now_s: float, *, is_patient: bool = False) -> None:
        self.is_patient = is_patient
        self._hold_s = PATIENT_HOLD_S if is_patient else HOLD_S
        self.lost = 0
        self.recovered = 0
        self._lines: dict[Key, _Line] = {}
        self._runs: dict[str, int] = {}
        self._old_runs: dict[str, int] = {}  # of which late messages may come
        self._new_runs: set[str] = set()  # boards whose present run was observed from its beginning
        self._asking: dict[str, Key] = {}
        self._unsent: dict[str, dict[str, Any]] = {}
        self._name = secrets.token_hex(4)  # a relay of several clients tells them apart by their ids
        self._number = 0
        self._answered = False
        self._probe_s = now_s if can_ask else math.inf
        self._known: set[str] = set()  # boards of which a status was read
        self._retained: dict[Key, Message] = {}  # handed on after the next message or status

    @property
    def deadline_s(self) -> float:
        """Time of the next `tick`, monotonic seconds."""
        return min([self._probe_s, *(self._lines[key].until_s for key in self._asking.values())])

    @property
    def waits_from_s(self) -> float:
        """Time at which the oldest message that waits behind a hole was read; inf for none."""
        lines = (self._lines[key] for key in self._asking.values())
        return min((line.held[0].received_s for line in lines if line.held), default=math.inf)

    @property
    def unsent(self) -> list[dict[str, Any]]:
        """Requests to send; call `sent` for each that left."""
        return list(self._unsent.values())

    def sent(self, request: dict[str, Any]) -> None:
        """Take note of a request that was sent."""
        self._unsent.pop(request["id"], None)

    def tick(self, now_s: float, silent_s: float = 0.0) -> list[Item]:
        """Return the items that follow from passed deadlines, after so many seconds without a message."""
        if now_s >= self._probe_s:
            self._probe_s = now_s + PROBE_S
            self._unsent = {id_: asked for id_, asked in self._unsent.items() if asked["do"] != "state"}
            self._ask("state")
        items: list[Item] = []
        asking = frozenset(self._asking.values())  # topics with a hole: nearly always none
        for key in [key for key in self._lines if key in asking] if asking else []:
            line = self._lines[key]
            if now_s < line.until_s:
                continue
            if self.is_patient and (silent_s >= self._hold_s or line.n_repeated < _REPEATS):
                end_seq, n_repeated = line.hole_end, 0 if silent_s >= self._hold_s else line.n_repeated + 1
                self._forget(line)  # under another id: the answer to the first may still come
                self._ask_for(key, line, end_seq, now_s, n_repeated)
            else:
                items += self._give_up(key, line, now_s)
                self._answered, self._probe_s = False, now_s + PROBE_S
        return items

    def has_room(self, message: Message) -> bool:
        """Return True for a message of a known board and topic, or while there is room for new ones."""
        key = (message.board, message.topic)
        return (key in self._lines or len(self._lines) < _MOST_TOPICS) and (
            message.board in self._runs or len(self._runs) < _MOST_TOPICS
        )

    def is_of_old_run(self, message: Message) -> bool:
        """Return True for a message that the daemon sent before its restart, and that was overtaken."""
        return bool(message.data["run"] == self._old_runs.get(message.board))

    def watch_run(self, message: Message) -> list[Item]:
        """Detect a message of a new run of the daemon, and give up the holes of the old one."""
        board, run = message.board, message.data["run"]
        known = self._runs.setdefault(board, run)
        if known == run:
            return []
        items: list[Item] = []
        self._runs[board], self._old_runs[board] = run, known
        self._new_runs.add(board)
        for key, line in self._lines.items():
            if key[0] == board:
                items += self._give_up(key, line, message.received_s)
                self._lines[key] = _Line(0)
        return [*items, Restarted(board)]

    def place(self, message: Message, now_s: float) -> list[Item]:
        """Take a received message; return the messages that are in order now."""
        key = (message.board, message.topic)
        items: list[Item] = []
        if key in self._retained and self._retained[key].seq < message.seq:
            items = self._give_retained(key)
        line = self._line(key, message.seq)
        if line is None or message.seq < line.next_seq:  # recovered already
            return items
        line.end_seq = max(line.end_seq, message.seq + 1)
        line.held.append(message)
        if line.hole_end and len(line.held) <= _MOST_HELD:
            return items
        return items + self._settle(key, line, line.hole_end, now_s)

    def expect(self, key: Key, end_seq: int, now_s: float) -> list[Item]:
        """Take note that all messages before `end_seq` were sent, which a status shows."""
        line = self._line(key, end_seq)
        if line is None:
            return []
        line.end_seq = max(line.end_seq, end_seq)
        if line.hole_end or line.end_seq <= line.next_seq:
            return []
        return self._settle(key, line, 0, now_s)

    def status_read(self, board: str) -> list[Item]:
        """Take note of a status, after `expect`; return retained messages of topics without a newer one.

        A reply overtakes messages that wait to be read. Retained messages that were handed on at once would
        hide the older ones of their topic, which arrive after the reply.
        """
        if len(self._known) < _MOST_TOPICS:
            self._known.add(board)
        keys = [key for key in self._retained if key[0] == board]
        return [item for key in keys for item in self._give_retained(key)]

    def answer(self, reply: dict[str, Any], now_s: float, unix_s: float) -> list[Item]:
        """Take a reply; never raises, whatever it contains."""
        id_ = reply.get("id")
        if reply.get("do") == "state" and isinstance(reply.get("messages"), dict):
            first, self._answered, self._probe_s = not self._answered, True, math.inf
            return self._retain(reply["messages"], now_s, unix_s) if first else []
        key = self._asking.pop(id_, None) if isinstance(id_, str) else None
        line = None if key is None else self._lines[key]
        if key is None or line is None or line.asked != id_:
            return []  # given up meanwhile
        messages, next_seq, run = reply.get("messages"), reply.get("next_seq"), reply.get("run")
        same_run = is_count(run) and run == self._runs.get(key[0])
        if reply.get("ok") is not True or not same_run or not isinstance(messages, list):
            return self._settle(key, line, line.hole_end, now_s)
        before = line.next_seq
        items = self._fill(key, line, messages, now_s, unix_s)
        settled = min(next_seq, line.hole_end) if type(next_seq) is int else line.hole_end
        if reply.get("more") is True and before < line.next_seq < line.hole_end:
            self._ask_for(key, line, line.hole_end, now_s)
            return items
        return items + self._settle(key, line, max(settled, line.next_seq), now_s)

    # ---- state of topics ---------------------------------------------------------------------------

    def _line(self, key: Key, joined_seq: int) -> _Line | None:
        """State of a topic; a new one begins at `joined_seq`, because earlier messages are not lost."""
        line = self._lines.get(key)
        if line is None and len(self._lines) < _MOST_TOPICS:
            line = self._lines[key] = _Line(0 if key[0] in self._new_runs else joined_seq)
        return line

    def _fill(self, key: Key, line: _Line, messages: list[Any], now_s: float, unix_s: float) -> list[Item]:
        """Hand on messages of a reply that belong to the hole."""
        items: list[Item] = []
        for data in messages:
            message = message_of(key[1], data, now_s, unix_s) if isinstance(data, dict) else None
            if not isinstance(message, Message) or not line.next_seq <= message.seq < line.hole_end:
                continue
            items += self._lose(key, line, message.seq)
            line.next_seq = message.seq + 1
            self.recovered += 1
            items.append(Recovered(message))
        return items

    def _settle(self, key: Key, line: _Line, settled_seq: int, now_s: float) -> list[Item]:
        """Count missing messages before `settled_seq` as lost; go on to the next hole, and request it."""
        items = self._lose(key, line, settled_seq)
        self._forget(line)
        while True:
            while line.held and line.held[0].seq <= line.next_seq:
                message = line.held.popleft()
                if message.seq == line.next_seq:
                    line.next_seq, line.given = line.next_seq + 1, True
                    items.append(_after_wait(message, now_s))
            hole_end = line.held[0].seq if line.held else line.end_seq
            if hole_end <= line.next_seq:
                return items
            if (self._answered or self.is_patient) and len(line.held) <= _MOST_HELD:
                self._ask_for(key, line, hole_end, now_s)
                return items
            items += self._lose(key, line, hole_end)

    def _give_up(self, key: Key, line: _Line, now_s: float) -> list[Item]:
        """Count the holes of a topic as lost, and hand on the messages that wait behind them."""
        items: list[Item] = []
        self._forget(line)
        for message in line.held:
            if message.seq >= line.next_seq:
                items += [*self._lose(key, line, message.seq), _after_wait(message, now_s)]
                line.next_seq = message.seq + 1
        return items + self._lose(key, line, line.end_seq)

    def _lose(self, key: Key, line: _Line, before_seq: int) -> list[Item]:
        count = before_seq - line.next_seq
        if count <= 0:
            return []
        line.next_seq = before_seq
        self.lost += count
        return [Lost(key[1], key[0], count)]

    def _retain(self, messages: dict[Any, Any], now_s: float, unix_s: float) -> list[Item]:
        """Take the newest message of each topic, and hand on those whose order is known."""
        items: list[Item] = []
        for path, data in messages.items():
            if not isinstance(path, str) or not isinstance(data, dict):
                continue
            topic = path.rsplit("/", 1)[-1]
            message = message_of(topic, data, now_s, unix_s)
            if not isinstance(message, Message) or topic in ("scan", "status") or not self.has_room(message):
                continue
            key = (message.board, topic)
            self._retained[key] = message
            if self.is_patient or message.board in self._known or key in self._lines:
                items += self._give_retained(key)
        return items

    def _give_retained(self, key: Key) -> list[Item]:
        """Hand on the newest message of a topic to a new subscriber."""
        message = self._retained.pop(key)
        same_run = message.data["run"] == self._runs.setdefault(key[0], message.data["run"])
        line = self._line(key, message.seq + 1) if same_run else None
        if line is None or line.given or line.next_seq != message.seq + 1:
            return []
        line.given = True
        return [Recovered(message)]

    def _ask_for(self, key: Key, line: _Line, end_seq: int, now_s: float, n_repeated: int = 0) -> None:
        board, topic = key
        line.hole_end, line.until_s, line.n_repeated = end_seq, now_s + self._hold_s, n_repeated
        line.asked = self._ask("events", board=board, topic=topic, first_seq=line.next_seq, end_seq=end_seq)
        self._asking[line.asked] = key

    def _ask(self, do: str, **arguments: Any) -> str:
        self._number += 1
        id_ = f"{do}-{self._name}-{self._number}"
        self._unsent[id_] = {"v": 1, "id": id_, "do": do, **arguments}
        return id_

    def _forget(self, line: _Line) -> None:
        """Forget the request for a hole."""
        self._asking.pop(line.asked, None)
        self._unsent.pop(line.asked, None)
        line.asked, line.hole_end, line.until_s = "", 0, math.inf


def _after_wait(message: Message, now_s: float) -> Message | Recovered:
    """Return a message as present, or as recovered where it has waited for too long."""
    return message if now_s - message.received_s <= WAITS_S else Recovered(message)
