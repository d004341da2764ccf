"""Base of the framers, and the framer of boards whose commands are fixed bytes."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator

from tactiled.wire.frames import Corrupt, Scan
from tactiled.wire.layout import Layout


class Framer(ABC):
    """Kind of framing: the bytes that are neither framed nor discarded yet, and counts of the others."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.bytes_in = self.bytes_framed = self.bytes_discarded = 0

    @property
    def bytes_pending(self) -> int:
        """Bytes of a frame that is not complete yet, or that waits for others to be known as one."""
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterable[bytes | Scan | Corrupt]:
        """Return what `data` completes, in order: bodies, scans that were read already, corruptions."""
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


class FixedCommandFramer(Framer):
    """Find fixed commands, without token, among any bytes; the body of a command is its bytes."""

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self._commands = tuple(layout.fixed_commands)

    def _search(self) -> Iterator[bytes]:
        """Yield the commands in the buffer; other bytes are discarded."""
        while self._buffer:
            body = next((each for each in self._commands if self._buffer.startswith(each)), None)
            if body is not None:
                yield self._take(len(body))
            elif any(each.startswith(self._buffer) for each in self._commands):
                return
            else:
                del self._buffer[:1]
                self.bytes_discarded += 1
