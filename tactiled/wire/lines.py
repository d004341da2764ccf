"""Framing of scans that are lines of text: numbers with a separator between them.

The framer hands on a line as the record that the layout describes, float64 in the byte order of the layout,
so that readers and writers of frames need not know of text.
"""

import math
from collections.abc import Iterator

import numpy as np

from tactiled.wire.framer import Framer
from tactiled.wire.frames import Corrupt
from tactiled.wire.layout import Layout
from tactiled.wire.schema import Direction

# Longest number with its separator: 17 digits, sign, point, exponent, and blanks that align columns.
_LONGEST_NUMBER = 32


class LineFramer(Framer):
    """Find lines of as many numbers as a scan has values.

    A line that the stream begins with may lack its beginning, and `12.5` would read `2.5`: it is given up. A
    changed digit cannot be detected, and neither can a whole line that is lost.
    """

    def __init__(self, layout: Layout, direction: Direction) -> None:
        super().__init__()
        self._terminator = layout.terminator
        self._separator = layout.file.framing.separator or ","
        self._dtype = layout.messages["scan"].dtype["counts"].base
        self._n_values = math.prod(layout.messages["scan"].dtype["counts"].shape)
        self._longest = _LONGEST_NUMBER * self._n_values + len(self._terminator)
        self._has_scans = direction == "board-to-host"
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
                line = self._parse(bytes(buffer[:end])) if self._is_begun and self._has_scans else None
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
            values = [float(part) for part in parts]
        except ValueError:
            return None
        if len(values) != self._n_values:
            return None
        return np.array(values, dtype=self._dtype).tobytes()


def encode(layout: Layout, record: bytes) -> bytes:
    """Return the line of a record, without its terminator."""
    values = np.frombuffer(record, layout.messages["scan"].dtype["counts"].base)
    return (
        (layout.file.framing.separator or ",")
        .join(f"{value:.9g}" for value in values.tolist())
        .encode("ascii")
    )
