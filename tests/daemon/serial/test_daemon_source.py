"""Ports: real ptys and sockets, and the words for what does not open."""

import asyncio
import grp
import os
import pty
import socket
import struct
import threading
import tty
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import serial
from boards import descriptors
from patience import PATIENCE_S

from tactiled.daemon.serial import device as devices
from tactiled.daemon.serial import port as source
from tactiled.daemon.serial.port import Connection, check_url, open_port, open_port_in_thread
from tactiled.errors import ConfigError, PortError


@contextmanager
def raw_pty() -> Iterator[tuple[int, str]]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    try:
        yield master, name
    finally:
        with suppress(OSError):
            os.close(master)


class Heard:
    """Record the callbacks of a port."""

    def __init__(self) -> None:
        self.data = b""
        self.lost: list[str] = []
        self.changed = asyncio.Event()

    def receive(self, data: bytes) -> None:
        self.data += data
        self.changed.set()

    def gone(self, reason: str) -> None:
        self.lost.append(reason)
        self.changed.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not condition():
                self.changed.clear()
                await self.changed.wait()


def run(scenario: Callable[[], Awaitable[None]]) -> None:
    async def main() -> None:
        await scenario()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    before = descriptors()
    asyncio.run(main())
    assert descriptors() == before


def test_bytes_pass_both_ways_on_a_pty_and_the_unplug_is_reported_once() -> None:
    async def scenario() -> None:
        with raw_pty() as (master, name):
            port = await open_port_in_thread(name, 115200)
            heard = Heard()
            port.attach(heard.receive, heard.gone)
            os.write(master, b"\x00\xffhello\r\n\x03\x11\x13")  # nothing is a control character here
            await heard.until(lambda: len(heard.data) == 12)
            assert heard.data == b"\x00\xffhello\r\n\x03\x11\x13"
            assert port.write(b"\x00\x10\x0d\x0a")
            assert os.read(master, 100) == b"\x00\x10\x0d\x0a"
            os.close(master)
            await heard.until(lambda: bool(heard.lost))
            await asyncio.sleep(0.02)
            assert len(heard.lost) == 1
            port.close()

    run(scenario)


def test_bytes_pass_both_ways_on_a_socket_and_its_end_is_noticed() -> None:
    async def scenario() -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            url = f"socket://127.0.0.1:{server.getsockname()[1]}"
            port = await open_port_in_thread(url, 115200)
            heard = Heard()
            port.attach(heard.receive, heard.gone)
            peer, _ = server.accept()
            with peer:
                peer.sendall(b"scan")
                await heard.until(lambda: heard.data == b"scan")
                assert port.write(b"start")
                assert peer.recv(100) == b"start"
            await heard.until(lambda: bool(heard.lost))
            port.close()

    run(scenario)


def test_a_connection_that_the_other_end_has_reset_is_closed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200)
        board, _ = server.accept()
        board.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # close with a reset
        board.close()
    connection = port._device._socket  # noqa: SLF001  the descriptor that must not leak
    port.close()
    assert connection.fileno() == -1


def test_a_port_without_descriptor_is_read_by_a_thread() -> None:
    async def scenario() -> None:
        port = await open_port_in_thread("loop://", 115200)
        heard = Heard()
        port.attach(heard.receive, heard.gone)
        assert port.write(b"round and round")
        await heard.until(lambda: heard.data == b"round and round")
        await asyncio.to_thread(port.close)
        await asyncio.sleep(0.02)
        assert heard.lost == []

    threads = set(threading.enumerate())
    run(scenario)
    assert not [t for t in set(threading.enumerate()) - threads if t.is_alive()]


def test_after_detach_nothing_is_called() -> None:
    async def scenario() -> None:
        with raw_pty() as (master, name):
            port = open_port(name, 115200)
            heard = Heard()
            port.attach(heard.receive, heard.gone)
            port.detach()
            os.write(master, b"late")
            await asyncio.sleep(0.02)
            assert (heard.data, heard.lost) == (b"", [])
            port.close()

    run(scenario)


def test_a_board_that_reads_nothing_never_blocks_a_write() -> None:
    async def scenario() -> None:
        with raw_pty() as (_, name):
            port = open_port(name, 115200)
            assert not all(port.write(b"x" * 1000) for _ in range(1000))
            port.close()

    run(scenario)


def test_a_port_that_opens_too_late_is_closed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        with raw_pty() as (_, name):
            may_open = threading.Event()
            real = source.open_port

            def slow(url: str, baud: int) -> source.SerialPort:
                may_open.wait()
                return real(url, baud)

            monkeypatch.setattr(source, "open_port", slow)
            opening = asyncio.create_task(open_port_in_thread(name, 115200))
            await asyncio.sleep(0.01)
            opening.cancel()
            with suppress(asyncio.CancelledError):
                await opening
            may_open.set()
            while any(t.name == "open-port" for t in threading.enumerate()):
                await asyncio.sleep(0.001)
            await asyncio.sleep(0)

    run(scenario)


def test_a_bug_in_opening_comes_to_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_url: str, _baud: int) -> source.SerialPort:
        raise ZeroDivisionError("a bug")

    async def scenario() -> None:
        async with asyncio.timeout(PATIENCE_S):
            with pytest.raises(ZeroDivisionError, match="a bug"):
                await open_port_in_thread("/dev/null", 115200)

    monkeypatch.setattr(source, "open_port", broken)
    run(scenario)


def test_a_loss_is_reported_before_the_port_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        may_close = threading.Event()
        real = source.SerialPort.close

        def slow(port: source.SerialPort) -> None:
            may_close.wait(PATIENCE_S)
            real(port)

        monkeypatch.setattr(source.SerialPort, "close", slow)
        with raw_pty() as (master, name):
            heard, connection = Heard(), Connection(name, 115200)
            ports: list[source.SerialPort | None] = []

            def lost(reason: str) -> None:
                ports.append(connection.port)
                heard.gone(reason)

            # Closing the master unplugs the port.
            serving = asyncio.create_task(connection.run(lambda _: os.close(master), heard.receive, lost))
            try:
                await heard.until(lambda: bool(heard.lost))
            finally:
                may_close.set()
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)
            assert heard.lost[0].startswith(f"{name}: ")
            assert ports[0] is None

    run(scenario)


def test_a_second_open_fails_with_busy() -> None:
    with raw_pty() as (_, name):
        first = open_port(name, 115200)
        with pytest.raises(PortError, match=f"{name}: busy, .+ has it .*lsof {name}"):
            open_port(name, 115200)
        first.close()
        open_port(name, 115200).close()


def test_the_error_for_a_missing_port_lists_present_ports(tmp_path: Path) -> None:
    (tmp_path / "tactiled-TS0001").symlink_to(tmp_path / "ttyUSB7")
    for name in ("ttyUSB7", "tactiled-TS0001"):
        with pytest.raises(PortError, match=r"no such port; (there are: /dev/|no serial port is plugged in)"):
            open_port(str(tmp_path / name), 115200)


@pytest.mark.parametrize("error", [FileNotFoundError, TypeError], ids=lambda error: error.__name__)
def test_ports_that_go_while_they_are_listed_are_no_fault(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: type[Exception]
) -> None:
    def gone() -> None:
        raise error

    monkeypatch.setattr(devices, "BY_ID", tmp_path / "gone")
    monkeypatch.setattr("tactiled.daemon.serial.device.list_ports.comports", gone)
    with pytest.raises(PortError, match="no such port; no serial port is plugged in"):
        open_port(str(tmp_path / "ttyUSB7"), 115200)


def test_permission_denied_names_the_group_and_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    # The tests may run as root, whom nothing is denied: the kernel's answer is put in its mouth.
    def denied(url: str, **_: object) -> None:
        raise serial.SerialException(13, f"could not open port {url}: [Errno 13] Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", denied)
    with raw_pty() as (_, name):
        group = grp.getgrgid(Path(name).stat().st_gid).gr_name
        with pytest.raises(
            PortError, match=f"permission denied; it belongs to group {group}: sudo usermod -aG {group}"
        ):
            open_port(name, 115200)


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(PortError, match="not a serial port"):
        open_port(str(tmp_path / "notes.txt"), 115200)


def test_a_refused_connection_is_explained() -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        with pytest.raises(PortError, match=r"cannot be opened .*is the other end up"):
            open_port(f"socket://127.0.0.1:{closed.getsockname()[1]}", 115200)


@pytest.mark.parametrize(
    ("url", "words"), [("usb://x", "protocol 'usb' not known"), ("/tmp", "is a directory")]
)
def test_an_impossible_port_is_a_config_error(url: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        check_url(url)


@pytest.mark.parametrize(
    "url", ["/dev/serial/by-id/none", "socket://robot:7000", "rfc2217://robot:2217", "loop://"]
)
def test_a_port_that_may_appear_later_is_accepted(url: str) -> None:
    check_url(url)
