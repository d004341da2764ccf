"""CDR (XCDR version 1, little-endian) of ROS messages by their types; values are maps and sequences.

OMG DDS-XTypes 1.3, 7.4.1: a header of four bytes, then the fields in order, each aligned to its own size,
counted from the end of the header.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tactiled.recording.cdr import HEAD
from tactiled.ros2.definitions import RosField, RosType

_CODES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_Write = Callable[[bytearray, Any], None]


class CdrEncoder:
    """Encoder of one message type."""

    def __init__(self, name: str, types: Mapping[str, RosType]) -> None:
        self._write = _writer(types[name], types)

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Encode a message with its header; a field without a value raises `KeyError`."""
        out = bytearray()
        self._write(out, values)
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
        values, _ = _read(types[name], types, data[4:], 0)
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"{name}: {len(data)} bytes are no such message ({error})") from None
    return values


def _writer(kind: RosType, types: Mapping[str, RosType]) -> _Write:
    fields = [(field.name, _field_writer(field, types)) for field in kind.fields]

    def write(out: bytearray, values: Mapping[str, Any]) -> None:
        for name, write_field in fields:
            write_field(out, values[name])

    return write


def _field_writer(field: RosField, types: Mapping[str, RosType]) -> _Write:
    one: _Write | None = _write_string if field.kind == "string" else None
    if field.kind in types:
        one = _writer(types[field.kind], types)
    if one is None:
        return _numbers_writer(_CODES[field.kind], field.size)
    if field.size is None:
        return one
    counted, write_one = field.size == 0, one

    def write(out: bytearray, values: Sequence[Any]) -> None:
        if counted:
            _write_length(out, len(values))
        for value in values:
            write_one(out, value)

    return write


def _numbers_writer(code: str, size: int | None) -> _Write:
    width = struct.calcsize(code)
    if size is None:
        packed = struct.Struct(f"<{code}")

        def write_number(out: bytearray, value: Any) -> None:
            out += bytes(-len(out) % width) + packed.pack(value)

        return write_number

    def write_numbers(out: bytearray, values: Sequence[Any]) -> None:
        if not size:
            _write_length(out, len(values))
        if len(values):
            out += bytes(-len(out) % width) + struct.pack(f"<{len(values)}{code}", *values)

    return write_numbers


def _write_string(out: bytearray, text: str) -> None:
    data = text.encode() + b"\0"
    _write_length(out, len(data))
    out += data


def _write_length(out: bytearray, length: int) -> None:
    out += bytes(-len(out) % 4) + struct.pack("<I", length)


def _read(kind: RosType, types: Mapping[str, RosType], data: bytes, at: int) -> tuple[dict[str, Any], int]:
    values: dict[str, Any] = {}
    for field in kind.fields:
        count, sequence = 1, field.size is not None
        if field.size:
            count = field.size
        elif sequence:
            count, at = _read_number("I", data, at)
        found = []
        for _ in range(count):
            one, at = _read_one(field.kind, types, data, at)
            found.append(one)
        values[field.name] = found if sequence else found[0]
    return values, at


def _read_one(kind: str, types: Mapping[str, RosType], data: bytes, at: int) -> tuple[Any, int]:
    if kind in types:
        return _read(types[kind], types, data, at)
    if kind != "string":
        return _read_number(_CODES[kind], data, at)
    length, at = _read_number("I", data, at)
    text = data[at : at + length]
    if len(text) != length:
        raise struct.error(f"{length} bytes announced, {len(text)} there")
    return text.removesuffix(b"\0").decode(), at + length


def _read_number(code: str, data: bytes, at: int) -> tuple[Any, int]:
    at += -at % struct.calcsize(code)
    (value,) = struct.unpack_from(f"<{code}", data, at)
    return value, at + struct.calcsize(code)
