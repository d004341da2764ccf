"""Ports on the emulator's side: a pty under a stable name, or a listening socket.

No call blocks. ``read`` returns b"" where there is nothing to read; ``write`` returns how many bytes the peer
took, whose buffer may be full: the others are lost.
"""

import contextlib
import errno
import os
import select
import socket
import tty
from pathlib import Path

from tactiled.errors import ConfigError

_READ_BYTES = 4096
_MOST_BYTES = 65536  # read at once from a host that does not stop writing


class PtyLink:
    """Pty with a symbolic link to its device, which is replaced in one step and removed at close.

    The device end is kept open here, so that the port stays while hosts come and go. It is raw: there is no
    echo and no line discipline before a host sets anything. `open` raises `ConfigError` where the path exists
    and is no symbolic link, or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._master = self._slave = -1
        self._device = ""

    def open(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._device = os.ttyname(self._slave)
        try:
            self._point()
        except OSError as error:
            self.close()
            raise ConfigError("link", [f"cannot make {self._path}: {error.strerror}"]) from None

    def close(self) -> None:
        if self._master < 0:
            return
        with contextlib.suppress(OSError):  # replaced by another emulator, or gone
            if str(self._path.readlink()) == self._device:
                self._path.unlink()
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def describe(self) -> dict[str, str]:
        return {"device": self._device, "link": str(self._path)}

    def fds(self) -> list[int]:
        return [self._master] if self._master >= 0 else []

    def read(self) -> bytes:
        try:
            return os.read(self._master, _READ_BYTES) if self._master >= 0 else b""
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        try:
            return os.write(self._master, data) if self._master >= 0 else 0
        except BlockingIOError:
            return 0

    def _point(self) -> None:
        """Make or replace the link in one step, so that a host never finds none."""
        path = self._path
        if path.exists() and not path.is_symlink():
            raise FileExistsError(0, "it exists and is no symbolic link")
        fresh = path.with_name(f".{path.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self._device)
        fresh.replace(path)


class SocketLink:
    """Listening socket for one peer at a time, at a path or at host and port.

    Port 0 takes a free port, which is kept when the port is unplugged. `open` raises `ConfigError` with the
    `option` that asked for the address where it is not available.
    """

    def __init__(self, option: str, address: Path | tuple[str, int]) -> None:
        self._option, self._address = option, address
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self.n_peers = 0
        """Peers that were accepted so far. A `read` that changes it gave the last bytes of the one before."""

    def open(self) -> None:
        try:
            self._listener = _listener(self._address)
        except OSError as error:
            words = f"cannot listen on {self.describe()['link']}: {error.strerror or error}"
            raise ConfigError(self._option, [words]) from None
        self._listener.setblocking(False)
        if not isinstance(self._address, Path):
            self._address = (self._address[0], self._listener.getsockname()[1])

    def close(self) -> None:
        self._hang_up()
        if self._listener is None:
            return
        self._listener.close()
        self._listener = None
        if isinstance(self._address, Path):
            self._address.unlink(missing_ok=True)

    def describe(self) -> dict[str, str]:
        if isinstance(self._address, Path):
            return {"link": f"unix://{self._address}"}
        host, port = self._address
        return {"link": f"socket://[{host}]:{port}" if ":" in host else f"socket://{host}:{port}"}

    def fds(self) -> list[int]:
        return [s.fileno() for s in (self._listener, self._client) if s is not None]

    def read(self) -> bytes:
        data = b""
        while self._client is not None and len(data) < _MOST_BYTES:
            try:
                chunk = self._client.recv(_READ_BYTES)
            except BlockingIOError:
                break
            except OSError:  # the peer hung up, or its host is gone
                chunk = b""
            data += chunk
            if not chunk:
                self._hang_up()
        self._accept()  # last, so that a host that has left makes room for the next one
        return data

    def write(self, data: bytes) -> int:
        if self._client is None:
            return 0
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._hang_up()
            return 0

    def _accept(self) -> None:
        """Accept a host; a second one is closed at once, as a busy port would do."""
        if self._listener is None or not select.select([self._listener], [], [], 0)[0]:
            return
        client, _ = self._listener.accept()
        if self._client is not None:
            client.close()
            return
        client.setblocking(False)
        if client.family != socket.AF_UNIX:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client
        self.n_peers += 1

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None


HostLink = PtyLink | SocketLink


def make_tcp_link(address: str) -> SocketLink:
    """Make a socket for the daemon at ``tcp://HOST:PORT``; `ConfigError` for other addresses."""
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    if not host or "/" in host or not port.isdecimal() or int(port) > 65535:
        raise ConfigError("command line", [f"tcp: {address!r} is not of the form tcp://HOST:PORT"])
    return SocketLink("tcp", (host.strip("[]"), int(port)))


def make_control_link(address: str) -> SocketLink:
    """Make a socket for a controller at ``unix:///PATH``; `ConfigError` for other addresses."""
    path = address.removeprefix("unix://")
    if not path or path == address:
        raise ConfigError("command line", [f"control: {address!r} is not of the form unix:///PATH"])
    return SocketLink("control", Path(path))


def _listener(address: Path | tuple[str, int]) -> socket.socket:
    """Listen at a path, in place of a socket that a killed emulator left, or at host and port."""
    if not isinstance(address, Path):
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        return socket.create_server(address, family=family)
    if address.is_socket():
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            if probe.connect_ex(str(address)) == 0:
                raise OSError(errno.EADDRINUSE, "another process listens there")
        address.unlink()
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(address))
    except OSError:
        listener.close()
        raise
    listener.listen()
    return listener
