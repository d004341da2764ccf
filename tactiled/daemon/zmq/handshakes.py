"""Log of clients that fail before authentication: without a key, or with the key of another daemon.

libzmq sends a ZAP request only for a client that uses CURVE with the public key of this daemon. Other clients
it reports to a monitor of the socket: ACCEPTED with the descriptor of the connection,
HANDSHAKE_FAILED_PROTOCOL with the cause, and DISCONNECTED with the descriptor (zmq_socket_monitor(3)).
"""

import asyncio
import socket
from typing import Any

import zmq
import zmq.asyncio
from zmq.utils.monitor import parse_monitor_message

from tactiled.limited_log import RateLimitedLog

_FAILED = (zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL, zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL)
_EVENTS = zmq.EVENT_ACCEPTED | _FAILED[0] | _FAILED[1] | zmq.EVENT_DISCONNECTED
_CAUSES: dict[int, str] = {
    zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH: "without a key",
    zmq.PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC: "with the key of another daemon",
}
_GONE = (
    "an unknown address (gone at once)"  # a handshake may fail before the monitor has reported the connection
)


class Handshakes:
    """Watch the handshakes of one socket with CURVE; make it before the socket is bound.

    Parameters
    ----------
    denied : RateLimitedLog
        Logs each client that failed.
    """

    def __init__(self, context: zmq.Context[Any], guarded: zmq.Socket[Any], denied: RateLimitedLog) -> None:
        self._denied = denied
        self._addresses: dict[int, str] = {}
        self._cause = ""
        endpoint = f"inproc://tactiled.handshakes.{id(guarded)}"
        guarded.monitor(endpoint, _EVENTS)
        self._socket = zmq.asyncio.Socket(context, zmq.PAIR)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.connect(endpoint)

    async def run(self) -> None:
        """Read the monitor until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            told = parse_monitor_message(await self._socket.recv_multipart())
            self._take(told["event"], told["value"], loop.time())

    def close(self) -> None:
        """Close the monitor socket."""
        self._socket.close()

    def _take(self, event: int, value: int, now_s: float) -> None:
        """Handle an event of the monitor.

        All events come from one I/O thread, so the next DISCONNECTED belongs to the handshake that failed.
        """
        if event == zmq.EVENT_ACCEPTED:
            self._addresses[value] = _peer(value)
        elif event == zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL:
            self._cause = "without a key, it seems: it left when it was asked for one"
        elif event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL:
            self._cause = _CAUSES.get(value, f"with a handshake that is none (ZMTP error {value:#x})")
        else:
            address = self._addresses.pop(value, _GONE)
            if self._cause:
                self._denied.add(f"{address} {self._cause}", now_s)
            self._cause = ""


def _peer(descriptor: int) -> str:
    """Peer address of a connection of libzmq, which may have closed it by now."""
    try:
        connection = socket.socket(fileno=descriptor)
    except OSError:
        return _GONE
    try:
        return str(connection.getpeername()[0]).removeprefix("::ffff:")
    except (OSError, IndexError):
        return _GONE
    finally:
        connection.detach()
