"""Frames of the page server, read back."""

import struct
from typing import Any

import msgpack


def unpack(frame: bytes) -> dict[str, Any]:
    """Map of a frame; the readings of scans are lists of numbers."""
    unpacked: dict[str, Any] = msgpack.unpackb(frame, ext_hook=_floats)
    return unpacked


def rows(frame: bytes | None) -> list[list[Any]]:
    """Messages of a frame, each with its source, topic, data and mark of recovery."""
    return [] if frame is None else list(unpack(frame)["m"])


def _floats(code: int, data: bytes) -> list[float]:
    assert code == 1
    return list(struct.unpack(f"<{len(data) // 4}f", data))
