"""Each topic's messages in order, each once, with what was missed fetched from the daemon. No I/O.

A hole shows in the numbers: of the topic itself, or of a status, which says what has been sent of every
topic. The daemon is asked for what is missing, and until it has answered, what is newer of that topic waits:
a millisecond on one host, `HOLD_S` at most. What the daemon no longer has, or does not answer for in
time, is `Lost`. Then, and before the daemon has answered at all, nothing waits until it answers again: where
nobody answers, loss is only told.

Numbers begin anew with each run of the daemon (`run` in every message): the holes of the old run are given
up, and everything of the new one is expected from number 0.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from tactiled.client.items import Item, Key, Lost, Message, Recovered, Restarted
from tactiled.client.parse import message_of

HOLD_S = (
    0.5  # longer than a reconnection to the daemon takes (0.1 s), shorter than anyone should wait for touch
)
PROBE_S = 1.0  # how often a daemon that does not answer is asked again
_MOST_HELD = 4000  # messages of one topic: 40 s of scans, far more than come while one waits
_MOST_TOPICS = 1024  # what a publisher of nonsense can make us remember


@dataclass
class _Line:
    """One topic of one board."""

    next_seq: int
    end_seq: int = 0
    """Everything before it is known to have been sent."""
    hole_end: int = 0
    """Where the hole ends that is being asked for; 0 when there is none."""
    asked: str = ""
    until_s: float = math.inf
    held: deque[Message] = field(default_factory=deque)
    given: bool = False
    """Whether anything of it was handed on."""


class CatchUp:
    """Puts messages in order and fills holes.

    Parameters
    ----------
    enabled : bool
        Whether there is anyone to ask.
    now_s : float
    """

    def __init__(self, enabled: bool, now_s: float) -> None:
        self.lost = 0
        self.recovered = 0
        self._lines: dict[Key, _Line] = {}
        self._runs: dict[str, int] = {}
        self._new_runs: set[str] = set()  # boards whose present run we know from its beginning
        self._asking: dict[str, Key] = {}
        self._unsent: dict[str, dict[str, Any]] = {}
        self._number = 0
        self._answered = False
        self._probe_s = now_s if enabled else math.inf

    @property
    def deadline_s(self) -> float:
        """When `tick` is due."""
        return min([self._probe_s, *(line.until_s for line in self._lines.values())])

    @property
    def unsent(self) -> list[dict[str, Any]]:
        """Requests to send; call `sent` for each that left."""
        return list(self._unsent.values())

    def sent(self, request: dict[str, Any]) -> None:
        """A request has left."""
        self._unsent.pop(request["id"], None)

    def tick(self, now_s: float) -> list[Item]:
        """What follows from time having passed."""
        if now_s >= self._probe_s:
            self._probe_s = now_s + PROBE_S
            self._unsent = {id_: asked for id_, asked in self._unsent.items() if asked["do"] != "state"}
            self._ask("state")
        items: list[Item] = []
        for key, line in self._lines.items():
            if now_s >= line.until_s:
                items += self._give_up(key, line)
                self._answered, self._probe_s = False, now_s + PROBE_S
        return items

    def has_room(self, message: Message) -> bool:
        """Whether a message is of a board and a topic that we know, or may still get to know."""
        key = (message.board, message.topic)
        return (key in self._lines or len(self._lines) < _MOST_TOPICS) and (
            message.board in self._runs or len(self._runs) < _MOST_TOPICS
        )

    def watch_run(self, message: Message) -> list[Item]:
        """See whether a message comes from another run than those before."""
        board, run = message.board, message.data["run"]
        known = self._runs.setdefault(board, run)
        if known == run:
            return []
        items: list[Item] = []
        self._runs[board] = run
        self._new_runs.add(board)
        for key, line in self._lines.items():
            if key[0] == board:
                items += self._give_up(key, line)
                self._lines[key] = _Line(0)
        return [*items, Restarted(board)]

    def place(self, message: Message, now_s: float) -> list[Item]:
        """Take a message that came; gives it, and what had to come before it, when its time has come."""
        key = (message.board, message.topic)
        line = self._line(key, message.seq)
        if line is None:
            return []
        if message.seq < line.next_seq:
            return []  # fetched already
        line.end_seq = max(line.end_seq, message.seq + 1)
        line.held.append(message)
        if line.hole_end and len(line.held) <= _MOST_HELD:
            return []
        return self._settle(key, line, line.hole_end, now_s)

    def expect(self, key: Key, end_seq: int, now_s: float) -> list[Item]:
        """A status says that everything before `end_seq` was sent, and so it came before the status."""
        line = self._line(key, end_seq)
        if line is None:
            return []
        line.end_seq = max(line.end_seq, end_seq)
        return [] if line.hole_end else self._settle(key, line, 0, now_s)

    def answer(self, reply: dict[str, Any], now_s: float, unix_s: float) -> list[Item]:
        """Take a reply; never raises for what it holds."""
        id_ = reply.get("id")
        if reply.get("do") == "state" and isinstance(reply.get("messages"), dict):
            first, self._answered, self._probe_s = not self._answered, True, math.inf
            return self._retained(reply["messages"], now_s, unix_s) if first else []
        key = self._asking.pop(id_, None) if isinstance(id_, str) else None
        line = None if key is None else self._lines[key]
        if key is None or line is None or line.asked != id_:
            return []  # given up meanwhile
        messages, next_seq = reply.get("messages"), reply.get("next_seq")
        same_run = reply.get("run") == self._runs.get(key[0])
        if reply.get("ok") is not True or not same_run or not isinstance(messages, list):
            return self._settle(key, line, line.hole_end, now_s)
        before = line.next_seq
        items = self._fill(key, line, messages, now_s, unix_s)
        settled = min(next_seq, line.hole_end) if type(next_seq) is int else line.hole_end
        if reply.get("more") is True and before < line.next_seq < line.hole_end:
            self._ask_for(key, line, line.hole_end, now_s)
            return items
        return items + self._settle(key, line, max(settled, line.next_seq), now_s)

    # ---- how it is done ----------------------------------------------------------------------------

    def _line(self, key: Key, joined_seq: int) -> _Line | None:
        """What is known of a topic; one that is new begins here, since joining late is no loss."""
        line = self._lines.get(key)
        if line is None and len(self._lines) < _MOST_TOPICS:
            line = self._lines[key] = _Line(0 if key[0] in self._new_runs else joined_seq)
        return line

    def _fill(self, key: Key, line: _Line, messages: list[Any], now_s: float, unix_s: float) -> list[Item]:
        """Messages of a reply, as far as they belong into the hole."""
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
        """Nothing more comes of what lies before `settled_seq`; go on to the next hole, and ask for it."""
        items = self._lose(key, line, settled_seq)
        self._forget(line)
        while True:
            while line.held and line.held[0].seq <= line.next_seq:
                message = line.held.popleft()
                if message.seq == line.next_seq:
                    line.next_seq, line.given = line.next_seq + 1, True
                    items.append(message)
            hole_end = line.held[0].seq if line.held else line.end_seq
            if hole_end <= line.next_seq:
                return items
            if self._answered and len(line.held) <= _MOST_HELD:
                self._ask_for(key, line, hole_end, now_s)
                return items
            items += self._lose(key, line, hole_end)

    def _give_up(self, key: Key, line: _Line) -> list[Item]:
        """Nobody will fill the holes of a topic; what waits behind them is let go."""
        items: list[Item] = []
        self._forget(line)
        for message in line.held:
            if message.seq >= line.next_seq:
                items += [*self._lose(key, line, message.seq), message]
                line.next_seq = message.seq + 1
        return items + self._lose(key, line, line.end_seq)

    def _lose(self, key: Key, line: _Line, before_seq: int) -> list[Item]:
        count = before_seq - line.next_seq
        if count <= 0:
            return []
        line.next_seq = before_seq
        self.lost += count
        return [Lost(key[1], key[0], count)]

    def _retained(self, messages: dict[str, Any], now_s: float, unix_s: float) -> list[Item]:
        """The newest of each topic, for one who has just come; scans and statuses come by themselves."""
        items: list[Item] = []
        for path, data in messages.items():
            topic = path.rsplit("/", 1)[-1] if isinstance(path, str) else ""
            message = message_of(topic, data, now_s, unix_s) if isinstance(data, dict) else None
            if not isinstance(message, Message) or topic in ("scan", "status"):
                continue
            key = (message.board, topic)
            if not self.has_room(message):
                continue
            same_run = message.data["run"] == self._runs.setdefault(key[0], message.data["run"])
            line = self._line(key, message.seq + 1) if same_run else None
            if line is not None and not line.given and line.next_seq == message.seq + 1:
                line.given = True
                items.append(Recovered(message))
        return items

    def _ask_for(self, key: Key, line: _Line, end_seq: int, now_s: float) -> None:
        board, topic = key
        line.hole_end, line.until_s = end_seq, now_s + HOLD_S
        line.asked = self._ask("events", board=board, topic=topic, first_seq=line.next_seq, end_seq=end_seq)
        self._asking[line.asked] = key

    def _ask(self, do: str, **arguments: Any) -> str:
        self._number += 1
        id_ = f"{do}-{self._number}"
        self._unsent[id_] = {"v": 1, "id": id_, "do": do, **arguments}
        return id_

    def _forget(self, line: _Line) -> None:
        """The request for a line's hole, if there is one, is over."""
        self._asking.pop(line.asked, None)
        self._unsent.pop(line.asked, None)
        line.asked, line.hole_end, line.until_s = "", 0, math.inf
