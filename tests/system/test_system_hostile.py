"""Real processes: a daemon with an emulated board, whose clients send what no client should."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import msgpack
import pytest
import zmq
from patience import PATIENCE_S
from ports import free_pair

from tactiled.daemon.zmq import zmtp

pytestmark = pytest.mark.system
ATTACK_S = 2.0
MOST_MB = 150.0  # resident memory of the daemon, whatever a client does
SUBSCRIBER = zmtp.GREETING + zmtp.ready("SUB")
REQUESTER = zmtp.GREETING + zmtp.ready("DEALER")


@dataclass
class Sensing:
    """Port of the events of a daemon (of its requests: the next one), its process, and a good subscriber.

    Attributes
    ----------
    overrun : int
        Scans that the board has missed itself, by the newest status, or -1: this host gave it no time.
    """

    port: int
    pid: int
    events: "zmq.Socket[bytes]"
    overrun: int = -1

    def next_seq(self) -> int:
        """Return the number of the next scan."""
        while True:
            assert self.events.poll(round(1000 * PATIENCE_S)), "the daemon publishes nothing"
            topic, payload = self.events.recv_multipart()
            data = msgpack.unpackb(payload)
            if topic.endswith(b"/scan"):
                return int(data["seq"])
            self.overrun = int(data["scans_overrun"])

    def peak_mb(self) -> float:
        """Largest resident memory of the daemon so far, 10^6 bytes."""
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return sum(int(line.split()[1]) * 1024 / 1e6 for line in lines if line.startswith("VmHWM"))


@pytest.fixture(scope="module")
def sensing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sensing]:
    """One daemon for all attacks, so that its memory is bounded over them together, too."""
    folder = tmp_path_factory.mktemp("hostile")
    port, board, config = free_pair(), folder / "board", folder / "tactiled.toml"
    events = f"ipc://{folder}/events.ipc"
    config.write_text(
        f'[port]\nurl = "{board}"\n[publish]\nendpoints = ["tcp://127.0.0.1:{port}", "{events}"]\n'
    )
    with ExitStack() as stack:

        def start(*arguments: str) -> "subprocess.Popen[bytes]":
            command = [sys.executable, "-m", "tactiled", *arguments]
            null = subprocess.DEVNULL
            child = stack.enter_context(subprocess.Popen(command, stdout=null, stderr=null))
            stack.callback(child.terminate)
            return child

        start("emulate", "--scene", "rest", "--link", str(board))
        daemon = start("run", "--config", str(config))
        sub = stack.enter_context(zmq.Context()).socket(zmq.SUB)
        stack.enter_context(sub)
        sub.rcvhwm = 0
        for topic in ("scan", "status"):
            sub.subscribe(f"tactile/TS0001/{topic}")
        sub.connect(events)
        made = Sensing(port, daemon.pid, sub)
        while made.overrun < 0:  # connected: no test opens a descriptor that stays
            made.next_seq()
        yield made


def flood(port: int, greeting: bytes, piece: bytes) -> None:
    """Send a piece again and again, as fast as it is taken; where the daemon closes, connect again."""
    end_s = time.monotonic() + ATTACK_S
    while time.monotonic() < end_s:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)) as sock:
            sock.settimeout(0.1)
            rest = greeting + piece
            while time.monotonic() < end_s:
                with suppress(TimeoutError):
                    rest = rest[sock.send(rest) :] or piece


@pytest.mark.parametrize(
    ("port_offset", "greeting", "piece"),
    [
        (0, b"", os.urandom(4096)),
        (0, SUBSCRIBER, b"".join(zmtp.message(b"\1%08d" % k + bytes(242)) for k in range(4000))),
        (0, SUBSCRIBER, b"\3" + b"\x7f" * 8 + bytes(2**20)),
        (0, SUBSCRIBER, 256 * (b"\1\xff" + bytes(255))),
        (1, REQUESTER, b"\3" + (16384).to_bytes(8) + bytes(16384)),
    ],
    ids=[
        "random bytes",
        "subscriptions",
        "a huge frame",
        "an endless message",
        "an endless request",
    ],
)
def test_a_hostile_client_costs_bounded_memory_and_no_scan(
    sensing: Sensing, port_offset: int, greeting: bytes, piece: bytes
) -> None:
    first, overrun = sensing.next_seq(), sensing.overrun
    flood(sensing.port + port_offset, greeting, piece)
    last, after_s = first, time.monotonic()
    while time.monotonic() - after_s < ATTACK_S:  # what was published during the attack, and after it
        assert sensing.next_seq() == (last := last + 1)
    # At 100 scans a second, over twice the time; the flood may leave the board none of a small host.
    assert last - first + sensing.overrun - overrun > 100 * ATTACK_S
    assert sensing.peak_mb() <= MOST_MB
