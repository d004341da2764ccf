"""Print each message, also those that a PUB socket dropped. Needs zmq and msgpack alone."""

import itertools
from collections.abc import Iterator
from typing import Any

import msgpack
import zmq

context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
events, control = context.socket(zmq.SUB), context.socket(zmq.REQ)
events.connect("tcp://127.0.0.1:9872")
events.subscribe("tactile/")
control.connect("tcp://127.0.0.1:9873")
ids = itertools.count()
heard: dict[tuple[str, str], tuple[int, int]] = {}  # by board and topic: run, and the number that comes next


def missed(board: str, topic: str, first: int, end: int) -> Iterator[dict[str, Any]]:
    """Fetch the messages of a topic from number `first` to before `end`."""
    while first < end:
        ask = {"v": 1, "id": str(next(ids)), "do": "events", "board": board, "topic": topic}
        control.send(msgpack.packb({**ask, "first_seq": first, "end_seq": end}))
        reply = msgpack.unpackb(control.recv())
        yield from reply["messages"]
        first = reply["next_seq"] if reply["more"] else end


while True:
    path, payload = events.recv_multipart()
    message, topic = msgpack.unpackb(payload), path.decode().rsplit("/", 1)[1]
    key = (message["board"], topic)
    run, expected = heard.get(key, (message["run"], message["seq"]))
    expected = expected if run == message["run"] else 0  # started anew: all of the new run
    for old in missed(*key, expected, message["seq"]):
        print("missed", topic, old["seq"], flush=True)
    print("now", topic, message["seq"], flush=True)
    heard[key] = (message["run"], message["seq"] + 1)
