"""Notifications to systemd (sd_notify(3)): ready, watchdog, reloading, stopping, and a line of status."""

import os
import socket
import time
from collections.abc import Mapping


class Notifier:
    """Send datagrams to the service manager; do nothing where there is none.

    Parameters
    ----------
    environ : mapping
        Read for ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID``.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        # An abstract address is written with @ and begins with NUL.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)  # a manager that does not read must not stop the data path
        mine = environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = environ.get("WATCHDOG_USEC", "") if mine else ""
        # sd_watchdog_enabled(3) asks for half of the limit; a quarter leaves room for one lost ping.
        self._ping_every_s = int(usec) / 1e6 / 4 if usec.isdigit() else float("inf")
        self._next_ping_s = float("-inf")

    def ready(self) -> None:
        """Report that the start or a reload is complete."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report that a reload begins."""
        # MONOTONIC_USEC is what Type=notify-reload of newer systemd asks for; older ones ignore it.
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Report that the service is ending."""
        self._send("STOPPING=1\nSTATUS=stopping")

    def status(self, text: str) -> None:
        """Set the line that ``systemctl status`` shows."""
        self._send(f"STATUS={text}")

    def alive(self, now_s: float) -> None:
        """Report that the data path ran; a watchdog ping is sent when one is due."""
        if now_s >= self._next_ping_s and self._ping_every_s < float("inf"):
            self._next_ping_s = now_s + self._ping_every_s
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendto(message.encode(), self._address)
        except OSError:
            return  # the manager is gone or busy; the daemon continues without it
