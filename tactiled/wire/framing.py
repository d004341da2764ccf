"""Finding frames in a stream of bytes.

The rules, before the code:

1. What is decided depends on the bytes alone, never on how they were cut into calls of ``feed``.
2. Every byte ends in exactly one place: ``bytes_in == framed + discarded + pending``.
3. A corrupt frame costs itself only. Rejected bytes are searched again: a good frame before a broken
   delimiter, behind a cut frame or inside noise is found.
4. Any bytes at all are taken; nothing raises; pending bytes are bounded.

A body is message type and fields, its checksum already verified and taken off.

Can the search find a frame that was never sent? A window of rejected bytes must be a COBS string, carry
a known type, have the one length of that type and then the right checksum, of which chance passes 2^-16.
Counted with board-v1: 7e-5 windows for each byte of noise come as far as the checksum, so 1e-9 false frames
a byte (a line of nothing but noise at 115200 baud: one a day); in damaged scans 5e-4 a byte, all of
them the shape of an acknowledge, so 7e-7 a damaged frame. That is a twentieth of what any CRC-16 lets
through at the frame's own place (2^-16 = 1.5e-5 of the frames damaged beyond what it surely detects).
"""

from collections import defaultdict
from collections.abc import Iterator
from typing import Protocol

from tactiled.wire import cobs
from tactiled.wire.frames import Corrupt
from tactiled.wire.layout import Layout
from tactiled.wire.schema import Direction


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
        body, tail = guarded[: -self._checksum.n_bytes], guarded[-self._checksum.n_bytes :]
        if len(body) < max(self._type_bytes, 1):
            return "length"
        covered = body
        if self._with_length:
            covered = len(body).to_bytes(self._length_bytes, self._order) + body
        if self._checksum.compute(covered) != int.from_bytes(tail, self._order):
            return "checksum"
        if self.body_bytes.get(int.from_bytes(body[: self._type_bytes], self._order)) != len(body):
            return "type"
        return None


# Both ends take frames of a later version up to this many stuffed bytes, to name them (board.md).
_LEAST_TAKEN = 32


class CobsFramer:
    """COBS frames, each closed by 0x00."""

    def __init__(self, layout: Layout, direction: Direction) -> None:
        self._checker = _Checker(layout, direction)
        self._tail = layout.checksum.n_bytes
        # What may follow a first byte (None: any). A search that asks this first is a hundred times cheaper
        # in the worst noise, a line stuck at 0x01.
        self._sizes: defaultdict[int | None, set[int]] = defaultdict(set)
        for type_, n in self._checker.body_bytes.items():
            start = type_.to_bytes(layout.type_bytes, layout.byte_order)
            self._sizes[start[0] if start else None].add(n + self._tail)
        # Stuffing adds one byte, and at most one more for each full run of 254. 1 where nothing can come.
        self._longest = max((n + 1 + (n - 1) // 254 for s in self._sizes.values() for n in s), default=1)
        # Two frames with a broken delimiter between them still fit; what is longer is cut.
        self._limit = max(2 * self._longest + 1, _LEAST_TAKEN + 1)
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
        limit = self._limit
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
        if guarded is not None and fault == "type":
            self.bytes_discarded += len(chunk) + 1
            yield Corrupt(fault, len(chunk) + 1, guarded[: -self._tail])
            return
        # First the frame that the delimiter closed: one before it that lost its last byte could pass for
        # whole with this one's first.
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
            body, end = self._frame_at(chunk, start)
            if body is not None:
                bodies.append(body)
                framed += end - start
                last = end
            start = end
        return bodies, framed, last

    def _frame_before_end(self, chunk: bytes) -> tuple[int, bytes | None]:
        """Where the good frame begins that ends with the chunk, and its body; None where none does."""
        for start in range(max(len(chunk) - self._longest, 0), len(chunk)):
            body, end = self._frame_at(chunk, start)
            if body is not None and end == len(chunk):
                return start, body
        return len(chunk), None

    def _frame_at(self, chunk: bytes, start: int) -> tuple[bytes | None, int]:
        """Body of the good frame that begins at `start`, or None, and where to search on."""
        first = 0 if chunk[start] == 1 else chunk[min(start + 1, len(chunk) - 1)]
        sizes = self._sizes.get(None) or self._sizes.get(first)
        if sizes is None:
            return None, start + 1
        for end, n_bytes in cobs.prefixes(chunk, start):
            if n_bytes in sizes:
                guarded = cobs.decode(chunk[start:end])
                if guarded is not None and self._checker.fault(guarded) is None:
                    return guarded[: -self._tail], end
            if n_bytes >= max(sizes):
                break
        return None, start + 1


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
        # A frame that lost its last byte passes for whole with the first byte of the next one's sync word,
        # one time in 256. So an end that could begin a sync word is looked at again: these bytes, counted
        # as framed, still stand at the front of the buffer.
        self._lent = 0
        self.bytes_in = self.bytes_framed = self.bytes_discarded = 0

    @property
    def bytes_pending(self) -> int:
        return len(self._buffer) - self._lent

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
                yield from self._reject("length")
                continue
            size = self._header + length + self._tail
            if len(buffer) < size:
                return
            guarded = bytes(buffer[self._header : size])
            fault = self._checker.fault(guarded)
            if fault is None:
                self.bytes_framed += self._drop(size)
                self._lend(guarded)
                yield guarded[: -self._tail]
            else:
                yield from self._reject(fault)

    def _seek_sync(self) -> bool:
        """Drop what cannot begin a frame; True when the buffer begins with the sync word."""
        at = self._buffer.find(self._sync)
        if at < 0:
            at = len(self._buffer) - self._sync_begun(self._buffer)
        self.bytes_discarded += self._drop(at)
        return self._buffer.startswith(self._sync)

    def _sync_begun(self, data: bytes | bytearray) -> int:
        """Length of the longest end of `data` that may grow into the sync word."""
        return max(k for k in range(len(self._sync)) if data.endswith(self._sync[:k]))

    def _lend(self, guarded: bytes) -> None:
        """Put back the end of a good frame if it may begin the next."""
        self._lent = 1 if guarded[-1:] == self._sync else self._sync_begun(guarded)
        self._buffer[:0] = guarded[len(guarded) - self._lent :]

    def _drop(self, n: int) -> int:
        """Take `n` bytes off the front; how many of them were not counted before."""
        del self._buffer[:n]
        lent = min(n, self._lent)
        self._lent -= lent
        return n - lent

    def _reject(self, fault: str) -> Iterator[Corrupt]:
        """Give up one byte only: the frame that was damaged may hide a good one."""
        given_up = self._drop(1)
        self.bytes_discarded += given_up
        if given_up:
            yield Corrupt(fault, given_up)


def make_framer(layout: Layout, direction: Direction) -> Framer:
    """Framer of the layout's kind, for one direction."""
    return (
        CobsFramer(layout, direction) if layout.file.framing.kind == "cobs" else SyncFramer(layout, direction)
    )
