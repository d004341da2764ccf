"""Base of all framers, and the framers of frames without a checksum.

Where frames have no checksum, damage that leaves their form intact cannot be detected, and neither can a
whole frame that is lost.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from tactiled.wire.frames import Corrupt, Scan
from tactiled.wire.layout import Layout
from tactiled.wire.schema import LinesFraming, TaggedFraming


class Framer(ABC):
    """Kind of framing: the bytes that are neither framed nor discarded yet, and counts of the others."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.bytes_in = self.bytes_framed = self.bytes_discarded = 0

    @property
    def bytes_pending(self) -> int:
        """Bytes of a frame that is not complete yet, or that waits for others to be known as one."""
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterator[bytes | Scan | Corrupt]:
        """Yield what `data` completes, in order: bodies, scans that were read already, corruptions."""
        self.bytes_in += len(data)
        self._buffer += data
        return self._search()

    @abstractmethod
    def _search(self) -> Iterator[bytes | Scan | Corrupt]:
        """Yield what the buffer completes, in order."""

    def _take(self, n: int) -> bytes:
        """Remove a frame from the front."""
        frame = bytes(self._buffer[:n])
        del self._buffer[:n]
        self.bytes_framed += n
        return frame


class FixedCommandFramer(Framer):
    """Find fixed commands, without token, among any bytes, which are discarded; their body is their bytes."""

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self._commands = tuple(layout.fixed_commands)

    def _search(self) -> Iterator[bytes]:
        while self._buffer:
            body = next((each for each in self._commands if self._buffer.startswith(each)), None)
            if body is not None:
                yield self._take(len(body))
            elif any(each.startswith(self._buffer) for each in self._commands):
                return
            else:
                del self._buffer[:1]
                self.bytes_discarded += 1


class LineFramer(Framer):
    """Find lines of text with as many numbers as a scan has values, and a separator between them.

    A body is the record that the layout describes, float64 in its byte order, so that readers of frames need
    not know of text. A line that the stream begins with may lack its beginning, and `12.5` would read `2.5`:
    it is given up.
    """

    # Longest number with its separator: 17 digits, sign, point, exponent, and blanks that align columns.
    LONGEST_NUMBER = 32

    def __init__(self, layout: Layout, framing: LinesFraming) -> None:
        super().__init__()
        self._terminator = layout.terminator
        self._separator = framing.separator
        self._dtype = layout.messages["scan"].dtype["counts"].base
        self._n_values = math.prod(layout.messages["scan"].dtype["counts"].shape)
        self._longest = self.LONGEST_NUMBER * self._n_values + len(self._terminator)
        self._is_begun = False  # the buffer begins with the beginning of a line

    def _search(self) -> Iterator[bytes | Corrupt]:
        buffer = self._buffer
        while True:
            end = buffer.find(self._terminator, 0, self._longest)
            if end < 0 and len(buffer) < self._longest:
                return
            if end < 0:  # no line is so long: what is left of it is none either
                n, fault, line = self._longest - len(self._terminator) + 1, "overlong", None
            else:
                n = end + len(self._terminator)
                line = self._parse(bytes(buffer[:end])) if self._is_begun else None
                fault = "value" if self._is_begun else "terminator"
            self._is_begun = end >= 0
            del buffer[:n]
            if line is None:
                self.bytes_discarded += n
                yield Corrupt(fault, n)
            else:
                self.bytes_framed += n
                yield line

    def _parse(self, line: bytes) -> bytes | None:
        """Record of a line, or None where it is not the right number of numbers."""
        try:
            text = line.decode("ascii").strip()
            parts = text.split() if self._separator in " \t" else text.split(self._separator)
            if parts[-1:] == [""]:  # a separator ends the line
                parts.pop()
            values = [float(part.replace("_", "x")) for part in parts]  # Python allows _ between digits
        except ValueError:
            return None
        return np.array(values, dtype=self._dtype).tobytes() if len(values) == self._n_values else None


class LockingFramer(Framer):
    """Framing that is known only from frames in a row; what it gives up is reported by length.

    Parameters
    ----------
    fault : str
        Reason of corruptions.
    longest : int
        Bytes given up in a row that are one corrupt frame.
    """

    def __init__(self, fault: str, longest: int) -> None:
        super().__init__()
        self._fault, self._longest = fault, longest
        self._is_locked = False
        self._lost = 0  # bytes given up that are not reported yet

    def _give_up(self, n: int) -> Iterator[Corrupt]:
        """Discard bytes at the front."""
        del self._buffer[:n]
        self.bytes_discarded += n
        self._lost += n
        while self._lost >= self._longest:
            self._lost -= self._longest
            yield Corrupt(self._fault, self._longest)

    def _lock(self) -> Iterator[Corrupt]:
        self._is_locked = True
        lost, self._lost = self._lost, 0
        if lost:
            yield Corrupt(self._fault, lost)


class TerminatorFramer(LockingFramer):
    """Find scans of fixed length behind each other, each with its terminator, without sync word.

    The bytes of the terminator may occur inside a reading, so one occurrence proves nothing. The framer locks
    to a position at which terminators follow each other at the length of a frame, while no other position
    does so. In lock, a frame is good when its terminator is in its place. When it is not, that frame is
    dropped, and the search begins anew behind its first byte. A frame begins behind a terminator, so the
    first frame of a stream is given up.
    """

    # Terminators in a row that lock. Two bytes agree by chance with probability 2^-16 at each place; in a
    # reading that does not change they agree for ever, and then the true position has a rival (see MOST).
    LEAST = 3
    # Terminators in a row after which a position is given up while another one has as many: a reading that
    # holds the bytes of the terminator has not changed for so long. It bounds the pending bytes.
    MOST = 64

    def __init__(self, layout: Layout) -> None:
        self._terminator = layout.terminator
        self._size = layout.wire_bytes("scan")
        super().__init__("terminator", self._size)

    def _search(self) -> Iterator[bytes | Corrupt]:
        while True:
            if self._is_locked:
                if len(self._buffer) < self._size:
                    return
                body_end = self._size - len(self._terminator)
                if self._is_at(body_end):
                    yield self._take(self._size)[:body_end]
                else:
                    self._is_locked = False
                    yield from self._give_up(1)
                continue
            at = self._buffer.find(self._terminator)
            if at != 0:
                keep = len(self._terminator) - 1
                yield from self._give_up(at if at > 0 else max(len(self._buffer) - keep, 0))
                if at < 0:
                    return
                continue
            is_true = self._judge()
            if is_true is None:
                return
            if is_true:
                yield from self._give_up(len(self._terminator))
                yield from self._lock()
            else:
                yield from self._give_up(1)

    def _judge(self) -> bool | None:
        """Return whether the terminator at the front of the buffer is a true one; None: not known yet."""
        for depth in range(1, self.MOST + 1):
            if depth * self._size + len(self._terminator) > len(self._buffer):
                return None
            if not self._is_at(depth * self._size):
                return False
            if depth + 1 >= self.LEAST and not self._has_rival(depth):
                return True
        return False

    def _has_rival(self, depth: int) -> bool:
        """Return True when another position of the period has had its terminator, too, in `depth` periods."""
        until = self._size + len(self._terminator) - 1
        at = self._buffer.find(self._terminator, 1, until)
        while at >= 0:
            if all(self._is_at(at + k * self._size) for k in range(1, depth)):
                return True
            at = self._buffer.find(self._terminator, at + 1, until)
        return False

    def _is_at(self, place: int) -> bool:
        return self._buffer.startswith(self._terminator, place)


class TaggedFramer(LockingFramer):
    """Find packets of tagged records behind each other, and collect the scans in their records.

    A packet is a sync word, a header, a length, then records of several kinds; the tag that begins a record
    says its kind and thereby its length. A packet is well formed when its records are known and fill its
    length exactly. This form, and the next packet directly behind it, are all the evidence that there is.

    1. In lock, each well-formed packet is accepted. At any other bytes the lock is lost: they are given up
       one by one until a well-formed packet is followed by another one, which locks again. So a damaged
       packet costs itself only.
    2. A scan begins with the first record of channels that the layout lists, and is complete when every other
       one has come, in this packet or in later ones. An incomplete scan is dropped when the next one begins,
       and when the lock is lost: readings of two instants are never mixed behind a loss that is seen.
    3. Records that are no channels are skipped.
    """

    def __init__(self, framing: TaggedFraming) -> None:
        self._sync = bytes.fromhex(framing.sync_hex)
        self._length_at = len(self._sync) + framing.skipped
        self._header = self._length_at + 1
        self._mask = framing.tag_mask
        self._most_bytes = framing.most_bytes
        super().__init__("records", self._header + self._most_bytes)
        self._sizes = {record.tag: record.bytes for record in framing.records}
        channels = [record.tag for record in framing.records if record.channels]
        self._place = {tag: place for place, tag in enumerate(channels)}
        self._parts: dict[int, bytes] = {}  # records of the scan that is being collected, by their place

    def _search(self) -> Iterator[bytes | Corrupt]:
        """Yield the channels of scans, in the order of the layout, and corruptions."""
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
        length = buffer[start + self._length_at]
        if not 0 < length <= self._most_bytes:
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
        rest = self._buffer[1:]
        return len(self._buffer) - max(k for k in range(len(self._sync)) if rest.endswith(self._sync[:k]))

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
