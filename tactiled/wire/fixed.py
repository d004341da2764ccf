"""Commands that are fixed bytes, without token and answer, as the board receives them."""

from collections.abc import Iterator

from tactiled.wire.frames import Corrupt
from tactiled.wire.layout import Layout


class FixedCommandFramer:
    """Find fixed commands among any bytes; the body of a command is its bytes."""

    def __init__(self, layout: Layout) -> None:
        self._commands = tuple(layout.fixed_commands)
        self._buffer = bytearray()
        self.bytes_in = self.bytes_framed = self.bytes_discarded = 0

    @property
    def bytes_pending(self) -> int:
        """Bytes of a command that is not complete yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterator[bytes | Corrupt]:
        """Yield the commands that `data` completes; other bytes are discarded."""
        self.bytes_in += len(data)
        self._buffer += data
        while self._buffer:
            body = next((each for each in self._commands if self._buffer.startswith(each)), None)
            if body is not None:
                del self._buffer[: len(body)]
                self.bytes_framed += len(body)
                yield body
            elif any(each.startswith(self._buffer) for each in self._commands):
                return
            else:
                del self._buffer[:1]
                self.bytes_discarded += 1
