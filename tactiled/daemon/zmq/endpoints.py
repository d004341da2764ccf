"""Endpoints of the configuration: syntax, reachability from other hosts, and binding of sockets."""

import contextlib
import errno
import ipaddress
import os
import socket
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import zmq

from tactiled.errors import ConfigError, OperatorError, UnavailableError
from tactiled.outside import shown

RUNTIME = "{runtime}"  # placeholder for the runtime directory in an endpoint
_LONGEST_PATH = 107  # bytes: sun_path of unix(7), less its closing NUL
# Of the kernel, for each connection: what comes is short, and without a limit it grows to some megabytes.
_RECEIVE_BUFFER_BYTES = 16 * 1024
_BACKLOG = 64  # connections that wait to be accepted, within a turn of the event loop
_SOCKET_UMASK = 0o117  # ipc sockets get mode 0660: for the user and group of the daemon


def fault_of(endpoint: str) -> str:
    """Return the syntax error of an endpoint, or an empty string."""
    transport, _, address = endpoint.partition("://")
    host, _, port = address.rpartition(":")
    fault = ""
    if not endpoint.isprintable():
        fault = "has characters that cannot be printed"
    elif transport == "tcp" and not host.strip("[]"):
        fault = "has no host or no port"
    elif transport == "tcp" and not (
        port.isascii() and port.isdigit() and len(port) < 6 and 0 < int(port) < 65536
    ):
        fault = "has no port from 1 to 65535"
    elif transport == "ipc" and address.startswith("@"):
        fault = "is an abstract socket, which any user of this host may connect to: give the path of a file"
    elif transport == "ipc" and not address.strip("/"):
        fault = "has no path"
    elif transport == "ipc" and RUNTIME not in address and len(os.fsencode(address)) > _LONGEST_PATH:
        fault = f"has a path longer than the {_LONGEST_PATH} bytes that a socket may have"
    elif transport not in ("tcp", "ipc"):
        fault = "is neither tcp nor ipc"
    return (
        f"{shown(endpoint)} {fault}; not an endpoint such as tcp://127.0.0.1:9872 or ipc://PATH"
        if fault
        else ""
    )


def is_wide(endpoint: str) -> bool:
    """Return True when other hosts can reach the endpoint."""
    transport, _, address = endpoint.partition("://")
    if transport != "tcp":
        return False
    host = address.rsplit(":", 1)[0].strip("[]")
    if host == "localhost":
        return False
    with contextlib.suppress(ValueError):
        return not ipaddress.ip_address(host).is_loopback
    return True


def filled(endpoint: str) -> str:
    """Return the endpoint with the runtime directory in place of ``{runtime}``."""
    return endpoint.replace(RUNTIME, str(runtime_directory())) if RUNTIME in endpoint else endpoint


def bind(sock: zmq.Socket[Any], endpoint: str) -> None:
    """Bind a socket of libzmq to an endpoint.

    An ipc socket is open to the user and the group of this process only (mode 0660).

    Raises
    ------
    UnavailableError
        The endpoint is in use or cannot be bound now; the message says what to do.
    OperatorError
        The path is that of a file which is no socket.
    ConfigError
        The path is longer than the system allows.
    """
    endpoint = _prepared(endpoint)
    try:
        with _socket_umask():
            sock.bind(endpoint)
    except zmq.ZMQError as error:
        raise _not_bound(endpoint, error) from None


def listen(endpoint: str) -> list[socket.socket]:
    """Return sockets of the kernel, not blocking, that listen at a plain endpoint: one for each address.

    It raises as `bind`.
    """
    endpoint = _prepared(endpoint)
    listeners: list[socket.socket] = []
    fault: OSError | None = None
    try:
        for family, address in _addresses(endpoint):
            try:
                listeners.append(_listener(family, address))
            except OSError as error:
                if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                    raise
                fault = error  # localhost may have an address that this host lacks, mostly that of IPv6
        if fault is not None and not listeners:
            raise fault
    except OSError as error:
        for sock in listeners:
            sock.close()
        raise _not_bound(endpoint, error) from None
    return listeners


def _listener(family: int, address: Any) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    try:
        # Accepted ones inherit it.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        if family != socket.AF_UNIX:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with _socket_umask():
            sock.bind(address)
        sock.listen(_BACKLOG)
    except OSError:
        sock.close()
        raise
    return sock


def stop_listening(sock: socket.socket) -> None:
    """Close a socket of `listen`, and remove its path."""
    if sock.family == socket.AF_UNIX and (path := sock.getsockname()):
        Path(path).unlink(missing_ok=True)
    sock.close()


def _prepared(endpoint: str) -> str:
    """Fill in the runtime directory, and make sure that an ipc path may be taken."""
    endpoint = filled(endpoint)
    path = Path(endpoint.removeprefix("ipc://")) if endpoint.startswith("ipc://") else None
    if path is None:
        return endpoint
    if _is_served(path):
        # Its socket must stay: a path that nobody serves is removed below.
        raise UnavailableError(f"{endpoint}: in use by another tactiled; give this one other endpoints")
    if path.is_socket():
        with contextlib.suppress(OSError):  # what a killed daemon left; if it stays, binding says why
            path.unlink()
    elif path.exists():
        # Binding would say that the endpoint is in use, or delete the file.
        raise OperatorError(f"{endpoint}: a file stands there that is no socket; name another path")
    return endpoint


@contextlib.contextmanager
def _socket_umask() -> Iterator[None]:
    """Bind with this umask: unlike chmod afterwards, it leaves no time in which others have access."""
    umask = os.umask(_SOCKET_UMASK)
    try:
        yield
    finally:
        os.umask(umask)


def _not_bound(endpoint: str, error: zmq.ZMQError | OSError) -> UnavailableError:
    if error.errno == errno.EADDRINUSE:
        port = endpoint.rsplit(":", 1)[-1]
        return UnavailableError(
            f"{endpoint}: in use, by another tactiled perhaps (see who: ss -tlnp 'sport = :{port}'); "
            "stop it, or give this one another port in endpoints"
        )
    return UnavailableError(f"{endpoint}: cannot be bound: {error.strerror}")


def _addresses(endpoint: str) -> list[tuple[int, Any]]:
    """Return family and address of the sockets of an endpoint."""
    transport, _, address = endpoint.partition("://")
    if transport == "ipc":
        return [(socket.AF_UNIX, address)]
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    found = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)
    return list(dict.fromkeys((family, where) for family, _, _, _, where in found))


def runtime_directory(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the directory for ipc sockets: that of systemd, or one of this user.

    `UnavailableError` if it cannot be created; `OperatorError` if another user owns it.
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
    """Return True when a process listens on a Unix socket (a killed daemon leaves its file)."""
    if len(os.fsencode(path)) > _LONGEST_PATH:
        raise ConfigError(
            "publish.endpoints",
            [f"{path}: longer than the {_LONGEST_PATH} bytes that a socket path may have"],
        )
    with socket.socket(socket.AF_UNIX) as probe, contextlib.suppress(OSError):
        probe.connect(str(path))
        return True
    return False
