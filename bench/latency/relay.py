"""Process between an emulated board and two readers: passes frames on, and notes when it wrote each.

Usage: ``python -m bench.latency.relay BOARD DAEMON_LINK REFERENCE_LINK LOG``. The reference gets each frame
5 ms after the daemon, so that the two do not compete for the processor. Commands of the daemon go to the
board. Ends when the board is gone; the log then has a line for each frame: both times and the octets.
"""

import contextlib
import json
import os
import selectors
import sys
import time
import tty
from collections import deque
from pathlib import Path

STAGGER_S = 0.005  # half of the time between scans at 100 Hz


def _pty(link: Path) -> tuple[int, int]:
    """Make a raw pty under a name; returns master and slave (kept open, so that readers may come and go)."""
    master, slave = os.openpty()
    tty.setraw(slave)
    link.symlink_to(os.ttyname(slave))
    return master, slave


def relay(board: Path, daemon_link: Path, reference_link: Path, log: Path) -> None:
    """Pass frames on until the board is gone."""
    source = os.open(board, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(source)
    (daemon, daemon_slave), (reference, reference_slave) = _pty(daemon_link), _pty(reference_link)
    print("ready", flush=True)
    rows: list[list[object]] = []
    waiting: deque[tuple[float, int]] = deque()
    held = b""
    with selectors.DefaultSelector() as selector:
        selector.register(source, selectors.EVENT_READ)
        selector.register(daemon, selectors.EVENT_READ)
        while True:
            left_s = waiting[0][0] - time.monotonic() if waiting else None
            ready = selector.select(None if left_s is None else max(left_s, 0))
            while waiting and waiting[0][0] <= time.monotonic():
                _, number = waiting.popleft()
                rows[number][1] = time.monotonic()
                os.write(reference, bytes.fromhex(str(rows[number][2])))
            try:
                for key, _ in ready:
                    data = os.read(key.fd, 4096)
                    if key.fd == daemon:
                        os.write(source, data)
                        continue
                    *frames, held = (held + data).split(b"\0")
                    for frame in frames:
                        now_s = time.monotonic()
                        os.write(daemon, frame + b"\0")
                        waiting.append((now_s + STAGGER_S, len(rows)))
                        rows.append([now_s, 0.0, (frame + b"\0").hex()])
            except OSError:  # the board has closed its end
                break
    with log.open("w") as out:
        out.writelines(json.dumps(row) + "\n" for row in rows)
    for descriptor in (source, daemon, daemon_slave, reference, reference_slave):
        with contextlib.suppress(OSError):
            os.close(descriptor)


if __name__ == "__main__":
    relay(*map(Path, sys.argv[1:]))
