"""Consistent Overhead Byte Stuffing (Cheshire and Baker 1999): encodes any bytes without zero bytes."""

from collections.abc import Iterator

_LONGEST_RUN = 254  # a code of 255 means that 254 bytes follow without a zero after them


def encode(data: bytes) -> bytes:
    """Return the stuffed form of `data`, without the closing delimiter."""
    out = bytearray()
    start, size = 0, len(data)
    while True:
        zero = data.find(0, start, start + _LONGEST_RUN)
        end = zero if zero >= 0 else min(start + _LONGEST_RUN, size)
        out.append(end - start + 1)
        out += data[start:end]
        if zero >= 0:
            start = zero + 1  # the block's code stands for the zero
        elif end == size:
            return bytes(out)
        else:
            start = end


def decode(stuffed: bytes) -> bytes | None:
    """Return the bytes that were stuffed, or None when `stuffed` is not a COBS string; never raises."""
    if b"\0" in stuffed:
        return None
    out = bytearray()
    start, size = 0, len(stuffed)
    while start < size:
        code = stuffed[start]
        end = start + code
        if end > size:
            return None
        out += stuffed[start + 1 : end]
        start = end
        if code <= _LONGEST_RUN and start < size:
            out.append(0)
    return bytes(out)


def prefixes(stuffed: bytes, start: int) -> Iterator[tuple[int, int]]:
    """Find every possible end of a COBS string that begins at `start`.

    Yields
    ------
    end : int
        ``stuffed[start:end]`` is a COBS string, as long as it holds no zero.
    n_bytes : int
        Bytes that it decodes to.
    """
    end, n_bytes = start, 0
    while end < len(stuffed) and stuffed[end]:
        code = stuffed[end]
        end += code
        n_bytes += code - 1
        if end > len(stuffed):
            return
        yield end, n_bytes
        n_bytes += code <= _LONGEST_RUN
