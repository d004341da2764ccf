"""sd_notify against a real datagram socket, where systemd would stand."""

import itertools
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tactiled.daemon.operations.notify import Notifier


def drain(manager: socket.socket) -> list[str]:
    manager.setblocking(False)
    messages = []
    while True:
        try:
            messages.append(manager.recv(4096).decode())
        except BlockingIOError:
            return messages


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    name = f"@tactiled-test-{os.getpid()}" if request.param == "abstract" else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind("\0" + name[1:] if name.startswith("@") else name)
        yield listening, name


def test_each_message_arrives(manager: tuple[socket.socket, str]) -> None:
    listening, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name})
    notifier.ready()
    notifier.status("board TS0001 running: 100 Hz")
    notifier.stopping()
    notifier.close()
    ready, status, stopping = drain(listening)
    assert ready == "READY=1"
    assert status == "STATUS=board TS0001 running: 100 Hz"
    assert stopping.startswith("STOPPING=1")


def test_pings_come_in_less_than_half_the_limit_and_only_when_the_data_path_runs(
    manager: tuple[socket.socket, str],
) -> None:
    listening, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())})
    pings_s = []
    for step in range(1000):
        now_s = 50.0 + 0.01 * step
        notifier.alive(now_s)
        pings_s += [now_s] * len(drain(listening))
    notifier.close()
    gaps_s = [b - a for a, b in itertools.pairwise(pings_s)]
    assert max(gaps_s) < 1.0
    assert len(pings_s) <= 21  # a datagram for every scan would be a waste


@pytest.mark.parametrize(
    "environ", [{}, {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "x"}]
)
def test_no_watchdog_pings_without_a_request(
    environ: dict[str, str], manager: tuple[socket.socket, str]
) -> None:
    listening, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name, **environ})
    notifier.alive(1.0)
    notifier.close()
    assert drain(listening) == []


def test_without_a_manager_nothing_happens() -> None:
    notifier = Notifier({})
    notifier.ready()
    notifier.alive(1.0)
    notifier.close()


def test_a_missing_or_blocked_service_manager_never_blocks(tmp_path: Path) -> None:
    name = tmp_path / "notify"
    notifier = Notifier({"NOTIFY_SOCKET": str(name)})
    notifier.ready()  # nobody there
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(name))
        for _ in range(5000):  # far more than the kernel queues
            notifier.status("x" * 100)
        assert 0 < len(drain(listening)) < 5000
    notifier.alive(1.0)  # gone again
    notifier.close()


def test_what_a_busy_manager_does_not_take_comes_later_and_in_order(tmp_path: Path) -> None:
    name = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(name))
        notifier = Notifier({"NOTIFY_SOCKET": str(name), "WATCHDOG_USEC": "4000000"})
        for second in range(1000):  # until the queue is full
            notifier.alive(float(second))
        notifier.status("board TS0001 running: 100 Hz")
        notifier.ready()
        notifier.status("board TS0001 no-device")
        assert set(drain(listening)) == {"WATCHDOG=1"}
        notifier.alive(2000.0)
        assert drain(listening) == ["READY=1", "STATUS=board TS0001 no-device", "WATCHDOG=1"]
        for n in range(5000):  # what waits is bounded
            notifier.ready()
            notifier.status(str(n))
        drain(listening)
        later = []
        for turn in range(5):
            notifier.alive(3000.0 + 0.1 * turn)
            later += drain(listening)
        assert later[:2] == ["READY=1", "STATUS=4999"]
        notifier.close()
