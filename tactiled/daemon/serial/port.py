"""The serial port: opened with care, then read and written without ever blocking the loop.

Opening, which may take seconds (a TCP connect, an RFC 2217 negotiation), is done in a thread. What has a
file descriptor is read by ``loop.add_reader`` and ``os.read``; what has none (rfc2217://, loop://) by a
thread. A port that goes away shows as b"", EIO, ENXIO or any other OSError, depending on what it is: all
of them mean lost, and none is worth telling apart.
"""

import asyncio
import contextlib
import logging
import os
import termios
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import serial
from pydantic import Field

from tactiled.daemon.serial import device as devices
from tactiled.daemon.serial.device import LineErrors
from tactiled.errors import ConfigError, PortError
from tactiled.tomlfile import Params

logger = logging.getLogger(__name__)

_READ_BYTES = 4096  # what a tty holds at most; small enough that a flood leaves the status tick its turn
_POLL_S = 0.1  # how often the reading thread of a port without descriptor looks whether to end


class PortParams(Params):
    """Where the board is plugged in."""

    url: str = Field(
        min_length=1,
        description="Port of the board. Prefer a name that follows the board, /dev/serial/by-id/... or the "
        "udev link /dev/tactiled-SERIAL: ttyUSB numbers move when things are plugged. Any pyserial URL "
        "does: socket://host:port, rfc2217://host:port.",
    )
    baud: int = Field(
        default=0,
        ge=0,
        le=12_000_000,
        description="Bits per second; 0 takes what the protocol file says. Set it only when the firmware "
        "was built for another rate than its protocol file. USB-CDC boards and sockets ignore it.",
    )


def check_url(url: str) -> None:
    """Refuse what can never become a port, so that it is not retried for ever.

    Raises
    ------
    ConfigError
        Unknown URL scheme, or a directory.
    """
    try:
        serial.serial_for_url(url, do_not_open=True)
    except (ValueError, serial.SerialException) as error:
        raise ConfigError("port.url", [f"{url}: {error}; give a device path or socket://host:port"]) from None
    if Path(url).is_dir():
        raise ConfigError("port.url", [f"{url} is a directory; name a port in it{devices.available()}"])


class SerialPort:
    """An open port; made by `open_port`.

    Attributes
    ----------
    warning : str
        What should be mended although the port works; empty when nothing.
    handover_s : float or None
        The adapter's timer, where it says one.
    """

    def __init__(self, device: Any, url: str, latency_ms: int | None = None) -> None:
        self._device = device
        self._url = url
        self.warning = devices.laziness(url, latency_ms)
        self.handover_s = None if latency_ms is None else latency_ms / 1000
        try:
            self._fd: int | None = device.fileno()
        except OSError:  # io.UnsupportedOperation
            self._fd = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def attach(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        """Call `receive` with bytes as they come, and `lost` once, with the reason, when the port is gone."""
        self._loop = asyncio.get_running_loop()
        self._receive, self._lost = receive, lost
        if self._fd is not None:
            self._loop.add_reader(self._fd, self._readable, self._fd)
        else:
            self._thread = threading.Thread(target=self._read_in_thread, args=(self._loop,), daemon=True)
            self._thread.start()

    def detach(self) -> None:
        """No further calls of `receive` or `lost`."""
        if self._loop is not None and self._fd is not None:
            self._loop.remove_reader(self._fd)
        self._loop = None

    def write(self, data: bytes) -> bool:
        """Hand `data` to the line; False when it did not take all (whoever asked asks again later)."""
        try:
            written = os.write(self._fd, data) if self._fd is not None else self._device.write(data)
        except (serial.SerialException, OSError) as error:  # BlockingIOError among them
            logger.debug("write failed: %s", error)
            return False
        return written == len(data)

    def is_orphan(self) -> bool:
        """Whether the name leads elsewhere by now: a device that left without a word, or was swapped."""
        return (
            self._fd is not None
            and not devices.is_url(self._url)
            and not devices.same_device(self._fd, self._url)
        )

    @property
    def is_pty(self) -> bool:
        """Whether a program is at the other end, and no cable."""
        return self._fd is not None and devices.is_pty(self._fd)

    def errors(self) -> LineErrors | None:
        """What the UART's driver counted; None where it keeps no count."""
        return devices.line_errors(self._fd) if self._fd is not None else None

    def close(self) -> None:
        """Close the port; `detach` first, then call it in a thread: sockets sleep a moment here."""
        self.detach()
        if self._thread is not None:
            self._thread.join(2 * _POLL_S)
        with contextlib.suppress(serial.SerialException, OSError, termios.error):
            # Closing a tty waits up to 30 s for bytes that nobody will take; those are dropped instead.
            self._device.reset_output_buffer()
        with contextlib.suppress(serial.SerialException, OSError, termios.error):
            self._device.close()

    def _readable(self, fd: int) -> None:
        try:
            data = os.read(fd, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._gone(f"read failed: {error.strerror or error}")
            return
        if data:
            self._receive(data)
        else:
            self._gone("unplugged, or closed at the other end")

    def _read_in_thread(self, loop: asyncio.AbstractEventLoop) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended, and we with it
            try:
                while self._loop is loop:
                    if data := self._device.read(max(1, self._device.in_waiting)):
                        loop.call_soon_threadsafe(self._take, data)
            except (serial.SerialException, OSError) as error:
                loop.call_soon_threadsafe(self._gone, str(error))

    def _take(self, data: bytes) -> None:
        if self._loop is not None:
            self._receive(data)

    def _gone(self, reason: str) -> None:
        if self._loop is not None:
            self.detach()
            self._lost(reason)


def open_port(url: str, baud: int) -> SerialPort:
    """Open and configure a port, for us alone.

    Raises
    ------
    PortError
        One line that says what to do; worth trying again.
    """
    try:
        device = serial.serial_for_url(url, baudrate=baud, timeout=_POLL_S, exclusive=True)
    except (serial.SerialException, OSError, ValueError, termios.error) as error:
        raise PortError(devices.explain(url, error)) from None
    try:
        device.set_low_latency_mode(True)
    except (AttributeError, ValueError, OSError, NotImplementedError) as error:
        logger.debug("%s has no low latency mode: %s", url, error)  # ptys, sockets, USB-CDC
    if devices.is_url(url):
        return SerialPort(device, url)
    devices.keep_others_out(device.fileno())
    return SerialPort(device, url, devices.hasten(url))


async def open_port_in_thread(url: str, baud: int) -> SerialPort:
    """`open_port` without blocking the loop; a port that opens after we were cancelled is closed again."""
    loop = asyncio.get_running_loop()
    opened: asyncio.Future[SerialPort] = loop.create_future()

    def deliver(outcome: SerialPort | PortError) -> None:
        if isinstance(outcome, SerialPort):
            outcome.close() if opened.done() else opened.set_result(outcome)
        elif not opened.done():
            opened.set_exception(outcome)

    def work() -> None:
        try:
            outcome: SerialPort | PortError = open_port(url, baud)
        except PortError as error:
            outcome = error
        try:
            loop.call_soon_threadsafe(deliver, outcome)
        except RuntimeError:  # the loop has ended
            if isinstance(outcome, SerialPort):
                outcome.close()

    # Not the default executor: asyncio would wait for it, so for a dead host, before it lets us end.
    threading.Thread(target=work, name="open-port", daemon=True).start()
    return await opened
