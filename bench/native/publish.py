"""Messages for several programs in turn, so that the programs do not compete for the processors."""

import subprocess
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import msgpack
import numpy as np
import zmq

from tactiled.array import FloatArray
from tactiled.events.codec import encode
from tactiled.events.endpoints import control_endpoint
from tactiled.events.types import Event, Sent, StatusEvent

BOARD, RUN = "TS0001", 7
_PERIOD_S = 0.01  # messages at 100 Hz
_STATUS_EVERY = 10  # messages
_SETTLE = 100  # messages that are left out at the beginning: caches, the first answer to the client
STATUS = StatusEvent(
    time_s=0.0, state="running", valid=True, reason="", warning="", age_s=0.004, clock_sd_s=2e-5,
    clock_rate_ppm=21.4, rate_hz=100.0, scans=123456, frames_corrupt=3, scans_missing=2, scans_duplicate=0,
    restarts=1, bytes_in=9876543, bytes_framed=9876000, bytes_discarded=500, bytes_pending=43, connects=1,
    contact="holding", slipping=False, uptime_s=1234.5,
)  # fmt: skip


class Sender(Protocol):
    """Something that sends the messages of one program."""

    def send(self) -> None:
        """Send the next message."""

    def send_status(self) -> None:
        """Send what comes once in `_STATUS_EVERY` messages."""


class Publisher:
    """Publisher of one program, which answers its questions about what it missed: nothing.

    `make_event` returns the event of a sequence number.
    """

    def __init__(
        self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str, make_event: Callable[[int], Event]
    ) -> None:
        self._make_event, self._topic = make_event, make_event(0).topic
        self._events, self._control = context.socket(zmq.PUB), context.socket(zmq.ROUTER)
        self._events.bind(endpoint)
        self._control.bind(control_endpoint(endpoint))
        self.sent_ns: list[int] = []
        """Time before the send of each event, by sequence number."""
        self._statuses = 0

    def send(self) -> None:
        """Send an event."""
        number = len(self.sent_ns)
        frames = self._frames(self._make_event(number), number)
        self.sent_ns.append(time.monotonic_ns())
        self._events.send_multipart(frames)

    def send_status(self) -> None:
        """Send a status, and answer what was asked."""
        sent = Sent(**{self._topic: len(self.sent_ns)})
        status = replace(STATUS, uptime_s=time.monotonic(), sent=sent)
        self._events.send_multipart(self._frames(status, self._statuses))
        self._statuses += 1
        while self._control.poll(0):
            who, payload = self._control.recv_multipart()
            asked = msgpack.unpackb(payload)
            reply = {"v": 1, "id": asked["id"], "do": asked["do"], "ok": True, "run": RUN, "messages": {}}
            self._control.send_multipart([who, msgpack.packb(reply)])

    @staticmethod
    def _frames(event: Event, seq: int) -> tuple[bytes, bytes]:
        event = replace(event, time_s=time.monotonic())
        return encode(event, seq=seq, board=BOARD, unix_offset_s=time.time() - time.monotonic(), run=RUN)

    def close(self) -> None:
        """Close the sockets."""
        self._events.close(0)
        self._control.close(0)


def publish_in_turn(senders: Sequence[Sender], programs: Sequence["subprocess.Popen[str]"]) -> None:
    """Send to one program after the other until all have printed what they received."""
    next_s, turn = time.monotonic(), 0
    while any(program.poll() is None for program in programs):
        next_s += _PERIOD_S / len(senders)
        time.sleep(max(0.0, next_s - time.monotonic()))
        sender = senders[turn % len(senders)]
        sender.send()
        turn += 1
        if turn // len(senders) % _STATUS_EVERY == 0:
            sender.send_status()


def latencies_us(rows: Iterable[str], sent_ns: Sequence[int]) -> FloatArray:
    """Latencies of rows with a sequence number and a time of receipt, without the first ones."""
    received = [line.split() for line in rows]
    return np.array([int(at_ns) - sent_ns[int(seq)] for seq, at_ns in received][_SETTLE:]) / 1e3
