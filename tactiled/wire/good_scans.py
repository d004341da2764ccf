"""Good scans at the beginning of a buffer of COBS frames, read in one pass.

The file is plain Python, which Cython compiles with the types of `good_scans.pxd`. As plain Python it is
slower than `framing`, which then reads all frames; both find the same frames.
"""

from array import array

import numpy as np

from tactiled.wire.frames import Scan
from tactiled.wire.layout import Layout

MOST_BYTES, _MOST_SCANS = 1 << 16, 1024  # of one call
_CRC16_START = 0xFFFF  # as in `framing.crc16`


class GoodScans:
    """Reader of the scan messages of one layout; every value on the wire is a channel.

    Parameters
    ----------
    limit : int
        Bytes before which the delimiter of a frame must come.
    """

    def __init__(self, layout: Layout, limit: int) -> None:
        scan = layout.messages["scan"]
        # Places and widths are bytes of the body: type and fields.
        fields = {name: field[:2] for name, field in (scan.dtype.fields or {}).items()}
        heads = [fields.get(name) for name in ("sequence", "ticks", "flags")]
        counts, counts_at = fields["counts"]
        self.has_ticks = "ticks" in fields
        self.is_little = layout.file.byte_order == "little"
        self.limit, self.type_number, self.body_bytes = limit, scan.id, 1 + scan.dtype.itemsize
        self.places = array("q", [0 if head is None else head[1] + 1 for head in heads])
        self.widths = array("q", [0 if head is None else head[0].itemsize for head in heads])
        self.counts_at, self.counts_width = counts_at + 1, counts.base.itemsize
        self.sign = 1 << (8 * self.counts_width - 1) if counts.base.kind == "i" else 0
        self.n_most, self.n_channels, self.crc_start = _MOST_SCANS, layout.n_channels, _CRC16_START
        self.rows = np.empty((self.n_most, self.n_channels), dtype=np.int64)
        self.counts = self.rows.reshape(-1)
        # Of each scan: its end in the bytes, sequence, ticks and flags.
        self.heads = array("q", bytes(8 * 4 * self.n_most))
        self.body = array("B", bytes(limit))

    def take(self, data: bytes) -> tuple[list[Scan], int]:
        """Return the good scans at the beginning, and the bytes that they take."""
        n = self._read(data)
        if not n:
            return [], 0
        heads = self.heads
        scans = [
            Scan(heads[k + 1], row, heads[k + 2] if self.has_ticks else None, heads[k + 3])
            for k, row in zip(range(0, 4 * n, 4), self.rows[:n].copy(), strict=True)
        ]
        return scans, heads[4 * n - 4]

    def _read(self, data: bytes) -> int:
        """Read until the first frame that is no good scan, or not complete; return the number of scans."""
        n_scans, at = 0, 0
        while n_scans < self.n_most:
            end = self._unstuff(data, at)
            if end < 0 or self.body[0] != self.type_number or not self._is_whole():
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
