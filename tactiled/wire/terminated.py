"""Framing of scans of fixed length that end with a terminator, without sync word or checksum.

The bytes of the terminator may occur inside a reading, so one occurrence proves nothing. The framer locks to
a position at which terminators follow each other at the length of a frame, while no other position does so.
In lock, a frame is good when its terminator is in its place. When it is not, that frame is dropped, and the
search begins anew behind its first byte.

Damage that leaves the terminator in its place cannot be detected, and neither can a whole frame that is lost.
"""

from collections.abc import Iterator

from tactiled.wire.framer import LockingFramer
from tactiled.wire.frames import Corrupt
from tactiled.wire.layout import Layout
from tactiled.wire.schema import Direction


class TerminatorFramer(LockingFramer):
    """Find frames of fixed length behind each other, each with its terminator.

    A frame begins behind a terminator, so the first frame of a stream is given up.
    """

    # Terminators in a row that lock. Two bytes agree by chance with probability 2^-16 at each place; in a
    # reading that does not change they agree for ever, and then the true position has a rival (see MOST).
    LEAST = 3
    # Terminators in a row after which a position is given up while another one has as many: a reading that
    # holds the bytes of the terminator has not changed for so long. It bounds the pending bytes.
    MOST = 64

    def __init__(self, layout: Layout, direction: Direction) -> None:
        self._terminator = layout.terminator
        self._has_scans = direction == "board-to-host"
        self._size = layout.wire_bytes("scan")
        super().__init__("terminator", self._size)

    def _search(self) -> Iterator[bytes | Corrupt]:
        if not self._has_scans:
            yield from self._give_up(len(self._buffer))
            return
        while True:
            if self._is_locked:
                if len(self._buffer) < self._size:
                    return
                body_end = self._size - len(self._terminator)
                if self._buffer[body_end : self._size] == self._terminator:
                    yield self._take(self._size)[:body_end]
                else:
                    self._is_locked = False
                    yield from self._give_up(1)
                continue
            at = self._buffer.find(self._terminator)
            if at != 0:
                keep = len(self._terminator) - 1
                n = at if at > 0 else max(len(self._buffer) - keep, 0)
                yield from self._give_up(n)
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
        at = self._buffer.find(self._terminator, 1, self._size + len(self._terminator) - 1)
        while at >= 0:
            if all(self._is_at(at + k * self._size) for k in range(1, depth)):
                return True
            at = self._buffer.find(self._terminator, at + 1, self._size + len(self._terminator) - 1)
        return False

    def _is_at(self, place: int) -> bool:
        return self._buffer.startswith(self._terminator, place)
