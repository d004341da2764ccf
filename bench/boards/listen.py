"""Subscriber of all boards: notes when each message came, and interprets none of them before the end.

Usage: ``python -m bench.boards.listen LOG ENDPOINT...``. Ends on SIGTERM; the log is an npz file.
"""

import signal
import sys
import time
from pathlib import Path

import msgpack
import numpy as np
import zmq


def listen(log: Path, endpoints: list[str]) -> None:
    """Receive until SIGTERM, then write boards, times and what was measured of scans and statuses."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    context = zmq.Context()
    events = context.socket(zmq.SUB)
    events.setsockopt(zmq.RCVHWM, 0)  # what the machine delays here is not lost
    events.subscribe("tactile/")
    for endpoint in endpoints:
        events.connect(endpoint)
    print("ready", flush=True)
    rows: list[tuple[float, bytes, bytes]] = []
    while not ended:
        if events.poll(200):
            topic, payload = events.recv_multipart()
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
    listen(Path(sys.argv[1]), sys.argv[2:])
