"""Conversion of events to messages (``[topic, msgpack map]``) and of messages to plain maps.

The map has string keys, no bin, no ext, no nil, and a type for each field that never changes, so that
PlotJuggler, nlohmann::json and every msgpack library can read it. `unix_offset_s` converts instants from the
monotonic clock to epoch seconds (0 offline: instants stay in the clock of the file).
"""

import dataclasses
import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple, get_args, get_origin

import msgpack

from tactiled.errors import ContractError
from tactiled.events.types import EVENT_TYPES, Event

MESSAGE_VERSION = 1
# Instants become epoch seconds, under names without the unit.
_RENAMED = {"time_s": "timestamp", "onset_s": "onset", "detected_s": "detected", "answered_s": "answered"}


def message_key(name: str) -> str:
    """Return the key under which a field of an event stands in its message."""
    return _RENAMED.get(name, name)


@functools.lru_cache(maxsize=256)  # boards times topics; a board that renames itself costs no memory for ever
def topic_of(board: str, event_topic: str) -> str:
    """Return ``tactile/<board>/<topic>``; characters at which viewers split filters become ``-``."""
    safe = "".join("-" if c in " ,;/\t" or not c.isprintable() else c for c in board) or "-"
    return f"tactile/{safe}/{event_topic}"


def to_map(event: Event, *, seq: int, board: str, unix_offset_s: float, run: int = 0) -> dict[str, Any]:
    """Return the message map of an event; `run` identifies the run of the daemon, 0 for files."""
    message: dict[str, Any] = {"v": MESSAGE_VERSION, "timestamp": 0.0, "seq": seq, "board": board, "run": run}
    values_of, fields = _FIELDS[type(event)]
    for (key, convert), value in zip(fields, values_of(event), strict=True):
        message[key] = float(value) + unix_offset_s if convert is None else convert(value)
    return message


class _Fields(NamedTuple):
    """Getter of the values of an event, and for each its key in the map and its conversion.

    The conversion is None for an instant.
    """

    values_of: Callable[[Event], tuple[Any, ...]]
    keys: tuple[tuple[str, Callable[[Any], Any] | None], ...]


def _converter(name: str, kind: Any) -> Callable[[Any], Any] | None:
    return None if name in _RENAMED else _plain(kind)


def _plain(kind: Any) -> Callable[[Any], Any]:
    """Make the conversion to a declared type: 0 becomes 0.0 in a float field, a numpy integer an int."""
    if dataclasses.is_dataclass(kind):
        parts = [(field.name, _plain(field.type)) for field in dataclasses.fields(kind)]
        return lambda value: {name: convert(getattr(value, name)) for name, convert in parts}
    if get_origin(kind) is tuple:
        inner = _plain(get_args(kind)[0])
        return lambda value: list(map(inner, value))
    if kind in (bool, int, float, str):
        made: Callable[[Any], Any] = kind
        return made
    return lambda value: value  # a Literal: the string itself


def _fields(kind: type[Event]) -> _Fields:
    fields = dataclasses.fields(kind)
    return _Fields(
        operator.attrgetter(*(field.name for field in fields)),
        tuple((message_key(each.name), _converter(each.name, each.type)) for each in fields),
    )


# Walking the fields for each event took most of the time of encoding.
_FIELDS = {kind: _fields(kind) for kind in EVENT_TYPES.values()}
# A packer allocates its buffer of 256 kB once.
_pack = msgpack.Packer().pack


def encode(event: Event, *, seq: int, board: str, unix_offset_s: float, run: int = 0) -> tuple[bytes, bytes]:
    """Return the two frames of a message: topic and payload. One thread alone may call it."""
    payload = _pack(to_map(event, seq=seq, board=board, unix_offset_s=unix_offset_s, run=run))
    return _topic_octets(board, event.topic), payload


@functools.lru_cache(maxsize=256)
def _topic_octets(board: str, event_topic: str) -> bytes:
    return topic_of(board, event_topic).encode()


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
