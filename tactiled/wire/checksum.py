"""Checksums by their names in the Rocksoft catalogue, computed by the standard library."""

import binascii
import zlib
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Checksum:
    """Checksum algorithm: width on the wire in bytes, and function."""

    n_bytes: int
    compute: Callable[[bytes], int]
    crc16_start: int | None = None
    """First remainder, where the polynomial is that of `good_scans`."""


NO_CHECKSUM = Checksum(0, lambda _: 0)

# Check values over b"123456789": 0x29B1, 0x31C3, 0xCBF43926.
CHECKSUMS: dict[str, Checksum] = {
    "crc-16/ibm-3740": Checksum(2, lambda data: binascii.crc_hqx(data, 0xFFFF), 0xFFFF),
    "crc-16/xmodem": Checksum(2, lambda data: binascii.crc_hqx(data, 0), 0),
    "crc-32/iso-hdlc": Checksum(4, zlib.crc32),
}
