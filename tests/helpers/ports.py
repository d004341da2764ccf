"""Free TCP ports of this host."""

import contextlib
import socket


def free_pair() -> int:
    """Find a free port whose successor is free too, for a daemon's requests."""
    while True:
        with socket.socket() as probe, socket.socket() as beside:
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
            with contextlib.suppress(OSError, OverflowError):  # in use, or beyond the last port
                beside.bind(("127.0.0.1", port + 1))
                return port
