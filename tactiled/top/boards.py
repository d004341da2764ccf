"""State of the boards of one daemon, from the messages of its subscription. No I/O, no clock."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.board_geometry import geometry_of, same_array
from tactiled.client import Item, Lost, Malformed, Message, Recovered, Restarted
from tactiled.errors import ContractError
from tactiled.events.codec import evidence_key
from tactiled.events.incoming import checked_map
from tactiled.events.words import event_words, printable

_EVENTS = 50
_MOST_BOARDS = 1000
_SILENT_S = 0.3  # three statuses are missing; protocols/events.md: after this, trust nothing
_LATE_S = 0.16  # samples.late_after_s, and the interval of drawings of a page
_OVERTAKEN_S = 1.0  # a status that was made before a slip may come after it over zenoh, by less than this
_PERIODS = 3  # scan periods that are not late on a slow board
_OF_NOW = ("contact", "texture", "grip", "force")
LampState = Literal["FRESH", "LATE", "STALE", "NO BOARD"]


class Lamp(NamedTuple):
    """Freshness of a board: state, age of the newest scan (None where unknown), and words."""

    state: LampState
    age_s: float | None
    words: str


class ListedEvent(NamedTuple):
    """Event with its instant, epoch seconds."""

    at_s: float
    topic: str
    words: str


class Felt(NamedTuple):
    """Load and shear of each taxel, in the unit of the array."""

    load: NDArray[np.float64]
    shear_x: NDArray[np.float64]
    shear_y: NDArray[np.float64]


@dataclass
class BoardView:
    """Newest messages of one board."""

    name: str
    geometry: dict[str, Any] | None = None
    newest: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    """Newest message of each topic."""
    slip: Mapping[str, Any] | None = None
    """Newest onset of a slip that has not ended."""
    events: deque[ListedEvent] = field(default_factory=lambda: deque(maxlen=_EVENTS))
    zero: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Readings without a load; empty while they are not known."""

    def lamp(self, now_unix_s: float) -> Lamp:
        """Judge how old the data are at an instant, by the instants in the messages."""
        status, scan = self.newest.get("status"), self.newest.get("scan")
        if status is None:
            return Lamp("STALE", None, "no status from the daemon yet: is tactiled run running?")
        silent_s = now_unix_s - status["timestamp"]
        age_s = now_unix_s - scan["timestamp"] if scan is not None else status["age_s"] + silent_s
        if silent_s > _SILENT_S:
            return Lamp("STALE", age_s, f"no status for {silent_s:.1f} s: is tactiled running?")
        if silent_s < -1.0:
            words = "messages carry instants in the future: compare the clocks of the hosts"
            return Lamp("STALE", None, words)
        if status["state"] == "no-device":
            return Lamp("NO BOARD", age_s, status["reason"])
        if not status["valid"]:
            return Lamp("STALE", age_s, f"{status['state']}: {status['reason']}")
        late_s = max(_LATE_S, _PERIODS / status["rate_hz"] if status["rate_hz"] > 0 else 0.0)
        if age_s > max(_SILENT_S, 2 * late_s):
            return Lamp("STALE", age_s, "no scan arrives")
        if age_s > late_s or (scan is not None and scan["late"]):
            return Lamp("LATE", age_s, "scans come later than a controller can use")
        return Lamp("FRESH", age_s, status["warning"])

    def drop_other_runs(self, run: int) -> None:
        """Forget what another run of the daemon said of now: its slips and contacts never end."""
        if self.slip is not None and self.slip["run"] != run:
            self.slip = None
        for topic in _OF_NOW:
            if topic in self.newest and self.newest[topic]["run"] != run:
                del self.newest[topic]

    def drop_ended(self, status: Mapping[str, Any]) -> None:
        """Forget a slip and a contact that a later status does not have: their end was lost, or came late."""
        at_s = status["timestamp"] - _OVERTAKEN_S
        if self.slip is not None and not status["slipping"] and self.slip["detected"] <= at_s:
            self.slip = None
        contact = self.newest.get("contact")
        if contact is not None and contact["state"] != status["contact"] and contact["timestamp"] <= at_s:
            del self.newest["contact"]
        texture = self.newest.get("texture")
        if texture is not None and status["contact"] == "none" and texture["timestamp"] <= at_s:
            del self.newest["texture"]

    def goes_on(self, message: Message) -> bool:
        """Return True for a slip or contact that was missed at first and that the newest status has."""
        topic, data, status = message.topic, message.data, self.newest.get("status")
        if topic not in ("slip", "contact") or status is None or status["run"] != data["run"]:
            return False
        if topic in self.newest and self.newest[topic]["timestamp"] >= data["timestamp"]:
            return False
        if topic == "contact":
            return bool(status["contact"] == data["state"])
        return bool(status["slipping"] == (data["state"] != "end"))

    def current(self, topic: str) -> Mapping[str, Any] | None:
        """Return the newest message of a topic that comes with each scan; None where it has ended."""
        message, scan = self.newest.get(topic), self.newest.get("scan")
        if message is None or scan is None:
            return None
        rate_hz = self.newest.get("status", {}).get("rate_hz", 0.0)
        allowed_s = max(_SILENT_S, _PERIODS / rate_hz if rate_hz > 0 else 0.0)
        return message if scan["timestamp"] - message["timestamp"] <= allowed_s else None

    def felt(self) -> Felt | None:
        """Return load and shear of the newest scan; None without a scan, an array or its zero."""
        scan, geometry = self.newest.get("scan"), self.geometry
        if scan is None or geometry is None or len(scan["volts"]) != len(self.zero):
            return None
        readings = np.where(scan["valid"], np.array(scan["volts"]) - self.zero, 0.0)
        return Felt(*(_weighted(geometry[name], readings) for name in ("pressure", "shear_x", "shear_y")))


class BoardViews:
    """All boards of one daemon; `array` is one that does not ship with tactiled."""

    def __init__(self, array: Array | None = None) -> None:
        self._array = array
        self.boards: dict[str, BoardView] = {}
        self.unreadable = 0
        """Number of messages that are not as protocols/events.md says, such as a foreign publisher sends."""
        self._unreadable_reason = ""

    @property
    def notice(self) -> str:
        """Number of unreadable messages, and the fault of the newest; empty where there is none."""
        words = f"{self.unreadable} messages are not as protocols/events.md says; the newest: "
        return printable(words + self._unreadable_reason) if self.unreadable else ""

    def take(self, item: Item) -> None:
        """Take an item of the subscription; a message that cannot be read is counted."""
        if isinstance(item, Message | Recovered):
            message = item.message if isinstance(item, Recovered) else item
            try:
                message = replace(message, data=checked_map(message.topic, message.data))
            except ContractError as error:
                self._refuse(str(error))
                return
            board = self._board(message.board)
            if isinstance(item, Recovered) and not board.goes_on(message):
                self._list(board, message)
            else:
                self._message(board, message)
        elif isinstance(item, Malformed):
            self._refuse(item.reason)
        elif isinstance(item, Lost | Restarted):
            words = "daemon restarted"
            if isinstance(item, Lost):
                words = f"{item.count} {item.topic} messages lost"
            board = self._board(item.board)
            at_s = float(board.newest.get("status", {}).get("timestamp", 0.0))
            board.events.appendleft(ListedEvent(at_s, "notice", words))

    def _refuse(self, reason: str) -> None:
        self.unreadable += 1
        self._unreadable_reason = reason

    def _board(self, name: str) -> BoardView:
        """Return the view of a board; a daemon that waits for its board means the only one it had."""
        if name in self.boards:
            return self.boards[name]
        if "" in self.boards and name:
            view = self.boards.pop("")
            view.name = name
        elif not name and len(self.boards) == 1:
            return next(iter(self.boards.values()))
        else:
            view = BoardView(name)
        if len(self.boards) >= _MOST_BOARDS:  # names of a foreign publisher: the oldest goes
            del self.boards[next(iter(self.boards))]
        self.boards[name] = view
        return view

    def _message(self, board: BoardView, message: Message) -> None:
        data = message.data
        if message.topic == "info":
            if not same_array(data, board.newest.get("info")):
                board.geometry = geometry_of(data, self._array)
            board.zero = np.array(data["zero"])
        if message.topic in ("status", "scan"):
            board.drop_other_runs(data["run"])
        if message.topic == "status":
            board.drop_ended(data)
        board.newest[message.topic] = data
        if message.topic == "slip":
            board.slip = None if data["state"] == "end" else data
        if message.topic == "contact" and data["state"] == "none":
            board.newest.pop("texture", None)  # of a slide that has ended
        self._list(board, message)

    @staticmethod
    def _list(board: BoardView, message: Message) -> None:
        if message.topic in ("slip", "contact", "texture", "command"):
            at_s = float(message.data[evidence_key(message.topic)])
            words = event_words(message.topic, message.data)
            board.events.appendleft(ListedEvent(at_s, message.topic, words))


def _weighted(pairs: list[list[list[float]]], readings: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([sum(weight * readings[int(channel)] for channel, weight in taxel) for taxel in pairs])
