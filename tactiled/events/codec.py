"""Conversion of events to messages (``[topic, msgpack map]``) and of messages to plain maps.

The map has string keys, no bin, no ext, no nil, and a type for each field that never changes, so that
PlotJuggler, nlohmann::json and every msgpack library can read it. `unix_offset_s` converts instants from the
monotonic clock to epoch seconds (0 offline: instants stay in the clock of the file).
"""

import dataclasses
from typing import Any, get_args

import msgpack

from tactiled.errors import ContractError
from tactiled.events.types import Event

MESSAGE_VERSION = 1
# Instants become epoch seconds, under names without the unit.
_RENAMED = {"time_s": "timestamp", "onset_s": "onset", "detected_s": "detected", "answered_s": "answered"}


def topic_of(board: str, event_topic: str) -> str:
    """Return ``tactile/<board>/<topic>``; characters at which viewers split filters become ``-``."""
    safe = "".join("-" if c in " ,;/\t" or not c.isprintable() else c for c in board) or "-"
    return f"tactile/{safe}/{event_topic}"


def to_map(event: Event, *, seq: int, board: str, unix_offset_s: float, run: int = 0) -> dict[str, Any]:
    """Return the message map of an event; `run` identifies the run of the daemon, 0 for files."""
    message: dict[str, Any] = {"v": MESSAGE_VERSION, "timestamp": 0.0, "seq": seq, "board": board, "run": run}
    for field in dataclasses.fields(event):
        value = getattr(event, field.name)
        if field.name in _RENAMED:
            message[_RENAMED[field.name]] = float(value) + unix_offset_s
        else:
            message[field.name] = _plain(value, field.type)
    return message


def _plain(value: Any, kind: Any) -> Any:
    """Plain value of the declared type: 0 becomes 0.0 in a float field, a numpy integer an int."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name), f.type) for f in dataclasses.fields(value)}
    if isinstance(value, tuple):
        inner = get_args(kind)[0]
        return [_plain(v, inner) for v in value]
    if kind in (bool, int, float, str):
        return kind(value)
    return value  # a Literal: the string itself


def encode(event: Event, *, seq: int, board: str, unix_offset_s: float, run: int = 0) -> tuple[bytes, bytes]:
    """Return the two frames of a message: topic and payload."""
    payload = msgpack.packb(to_map(event, seq=seq, board=board, unix_offset_s=unix_offset_s, run=run))
    return topic_of(board, event.topic).encode(), payload


def decode(topic: bytes, payload: bytes) -> tuple[str, dict[str, Any]]:
    """Return the last part of the topic, and the map.

    Raises
    ------
    ContractError
        The payload is not a map with string keys.
    """
    try:
        message = msgpack.unpackb(payload, raw=False, strict_map_key=True)
    except (ValueError, msgpack.exceptions.ExtraData) as error:
        raise ContractError(f"message on {topic!r} is not msgpack: {error}") from None
    if not isinstance(message, dict):
        raise ContractError(f"message on {topic!r} is not a map")
    return topic.decode(errors="replace").rsplit("/", 1)[-1], message
