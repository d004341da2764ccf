"""A daemon with an emulated board, both processes of their own, and a good subscriber that looks on."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgpack
import numpy as np
import zmq

from bench.hostile.attack import Outcome
from tactiled.array import FloatArray
from tactiled.errors import OperatorError

LIMIT_MB = 150.0  # resident memory of the daemon, whatever a client does
LATE_S = 0.1  # as `samples.late_after_s`: no slip is valid on a later scan
BOARD = "TS0001"
_START_S = 60.0
_CALM_S = 1.0  # before an attack, to compare with
_CONFIG = """[port]
url = "{link}"
[session]
board_serial = "TS0001"
[publish]
endpoints = ["{tcp}", "{ipc}"]
{publish}
"""


@dataclass(frozen=True)
class Sensing:
    """Messages that the good subscriber receives.

    Attributes
    ----------
    tcp, ipc : str
        Endpoints of the daemon.
    pid : int
        The daemon.
    heard : Path
        Written by `listen`, which is a process of its own: an attack does not make it late.
    """

    tcp: str
    ipc: str
    pid: int
    heard: Path

    def scans(self) -> list[tuple[int, float, float]]:
        """Return sequence number, time of reception (epoch) and age (seconds) of each scan so far."""
        lines = self.heard.read_text().split("\n")[:-1] if self.heard.exists() else []
        return [(int(seq), float(unix_s), float(age_s)) for seq, unix_s, age_s in map(str.split, lines)]

    def wait_for(self, n: int) -> None:
        """Wait for a number of scans more."""
        goal, end_s = len(self.scans()) + n, time.monotonic() + _START_S
        while len(self.scans()) < goal:
            if time.monotonic() > end_s:
                raise OperatorError(f"the daemon published no {n} scans within {_START_S:g} s")
            time.sleep(0.02)

    @property
    def peak_mb(self) -> float:
        """Largest resident memory of the daemon and of its children so far, 10^6 bytes."""
        children = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
        return sum(_peak_mb(pid) for pid in (str(self.pid), *children))

    def outcome(self, begin_unix_s: float, scale: float, seen: str, *, held: bool = True) -> Outcome:
        """Judge scans and memory since the begin of an attack.

        The short form does not judge times, because tests run on busy machines.
        """
        self.wait_for(1)
        scans = self.scans()
        numbers = [seq for seq, _, _ in scans]
        lost = numbers[-1] - numbers[0] + 1 - len(numbers)
        ages: FloatArray = np.array([age_s for _, received_s, age_s in scans if received_s >= begin_unix_s])
        before: FloatArray = np.array([age_s for _, received_s, age_s in scans if received_s < begin_unix_s])
        peak_mb = self.peak_mb
        is_held = held and not lost and len(ages) > 0 and peak_mb <= LIMIT_MB
        if scale >= 1.0:
            is_held &= float(ages.max()) <= LATE_S
        words = (
            f"{seen}; daemon at most {peak_mb:.0f} MB; {len(ages)} scans, {lost} lost, the latest "
            f"{1e3 * ages.max():.0f} ms old ({1e3 * before.max():.0f} ms before)"
        )
        return Outcome(words, is_held)


@contextmanager
def sensing(folder: Path, publish: str = "") -> Iterator[Sensing]:
    """Run a daemon with an emulated board, and a good subscriber.

    Parameters
    ----------
    publish : str
        Lines for the table ``[publish]`` of the configuration.
    """
    link, config = folder / "board", folder / "tactiled.toml"
    tcp, ipc = f"tcp://127.0.0.1:{_free_pair()}", f"ipc://{folder}/events.ipc"
    config.write_text(_CONFIG.format(link=link, tcp=tcp, ipc=ipc, publish=publish))
    with ExitStack() as stack:
        _start(stack, "tactiled", "emulate", "--scene", "rest", "--link", str(link))
        _wait_for(link)
        daemon = _start(stack, "tactiled", "run", "--config", str(config))
        found = Sensing(tcp, ipc, daemon.pid, folder / "heard")
        _start(stack, "bench.hostile.sensing", ipc, str(found.heard))
        found.wait_for(1)
        time.sleep(_CALM_S)
        yield found


def address_of(endpoint: str) -> tuple[str, int]:
    """Return host and port of a TCP endpoint."""
    host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
    return host, int(port)


def listen(endpoint: str, path: Path) -> None:
    """Write each scan to a file as it is received, until terminated."""
    with zmq.Context() as context, context.socket(zmq.SUB) as sub, path.open("w", buffering=1) as file:
        sub.subscribe(f"tactile/{BOARD}/scan")
        sub.connect(endpoint)
        while True:
            _, payload = sub.recv_multipart()
            received_s = time.time()
            scan = msgpack.unpackb(payload)
            print(scan["seq"], received_s, received_s - scan["timestamp"], file=file)


def _start(stack: ExitStack, module: str, *arguments: str) -> "subprocess.Popen[bytes]":
    process = subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


def _wait_for(path: Path) -> None:
    end_s = time.monotonic() + _START_S
    while not path.exists():
        if time.monotonic() > end_s:
            raise OperatorError(f"{path} did not appear within {_START_S:g} s")
        time.sleep(0.02)


def _free_pair() -> int:
    """Return a free port whose next port is free, too."""
    while True:
        with socket.create_server(("127.0.0.1", 0)) as first:
            port: int = first.getsockname()[1]
            try:
                with socket.create_server(("127.0.0.1", port + 1)):
                    return port
            except OSError:
                continue


def _peak_mb(pid: str) -> float:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) * 1024 / 1e6 for line in lines if line.startswith("VmHWM"))


if __name__ == "__main__":
    listen(sys.argv[1], Path(sys.argv[2]))
