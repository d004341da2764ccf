"""Framing of packets of tagged records: sync word, header, length, then records of several kinds.

Each record begins with a tag that says its kind and thereby its length. A packet is well formed when its
records are known and fill its length exactly. The header has no checksum that is known, so this form, and the
next packet directly behind it, are all the evidence that there is.

Rules:

1. In lock, each well-formed packet is accepted. At any other bytes the lock is lost: they are given up one by
   one until a well-formed packet is followed by another one, which locks again. So a damaged packet costs
   itself only.
2. A scan begins with the first record of channels that the layout lists, and is complete when every other one
   has come, in this packet or in later ones. An incomplete scan is dropped when the next one begins, and when
   the lock is lost: readings of two instants are never mixed behind a loss that is seen.
3. Records that are no channels are skipped.

Damage that leaves the form of a packet intact cannot be detected, and neither can a whole packet that is
lost.
"""

from collections.abc import Iterator

from tactiled.wire.framer import LockingFramer
from tactiled.wire.frames import Corrupt
from tactiled.wire.layout import Layout
from tactiled.wire.schema import Direction


class TaggedFramer(LockingFramer):
    """Find packets behind each other, and collect the scans in their records."""

    def __init__(self, layout: Layout, direction: Direction) -> None:
        framing = layout.file.framing
        self._has_scans = direction == "board-to-host"
        self._sync, self._order = layout.sync, layout.byte_order
        self._length_at = len(layout.sync) + framing.skipped
        self._header = self._length_at + layout.length_bytes
        self._mask = framing.tag_mask
        self._longest_body = layout.longest_body
        super().__init__("records", self._header + self._longest_body)
        self._sizes = {record.tag: record.bytes for record in layout.file.records}
        channels = [record.tag for record in layout.file.records if record.channels]
        self._place = {tag: place for place, tag in enumerate(channels)}
        self._parts: dict[int, bytes] = {}  # records of the scan that is being collected, by their place

    def _search(self) -> Iterator[bytes | Corrupt]:
        """Yield the channels of scans, in the order of the layout, and corruptions."""
        if not self._has_scans:
            yield from self._give_up(len(self._buffer))
            return
        while True:
            size = self._size_at(0)
            if size and not self._is_locked:
                next_size = self._size_at(size)
                size = next_size and size
            if size is None:
                return
            if size:
                yield from self._lock()
                yield from self._collect(self._take(size))
            else:
                self._is_locked = False
                self._parts.clear()
                yield from self._give_up(self._to_next_sync())

    def _size_at(self, start: int) -> int | None:
        """Return the bytes of the well-formed packet at `start`; 0: there is none; None: not known yet."""
        buffer = self._buffer
        sync = bytes(buffer[start : start + len(self._sync)])
        if sync != self._sync:
            return None if self._sync.startswith(sync) else 0
        at = start + self._header
        if len(buffer) < at:
            return None
        length = int.from_bytes(buffer[start + self._length_at : at], self._order)
        if not 0 < length <= self._longest_body:
            return 0
        end = at + length
        while at < end:
            if at >= len(buffer):
                return None
            n_bytes = self._sizes.get(buffer[at] & self._mask)
            if n_bytes is None or at + 1 + n_bytes > end:
                return 0
            at += 1 + n_bytes
        return end - start if len(buffer) >= end else None

    def _to_next_sync(self) -> int:
        """Return the number of bytes at the front that cannot begin a packet; the first one does not."""
        at = self._buffer.find(self._sync, 1)
        if at >= 0:
            return at
        tails = range(min(len(self._sync), len(self._buffer)) - 1, 0, -1)
        begun = next((k for k in tails if self._buffer.endswith(self._sync[:k])), 0)
        return len(self._buffer) - begun

    def _collect(self, packet: bytes) -> Iterator[bytes]:
        """Yield the scans that the records of a packet complete."""
        at = self._header
        while at < len(packet):
            tag = packet[at] & self._mask
            end = at + 1 + self._sizes[tag]
            place = self._place.get(tag)
            if place == 0:
                self._parts = {}
            if place is not None:
                self._parts[place] = packet[at + 1 : end]
                if len(self._parts) == len(self._place):
                    yield b"".join(self._parts[k] for k in range(len(self._place)))
                    self._parts = {}
            at = end
