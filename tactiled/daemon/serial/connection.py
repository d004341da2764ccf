"""A port kept open: opened, lost, opened again, for as long as the daemon lives."""

import asyncio
import logging
from typing import Protocol

from tactiled.daemon.operations.complaints import Complaints
from tactiled.daemon.serial.device import LineErrors
from tactiled.daemon.serial.port import SerialPort, open_port_in_thread
from tactiled.errors import PortError

logger = logging.getLogger(__name__)

QUICK_TRIES = 20  # for the second in which a twitched cable comes back ...
QUICK_S = 0.05
SLOWEST_S = 0.5  # ... then rarer, but so that a board is back, settings and all, within 1 s of its node
_SLOWER = 1.5
_SETTLED_S = 1.0  # a port that stayed open for so long earned quick tries again when it goes


class Listener(Protocol):
    """Whom a connection tells."""

    def opened(self) -> None:
        """A port is there, `Connection.write` reaches it."""

    def received(self, data: bytes) -> None:
        """Bytes, as they come."""

    def lost(self, reason: str) -> None:
        """Why there is no port; again at each try."""


class Connection:
    """Keeps a port open and tells of it.

    Parameters
    ----------
    url : str
    baud : int
    """

    def __init__(self, url: str, baud: int) -> None:
        self.connects = 0
        self.log = Complaints(logger)
        """What is logged of the port: a port that opens and fails again and again must not fill the log."""
        self._url, self._baud = url, baud
        self._port: SerialPort | None = None
        self._gone: asyncio.Future[str] | None = None

    @property
    def is_open(self) -> bool:
        return self._port is not None

    def write(self, data: bytes) -> None:
        """Hand a command to the line; one that it does not take is sent again by whoever needs it."""
        if self._port is not None:
            self._port.write(data)

    @property
    def warning(self) -> str:
        """What should be mended although the port works; empty when nothing, or there is none."""
        return self._port.warning if self._port is not None else ""

    @property
    def handover_s(self) -> float | None:
        """Timer of the adapter; None where it says none, or there is no port."""
        return self._port.handover_s if self._port is not None else None

    @property
    def is_pty(self) -> bool:
        """Whether a program is at the other end, and no cable; False while there is no port."""
        return self._port is not None and self._port.is_pty

    def errors(self) -> LineErrors | None:
        """What the UART's driver counted; None where it keeps no count, or there is no port."""
        return self._port.errors() if self._port is not None else None

    def check(self, dead_because: str) -> None:
        """Leave a port that is dead, as the caller says, or whose name leads to another device by now."""
        if self._port is None:
            return
        if self._port.is_orphan():
            self._leave("its name leads to another device, or to none: opened anew")
        elif dead_because:
            self._leave(dead_because)

    def move(self, url: str, baud: int) -> None:
        """Leave this port for another one."""
        self._url, self._baud = url, baud
        self._leave("the configuration names another port")

    async def run(self, listener: Listener) -> None:
        """Never returns; cancel it to close the port."""
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
        """From an open port until it is lost; gives the reason."""
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
            # Shielded: cancelled before its thread began, the closing would never be done.
            await asyncio.shield(asyncio.get_running_loop().run_in_executor(None, port.close))

    def _leave(self, reason: str) -> None:
        if self._gone is not None and not self._gone.done():
            self._gone.set_result(reason)
