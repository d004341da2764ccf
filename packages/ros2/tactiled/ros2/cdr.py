"""CDR (XCDR version 1, little-endian) of ROS messages by their types; values are maps and sequences.

OMG DDS-XTypes 1.3, 7.4.1: a header of four bytes, then the fields in order, each aligned to its own size,
counted from the end of the header.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from tactiled.recording.cdr import HEAD
from tactiled.ros2.definitions import RosField, RosType

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


def decode(name: str, types: Mapping[str, RosType], data: bytes) -> dict[str, Any]:
    """Decode a message with its header.

    Raises
    ------
    ValueError
        The bytes are no little-endian message of this type.
    """
    if data[:2] != HEAD[:2]:
        raise ValueError(f"{name}: not little-endian CDR")
    try:
        return _MessageReader(data[4:], types).message(types[name])
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"{name}: {len(data)} bytes are no such message ({error})") from None


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


class _MessageReader:
    def __init__(self, data: bytes, types: Mapping[str, RosType]) -> None:
        self._data, self._types, self._at = data, types, 0

    def message(self, kind: RosType) -> dict[str, Any]:
        return {field.name: self._field(field) for field in kind.fields}

    def _field(self, field: RosField) -> Any:
        if field.size is None:
            return self._one(field.kind)
        return [self._one(field.kind) for _ in range(field.size or self._number("I"))]

    def _one(self, kind: str) -> Any:
        if kind in self._types:
            return self.message(self._types[kind])
        if kind != "string":
            return self._number(_CODES[kind])
        length = self._number("I")
        text = self._data[self._at : self._at + length]
        if len(text) != length:
            raise struct.error(f"{length} bytes announced, {len(text)} there")
        self._at += length
        return text.removesuffix(b"\0").decode()

    def _number(self, code: str) -> Any:
        self._at += -self._at % struct.calcsize(code)
        (value,) = struct.unpack_from(f"<{code}", self._data, self._at)
        self._at += struct.calcsize(code)
        return value
