"""Where a daemon is found, and what both ends of a connection must set alike."""

DEFAULT_ENDPOINT = "tcp://127.0.0.1:9872"
"""PlotJuggler's ZeroMQ plugin looks there by itself."""

DEAD_PEER_OPTIONS = {
    "TCP_KEEPALIVE": 1,
    "TCP_KEEPALIVE_IDLE": 1,  # seconds
    "TCP_KEEPALIVE_INTVL": 1,
    "TCP_KEEPALIVE_CNT": 3,
    "TCP_MAXRT": 4000,  # ms for which what was sent may stay unacknowledged
}
"""ZeroMQ socket options by which the kernel finds out, within some 4 s, that the other host is gone; within
one host it knows at once.

Never ZeroMQ's own heartbeats: where a queue is full and the peer dies, libzmq 4.3.5 still wants to ping it,
finds ``_io_error`` and aborts the whole process. Measured on a subscriber that sleeps while its publisher is
killed, and on a server that a client floods and leaves.
"""


def control_endpoint(endpoint: str) -> str:
    """Endpoint for requests that belongs to an endpoint of events.

    TCP: the next port. ipc: the same folder, ``events`` in the name becomes ``control``, or ``.control`` is
    added. Empty where there is no such rule.

    >>> control_endpoint("tcp://127.0.0.1:9872"), control_endpoint("ipc:///run/tactiled/left/events.ipc")
    ('tcp://127.0.0.1:9873', 'ipc:///run/tactiled/left/control.ipc')
    """
    transport, _, address = endpoint.partition("://")
    if transport == "tcp":
        host, _, port = address.rpartition(":")
        return f"tcp://{host}:{int(port) + 1}" if port.isascii() and port.isdigit() else ""
    if transport == "ipc" and address:
        folder, slash, name = address.rpartition("/")
        name = name.replace("events", "control") if "events" in name else f"{name}.control"
        return f"ipc://{folder}{slash}{name}"
    return ""
