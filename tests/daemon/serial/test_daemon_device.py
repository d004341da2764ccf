"""Facts about a device: latency timer, processes that have it open, stable name, error counts of its UART."""

import errno
import fcntl
import os
import pty
import struct
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tactiled.daemon.serial import device

_TIOCGEXCL = 0x80045440  # asm-generic/ioctls.h


@contextmanager
def open_pty() -> Iterator[tuple[int, str]]:
    master, slave = pty.openpty()
    try:
        yield slave, os.ttyname(slave)
    finally:
        os.close(slave)
        os.close(master)


@pytest.fixture
def adapter(tmp_path: Path) -> tuple[Path, Path, Path]:
    """Port name, the sysfs that describes it, and its latency timer."""
    node = tmp_path / "dev/ttyUSB3"
    timer = tmp_path / "tty/ttyUSB3/device/latency_timer"
    name = tmp_path / "by-id/usb-FTDI_FT232R_X-if00"
    for path in (node, timer, name):
        path.parent.mkdir(parents=True)
    node.touch()
    timer.write_text("16\n")
    name.symlink_to(node)
    return name, tmp_path / "tty", timer


def test_the_latency_timer_is_found_behind_a_stable_name_and_set(adapter: tuple[Path, Path, Path]) -> None:
    name, sys_tty, timer = adapter
    assert device.latency_ms(str(name), sys_tty) == 16
    assert device.shorten_latency(str(name), sys_tty) == 1
    assert timer.read_text() == "1\n"
    assert device.latency_warning(str(name), 1) == ""


def test_a_timer_without_permission_gives_a_warning(
    adapter: tuple[Path, Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    name, sys_tty, _ = adapter

    def denied(*_: object) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "write_text", denied)  # the tests may run as root, whom nothing is denied
    left_ms = device.shorten_latency(str(name), sys_tty)
    assert left_ms == 16
    words = device.latency_warning(str(name), left_ms)
    assert "every 16 ms only" in words
    assert "99-tactiled.rules" in words
    assert "ttyUSB3/device/latency_timer" in words


def test_no_warning_without_a_timer(tmp_path: Path) -> None:
    assert device.shorten_latency("/dev/ttyACM9", tmp_path) is None
    assert device.latency_warning("/dev/ttyACM9", None) == ""


def test_the_stable_name_is_found_from_the_device_name(adapter: tuple[Path, Path, Path]) -> None:
    name, _, _ = adapter
    assert device.stable_name(str(name.resolve()), name.parent) == name
    assert device.stable_name("/dev/null", name.parent) is None
    assert device.stable_name("/dev/null", name.parent / "none") is None


def test_ptys_are_not_marked_exclusive_and_have_no_counters() -> None:
    with open_pty() as (slave, _):
        device.keep_others_out(slave)
        answer = fcntl.ioctl(slave, _TIOCGEXCL, struct.pack("i", -1))
        assert struct.unpack("i", answer) == (0,)
        assert device.line_errors(slave) is None


def test_another_tty_is_marked_exclusive(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_pty() as (slave, _):
        monkeypatch.setattr(os, "ttyname", lambda _: "/dev/ttyUSB0")
        device.keep_others_out(slave)
        answer = fcntl.ioctl(slave, _TIOCGEXCL, struct.pack("i", -1))
        assert struct.unpack("i", answer) == (1,)
        fcntl.ioctl(slave, termios.TIOCNXCL)


def test_counters_of_a_uart_are_read_from_their_places(monkeypatch: pytest.MonkeyPatch) -> None:
    def counters(_fd: int, _request: int, buffer: bytearray) -> int:
        buffer[:] = struct.pack("20i", *range(100, 120))
        return 0

    monkeypatch.setattr(fcntl, "ioctl", counters)
    # linux/serial.h: cts dsr rng dcd rx tx frame overrun parity brk buf_overrun
    assert device.line_errors(3) == device.LineErrors(framing=106, overrun=107 + 110)


def test_a_name_that_leads_to_another_device_is_noticed(tmp_path: Path) -> None:
    link = tmp_path / "board"
    with open_pty() as (first, first_name), open_pty() as (_, second_name):
        link.symlink_to(first_name)
        assert device.same_device(first, str(link))
        link.unlink()
        assert not device.same_device(first, str(link))
        link.symlink_to(second_name)
        assert not device.same_device(first, str(link))


def test_a_port_is_free_until_a_daemon_locks_it(tmp_path: Path) -> None:
    assert not device.is_free(str(tmp_path / "none"))
    with open_pty() as (slave, name):
        assert device.is_free(name)
        assert device.is_free(name)  # looking does not take it
        fcntl.flock(slave, fcntl.LOCK_EX)
        assert not device.is_free(name)
