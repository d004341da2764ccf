"""CDR encoding of dataclasses, with the ros2msg schema that lets any viewer decode them.

CDR is what ROS 2 puts on the wire (OMG DDSI-RTPS 2.5, chapter 10; OMG DDS-XTypes 1.3, 7.4.1, "plain CDR"):
a header of four bytes (little-endian), then the fields in order, each aligned to its own size, counted from
the end of the header. A string is its length with the closing NUL, then the characters; a sequence is its
length, then its items. PlotJuggler, Foxglove and rerun decode it when the file carries the schema.
"""

import dataclasses
import struct
from collections.abc import Mapping
from typing import Any, Literal, get_args, get_origin, get_type_hints

from tactiled.errors import DataError

HEAD = b"\x00\x01\x00\x00"  # CDR_LE, no options (RTPS 2.5, table 10.3)
_PACKAGE = "tactiled_msgs"
# Python type: ros2msg type, struct code, size in bytes.
_PRIMITIVES = {bool: ("bool", "?", 1), int: ("int64", "q", 8), float: ("float64", "d", 8)}
_RULER = "=" * 80  # separator of types in a concatenated ros2msg schema


class Schema:
    """Message type: its ros2msg text, and the encoding of its messages.

    Parameters
    ----------
    name : str
        Bare name of the type, e.g. ``"Slip"``.
    fields : mapping of str to type
        bool, int, float, str, bytes, Literal strings, dataclasses of these, and tuples of one of them.
    """

    def __init__(self, name: str, fields: Mapping[str, Any]) -> None:
        self.name = f"{_PACKAGE}/msg/{name}"
        self._fields = {field: _plain(kind) for field, kind in fields.items()}
        nested: dict[str, type] = {}
        parts = [_definition(self._fields, nested)]
        while len(parts) <= len(nested):  # a nested type may contain further nested types
            kind = list(nested.values())[len(parts) - 1]
            text = _definition(_fields_of(kind), nested)
            parts.append(f"{_RULER}\nMSG: {_PACKAGE}/{kind.__name__}\n{text}")
        self.text = "".join(parts)

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Encode a message."""
        out = bytearray()
        for name, kind in self._fields.items():
            _write(out, values[name], kind)
        return HEAD + bytes(out)

    def decode(self, data: bytes) -> dict[str, Any]:
        """Decode a message: tuples for sequences, dataclasses for nested types.

        `DataError` if the bytes are not a message of this type.
        """
        if data[:4] != HEAD:
            raise DataError(f"{self.name}: not little-endian CDR")
        reader = _Reader(data[4:])
        try:
            return {name: reader.read(kind) for name, kind in self._fields.items()}
        except (struct.error, UnicodeDecodeError) as error:
            raise DataError(f"{self.name}: {len(data)} bytes are no such message ({error})") from None


def fields_of(kind: type) -> dict[str, Any]:
    """Return the field names and types of a dataclass."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _fields_of(kind: type) -> dict[str, Any]:
    return {name: _plain(inner) for name, inner in fields_of(kind).items()}


def _plain(kind: Any) -> Any:
    return str if get_origin(kind) is Literal else kind


def _definition(fields: Mapping[str, Any], nested: dict[str, type]) -> str:
    return "".join(f"{_ros_type(kind, nested)} {name}\n" for name, kind in fields.items())


def _ros_type(kind: Any, nested: dict[str, type]) -> str:
    if kind is str:
        return "string"
    if kind is bytes:
        return "uint8[]"
    if kind in _PRIMITIVES:
        return _PRIMITIVES[kind][0]
    if get_origin(kind) is tuple:
        return f"{_ros_type(_plain(get_args(kind)[0]), nested)}[]"
    nested[kind.__name__] = kind
    return f"{_PACKAGE}/{kind.__name__}"


def _align(out: bytearray, size: int) -> None:
    out.extend(bytes(-len(out) % size))


def _write(out: bytearray, value: Any, kind: Any) -> None:
    """Append a value of a kind that a `Schema` may have, aligned."""
    if kind in _PRIMITIVES:
        _, code, size = _PRIMITIVES[kind]
        _align(out, size)
        out += struct.pack(f"<{code}", value)
    elif kind is str:
        data = value.encode() + b"\x00"
        _write_length(out, len(data))
        out += data
    elif kind is bytes:
        _write_length(out, len(value))
        out += value
    elif get_origin(kind) is tuple:
        inner = _plain(get_args(kind)[0])
        _write_length(out, len(value))
        if inner in _PRIMITIVES and value:
            _, code, size = _PRIMITIVES[inner]
            _align(out, size)
            out += struct.pack(f"<{len(value)}{code}", *value)
        else:
            for item in value:
                _write(out, item, inner)
    else:
        for name, inner in _fields_of(kind).items():
            _write(out, getattr(value, name), inner)


def _write_length(out: bytearray, length: int) -> None:
    """Append the length of a sequence."""
    _align(out, 4)
    out += struct.pack("<I", length)


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def read(self, kind: Any) -> Any:
        if kind in _PRIMITIVES:
            return self._numbers(1, kind)[0]
        if kind is str:
            return self._bytes(self._length())[:-1].decode()
        if kind is bytes:
            return self._bytes(self._length())
        if get_origin(kind) is tuple:
            inner = _plain(get_args(kind)[0])
            length = self._length()
            if inner in _PRIMITIVES:
                return self._numbers(length, inner) if length else ()
            return tuple(self.read(inner) for _ in range(length))
        return kind(**{name: self.read(inner) for name, inner in _fields_of(kind).items()})

    def _length(self) -> int:
        self._at += -self._at % 4
        (length,) = struct.unpack_from("<I", self._data, self._at)
        self._at += 4
        return int(length)

    def _numbers(self, count: int, kind: Any) -> tuple[Any, ...]:
        _, code, size = _PRIMITIVES[kind]
        self._at += -self._at % size
        values = struct.unpack_from(f"<{count}{code}", self._data, self._at)
        self._at += size * count
        return values

    def _bytes(self, length: int) -> bytes:
        part = self._data[self._at : self._at + length]
        if len(part) != length:
            raise struct.error(f"{length} bytes announced, {len(part)} there")
        self._at += length
        return part
