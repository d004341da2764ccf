"""Check of received message maps against the declared types, for programs that draw what they receive.

Any publisher on the endpoint may send any map. What passes here can be used without further checks: every
field that `types` declares is there, has its type, and is small enough to be squared and summed.
"""

import dataclasses
import math
import reprlib
from collections.abc import Callable, Mapping
from typing import Any, get_args, get_origin

from tactiled.errors import ContractError
from tactiled.events.codec import message_key
from tactiled.events.types import EVENT_TYPES, Event

# No quantity of a message is larger in its unit; `UNKNOWN_SD_N` and unknown clocks are 1e9.
_LARGEST = 1e15
# Epoch seconds of the years 68 and 5138, between which every calendar function takes them.
_EARLIEST_S, _LATEST_S = -6e10, 1e11

_Check = Callable[[Any], bool]


def checked_map(topic: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the declared fields of a message map, each present and of its type.

    Fields that are not declared are left out; declared fields with a default, which an earlier version does
    not send, get that default.

    `ContractError` where there is no such topic, a field is missing, of another type, or too large, or lists
    that belong together differ in length.
    """
    fields = _FIELDS.get(topic)
    if fields is None:
        raise ContractError(f"no topic {topic!r:.40}")
    found: dict[str, Any] = {}
    for key, is_valid, default in fields:
        value = data.get(key, default)
        if value is default:
            if value is dataclasses.MISSING:
                raise ContractError(f"{topic}: {key} is missing")
        elif not is_valid(value):
            raise ContractError(f"{topic}: {key} is {reprlib.repr(value):.40}")
        found[key] = value
    for keys in _EQUALLY_LONG.get(topic, ()):
        if len({found[key] if type(found[key]) is int else len(found[key]) for key in keys}) > 1:
            raise ContractError(f"{topic}: {', '.join(keys)} differ in length")
    return found


def _is_number(value: Any) -> bool:
    return type(value) in (float, int) and abs(value) <= _LARGEST  # which neither NaN nor infinity is


def _are_numbers(value: Any) -> bool:
    """Check the readings of a scan at once: one call for each takes three times as long."""
    if not isinstance(value, list) or not {*map(type, value)} <= {float, int}:
        return False
    # The norm bounds them all in a fifth of the time. With a NaN, norm and sum are NaN: below nothing.
    return math.hypot(*value) <= _LARGEST or (
        min(value) >= -_LARGEST and max(value) <= _LARGEST and sum(value) < math.inf
    )


def _is_instant(value: Any) -> bool:
    return _is_number(value) and _EARLIEST_S <= value <= _LATEST_S


def _is_count(value: Any) -> bool:
    return type(value) is int and abs(value) < 2**64


def _check_of(kind: Any) -> _Check:
    """Check of a declared type. A `Literal` is any text: later versions may have more values."""
    if dataclasses.is_dataclass(kind):
        parts = [(field.name, _check_of(field.type)) for field in dataclasses.fields(kind)]
        return lambda value: isinstance(value, dict) and all(is_valid(value.get(k)) for k, is_valid in parts)
    if get_origin(kind) is tuple:
        element = get_args(kind)[0]
        if element is float:
            return _are_numbers
        if element is bool:
            return lambda value: isinstance(value, list) and {*map(type, value)} <= {bool}
        inner = _check_of(element)
        return lambda value: isinstance(value, list) and all(map(inner, value))
    if kind is float:
        return _is_number
    if kind is int:
        return _is_count
    if kind is bool:
        return lambda value: isinstance(value, bool)
    return lambda value: isinstance(value, str)


def _fields(kind: type[Event]) -> list[tuple[str, _Check, Any]]:
    made = []
    for field in dataclasses.fields(kind):
        key = message_key(field.name)
        is_valid = _is_instant if key != field.name else _check_of(field.type)
        default = field.default
        if dataclasses.is_dataclass(default):
            default = dataclasses.asdict(default)  # type: ignore[arg-type]
        made.append((key, is_valid, list(default) if isinstance(default, tuple) else default))
    return made


_HEAD: list[tuple[str, _Check, Any]] = [
    *((key, _is_count, dataclasses.MISSING) for key in ("v", "seq", "run")),
    ("board", _check_of(str), dataclasses.MISSING),
]
_FIELDS = {topic: _HEAD + _fields(kind) for topic, kind in EVENT_TYPES.items()}
_EQUALLY_LONG = {
    "scan": (("volts", "valid"),),
    "info": (("taxels", "x_mm", "y_mm"), ("channels", "channel_names")),
    "force": (("taxel_fx_n", "taxel_fy_n", "taxel_fz_n"),),
}
