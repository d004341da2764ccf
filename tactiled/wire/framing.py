"""Finding frames in a stream of bytes.

The rules, before the code:

1. What is decided depends on the bytes alone, never on how they were cut into calls of ``feed``.
2. Every byte ends in exactly one place: ``bytes_in == framed + discarded + pending``.
3. A corrupt frame costs itself only. Rejected bytes are searched again: a good frame before a broken
   delimiter, behind a cut frame or inside noise is found.
4. Any bytes at all are taken; nothing raises; pending bytes are bounded.

A body is message type and fields, its checksum already verified and taken off.
"""

from collections.abc import Iterator
from typing import Protocol

from tactiled.wire import cobs
from tactiled.wire.frames import Corrupt
from tactiled.wire.layout import Direction, Layout


class Framer(Protocol):
    """Either framing, seen from the codec."""

    bytes_in: int
    bytes_framed: int
    bytes_discarded: int

    @property
    def bytes_pending(self) -> int: ...

    def feed(self, data: bytes) -> Iterator[bytes | Corrupt]: ...


class _Checker:
    """Decides whether a body with its checksum is one of ours."""

    def __init__(self, layout: Layout, direction: Direction) -> None:
        self._order = layout.byte_order
        self._type_bytes = layout.type_bytes
        self._checksum = layout.checksum
        self._with_length = layout.file.checksum.covers == "length-and-body"
        self._length_bytes = layout.length_bytes
        self.body_bytes = {
            type_: layout.body_bytes(message) for type_, message in layout.incoming(direction).items()
        }

    def fault(self, guarded: bytes) -> str | None:
        """Reason to refuse ``body + checksum``, or None when it is good."""
        tail = self._checksum.n_bytes
        body = guarded[:-tail]
        wanted = self.body_bytes.get(int.from_bytes(body[: self._type_bytes], self._order))
        if len(body) < self._type_bytes or wanted is None:
            return "type"
        if len(body) != wanted:
            return "length"
        covered = body
        if self._with_length:
            covered = len(body).to_bytes(self._length_bytes, self._order) + body
        if self._checksum.compute(covered) != int.from_bytes(guarded[-tail:], self._order):
            return "checksum"
        return None


class CobsFramer:
    """COBS frames, each closed by 0x00."""

    def __init__(self, layout: Layout, direction: Direction) -> None:
        self._checker = _Checker(layout, direction)
        self._tail = layout.checksum.n_bytes
        # A stuffed frame is longer than what it holds by one byte for each started run of 254.
        self._stuffed_bytes = sorted(
            {n + self._tail + 1 + (n + self._tail - 1) // 254 for n in self._checker.body_bytes.values()}
        )
        self._longest = self._stuffed_bytes[-1]
        self._buffer = bytearray()
        self.bytes_in = self.bytes_framed = self.bytes_discarded = 0

    @property
    def bytes_pending(self) -> int:
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterator[bytes | Corrupt]:
        """Bodies and corruptions that `data` completes, in order."""
        self.bytes_in += len(data)
        buffer = self._buffer
        buffer += data
        # Two frames with a broken delimiter between them still fit; what is longer is cut here.
        limit = 2 * self._longest + 1
        while buffer:
            end = buffer.find(0, 0, limit)
            if end < 0 and len(buffer) < limit:
                return
            chunk = bytes(buffer[: end if end >= 0 else limit])
            if end >= 0:
                del buffer[: end + 1]
                yield from self._closed(chunk)
            else:
                yield from self._overlong(chunk)

    def _closed(self, chunk: bytes) -> Iterator[bytes | Corrupt]:
        if not chunk:  # an idle line or a flushing delimiter
            self.bytes_discarded += 1
            return
        guarded = cobs.decode(chunk)
        fault = "stuffing" if guarded is None else self._checker.fault(guarded)
        if guarded is not None and fault is None:
            self.bytes_framed += len(chunk) + 1
            yield guarded[: -self._tail]
            return
        bodies, framed, _ = self._salvage(chunk)
        lost = len(chunk) + 1 - framed
        self.bytes_framed += framed
        self.bytes_discarded += lost
        yield Corrupt(fault or "stuffing", lost)
        yield from bodies

    def _overlong(self, chunk: bytes) -> Iterator[bytes | Corrupt]:
        """No delimiter in `limit` bytes: salvage, and keep what may yet become a frame."""
        bodies, framed, last = self._salvage(chunk)
        used = max(last, len(chunk) - (self._longest - 1))
        del self._buffer[:used]
        self.bytes_framed += framed
        self.bytes_discarded += used - framed
        yield Corrupt("overlong", used - framed)
        yield from bodies

    def _salvage(self, chunk: bytes) -> tuple[list[bytes], int, int]:
        """Good frames inside rejected bytes, left to right, not overlapping.

        Returns
        -------
        bodies : list of bytes
        framed : int
            Bytes that the good frames took.
        last : int
            Where the last of them ended; 0 when there is none.
        """
        bodies: list[bytes] = []
        start = framed = last = 0
        while start < len(chunk):
            for size in self._stuffed_bytes:
                if start + size > len(chunk):
                    break
                guarded = cobs.decode(chunk[start : start + size])
                if guarded is not None and self._checker.fault(guarded) is None:
                    bodies.append(guarded[: -self._tail])
                    framed += size
                    last = start + size
                    start = last - 1
                    break
            start += 1
        return bodies, framed, last


class SyncFramer:
    """Frames of sync word, length, body, checksum."""

    def __init__(self, layout: Layout, direction: Direction) -> None:
        self._checker = _Checker(layout, direction)
        self._sync = layout.sync
        self._order = layout.byte_order
        self._header = len(layout.sync) + layout.length_bytes
        self._tail = layout.checksum.n_bytes
        self._lengths = set(self._checker.body_bytes.values())
        self._buffer = bytearray()
        self.bytes_in = self.bytes_framed = self.bytes_discarded = 0

    @property
    def bytes_pending(self) -> int:
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterator[bytes | Corrupt]:
        """Bodies and corruptions that `data` completes, in order."""
        self.bytes_in += len(data)
        buffer = self._buffer
        buffer += data
        while self._seek_sync():
            if len(buffer) < self._header:
                return
            length = int.from_bytes(buffer[len(self._sync) : self._header], self._order)
            if length not in self._lengths:
                yield self._reject("length")
                continue
            size = self._header + length + self._tail
            if len(buffer) < size:
                return
            guarded = bytes(buffer[self._header : size])
            fault = self._checker.fault(guarded)
            if fault is None:
                del buffer[:size]
                self.bytes_framed += size
                yield guarded[: -self._tail]
            else:
                yield self._reject(fault)

    def _seek_sync(self) -> bool:
        """Drop what cannot begin a frame; True when the buffer begins with the sync word."""
        at = self._buffer.find(self._sync)
        if at < 0:  # keep the longest end that may grow into the sync word
            keep = max(k for k in range(len(self._sync)) if self._buffer.endswith(self._sync[:k]))
            at = len(self._buffer) - keep
        del self._buffer[:at]
        self.bytes_discarded += at
        return self._buffer.startswith(self._sync)

    def _reject(self, fault: str) -> Corrupt:
        """Give up one byte only: the frame that was damaged may hide a good one."""
        del self._buffer[:1]
        self.bytes_discarded += 1
        return Corrupt(fault, 1)


def make_framer(layout: Layout, direction: Direction) -> Framer:
    """Framer of the layout's kind, for one direction."""
    return (
        CobsFramer(layout, direction) if layout.file.framing.kind == "cobs" else SyncFramer(layout, direction)
    )
