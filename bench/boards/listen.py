"""Subscriber of all boards: notes when each message came, and interprets none of them before the end.

Usage: ``python -m bench.boards.listen LOG N ENDPOINT...`` for N boards. Only scans and statuses are received.
Ends on SIGTERM; the log is an npz file.
"""

import signal
import sys
import time
from pathlib import Path

import msgpack
import numpy as np
import zmq

from bench.boards.writer import serial_of


def listen(log: Path, n_boards: int, endpoints: list[str]) -> None:
    """Receive until SIGTERM, then write boards, times and what was measured of scans and statuses."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    context = zmq.Context()
    events = context.socket(zmq.SUB)
    events.setsockopt(zmq.RCVHWM, 0)  # what the machine delays here is not lost
    events.setsockopt(zmq.RCVTIMEO, 200)  # ms; to notice the end
    for number in range(n_boards):
        for kind in ("scan", "status"):
            events.subscribe(f"tactile/{serial_of(number)}/{kind}")
    for endpoint in endpoints:
        events.connect(endpoint)
    print("ready", flush=True)
    rows: list[tuple[float, bytes, bytes]] = []
    while not ended:
        try:
            topic, payload = events.recv_multipart()
        except zmq.Again:
            continue
        rows.append((time.monotonic(), topic, payload))
    scans, statuses = [], []
    for time_s, topic, payload in rows:
        name = topic.rsplit(b"/", 1)[-1]
        if name == b"scan":
            said = msgpack.unpackb(payload)
            scans.append((int(said["board"][1:]), said["index"], time_s))
        elif name == b"status" and (said := msgpack.unpackb(payload))["board"]:
            statuses.append((int(said["board"][1:]), time_s, said["valid"], said["loop_lag_s"]))
    with log.open("wb") as out:
        np.savez(out, scans=np.array(scans).reshape(-1, 3), statuses=np.array(statuses).reshape(-1, 4))
    events.close(0)
    context.term()


if __name__ == "__main__":
    listen(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
