"""Subscriber of both programs: notes when each message came, and interprets none of them before the end.

Usage: ``python -m bench.latency.listen ENDPOINT UDP_PORT LOG``. Ends on SIGTERM.
"""

import json
import signal
import socket
import sys
import time
from pathlib import Path

import msgpack
import zmq


def listen(endpoint: str, port: int, log: Path) -> None:
    """Receive until SIGTERM, then write a line for each message: time, and what it says."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    context = zmq.Context()
    events, datagrams = context.socket(zmq.SUB), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    events.subscribe("")
    events.connect(endpoint)
    datagrams.bind(("127.0.0.1", port))
    poller = zmq.Poller()
    poller.register(events, zmq.POLLIN)
    poller.register(datagrams, zmq.POLLIN)
    print("ready", flush=True)
    rows: list[tuple[float, bytes, bytes]] = []
    while not ended:
        for source, _ in poller.poll(200):
            if source is events:
                topic, payload = events.recv_multipart()
            else:
                topic, payload = b"reference", datagrams.recv(4096)
            rows.append((time.monotonic(), topic, payload))
    with log.open("w") as out:
        for time_s, topic, payload in rows:
            if topic == b"reference":
                said = {"topic": "reference", "sequence": int.from_bytes(payload[:2], "little")}
            else:
                said = {**msgpack.unpackb(payload), "topic": topic.decode().rsplit("/", 1)[-1]}
            out.write(json.dumps([time_s, said]) + "\n")
    events.close(0)
    context.term()
    datagrams.close()


if __name__ == "__main__":
    listen(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
