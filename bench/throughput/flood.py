"""Board that sends scans as fast as its reader takes them.

Usage: ``python -m bench.throughput.flood LINK N_SCANS [--ask]``. Makes a pty under LINK; with ``--ask``
answers the commands of a daemon and sends after its start, else as soon as a reader has opened the pty.
Prints ``ready``, then the seconds from the first byte to the last.
"""

import itertools
import os
import select
import sys
import time
import tty
from pathlib import Path

import numpy as np

from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Hello, Scan
from tactiled.wire.layout import load_layout

_LAYOUT = load_layout("board-v1")
_RATE_HZ = 100.0
_DIFFERENT = 65_000  # frames that are made; the C program, which counts nothing, gets them again and again
_SCANS_A_WRITE = 40  # less than the 4096 bytes that a pty takes at once
_SETTLE_S = 0.5  # between the reader's opening of the pty and the first byte, where nobody asks


def _frames(n: int) -> list[bytes]:
    """Return writes of some frames each: an untouched skin with noise of a few counts."""
    encoder, rng = Encoder(_LAYOUT), np.random.default_rng(0)
    ticks_a_scan = round(1 / (_RATE_HZ * (_LAYOUT.tick_s or 1e-6)))
    counts = rng.integers(40, 44, (n, _LAYOUT.n_channels))
    frames = [
        encoder.encode(Scan(number % 65536, row, ticks=number * ticks_a_scan % 2**32))
        for number, row in enumerate(counts)
    ]
    return [b"".join(frames[k : k + _SCANS_A_WRITE]) for k in range(0, n, _SCANS_A_WRITE)]


def _answer(master: int) -> None:
    """Answer the commands of a daemon until it has asked for the start."""
    encoder, decoder = Encoder(_LAYOUT), Decoder(_LAYOUT, "host-to-board")
    hello = Hello(
        board_serial="FLOOD",
        array_id="wang2019-3x3",
        rate_hz=_RATE_HZ,
        adc_bits=12,
        adc_reference_v=3.0,
        channel_offset_s=(0.0,) * _LAYOUT.n_channels,
        ticks=0,
    )
    while True:
        for command in decoder.feed(os.read(master, 4096)):
            if isinstance(command, Command):
                os.write(master, encoder.encode(Acknowledge(command.token, command.name, "ok", ticks=0)))
                if command.name == "identify":
                    os.write(master, encoder.encode(hello))
                if command.name == "start":
                    return


def flood(link: Path, n_scans: int, *, asks: bool) -> None:
    """Send scans, and print the time that the reader took for them."""
    writes = _frames(min(n_scans, _DIFFERENT))
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    link.symlink_to(name)
    print("ready", flush=True)
    poll = select.poll()
    poll.register(master, select.POLLIN)
    while any(happened & select.POLLHUP for _, happened in poll.poll(0)):  # until a reader opens it
        time.sleep(0.01)
    if asks:
        _answer(master)
    else:
        time.sleep(_SETTLE_S)
    began_s = time.monotonic()
    for data in itertools.islice(itertools.cycle(writes), -(-n_scans // _SCANS_A_WRITE)):
        while data:
            data = data[os.write(master, data) :]
    print(time.monotonic() - began_s, flush=True)
    sys.stdin.readline()  # the pty stays until the reader has been measured


if __name__ == "__main__":
    flood(Path(sys.argv[1]), int(sys.argv[2]), asks="--ask" in sys.argv)
