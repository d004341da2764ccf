"""Where a daemon is found: its default endpoint, and the rule where its control endpoint lies."""

DEFAULT_ENDPOINT = "tcp://127.0.0.1:9872"
"""PlotJuggler's ZeroMQ plugin looks there by itself."""


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
