"""Conversion of events to messages (``[topic, msgpack map]``) and to plain maps.

The map has string keys, no bin, no ext, no nil, and a type for each field that never changes, so that
PlotJuggler, nlohmann::json and every msgpack library can read it. `unix_offset_s` converts instants from the
monotonic clock to epoch seconds (0 offline: instants stay in the clock of the file).
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, get_args, get_origin

import msgpack

from tactiled.events.types import EVENT_TYPES, Event

MESSAGE_VERSION = 1
# Instants become epoch seconds, under names without the unit.
_RENAMED = {"time_s": "timestamp", "onset_s": "onset", "detected_s": "detected", "answered_s": "answered"}


def evidence_key(topic: str) -> str:
    """Return the field of a message that has the instant at which its evidence was complete.

    A slip is reported some time after it began, a texture after its window.
    """
    kind = EVENT_TYPES.get(topic, Event)  # a topic of a later version
    return message_key(kind.evidence)


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
    return _MAPS[type(event)](event, seq, board, unix_offset_s, run)


def _map_of(kind: type[Event]) -> Callable[[Event, int, str, float, int], dict[str, Any]]:
    """Make the function that maps events of a type: one expression, because walking fields takes longer."""
    items = [f"'v': {MESSAGE_VERSION}", "'timestamp': float(event.time_s) + offset_s"]
    items += [f"{name!r}: {name}" for name in ("seq", "board", "run")]
    for field in dataclasses.fields(kind):
        if field.name in _RENAMED:
            if field.name != "time_s":
                items.append(f"{message_key(field.name)!r}: float(event.{field.name}) + offset_s")
        else:
            items.append(f"{field.name!r}: {_plain(f'event.{field.name}', field.type)}")
    made: Callable[[Event, int, str, float, int], dict[str, Any]] = eval(
        f"lambda event, seq, board, offset_s, run: {{{', '.join(items)}}}"
    )
    return made


def _plain(value: str, kind: Any) -> str:
    """Return the expression that converts a value to a declared type.

    A float field has 0.0 for 0, and an integer of numpy becomes an int.
    """
    if dataclasses.is_dataclass(kind):
        parts = [f"{f.name!r}: {_plain(f'{value}.{f.name}', f.type)}" for f in dataclasses.fields(kind)]
        return f"{{{', '.join(parts)}}}"
    if get_origin(kind) is tuple:
        inner = get_args(kind)[0]
        if dataclasses.is_dataclass(inner):
            return f"[{_plain('part', inner)} for part in {value}]"
        return f"list(map({inner.__name__}, {value}))"
    return f"{kind.__name__}({value})" if kind in (bool, int, float, str) else value  # a Literal: the string


_MAPS = {kind: _map_of(kind) for kind in EVENT_TYPES.values()}
# A packer allocates its buffer of 256 kB once.
_pack = msgpack.Packer().pack


def encode(event: Event, *, seq: int, board: str, unix_offset_s: float, run: int = 0) -> tuple[bytes, bytes]:
    """Return the two frames of a message: topic and payload. One thread alone may call it."""
    payload = _pack(to_map(event, seq=seq, board=board, unix_offset_s=unix_offset_s, run=run))
    return _topic_octets(board, event.topic), payload


@functools.lru_cache(maxsize=256)
def _topic_octets(board: str, event_topic: str) -> bytes:
    return topic_of(board, event_topic).encode()
