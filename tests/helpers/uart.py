"""A UART set to one baud rate that receives bytes sent at another, bit by bit, as the chips do it."""

import numpy as np


def received_at(data: bytes, sent_baud: float, set_baud: float, idle_bits: int = 40) -> tuple[bytes, int]:
    """Return the bytes that arrive, and how many of them lacked their stop bit.

    The line idles high; each byte is a start bit (low), eight data bits from the lowest, a stop bit. The
    receiver waits for a falling edge and reads the middle of each of its own bits.

    Parameters
    ----------
    data : bytes
        Sent back to back, between `idle_bits` of idle line.
    """
    octets = np.unpackbits(np.frombuffer(data, np.uint8)[:, np.newaxis], axis=1, bitorder="little")
    start, stop = np.zeros((len(data), 1), np.uint8), np.ones((len(data), 1), np.uint8)
    idle = np.ones(idle_bits, np.uint8)
    line = np.concatenate([idle, np.hstack([start, octets, stop]).ravel(), idle])
    step = sent_baud / set_baud  # sent bits in one of the receiver's
    fell = np.flatnonzero((line[:-1] == 1) & (line[1:] == 0)) + 1
    out, bad, now = bytearray(), 0, 0.0
    for edge in fell:
        if edge < now:
            continue  # inside a byte
        middles = edge + step * (np.arange(10) + 0.5)
        if middles[-1] >= len(line):
            break
        bits = line[middles.astype(int)]
        if bits[0]:
            continue  # a glitch shorter than half a bit
        out.append(int(np.packbits(bits[1:9], bitorder="little")[0]))
        bad += not bits[9]
        now = float(middles[9])
    return bytes(out), bad
