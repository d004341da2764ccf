"""CDR (XCDR version 1, little-endian) of ROS messages by their types; values are maps and sequences.

OMG DDS-XTypes 1.3, 7.4.1: a header of four bytes, then the fields in order, each aligned to its own size,
counted from the end of the header.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from tactiled.recording.cdr import HEAD
from tactiled.ros2.definitions import RosType

_CODES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


def encode(name: str, types: Mapping[str, RosType], values: Mapping[str, Any]) -> bytes:
    """Encode a message with its header.

    Raises
    ------
    KeyError
        A field has no value.
    struct.error
        A number does not fit its field.
    """
    out = bytearray()
    _write(out, types[name], types, values)
    return HEAD + bytes(out)


def _write(out: bytearray, kind: RosType, types: Mapping[str, RosType], values: Mapping[str, Any]) -> None:
    for field in kind.fields:
        value = values[field.name]
        if field.size == 0:
            _write_numbers(out, "I", (len(value),))
        _write_items(out, field.kind, types, (value,) if field.size is None else value)


def _write_items(out: bytearray, kind: str, types: Mapping[str, RosType], items: Sequence[Any]) -> None:
    if kind in types:
        for item in items:
            _write(out, types[kind], types, item)
    elif kind == "string":
        for item in items:
            text = item.encode() + b"\0"
            _write_numbers(out, "I", (len(text),))
            out += text
    elif len(items):  # an empty sequence is not aligned
        _write_numbers(out, _CODES[kind], items)


def _write_numbers(out: bytearray, code: str, numbers: Sequence[Any]) -> None:
    out += bytes(-len(out) % struct.calcsize(code)) + struct.pack(f"<{len(numbers)}{code}", *numbers)
