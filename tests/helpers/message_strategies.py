"""Events with any values that their types allow, and a strict reader of msgpack of its own."""

import dataclasses
import struct
import typing
from typing import Any, TypeVar

from hypothesis import strategies as st

FLOATS = st.one_of(st.sampled_from([0.0, -0.0, 1.0]), st.floats(-1e15, 1e15))
INTEGERS = st.integers(0, 2**63 - 1)
_MINUS_ONE = 0xFF  # msgpack byte of -1, which only `uid` may be (protocols/events.md)
NONNEGATIVE = {
    "period_mm", "speed_mm_s", "frequency_hz", "window_s", "rate_hz", "uptime_s", "volts_per_count", "weight",
    "period_min_mm", "period_max_mm", "free_mb", "inhibited_s", "loop_lag_s", "friction", "friction_low",
    "friction_high", "needed_load", "stray_rad",
}  # fmt: skip
SPECIAL: dict[str, st.SearchStrategy[Any]] = {
    "confidence": st.floats(0, 1),
    **dict.fromkeys(
        (
            "utilisation",
            "utilisation_low",
            "utilisation_high",
            "slipping_share",
            "p_sliding",
            "p_gross_50ms",
            "p_gross_100ms",
            "p_gross_300ms",
        ),
        st.floats(0, 1),
    ),
    "uid": st.integers(-1, 2**32 - 2),
    "protocol_version": st.integers(0, 255),
}
T = TypeVar("T")


def values(kind: Any) -> st.SearchStrategy[Any]:
    """Values of one declared type; a whole number may stand in a float field, as Python lets it."""
    if kind is float:
        return st.one_of(FLOATS, st.integers(-1000, 1000))
    if kind is bool:
        return st.booleans()
    if kind is int:
        return INTEGERS
    if kind is str:
        return st.text(max_size=20)
    if typing.get_origin(kind) is typing.Literal:
        return st.sampled_from(typing.get_args(kind))
    if typing.get_origin(kind) is tuple:
        return st.lists(values(typing.get_args(kind)[0]), max_size=40).map(tuple)
    assert isinstance(kind, type), f"no strategy for {kind}"
    return instances(kind)


def instances(kind: type[T]) -> st.SearchStrategy[T]:
    """Instances of a dataclass. Ranges that the schemas promise are kept; everything else is anything."""
    strategies = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        if field.name in NONNEGATIVE or "_sd_" in field.name:
            strategies[field.name] = st.floats(0, 1e12)
        else:
            strategies[field.name] = SPECIAL.get(field.name, values(field.type))
    return st.builds(kind, **strategies)


def walk(payload: bytes) -> tuple[Any, Any]:
    """Value and shape of a msgpack payload, read byte by byte as PlotJuggler's parser would.

    The shape names the wire type of every leaf: ``float64``, ``int``, ``bool``, ``str``. nil, bin, ext,
    float32, keys that are no strings, duplicate keys and trailing bytes are failures.
    """
    value, shape, end = _walk(payload, 0)
    assert end == len(payload), f"{len(payload) - end} bytes behind the map"
    return value, shape


def _walk(data: bytes, at: int) -> tuple[Any, Any, int]:
    first = data[at]
    at += 1
    if first <= 0x7F:
        return first, "int", at
    if first in (0xCC, 0xCD, 0xCE, 0xCF):
        size = 1 << (first - 0xCC)
        return int.from_bytes(data[at : at + size], "big"), "int", at + size
    if first == 0xCB:
        return struct.unpack_from(">d", data, at)[0], "float64", at + 8
    if first in (0xC2, 0xC3):
        return first == 0xC3, "bool", at
    if 0xA0 <= first <= 0xBF or first in (0xD9, 0xDA, 0xDB):
        size, at = _length(data, at, first, {0xA0: 0x1F}, {0xD9: 1, 0xDA: 2, 0xDB: 4})
        return data[at : at + size].decode(), "str", at + size
    if 0x90 <= first <= 0x9F or first in (0xDC, 0xDD):
        size, at = _length(data, at, first, {0x90: 0x0F}, {0xDC: 2, 0xDD: 4})
        items, shapes = [], []
        for _ in range(size):
            item, shape, at = _walk(data, at)
            items.append(item)
            shapes.append(shape)
        assert all(shape == shapes[0] for shape in shapes), f"an array of several types: {shapes}"
        return items, [shapes[0]] if shapes else [], at
    assert 0x80 <= first <= 0x8F or first in (0xDE, 0xDF), f"type byte {first:#04x} is not for us"
    size, at = _length(data, at, first, {0x80: 0x0F}, {0xDE: 2, 0xDF: 4})
    entries, kinds = {}, {}
    for _ in range(size):
        key, shape, at = _walk(data, at)
        assert shape == "str", f"a key that is {shape}"
        assert key not in entries, f"{key} twice"
        if key == "uid" and data[at] == _MINUS_ONE:
            entries[key], kinds[key], at = -1, "int", at + 1
        else:
            entries[key], kinds[key], at = _walk(data, at)
    return entries, kinds, at


def _length(data: bytes, at: int, first: int, short: dict[int, int], long: dict[int, int]) -> tuple[int, int]:
    """Length of a string, array or map, and where its content begins."""
    if first in long:
        return int.from_bytes(data[at : at + long[first]], "big"), at + long[first]
    ((base, mask),) = short.items()
    return (first - base) & mask, at
