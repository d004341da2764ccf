"""Events to ZeroMQ: exactly two frames each, never blocking, never in the way of the data.

A PUB socket drops for a subscriber that does not keep up, silently: so every message carries the number
of its topic, and the subscriber sees what it lost. ``CONFLATE`` is never set: it breaks two-frame messages.
"""

import contextlib
import ipaddress
import os
import socket
import stat
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import zmq
from pydantic import Field, model_validator

from tactiled.errors import ConfigError, OperatorError
from tactiled.events import codec
from tactiled.events.types import Event
from tactiled.tomlfile import Params

# A stalled subscriber may sleep for 2000 / (100 scans + 10 status per second) = 18 s before it loses
# anything, and costs us at most about 2 MB.
_SEND_HIGH_WATER = 2000
_LINGER_MS = 300  # enough for queued events to leave over loopback; a dead subscriber delays our end no more
_RUNTIME = "{runtime}"  # stands in an endpoint for the runtime directory


class PublishParams(Params):
    """Where events are offered."""

    endpoints: tuple[str, ...] = Field(
        default=("tcp://127.0.0.1:9872", f"ipc://{_RUNTIME}/events.ipc"),
        min_length=1,
        description="ZeroMQ endpoints to bind. 9872 is where PlotJuggler looks by itself; a second daemon on "
        "the host needs another port. {runtime} is /run/tactiled/NAME under systemd, else "
        "$XDG_RUNTIME_DIR/tactiled.",
    )
    allow_plaintext_on_network: bool = Field(
        default=False,
        description="Allow endpoints that other hosts can reach. Anyone there can read the events then, and "
        "nobody can tell ours from forged ones: only for a network that is yours alone.",
    )

    @model_validator(mode="after")
    def _reachable_only_if_meant(self) -> Self:
        for endpoint in self.endpoints:
            transport, _, address = endpoint.partition("://")
            if transport not in ("tcp", "ipc") or not address:
                raise ValueError(f"{endpoint}: not an endpoint; give tcp://127.0.0.1:PORT or ipc://PATH")
            if transport == "tcp" and not _is_loopback(address) and not self.allow_plaintext_on_network:
                raise ValueError(
                    f"{endpoint} can be reached from other hosts, unencrypted; use 127.0.0.1, or set "
                    "allow_plaintext_on_network = true"
                )
        return self


class Publisher:
    """The PUB socket, bound, and the running number of each topic.

    Raises
    ------
    OperatorError
        An endpoint cannot be bound; says what to do.
    """

    def __init__(self, params: PublishParams, environ: Mapping[str, str] = os.environ) -> None:
        self.dropped = 0
        """Messages that the socket itself refused; subscribers see them as lost."""
        self._next_seq: defaultdict[tuple[str, str], int] = defaultdict(int)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.SNDHWM, _SEND_HIGH_WATER)
        self._socket.setsockopt(zmq.LINGER, _LINGER_MS)
        self._socket.setsockopt(zmq.IPV6, 1)
        self._socket.setsockopt(zmq.HEARTBEAT_IVL, 1000)  # a subscriber that vanished is dropped in 3 s
        self._socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 3000)
        try:
            for endpoint in params.endpoints:
                self._bind(endpoint.replace(_RUNTIME, str(runtime_directory(environ))))
        except BaseException:
            self.close()
            raise

    def send(self, event: Event, *, board: str, unix_offset_s: float) -> None:
        """Publish one event now, or drop it; never waits."""
        key = (board, event.topic)
        seq = self._next_seq[key]
        self._next_seq[key] = seq + 1
        frames = codec.encode(event, seq=seq, board=board, unix_offset_s=unix_offset_s)
        try:
            self._socket.send_multipart(frames, zmq.NOBLOCK)
        except zmq.Again:
            self.dropped += 1

    def close(self) -> None:
        """Let queued events leave, then close."""
        self._socket.close()
        self._context.term()

    def _bind(self, endpoint: str) -> None:
        path = Path(endpoint.removeprefix("ipc://")) if endpoint.startswith("ipc://") else None
        if path is not None and _is_served(path):
            # libzmq would take the path away from the other daemon without a word.
            raise OperatorError(f"{endpoint}: in use by another tactiled; give this one other endpoints")
        try:
            self._socket.bind(endpoint)
            if path is not None:
                path.chmod(0o666)  # whoever may enter the directory may listen, as on loopback TCP
        except zmq.ZMQError as error:
            if error.errno == zmq.EADDRINUSE:
                port = endpoint.rsplit(":", 1)[-1]
                raise OperatorError(
                    f"{endpoint}: in use, by another tactiled perhaps (see who: ss -tlnp 'sport = :{port}'); "
                    "stop it, or give this one another port in endpoints"
                ) from None
            raise OperatorError(f"{endpoint}: cannot be bound: {error.strerror}") from None


def runtime_directory(environ: Mapping[str, str] = os.environ) -> Path:
    """Directory for our sockets: what systemd made for us, or one of our own for this user.

    Raises
    ------
    OperatorError
        It cannot be made, or someone else owns it.
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
        raise OperatorError(f"{directory}: cannot be made for our sockets: {error.strerror}") from None
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise OperatorError(f"{directory}: belongs to someone else; set XDG_RUNTIME_DIR to a folder of yours")
    return directory


def _is_loopback(address: str) -> bool:
    host = address.rsplit(":", 1)[0].strip("[]")
    if host in ("localhost", "lo"):
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


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
