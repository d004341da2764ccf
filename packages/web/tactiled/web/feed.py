"""Frames for browsers from items of a subscription; history for browsers that come later. No I/O.

A frame is a MessagePack map: ``{"now": epoch s, "mono": s, "m": [[source, topic, data, recovered], ...]}``.
`now` and `mono` are the clocks of this host: with `mono` the page measures how long frames wait on their way,
which no step of the wall clock disturbs. `source` is the number of the endpoint. Besides the topics of the
daemon there are ``geometry`` (see `board_geometry`), ``notice`` (lost messages, a restart of the daemon) and
``settings`` (of a daemon that takes commands of this page, see `commands`). Each message is packed once,
whatever the number of browsers. Readings are 32-bit floats; what no page shows is left out.
"""

import math
import struct
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgpack

from tactiled.array import Array
from tactiled.board_geometry import geometry_of, same_array
from tactiled.client import Item, Lost, Malformed, Message, Recovered, Restarted, Topic
from tactiled.errors import ContractError
from tactiled.events.incoming import checked_map

HISTORY_S = 60.0  # span of the timeline on the page
_THIN_S = 0.1  # interval of scans and grip messages in the history: 600 points over the timeline
_GONE_S = 600.0  # since the last status of a board: as long as an open page keeps its curves
_HISTORY_MESSAGES = 4000  # bound where events come faster than they can be read anyway
LIVE = frozenset({"scan", "grip", "force", "status"})
"""Topics of which a slow browser may miss messages: the next one replaces them."""
NEWEST_ALONE: frozenset[Topic] = frozenset({"grip", "force"})
"""Topics of each scan, of whose messages a frame has the newest: no other one need be read."""
URGENT: frozenset[Topic] = frozenset({"contact", "slip", "command"})
"""Topics that a page shows at once."""
_FLOATS = 1
"""MessagePack extension type of the readings of a scan: little-endian 32-bit floats."""
_PACKER = msgpack.Packer()  # kept: to make one for each message takes as long as to pack it
_UNSEEN = {"scan": ("time_sd_s", "age_s"), "force": ("taxel_fx_n", "taxel_fy_n", "taxel_fz_n")}
"""Fields of messages of each scan that no page shows."""
_NEWEST = ("geometry", "info", "settings", "status", "recording", "contact")
"""Topics whose newest message a new browser needs."""


class Entry(NamedTuple):
    """Packed message, with what decides where it goes."""

    key: tuple[int, str, str]
    timestamp: float
    packed: bytes

    @property
    def topic(self) -> str:
        """Topic of the message; `key` is its source, board and topic."""
        return self.key[2]


class Frames(NamedTuple):
    """Frames of one instant: of messages that every browser gets, of live ones, of both; None for none."""

    kept: bytes | None
    live: bytes | None
    both: bytes | None = None  # in place of the two, where both are there


class Feed:
    """Messages that wait for the next frame, and the history; arrays of the user are chosen by name."""

    def __init__(self, arrays: Sequence[Array] = ()) -> None:
        self._arrays = {array.name: array for array in arrays}
        self._pending: list[Entry] = []
        self._replaceable: dict[tuple[int, str, str], Message] = {}  # newest, not needed by the history
        self._history: deque[Entry] = deque(maxlen=_HISTORY_MESSAGES)
        self._newest: dict[tuple[int, str, str], Entry] = {}
        self._thinned_s: dict[tuple[int, str, str], float] = {}
        self._newest_s: dict[int, float] = {}
        self._infos: dict[tuple[int, str], Mapping[str, Any]] = {}
        self._heard_s: dict[tuple[int, str], float] = {}  # clock of the frame with the newest status
        self.unreadable = 0
        """Number of messages that are not as protocols/events.md says, such as a foreign publisher sends."""

    def take(self, source: int, item: Item) -> None:
        """Take an item of the subscription to an endpoint."""
        if isinstance(item, Message | Recovered):
            message = item.message if isinstance(item, Recovered) else item
            key = (source, message.board, message.topic)
            is_thinned = self._is_thinned(key, message.timestamp)
            if message.topic in LIVE and message.topic != "scan" and is_thinned and message is item:
                # Of several between two frames the newest is sent; no other one is checked or packed.
                self._replaceable[key] = message
            else:
                self._replaceable.pop(key, None)
                self._message(source, message, recovered=message is not item)
        elif isinstance(item, Lost):
            lost = "message was" if item.count == 1 else "messages were"
            self._notice(source, item.board, "lost", f"{item.count} {item.topic} {lost} lost on the way")
        elif isinstance(item, Restarted):
            self._notice(source, item.board, "restart", "the daemon was restarted")
        elif isinstance(item, Malformed):
            self.unreadable += 1

    def add(self, source: int, topic: str, data: Mapping[str, Any], recovered: bool = False) -> None:
        """Add a message to the next frame and to the history."""
        key = (source, str(data.get("board", "")), topic)
        entry = Entry(key, float(data.get("timestamp", 0.0)), _packed(source, topic, data, recovered))
        self._pending.append(entry)
        if topic in _NEWEST:
            self._newest[key] = entry
        if topic in _NEWEST and topic != "contact":
            return
        if topic in LIVE:
            if self._is_thinned(key, entry.timestamp):
                return
            self._thinned_s[key] = entry.timestamp
        self._history.append(entry)

    def _is_thinned(self, key: tuple[int, str, str], timestamp: float) -> bool:
        """Return True for a message that the history does not need; a clock may be set back by any time."""
        return -HISTORY_S <= timestamp - self._thinned_s.get(key, -math.inf) < _THIN_S

    def boards(self) -> list[tuple[int, str]]:
        """Return source and board of each status that has come."""
        return [(source, board) for source, board, topic in self._newest if topic == "status" and board]

    def frames(self, now_unix_s: float, now_s: float) -> Frames:
        """Return what has come and was not returned yet; of live topics but scans, the newest."""
        self._forget(now_unix_s)
        for (source, _, _), message in self._replaceable.items():
            self._message(source, message, recovered=False)
        self._replaceable.clear()
        self._heard_s.update({entry.key[:2]: now_s for entry in self._pending if entry.topic == "status"})
        self._forget_boards(now_s)
        kept = [entry.packed for entry in self._pending if entry.topic not in LIVE]
        live = [entry for entry in self._pending if entry.topic in LIVE]
        self._pending = []
        newest = {entry.key: entry for entry in live}
        # Scans last: the page draws their loads in the unit of the newest force message.
        packed = [entry.packed for entry in live if entry.topic != "scan" and newest[entry.key] is entry]
        packed += [entry.packed for entry in live if entry.topic == "scan"]
        both = [*kept, *packed] if kept and packed else []
        return Frames(
            *(pack_frame(now_unix_s, now_s, some) if some else None for some in (kept, packed, both))
        )

    def history(self, now_unix_s: float, now_s: float) -> bytes:
        """Return a frame with the newest state of each board, and a minute of events and thinned scans.

        Messages that wait for the next frame are not in it: the browser gets them with that frame.
        """
        self._forget(now_unix_s)
        waiting, listed = set(self._pending), set(self._history)
        newest = [entry for entry in self._newest.values() if entry not in waiting]
        state = sorted(newest, key=lambda entry: _NEWEST.index(entry.topic))
        packed = [entry.packed for entry in state if entry.topic != "status" and entry not in listed]
        packed += [entry.packed for entry in self._history if entry not in waiting]
        packed += [entry.packed for entry in state if entry.topic == "status"]
        return pack_frame(now_unix_s, now_s, packed)

    def _notice(self, source: int, board: str, kind: str, words: str) -> None:
        """Add a notice at the instant of the newest message of its endpoint."""
        instant_s = self._newest_s.get(source, 0.0)
        self.add(source, "notice", {"board": board, "timestamp": instant_s, "kind": kind, "words": words})

    def _forget(self, now_unix_s: float) -> None:
        """Drop what is older than the timeline, or ahead of it after the clock was set back."""
        while self._history and abs(self._history[0].timestamp - now_unix_s) > HISTORY_S:
            self._history.popleft()

    def _forget_boards(self, now_s: float) -> None:
        """Drop boards that were taken away, while others of their daemon go on: a page shows few boards."""
        newest_s: dict[int, float] = {}
        for (source, _), heard_s in self._heard_s.items():
            newest_s[source] = max(heard_s, newest_s.get(source, heard_s))
        for (source, board), heard_s in tuple(self._heard_s.items()):
            if heard_s < now_s - _GONE_S <= newest_s[source]:
                del self._heard_s[source, board]
                self._infos.pop((source, board), None)
                for key in [key for key in self._newest if key[:2] == (source, board)]:
                    del self._newest[key]

    def _message(self, source: int, message: Message, *, recovered: bool) -> None:
        try:
            data = checked_map(message.topic, message.data)
        except ContractError:
            self.unreadable += 1
            return
        if message.topic == "info":
            before, self._infos[source, message.board] = self._infos.get((source, message.board)), data
            if not same_array(data, before):
                geometry = geometry_of(data, self._arrays.get(str(data["array_id"])))
                self.add(source, "geometry", {"board": message.board, **geometry})
        if not recovered:
            self._newest_s[source] = float(data["timestamp"])
        self.add(source, message.topic, data, recovered)


def _packed(source: int, topic: str, data: Mapping[str, Any], recovered: bool) -> bytes:
    seen = dict(data)
    for name in _UNSEEN.get(topic, ()):
        seen.pop(name, None)
    if topic == "scan":
        volts = data["volts"]
        seen["volts"] = msgpack.ExtType(_FLOATS, struct.pack(f"<{len(volts)}f", *volts))
    packed: bytes = _PACKER.pack([source, topic, seen, recovered])
    return packed


def pack_frame(now_unix_s: float, now_s: float, packed: Sequence[bytes]) -> bytes:
    """Return a frame of packed messages."""
    packer = msgpack.Packer(autoreset=False)
    packer.pack_map_header(3)
    for name, value in (("now", now_unix_s), ("mono", now_s)):
        packer.pack(name)
        packer.pack(value)
    packer.pack("m")
    packer.pack_array_header(len(packed))
    return bytes(packer.bytes()) + b"".join(packed)
