"""Access from other hosts: a folder of CURVE keys, and the ZAP server that checks clients against it.

::

    keys/daemon.toml          key pair of the daemon; the secret key stays in this file (mode 0600)
    keys/clients/NAME.toml    public key of each client that may connect; remove the file to deny it access

A client has one file (written once by `tactiled keys make NAME`) with its key pair and the public key of the
daemon, so that it does not accept a forged daemon.

CURVE (CurveZMQ, rfc.zeromq.org/spec/26) protects endpoints that other hosts can reach. Endpoints of this host
alone stay plain, because PlotJuggler has no CURVE; the kernel controls access to them.

libzmq asks a REP socket at ``inproc://zeromq.zap.01`` about each client (ZAP, rfc.zeromq.org/spec/27), and
accepts every client when none is bound there. The ZAP server is therefore bound before any endpoint. A
refused client gets no answer; only the log tells of it. A client without the public key of the daemon fails
before libzmq asks, and is in no log.
"""

import asyncio
import logging
import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zmq
import zmq.asyncio
from pydantic import Field
from zmq.utils import z85

from tactiled import tomlfile
from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.events.endpoints import DEAD_PEER_OPTIONS
from tactiled.limited_log import RateLimitedLog
from tactiled.outside import read_secret
from tactiled.tomlfile import Params

logger = logging.getLogger(__name__)

_ZAP = "inproc://zeromq.zap.01"
_ZAP_DOMAIN = b"tactiled"  # not empty: without a domain libzmq would not ask
_KEY = r"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}"  # Z85, rfc.zeromq.org/spec/32: 32 bytes
_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}"


class _Client(Params):
    public_key: str = Field(pattern=f"^{_KEY}$")


class _Pair(_Client):
    secret_key: str = Field(pattern=f"^{_KEY}$")


class KeyFolder:
    """Folder of the keys of one daemon."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._seen: tuple[tuple[str, int], ...] = ()
        self._names: dict[bytes, str] = {}

    def pair(self, environ: Mapping[str, str] = os.environ) -> tuple[bytes, bytes]:
        """Return public and secret key of the daemon, from systemd's credentials if the unit loads them.

        `ConfigError` if the file is missing, is invalid, or can be read by other users.
        """
        path = self.path / "daemon.toml"
        # Only root can read the file of root: LoadCredential= of the unit copies it for the daemon.
        loaded = Path(environ.get("CREDENTIALS_DIRECTORY", "/nonexistent")) / "daemon.toml"
        if loaded.exists():
            path = loaded
        try:
            document = tomllib.loads(read_secret(path, environ=environ))
        except OSError:
            raise ConfigError(str(path), ["cannot be read; make it with `tactiled keys make`"]) from None
        except (DataError, ValueError, RecursionError) as error:
            raise ConfigError(str(path), [f"is no file of `tactiled keys make`: {error}"]) from None
        pair = tomlfile.parse(document, _Pair, str(path))
        return pair.public_key.encode(), pair.secret_key.encode()

    def clients(self) -> dict[bytes, str]:
        """Return the names of the clients that may connect, by public key; invalid files are logged."""
        try:
            files = sorted((self.path / "clients").glob("*.toml"))
            seen = tuple((path.name, path.stat().st_mtime_ns) for path in files)
        except OSError as error:
            # The reason is enough, a traceback would not help the operator.
            logger.error("%s: no client is let in: %s", self.path / "clients", error.strerror)  # noqa: TRY400
            return {}
        if seen != self._seen:
            self._seen, self._names = seen, {}
            for path in files:
                try:
                    self._names[tomlfile.load(path, _Client).public_key.encode()] = path.stem
                except (ConfigError, OSError, UnicodeDecodeError) as error:
                    logger.error("client not let in: %s", error)  # noqa: TRY400  as above
        return self._names

    def make(self, name: str, carry_to: Path) -> None:
        """Make the key pair of a client (and that of the daemon, if there is none), and write its file.

        `OperatorError` if the name is invalid or in use, or a file cannot be written.
        """
        if not re.fullmatch(_NAME, name) or name == "daemon":
            raise OperatorError(f"{name!r}: name a client with letters, digits, '_', '.' and '-'")
        try:
            self.path.mkdir(mode=0o755, parents=True, exist_ok=True)
            (self.path / "clients").mkdir(mode=0o755, exist_ok=True)
            if not (self.path / "daemon.toml").exists():
                public, secret = zmq.curve_keypair()
                _write(self.path / "daemon.toml", 0o600, public_key=public, secret_key=secret)
            public, secret = zmq.curve_keypair()
            daemon_key, _ = self.pair()
            _write(carry_to, 0o600, public_key=public, secret_key=secret, daemon_key=daemon_key)
            try:
                _write(self.path / "clients" / f"{name}.toml", 0o644, public_key=public)
            except OSError:
                carry_to.unlink()  # the daemon would not accept this client
                raise
        except FileExistsError as error:
            raise OperatorError(f"{error.filename}: exists; remove it to make {name} anew") from None
        except OSError as error:
            raise OperatorError(f"{error.filename}: cannot be written: {error.strerror}") from None


def _write(path: Path, mode: int, **keys: bytes) -> None:
    """Write a new file that at no time has a wider mode."""
    text = "".join(f'{name} = "{key.decode()}"\n' for name, key in keys.items())
    path.touch(0o600, exist_ok=False)
    try:
        path.write_text(text, encoding="ascii")
        path.chmod(mode)  # independent of the umask
    except OSError:
        path.unlink()  # without all of its keys, it would still count as made
        raise


class CurveAuthenticator:
    """ZAP server that admits clients by their CURVE keys; make it before any socket is bound."""

    def __init__(self, context: zmq.Context[Any], keys: KeyFolder) -> None:
        self.context = context
        self._keys = keys
        self._public, self._secret = keys.pair()
        self.denied = RateLimitedLog(logger, "client denied")
        self.accepted = RateLimitedLog(logger, "client connected")
        self._socket = zmq.asyncio.Socket(context, zmq.REP)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.bind(_ZAP)

    def guard(self, sock: zmq.Socket[Any], longest_bytes: int) -> None:
        """Set up a socket, not bound yet, as a CURVE server that takes frames of at most `longest_bytes`."""
        sock.setsockopt(zmq.IPV6, 1)
        sock.setsockopt(zmq.MAXMSGSIZE, longest_bytes)
        for name, value in DEAD_PEER_OPTIONS.items():
            sock.setsockopt(getattr(zmq, name), value)
        sock.setsockopt(zmq.CURVE_SERVER, 1)
        sock.setsockopt(zmq.CURVE_PUBLICKEY, self._public)
        sock.setsockopt(zmq.CURVE_SECRETKEY, self._secret)
        sock.setsockopt(zmq.ZAP_DOMAIN, _ZAP_DOMAIN)

    async def run(self) -> None:
        """Answer ZAP requests until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            request = await self._socket.recv_multipart()
            await self._socket.send_multipart(self.answer(request, loop.time()))

    def answer(self, request: list[bytes], now_s: float) -> list[bytes]:
        """Return the ZAP reply to a ZAP request; never raises."""
        version, number = (*request, b"", b"")[:2]
        rest = request[2:]
        name = None
        address, key = "?", b""
        if version == b"1.0" and len(rest) == 5:
            domain, address_raw, _, mechanism, credentials = rest
            address = address_raw.decode(errors="replace").removeprefix("::ffff:")  # IPv4 on an IPv6 socket
            if domain == _ZAP_DOMAIN and mechanism == b"CURVE" and len(credentials) == 32:
                key = z85.encode(credentials)
                name = self._keys.clients().get(key)
        if name is None:
            shown = key.decode() or "none"
            self.denied.add(
                f"{address} with the key {shown}: no such key in {self._keys.path}/clients", now_s
            )
            return [b"1.0", number, b"400", b"Unknown key", b"", b""]
        self.accepted.add(f"{name} from {address}", now_s, logging.INFO)
        return [b"1.0", number, b"200", b"OK", name.encode(), b""]

    def close(self) -> None:
        """Close the ZAP socket."""
        self._socket.close()
