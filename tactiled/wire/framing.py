"""Framing: search for frames in a stream of bytes.

Rules:

1. The result depends on the bytes alone, not on how they were divided into calls of ``feed``.
2. Every byte is counted exactly once: ``bytes_in == framed + discarded + pending``.
3. A corrupt frame costs no other frame. Rejected bytes are searched again, so that a good frame before a
   damaged delimiter, behind a truncated frame or inside noise is found.
4. Any bytes are accepted, nothing raises, and the number of pending bytes is bounded.

A body is message type and fields, without the checksum, which was verified.

Probability that the search finds a frame that was never sent: a window of rejected bytes must be a COBS
string, have a known type and the one length of that type, and then the right checksum, which random bytes
have with probability 2^-16. Counted with board-v1: 7e-5 windows for each byte of noise reach the checksum, so
1e-9 false frames for each byte (one a day on a line of noise alone at 115200 baud). In damaged scans 5e-4 for
each byte, all with the form of an acknowledge, so 7e-7 for each damaged frame. That is a twentieth of what
any CRC-16 accepts at the place of the frame itself (2^-16 = 1.5e-5 of the frames with more damage than it
surely detects).
"""

import binascii
from collections.abc import Iterator
from typing import Any

from tactiled.compiled import compiled_module
from tactiled.wire import cobs
from tactiled.wire.framer import FixedCommandFramer, Framer, LineFramer, TaggedFramer, TerminatorFramer
from tactiled.wire.frames import Corrupt, Scan
from tactiled.wire.good_scans import MOST_BYTES
from tactiled.wire.layout import Layout
from tactiled.wire.schema import Direction, LinesFraming, TaggedFraming

_CRC16_START = 0xFFFF


def crc16(data: bytes) -> int:
    """Return the CRC-16/IBM-3740 (Rocksoft catalogue); 0x29B1 over ``123456789``."""
    return binascii.crc_hqx(data, _CRC16_START)


# Both ends accept frames of later protocol versions up to this number of stuffed bytes, to report them
# (board.md).
_LEAST_TAKEN = 32
_TAIL = 2  # bytes of the checksum


_READER: Any = getattr(compiled_module("tactiled.wire.good_scans"), "GoodScans", None)
"""Reader of the good scans at the beginning of a buffer, where it is compiled."""


class CobsFramer(Framer):
    """Find COBS frames, each closed by 0x00."""

    def __init__(self, layout: Layout, direction: Direction) -> None:
        super().__init__()
        self._order = layout.file.byte_order
        # Size of the frames of each type, with checksum. Checking the type before the rest makes the search a
        # hundred times cheaper on a line that is stuck at 0x01. Bytes that are the type of a message, without
        # an end, cost most: 70 us each with 36 channels, and 0.9 ms each with 2048, which is more than the
        # 87 us that a byte takes at 115,200 baud.
        self._sizes = {
            type_: 1 + message.dtype.itemsize + _TAIL for type_, message in layout.incoming(direction).items()
        }
        # Stuffing adds one byte, and at most one more for each full run of 254. 1 without any message.
        self._longest = max((n + 1 + (n - 1) // 254 for n in self._sizes.values()), default=1)
        # Two frames with a damaged delimiter between them fit; longer chunks are cut.
        self._limit = max(2 * self._longest + 1, _LEAST_TAKEN + 1)
        has_reader = _READER is not None and direction == "board-to-host" and layout.channel_places is None
        self._scans = _READER(layout, self._limit) if has_reader else None

    def _search(self) -> Iterator[bytes | Scan | Corrupt]:
        buffer, limit = self._buffer, self._limit
        while buffer:
            if self._scans is not None:
                scans, used = self._scans.take(bytes(buffer[:MOST_BYTES]))
                if used:
                    self.bytes_framed += used
                    del buffer[:used]
                    yield from scans
                    continue
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
        fault = "stuffing" if guarded is None else self._fault(guarded)
        if guarded is not None and fault is None:
            self.bytes_framed += len(chunk) + 1
            yield guarded[:-_TAIL]
            return
        if guarded is not None and fault == "type":
            self.bytes_discarded += len(chunk) + 1
            yield Corrupt(fault, len(chunk) + 1, guarded[:-_TAIL])
            return
        # First the frame that the delimiter closed, because a frame before it that lost its last byte could
        # pass the check with the first byte of this one.
        start, closed = self._frame_before_end(chunk)
        bodies, framed, _ = self._salvage(chunk[:start])
        if closed is not None:
            bodies.append(closed)
            framed += len(chunk) - start
        lost = len(chunk) + 1 - framed
        self.bytes_framed += framed
        self.bytes_discarded += lost
        yield Corrupt(fault or "stuffing", lost)
        yield from bodies

    def _overlong(self, chunk: bytes) -> Iterator[bytes | Corrupt]:
        """Handle `limit` bytes without delimiter: search them, and keep the end that may become a frame."""
        bodies, framed, last = self._salvage(chunk)
        used = max(last, len(chunk) - (self._longest - 1))
        del self._buffer[:used]
        self.bytes_framed += framed
        self.bytes_discarded += used - framed
        yield Corrupt("overlong", used - framed)
        yield from bodies

    def _salvage(self, chunk: bytes) -> tuple[list[bytes], int, int]:
        """Find good frames inside rejected bytes, from left to right, without overlap.

        Returns
        -------
        last : int
            End of the last of them; 0 for none.
        """
        bodies: list[bytes] = []
        start = framed = last = 0
        while start < len(chunk):
            body, end = self._frame_at(chunk, start)
            if body is not None:
                bodies.append(body)
                framed += end - start
                last = end
            start = end
        return bodies, framed, last

    def _frame_before_end(self, chunk: bytes) -> tuple[int, bytes | None]:
        """Start and body of the good frame that ends with the chunk; None as body for none."""
        for start in range(max(len(chunk) - self._longest, 0), len(chunk)):
            body, end = self._frame_at(chunk, start)
            if body is not None and end == len(chunk):
                return start, body
        return len(chunk), None

    def _frame_at(self, chunk: bytes, start: int) -> tuple[bytes | None, int]:
        """Body of the good frame that begins at `start`, or None, and the position for the next search."""
        first = 0 if chunk[start] == 1 else chunk[min(start + 1, len(chunk) - 1)]
        size = self._sizes.get(first, 0)
        for end, n_bytes in cobs.prefixes(chunk, start) if size else ():
            if n_bytes == size:
                guarded = cobs.decode(chunk[start:end])
                if guarded is not None and self._fault(guarded) is None:
                    return guarded[:-_TAIL], end
            if n_bytes >= size:
                break
        return None, start + 1

    def _fault(self, guarded: bytes) -> str | None:
        """Return the reason to reject ``body + checksum``, or None when it is good."""
        if len(guarded) <= _TAIL:
            return "length"
        if crc16(guarded[:-_TAIL]) != int.from_bytes(guarded[-_TAIL:], self._order):
            return "checksum"
        return None if self._sizes.get(guarded[0]) == len(guarded) else "type"


def make_framer(layout: Layout, direction: Direction) -> Framer:
    """Make the framer of a layout for one direction."""
    framing = layout.file.framing
    if framing.kind == "cobs":
        return CobsFramer(layout, direction)
    if direction == "host-to-board":
        return FixedCommandFramer(layout)
    if isinstance(framing, TaggedFraming):
        return TaggedFramer(framing)
    return LineFramer(layout, framing) if isinstance(framing, LinesFraming) else TerminatorFramer(layout)
