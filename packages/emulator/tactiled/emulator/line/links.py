"""Links between emulator and host: a pty under a stable name, or a TCP listener."""

import contextlib
import os
import select
import socket
import tty
from pathlib import Path
from typing import Protocol

from tactiled.errors import ConfigError

_READ_BYTES = 4096
_MOST_BYTES = 65536  # read at once from a host that does not stop writing


class HostLink(Protocol):
    """Port on the emulator's side. No call blocks; bytes that the host does not take are lost."""

    def open(self) -> None: ...

    def close(self) -> None: ...

    def describe(self) -> dict[str, str]:
        """Address, for the report."""
        ...

    def fds(self) -> list[int]:
        """Descriptors to wait on for reading."""
        ...

    def read(self) -> bytes:
        """Read the bytes that the host wrote; b"" where there are none."""
        ...

    def write(self, data: bytes) -> int:
        """Write bytes, and return how many the host took: its buffer may be full."""
        ...


class PtyLink:
    """Pty with a symbolic link to its device, which is replaced in one step and removed at close.

    The device end is kept open here, so that the port stays while hosts come and go. It is raw: there is no
    echo and no line discipline before a host sets anything. Without a path the report has the name of the
    device. `open` raises `ConfigError` where the path exists and is no symbolic link, or cannot be made.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._master = self._slave = -1
        self._device = ""

    def open(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._device = os.ttyname(self._slave)
        if self._path is not None:
            try:
                self._point(self._path)
            except OSError as error:
                self.close()
                raise ConfigError("link", [f"cannot make {self._path}: {error.strerror}"]) from None

    def close(self) -> None:
        if self._master < 0:
            return
        with contextlib.suppress(OSError):  # replaced by another emulator, or gone
            if self._path is not None and str(self._path.readlink()) == self._device:
                self._path.unlink()
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def describe(self) -> dict[str, str]:
        return {"device": self._device, "link": str(self._path or self._device)}

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

    def _point(self, path: Path) -> None:
        """Make or replace the link in one step, so that a host never finds none."""
        if path.exists() and not path.is_symlink():
            raise FileExistsError(0, "it exists and is no symbolic link")
        fresh = path.with_name(f".{path.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self._device)
        fresh.replace(path)


class TcpLink:
    """TCP listener for one host at a time (``socket://HOST:PORT`` in pyserial).

    Port 0 takes a free port, which is kept when the port is unplugged. `open` raises `ConfigError` with the
    `option` that asked for the address where it is not available.
    """

    def __init__(self, option: str, host: str, port: int) -> None:
        self._option, self._host, self._port = option, host, port
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None

    def open(self) -> None:
        try:
            self._listener = socket.create_server((self._host, self._port))
        except OSError as error:
            words = f"cannot listen on {self._host}:{self._port}: {error}"
            raise ConfigError(self._option, [words]) from None
        self._listener.setblocking(False)
        self._port = self._listener.getsockname()[1]

    def close(self) -> None:
        self._hang_up()
        if self._listener is not None:
            self._listener.close()
        self._listener = None

    def describe(self) -> dict[str, str]:
        return {"link": f"socket://{self._host}:{self._port}"}

    def fds(self) -> list[int]:
        return [s.fileno() for s in (self._listener, self._client) if s is not None]

    def read(self) -> bytes:
        data = b""
        with contextlib.suppress(BlockingIOError):
            while self._client is not None and len(data) < _MOST_BYTES:
                try:
                    chunk = self._client.recv(_READ_BYTES)
                except ConnectionError:
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

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None


class UnixLink(TcpLink):
    """Unix socket for one peer at a time; its file is removed at close."""

    def __init__(self, option: str, path: Path) -> None:
        super().__init__(option, "", 0)
        self._path = path

    def open(self) -> None:
        if self._path.is_socket() and self._is_served():
            raise ConfigError(self._option, [f"cannot listen on {self._path}: another process listens there"])
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            if self._path.is_socket():
                self._path.unlink()  # left by an emulator that was killed
            listener.bind(str(self._path))
        except OSError as error:
            listener.close()
            why = error.strerror or str(error)
            raise ConfigError(self._option, [f"cannot listen on {self._path}: {why}"]) from None
        listener.listen()
        listener.setblocking(False)
        self._listener = listener

    def _is_served(self) -> bool:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            return probe.connect_ex(str(self._path)) == 0

    def close(self) -> None:
        if self._listener is not None:
            self._path.unlink(missing_ok=True)
        super().close()

    def describe(self) -> dict[str, str]:
        return {"link": f"unix://{self._path}"}


def make_link(link: Path | None, tcp: str | None) -> HostLink:
    """Make a pty of the name `link`, or a socket at `tcp`, which is ``tcp://HOST:PORT``.

    `ConfigError` where the address is of another form, or both are given.
    """
    if tcp is None:
        return PtyLink(link)
    if link is not None:
        raise ConfigError("command line", ["give either a link for a pty or a TCP address, not both"])
    return _tcp_link("tcp", tcp, "tcp://HOST:PORT")


def make_control_link(address: str) -> HostLink:
    """Make a socket for a controller at ``tcp://HOST:PORT`` or ``unix:///PATH``; `ConfigError` for others."""
    path = address.removeprefix("unix://")
    if path and path != address:
        return UnixLink("control", Path(path))
    return _tcp_link("control", address, "tcp://HOST:PORT or unix:///PATH")


def _tcp_link(option: str, address: str, form: str) -> TcpLink:
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    if not host or "/" in host or not port.isdecimal() or int(port) > 65535:
        raise ConfigError("command line", [f"{option}: {address!r} is not of the form {form}"])
    return TcpLink(option, host.strip("[]"), int(port))
