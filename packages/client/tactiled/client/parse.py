"""Parser of received bytes into messages."""

import math
from collections.abc import Mapping
from typing import Any, TypeGuard

import msgpack

from tactiled.client.items import Malformed, Message
from tactiled.client.typed import MESSAGE_TYPES
from tactiled.events.codec import MESSAGE_VERSION, evidence_key


def parse_map(payload: bytes, name: str) -> dict[str, Any] | Malformed:
    """Parse a msgpack map with string keys and a supported version; never raises."""
    try:
        data = msgpack.unpackb(payload)
    except (
        Exception
    ) as error:  # msgpack raises half a dozen kinds of exception, and perhaps others for forged data
        return Malformed(f"{name}: not msgpack ({type(error).__name__})")
    if not isinstance(data, dict) or not {*map(type, data)} <= {str}:
        return Malformed(f"{name}: not a map with string keys")
    version = data.get("v")
    if type(version) is not int or version != MESSAGE_VERSION:
        # Words for a map or a list may be as deep as its levels.
        words = type(version).__name__ if isinstance(version, dict | list) else f"{version!r:.20}"
        return Malformed(f"{name}: version {words}, this client reads {MESSAGE_VERSION}")
    return data


def is_count(value: Any) -> TypeGuard[int]:
    """Return True for a whole number from 0 on that clients with integers of 64 bits can hold."""
    return type(value) is int and 0 <= value < 2**63


def message_of(topic: str, data: Mapping[str, Any], now_s: float, unix_s: float) -> Message | Malformed:
    """Make a message from a map that was received at `now_s`; never raises."""
    seq, stamp, board, run = data.get("seq"), data.get("timestamp"), data.get("board"), data.get("run")
    if not is_count(seq) or type(stamp) is not float or not math.isfinite(stamp):
        return Malformed(f"{topic}: seq or timestamp is missing or no number")
    if not isinstance(board, str) or not is_count(run):
        return Malformed(f"{topic}: board or run is missing, or not what it should be")
    key = evidence_key(topic)
    evidence = data.get(key)
    if type(evidence) is not float or not math.isfinite(evidence):
        return Malformed(f"{topic}: {key} is missing or no number")
    kind = MESSAGE_TYPES.get(topic, Message)  # a topic of a later version has no class of its own
    return kind(topic, board, seq, stamp, dict(data), now_s, unix_s - stamp, unix_s - evidence)
