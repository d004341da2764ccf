"""Sockets bound where the configuration says: what can be reached from where, and what is in the way."""

import contextlib
import ipaddress
import os
import socket
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zmq

from tactiled.errors import ConfigError, OperatorError, UnavailableError

RUNTIME = "{runtime}"  # stands in an endpoint for the runtime directory


def fault_of(endpoint: str) -> str:
    """Why this is no endpoint; empty where it is one."""
    transport, _, address = endpoint.partition("://")
    port = address.rsplit(":", 1)[-1]
    if transport == "tcp" and ":" in address and (port == "*" or (port.isdigit() and int(port) < 65536)):
        return ""
    if transport == "ipc" and address:
        return ""
    return f"{endpoint}: not an endpoint; give tcp://127.0.0.1:PORT or ipc://PATH"


def is_wide(endpoint: str) -> bool:
    """Whether other hosts can reach it."""
    transport, _, address = endpoint.partition("://")
    if transport != "tcp":
        return False
    host = address.rsplit(":", 1)[0].strip("[]")
    if host in ("localhost", "lo"):
        return False
    with contextlib.suppress(ValueError):
        return not ipaddress.ip_address(host).is_loopback
    return True


def bind(sock: zmq.Socket[Any], endpoint: str, environ: Mapping[str, str] = os.environ) -> None:
    """Bind a socket, or say clearly why not.

    Raises
    ------
    UnavailableError
        The endpoint is in use or cannot be bound now; says what to do.
    OperatorError
        It never can: a file stands in its place.
    ConfigError
        The path is longer than the system allows.
    """
    if RUNTIME in endpoint:
        endpoint = endpoint.replace(RUNTIME, str(runtime_directory(environ)))
    path = Path(endpoint.removeprefix("ipc://")) if endpoint.startswith("ipc://") else None
    if path is not None and _is_served(path):
        # libzmq would take the path away from the other daemon without a word.
        raise UnavailableError(f"{endpoint}: in use by another tactiled; give this one other endpoints")
    if path is not None and path.exists() and not path.is_socket():
        # libzmq would delete whatever stands there.
        raise OperatorError(f"{endpoint}: a file stands there that is no socket; name another path")
    try:
        sock.bind(endpoint)
        if path is not None:
            path.chmod(0o666)  # whoever may enter the directory may connect, as on loopback TCP
    except zmq.ZMQError as error:
        if error.errno == zmq.EADDRINUSE:
            port = endpoint.rsplit(":", 1)[-1]
            raise UnavailableError(
                f"{endpoint}: in use, by another tactiled perhaps (see who: ss -tlnp 'sport = :{port}'); "
                "stop it, or give this one another port in endpoints"
            ) from None
        raise UnavailableError(f"{endpoint}: cannot be bound: {error.strerror}") from None


def runtime_directory(environ: Mapping[str, str] = os.environ) -> Path:
    """Directory for our sockets: what systemd made for us, or one of our own for this user.

    Raises
    ------
    UnavailableError
        It cannot be made.
    OperatorError
        Someone else owns it.
    """
    if given := environ.get("RUNTIME_DIRECTORY", "").split(":")[0]:
        return Path(given)
    if session := environ.get("XDG_RUNTIME_DIR"):
        directory = Path(session) / "tactiled"
    else:
        directory = Path("/tmp") / f"tactiled-{os.getuid()}"
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = directory.lstat()
    except OSError as error:
        raise UnavailableError(f"{directory}: cannot be made for our sockets: {error.strerror}") from None
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise OperatorError(f"{directory}: belongs to someone else; set XDG_RUNTIME_DIR to a folder of yours")
    return directory


def _is_served(path: Path) -> bool:
    """Whether someone listens on a Unix socket (a stale file left by a killed daemon refuses)."""
    if len(os.fsencode(path)) > 107:  # sun_path of unix(7), less its closing NUL
        raise ConfigError(
            "publish.endpoints", [f"{path}: longer than the 107 bytes that a socket path may have"]
        )
    with socket.socket(socket.AF_UNIX) as probe, contextlib.suppress(OSError):
        probe.connect(str(path))
        return True
    return False
