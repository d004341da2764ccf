"""Notifications to systemd (sd_notify(3)): ready, watchdog, stopping, and a line of status."""

import os
import socket
from collections.abc import Mapping


class Notifier:
    """Send datagrams to the service manager; do nothing where there is none.

    A manager whose queue is full (the kernel holds 10 datagrams by default) gets each message later, from
    `alive`: a lost READY=1 would let the start fail, and a lost status would show an old one for hours.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        # An abstract address is written with @ and begins with NUL.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._waiting: dict[str, str] = {}  # newest message of each kind that a busy manager has not taken
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
        """Report that the start is complete."""
        self._send("READY", "READY=1")

    def stopping(self) -> None:
        """Report that the service is ending."""
        self._send("STOPPING", "STOPPING=1\nSTATUS=stopping")

    def status(self, text: str) -> None:
        """Set the line that ``systemctl status`` shows."""
        self._send("STATUS", f"STATUS={text}")

    def alive(self, now_s: float) -> None:
        """Report that the data path ran; send a watchdog ping when one is due, and what waits."""
        self._send_waiting()
        if now_s >= self._next_ping_s and self._ping_every_s < float("inf"):
            self._next_ping_s = now_s + self._ping_every_s
            self._is_taken("WATCHDOG=1")  # never waits: a later one says more

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, kind: str, message: str) -> None:
        self._waiting.pop(kind, None)
        self._waiting[kind] = message  # behind those of other kinds
        self._send_waiting()

    def _send_waiting(self) -> None:
        for kind in [*self._waiting]:
            if not self._is_taken(self._waiting[kind]):
                return
            del self._waiting[kind]

    def _is_taken(self, message: str) -> bool:
        """Send a message; return False if it has to wait because the manager is busy."""
        if self._socket is None:
            return True
        try:
            self._socket.sendto(message.encode(), self._address)
        except BlockingIOError:
            return False
        except OSError:
            return True  # the manager is gone; the daemon continues without it
        return True
