"""Serial port: opened in a thread, read and written in the event loop without blocking, reopened when lost.

Opening may take seconds (a TCP connection, an RFC 2217 negotiation) and is therefore done in a thread. A port
with a file descriptor is read by ``loop.add_reader`` and ``os.read``, a port without one (rfc2217://,
loop://) by a thread. A port that disappears gives b"", EIO, ENXIO or another OSError, depending on its kind:
all of them count as a loss.

Only a write to rfc2217:// may block, for up to 5 s, where the other end reads nothing and the buffers of the
connection are full of commands.
"""

import asyncio
import contextlib
import logging
import os
import socket
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
from tactiled.limited_log import RateLimitedLog
from tactiled.tomlfile import Params

logger = logging.getLogger(__name__)

_READ_BYTES = 4096  # buffer of a tty; small enough that a flood of bytes does not delay the status
_POLL_S = 0.1  # period at which the reading thread of a port without descriptor checks for its end
_RETRY_S = 0.2  # between attempts to open: a board runs with its settings within 1 s of its device node


class PortParams(Params):
    """Port of the board."""

    url: str = Field(
        min_length=1,
        description="Serial port of the board. Use a name that follows the board, /dev/serial/by-id/... or "
        "the udev link /dev/tactiled-SERIAL: ttyUSB numbers change. Any pyserial URL works: "
        "socket://host:port, rfc2217://host:port.",
    )
    baud: int = Field(
        default=0,
        ge=0,
        le=12_000_000,
        description="Baud rate; 0: that of the layout. USB-CDC boards and sockets ignore it.",
    )


def check_url(url: str) -> None:
    """Refuse a URL that can never be opened, so that it is not tried for ever.

    `ConfigError` for an unknown scheme or a directory.
    """
    try:
        serial.serial_for_url(url, do_not_open=True)
    except (ValueError, serial.SerialException) as error:
        raise ConfigError("port.url", [f"{url}: {error}; give a device path or socket://host:port"]) from None
    with contextlib.suppress(OSError):  # a folder that this user may not enter: said when it is opened
        if Path(url).is_dir():
            raise ConfigError("port.url", [f"{url} is a directory; name a port in it{devices.available()}"])


class SerialPort:
    """Open port, made by `open_port`."""

    def __init__(self, device: Any, url: str, latency_ms: int | None = None) -> None:
        self._device = device
        self._url = url
        self.warning = devices.latency_warning(url, latency_ms)
        """Fault of a port that works all the same; empty for none."""
        self.handover_s = None if latency_ms is None else latency_ms / 1000
        """Latency timer of the adapter in seconds; None if unknown."""
        try:
            self._fd: int | None = device.fileno()
        except OSError:  # io.UnsupportedOperation
            self._fd = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def attach(self, receive: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        """Call `receive` with the bytes of each read, and `lost` once, with the reason, after a loss."""
        self._loop = asyncio.get_running_loop()
        self._receive, self._lost = receive, lost
        if self._fd is not None:
            self._loop.add_reader(self._fd, self._readable, self._fd)
        else:
            self._thread = threading.Thread(target=self._read_in_thread, args=(self._loop,), daemon=True)
            self._thread.start()

    def detach(self) -> None:
        """End the calls of `receive` and `lost`."""
        if self._loop is not None and self._fd is not None:
            self._loop.remove_reader(self._fd)
        self._loop = None

    def write(self, data: bytes) -> bool:
        """Write `data`; returns False when not all of it was accepted (the session repeats its commands)."""
        try:
            written = os.write(self._fd, data) if self._fd is not None else self._device.write(data)
        except (serial.SerialException, OSError) as error:  # BlockingIOError among them
            logger.debug("write failed: %s", error)
            return False
        return written == len(data)

    def is_orphan(self) -> bool:
        """Return True when the name no longer leads to this device, which was unplugged or replaced."""
        return (
            self._fd is not None
            and not devices.is_url(self._url)
            and not devices.same_device(self._fd, self._url)
        )

    @property
    def is_pty(self) -> bool:
        """True for a pseudo-terminal, which has a program at its other end instead of a cable."""
        return self._fd is not None and devices.is_pty(self._fd)

    def errors(self) -> LineErrors | None:
        """Return the error counts of the UART's driver; None where it keeps none."""
        return devices.line_errors(self._fd) if self._fd is not None else None

    def close(self) -> None:
        """Close the port; call it in a thread after `detach`, because closing a socket may block."""
        self.detach()
        if self._thread is not None:
            self._thread.join(2 * _POLL_S)
        with contextlib.suppress(serial.SerialException, OSError, termios.error):
            # Closing a tty would wait up to 30 s for its output to be sent; the output is discarded instead.
            self._device.reset_output_buffer()
        # pyserial leaves the descriptor of a socket open where the other end has reset the connection: its
        # shutdown fails, and close does not follow.
        connection = getattr(self._device, "_socket", None)
        with contextlib.suppress(serial.SerialException, OSError, termios.error):
            self._device.close()
        if isinstance(connection, socket.socket):
            connection.close()

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
        with contextlib.suppress(RuntimeError):  # the event loop has ended
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
    """Open and configure a port for exclusive use; a `PortError` says what to do if that fails now."""
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
    return SerialPort(device, url, devices.shorten_latency(url))


async def open_port_in_thread(url: str, baud: int) -> SerialPort:
    """Run `open_port` in a thread; a port that opens after a cancellation is closed again."""
    loop = asyncio.get_running_loop()
    opened: asyncio.Future[SerialPort] = loop.create_future()

    def deliver(outcome: SerialPort | Exception) -> None:
        if isinstance(outcome, SerialPort):
            if opened.done():
                loop.run_in_executor(None, outcome.close)  # it may take seconds
            else:
                opened.set_result(outcome)
        elif not opened.done():
            opened.set_exception(outcome)

    def work() -> None:
        try:
            outcome: SerialPort | Exception = open_port(url, baud)
        except Exception as error:  # raised where the port is awaited
            outcome = error
        try:
            loop.call_soon_threadsafe(deliver, outcome)
        except RuntimeError:  # the loop has ended
            if isinstance(outcome, SerialPort):
                outcome.close()

    # Not in the default executor: asyncio would wait for it at the end, for as long as a dead host takes.
    threading.Thread(target=work, name="open-port", daemon=True).start()
    return await opened


class Connection:
    """Keep a port open: open it again whenever it was lost."""

    def __init__(self, url: str, baud: int) -> None:
        self.port: SerialPort | None = None
        """The port while it is open."""
        self.connects = 0
        """Number of times that it was opened."""
        self.log = RateLimitedLog(logger)
        """Log with a bounded rate, because a port may open and fail again and again."""
        self._url, self._baud = url, baud
        self._gone: asyncio.Future[str] | None = None

    def write(self, data: bytes) -> None:
        """Write bytes of a command; a failed write is ignored, because the session repeats the command."""
        if self.port is not None:
            self.port.write(data)

    def check(self, reason: str) -> None:
        """Close the port if its name leads to another device, or if `reason` gives a reason."""
        if self.port is not None and self.port.is_orphan():
            reason = "its name leads to another device, or to none: opened anew"
        if reason:
            self._leave(reason)

    async def run(
        self,
        opened: Callable[[SerialPort], None],
        received: Callable[[bytes], None],
        lost: Callable[[str], None],
    ) -> None:
        """Open the port, read it until it is lost, and repeat; cancel this coroutine to close the port.

        `lost` takes the reason of each loss and of each failed attempt.
        """
        while True:
            try:
                port = await open_port_in_thread(self._url, self._baud)
            except PortError as error:
                lost(str(error))
            else:
                await self._serve(port, opened, received, lost)
            await asyncio.sleep(_RETRY_S)

    async def _serve(
        self,
        port: SerialPort,
        opened: Callable[[SerialPort], None],
        received: Callable[[bytes], None],
        lost: Callable[[str], None],
    ) -> None:
        """Read an open port until it is lost, say so, and close it, which may take seconds."""
        loop = asyncio.get_running_loop()
        self.connects += 1
        self.log.add(f"{self._url}: open at {self._baud} baud", loop.time(), logging.INFO)
        self.port, self._gone = port, loop.create_future()
        try:
            port.attach(received, self._leave)
            opened(port)
            reason = await self._gone
            self.port = None
            lost(f"{self._url}: {reason}")
        finally:
            self.port = self._gone = None
            port.detach()
            # Shielded: a cancellation before the thread begins would leave the port open.
            await asyncio.shield(loop.run_in_executor(None, port.close))

    def _leave(self, reason: str) -> None:
        if self._gone is not None and not self._gone.done():
            self._gone.set_result(reason)
