"""Connection to a port that is opened again whenever it was lost."""

import asyncio
import logging
from typing import Protocol

from tactiled.daemon.serial.device import LineErrors
from tactiled.daemon.serial.port import SerialPort, open_port_in_thread
from tactiled.errors import PortError
from tactiled.limited_log import RateLimitedLog

logger = logging.getLogger(__name__)

QUICK_TRIES = 20  # attempts at `QUICK_S`: a bumped cable is back within a second
QUICK_S = 0.05
SLOWEST_S = 0.5  # longest interval; a board then runs with its settings within 1 s of its device node
_SLOWER = 1.5  # factor between later intervals
_SETTLED_S = 1.0  # a port that was open for so long gets quick attempts again after a loss


class Listener(Protocol):
    """Callbacks of a connection."""

    def opened(self) -> None:
        """Handle a port that was just opened; `Connection.write` reaches it."""

    def received(self, data: bytes) -> None:
        """Handle the bytes of one read."""

    def lost(self, reason: str) -> None:
        """Handle a lost port; called again for each attempt to open it that fails."""


class Connection:
    """Keep a port open, and report its bytes and losses to a `Listener`."""

    def __init__(self, url: str, baud: int) -> None:
        self.connects = 0
        self.log = RateLimitedLog(logger)
        """Log of the port with a bounded rate, because a port may open and fail again and again."""
        self._url, self._baud = url, baud
        self._port: SerialPort | None = None
        self._gone: asyncio.Future[str] | None = None

    @property
    def is_open(self) -> bool:
        """True while a port is open."""
        return self._port is not None

    def write(self, data: bytes) -> None:
        """Write bytes of a command; a failed write is ignored, because the session repeats the command."""
        if self._port is not None:
            self._port.write(data)

    @property
    def warning(self) -> str:
        """Fault of an open port that works all the same; empty for none, or without a port."""
        return self._port.warning if self._port is not None else ""

    @property
    def handover_s(self) -> float | None:
        """Latency timer of the adapter in seconds; None if unknown, or without a port."""
        return self._port.handover_s if self._port is not None else None

    @property
    def is_pty(self) -> bool:
        """True when the port is a pseudo-terminal; False without a port."""
        return self._port is not None and self._port.is_pty

    def errors(self) -> LineErrors | None:
        """Return the error counts of the UART's driver; None if it keeps none, or without a port."""
        return self._port.errors() if self._port is not None else None

    def check(self, reason: str) -> None:
        """Close the port if its name leads to another device, or if `reason` gives a reason."""
        if self._port is None:
            return
        if self._port.is_orphan():
            self._leave("its name leads to another device, or to none: opened anew")
        elif reason:
            self._leave(reason)

    def move(self, url: str, baud: int) -> None:
        """Close this port and open another one."""
        self._url, self._baud = url, baud
        self._leave("the configuration names another port")

    async def run(self, listener: Listener) -> None:
        """Open the port, serve it until lost, and repeat; cancel this coroutine to close the port."""
        tries, delay_s = 0, QUICK_S
        loop = asyncio.get_running_loop()
        while True:
            url = self._url
            try:
                port = await open_port_in_thread(url, self._baud)
            except PortError as error:
                listener.lost(str(error))
            else:
                opened_s = loop.time()
                reason = await self._serve(port, listener)
                listener.lost(f"{url}: {reason}")
                if loop.time() - opened_s > _SETTLED_S:
                    tries, delay_s = 0, QUICK_S
            tries += 1
            if tries > QUICK_TRIES:
                delay_s = min(delay_s * _SLOWER, SLOWEST_S)
            await asyncio.sleep(delay_s)

    async def _serve(self, port: SerialPort, listener: Listener) -> str:
        """Serve an open port until it is lost; returns the reason."""
        self.connects += 1
        now_s = asyncio.get_running_loop().time()
        self.log.add(f"{self._url}: open at {self._baud} baud", now_s, logging.INFO)
        self._port = port
        self._gone = asyncio.get_running_loop().create_future()
        try:
            port.attach(listener.received, self._leave)
            listener.opened()
            return await self._gone
        finally:
            self._port = self._gone = None
            port.detach()
            # Shielded: a cancellation before the thread begins would leave the port open.
            await asyncio.shield(asyncio.get_running_loop().run_in_executor(None, port.close))

    def _leave(self, reason: str) -> None:
        if self._gone is not None and not self._gone.done():
            self._gone.set_result(reason)
