"""Good scans at the beginning of a buffer of COBS frames, read in one pass.

The file is plain Python, which Cython compiles with the types of `good_scans.pxd`. As plain Python it is
slower than `framing`, which then reads all frames; both find the same frames.
"""

from array import array

import numpy as np
from numpy.typing import NDArray


class GoodScans:
    """Reader of scan messages of one layout. Places and widths are bytes of the body: type and fields.

    Parameters
    ----------
    limit : int
        Bytes before which the delimiter of a frame must come.
    crc_start : int
        First remainder of CRC-16 with the polynomial x^16 + x^12 + x^5 + 1, most significant bit first.
    is_little : bool
        Byte order of all numbers.
    places, widths : list of 3 int
        Of sequence, ticks and flags; width 0 where the layout has no such field.
    is_signed : bool
        The counts are.
    n_most : int
        Scans of one call, at most.
    counts : (n_most * channels,) int64
        Gets the counts.

    Attributes
    ----------
    heads : (4 * n_most,) array of int
        Of each scan: its end in the bytes, sequence, ticks and flags.
    """

    def __init__(
        self,
        limit: int,
        crc_start: int,
        is_little: bool,
        type_number: int,
        type_width: int,
        body_bytes: int,
        places: list[int],
        widths: list[int],
        counts_at: int,
        counts_width: int,
        is_signed: bool,
        n_most: int,
        counts: NDArray[np.int64],
    ) -> None:
        self.limit, self.crc_start, self.is_little = limit, crc_start, is_little
        self.type_number, self.type_width, self.body_bytes = type_number, type_width, body_bytes
        self.places, self.widths = array("q", places), array("q", widths)
        self.counts_at, self.counts_width = counts_at, counts_width
        self.sign = 1 << (8 * counts_width - 1) if is_signed else 0
        self.n_most, self.n_channels = n_most, len(counts) // n_most
        self.counts = counts
        self.heads = array("q", bytes(8 * 4 * n_most))
        self.body = array("B", bytes(limit))

    def take(self, data: bytes) -> int:
        """Read until the first frame that is no good scan, or not complete; return the number of scans."""
        n_scans, at = 0, 0
        while n_scans < self.n_most:
            end = self._unstuff(data, at)
            if end < 0 or self._number(0, self.type_width) != self.type_number or not self._is_whole():
                break
            at = end + 1
            self.heads[4 * n_scans] = at
            for field in range(3):
                number = self._number(self.places[field], self.widths[field])
                self.heads[4 * n_scans + 1 + field] = number
            for c in range(self.n_channels):
                count = self._number(self.counts_at + c * self.counts_width, self.counts_width)
                self.counts[n_scans * self.n_channels + c] = (count ^ self.sign) - self.sign
            n_scans += 1
        return n_scans

    def _unstuff(self, data: bytes, at: int) -> int:
        """Undo the byte stuffing of a frame; return where its delimiter is, -1 for no frame of this size."""
        end, size = at, 0
        last = min(len(data), at + self.limit)
        while end < last and data[end] != 0:
            end += 1
        if end >= last:
            return -1
        while at < end:
            code = data[at]
            if at + code > end:
                return -1
            for k in range(at + 1, at + code):
                self.body[size] = data[k]
                size += 1
            at += code
            if code < 255 and at < end:
                self.body[size] = 0
                size += 1
        return end if size - 2 == self.body_bytes else -1

    def _is_whole(self) -> bool:
        """Compare the checksum behind the body with that of the body."""
        crc = self.crc_start
        for k in range(self.body_bytes):
            crc ^= self.body[k] << 8
            x = crc >> 8
            x ^= x >> 4
            crc = ((crc << 8) ^ (x << 12) ^ (x << 5) ^ x) & 0xFFFF
        return self._number(self.body_bytes, 2) == crc

    def _number(self, at: int, width: int) -> int:
        value = 0
        for k in range(width):
            value = (value << 8) | self.body[at + width - 1 - k if self.is_little else at + k]
        return value
