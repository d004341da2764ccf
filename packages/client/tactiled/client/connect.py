"""Sockets of a client for events and requests, with keys where the daemon requires them."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zmq

from tactiled.errors import ConfigError, DataError
from tactiled.events.codec import topic_of
from tactiled.events.endpoints import DEAD_PEER_OPTIONS, DEFAULT_ENDPOINT
from tactiled.outside import read_secret

_RECEIVE_HIGH_WATER = 2000  # as the publisher's: a pause of some 18 s loses nothing
_LARGEST_BYTES = (
    1 << 20
)  # the largest message has some 40 kB (4096 channels); libzmq disconnects from larger ones
_REQUEST_HIGH_WATER = 64
_RECONNECT_MS = 30  # requests wait for the connection to a daemon that restarts; libzmq's default is 100


def subscribe(
    sock: zmq.Socket[Any], endpoint: str, topics: Sequence[str], board: str | None, keys: Path | None
) -> None:
    """Set up a SUB socket and connect it; parameters and errors as for `Client`."""
    sock.setsockopt(zmq.RCVHWM, _RECEIVE_HIGH_WATER)
    if board is None:
        prefixes = ["tactile/"]  # the topic comes after the board, so the inbox filters by it
    else:
        wanted = {*topics, "status"} if topics else {""}
        prefixes = [topic_of(board, topic) for topic in sorted(wanted)] + [topic_of("", "status")]
    for prefix in prefixes:
        sock.setsockopt(zmq.SUBSCRIBE, prefix.encode())
    _connect(sock, endpoint, keys)


def ask(sock: zmq.Socket[Any], endpoint: str, keys: Path | None) -> None:
    """Set up a DEALER socket and connect it; it accepts requests only while it is connected."""
    sock.setsockopt(zmq.SNDHWM, _REQUEST_HIGH_WATER)
    sock.setsockopt(zmq.RCVHWM, _REQUEST_HIGH_WATER)
    sock.setsockopt(zmq.IMMEDIATE, 1)
    sock.setsockopt(zmq.RECONNECT_IVL, _RECONNECT_MS)
    _connect(sock, endpoint, keys)


def _connect(sock: zmq.Socket[Any], endpoint: str, keys: Path | None) -> None:
    sock.setsockopt(zmq.MAXMSGSIZE, _LARGEST_BYTES)
    sock.setsockopt(zmq.IPV6, 1)
    for name, value in DEAD_PEER_OPTIONS.items():
        sock.setsockopt(getattr(zmq, name), value)
    sock.setsockopt(zmq.LINGER, 0)
    if keys is not None:
        public, secret, daemon = _read_keys(keys)
        sock.setsockopt(zmq.CURVE_PUBLICKEY, public)
        sock.setsockopt(zmq.CURVE_SECRETKEY, secret)
        sock.setsockopt(zmq.CURVE_SERVERKEY, daemon)
    try:
        sock.connect(endpoint)
    except zmq.ZMQError as error:
        fault = f"{endpoint!r}: {error.strerror}; it should look like {DEFAULT_ENDPOINT}"
        raise ConfigError("endpoint", [fault]) from None


def _read_keys(path: Path) -> tuple[bytes, bytes, bytes]:
    """Keys in a file of `tactiled keys make`: public and secret of the client, public of the daemon."""
    try:
        document = tomllib.loads(read_secret(path))
        public, secret, daemon = (document[name] for name in ("public_key", "secret_key", "daemon_key"))
        keys = tuple(str(key).encode("ascii") for key in (public, secret, daemon))
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except (DataError, ValueError, KeyError, RecursionError) as error:  # no TOML, no ASCII, a key is missing
        raise ConfigError(str(path), [f"is no file of `tactiled keys make`: {error}"]) from None
    if any(len(key) != 40 for key in keys):
        raise ConfigError(str(path), ["a key has 40 characters"])
    return keys[0], keys[1], keys[2]
