"""Endpoints of a daemon, and socket options that both ends of a connection share."""

DEFAULT_ENDPOINT = "tcp://127.0.0.1:9872"
"""Default endpoint of PlotJuggler's ZeroMQ plugin."""

ZENOH_SCHEME = "zenoh://"
"""Beginning of endpoints that name a host on a zenoh network instead of a daemon's socket."""

DEAD_PEER_OPTIONS = {
    "TCP_KEEPALIVE": 1,
    "TCP_KEEPALIVE_IDLE": 1,  # seconds
    "TCP_KEEPALIVE_INTVL": 1,
    "TCP_KEEPALIVE_CNT": 3,
    "TCP_MAXRT": 4000,  # ms for which sent data may stay unacknowledged
}
"""ZeroMQ socket options with which the kernel detects a lost host within some 4 s, and a lost process of this
host at once.

ZeroMQ's own heartbeats are never used: where a queue is full and the peer dies, libzmq 4.3.5 still tries to
ping it, finds ``_io_error`` and aborts the whole process. Measured on a subscriber that sleeps while its
publisher is killed, and on a server that a client floods and leaves.
"""


def control_endpoint(endpoint: str) -> str:
    """Return the endpoint for requests that belongs to an endpoint of events.

    TCP: the next port. ipc: the same folder, where ``events`` in the name becomes ``control``, or
    ``.control`` is added. zenoh: the same endpoint. Other transports: an empty string.

    >>> control_endpoint("tcp://127.0.0.1:9872"), control_endpoint("ipc:///run/tactiled/left/events.ipc")
    ('tcp://127.0.0.1:9873', 'ipc:///run/tactiled/left/control.ipc')
    """
    if endpoint.startswith(ZENOH_SCHEME):
        return endpoint
    transport, _, address = endpoint.partition("://")
    if transport == "tcp":
        host, _, port = address.rpartition(":")
        return f"tcp://{host}:{int(port) + 1}" if port.isascii() and port.isdigit() else ""
    if transport == "ipc" and address:
        folder, slash, name = address.rpartition("/")
        name = name.replace("events", "control") if "events" in name else f"{name}.control"
        return f"ipc://{folder}{slash}{name}"
    return ""
