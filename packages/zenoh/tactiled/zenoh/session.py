"""Sessions with a zenoh network: endpoints such as ``zenoh://router:7447/robot7``, and the hosts there."""

import json
import re
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgpack
import zenoh

from tactiled.errors import ConfigError, UnavailableError
from tactiled.events.endpoints import ZENOH_SCHEME

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
_LONGEST_CHUNK = 128


@dataclass(frozen=True)
class ZenohAddress:
    """Parts of an endpoint ``zenoh://ROUTER:PORT/HOST``, and the file of the client that goes there."""

    router: str  # locator, such as ``tcp/router:7447``; empty: the file of the configuration has it
    host: str  # name under which `tactiled zenoh` publishes; ``*`` for all hosts
    config: Path | None  # configuration of zenoh (JSON5)

    @property
    def control(self) -> str:
        """Key of the questions."""
        return f"tactile/{self.host}/control"

    @property
    def command(self) -> str:
        """Key of the commands: one of its own, so that routers can tell who may use it."""
        return f"tactile/{self.host}/command"


def parse_address(endpoint: str, keys: Path | None = None) -> ZenohAddress:
    """Parse an endpoint.

    `keys` is a configuration of zenoh with the certificates of this client, with which the router is reached
    over TLS. `ConfigError` where the endpoint names no host, or has other faults.
    """
    form = f"it should look like {ZENOH_SCHEME}ROUTER:7447/HOST"
    try:
        url = urlsplit(endpoint)
        port = url.port
    except ValueError as error:
        raise ConfigError("endpoint", [f"{endpoint!r}: {error}; {form}"]) from None
    if not endpoint.startswith(ZENOH_SCHEME):
        raise ConfigError("endpoint", [f"{endpoint!r} is none of zenoh; {form}"])
    host = url.path.strip("/")
    if url.query or (not is_chunk(host) and host != "*"):
        raise ConfigError("endpoint", [f"{endpoint!r} names no host, or more than that; {form}"])
    router = DEFAULT_ROUTER if keys is None else ""
    if url.hostname:
        name = f"[{url.hostname}]" if ":" in url.hostname else url.hostname
        router = f"{'tcp' if keys is None else 'tls'}/{name}:{port or 7447}"
    return ZenohAddress(router, host, keys)


def is_chunk(name: str) -> bool:
    """Return True for a name that can stand between two slashes of a key of zenoh."""
    return 0 < len(name) <= _LONGEST_CHUNK and name.isprintable() and not set(name) & set("/*$?# @")


def chunk_of(name: str) -> str:
    """Return a name with ``-`` for the characters that have a meaning in keys of zenoh."""
    return "".join("-" if c in "*$?#@" else c for c in name)


def quiet_config(file: Path | None) -> "zenoh.Config":
    """Read a configuration of zenoh; where it does not say otherwise, a client that looks for nobody.

    `zenoh.ZError` where the file cannot be read.
    """
    config = zenoh.Config() if file is None else zenoh.Config.from_file(file)
    off = ((f"scouting/{way}/enabled", "false") for way in ("multicast", "gossip"))
    for key, value in (("mode", '"client"'), *off):
        if config.get_json(key) == "null":
            config.insert_json5(key, value)
    config.insert_json5("transport/shared_memory/enabled", "false")  # for payloads far larger than ours
    return config


def session_config(address: ZenohAddress) -> "zenoh.Config":
    """Make the configuration of a session in the mode `client`, which listens nowhere.

    `ConfigError` where the file cannot be read.
    """
    try:
        config = quiet_config(address.config)
        config.insert_json5("mode", '"client"')
        if address.router:
            config.insert_json5("connect/endpoints", json.dumps([address.router]))
    except zenoh.ZError as error:
        raise ConfigError(str(address.config or "endpoint"), [words_of(error)]) from None
    return config


def open_session(address: ZenohAddress) -> "zenoh.Session":
    """Open a session.

    `ConfigError` where the configuration cannot be read; `UnavailableError` where the router does not answer.
    """
    try:
        return zenoh.open(session_config(address))
    except zenoh.ZError as error:
        where = address.router or str(address.config)
        words = f"{where}: no session with a router of zenoh there: {words_of(error)}"
        raise UnavailableError(words) from None


def words_of(error: "zenoh.ZError") -> str:
    """Return the message of an error of zenoh, without the places in its source."""
    return re.sub(r"\s+at /\S+", "", str(error)).strip()


def states(
    endpoint: str, keys: Path | None, timeout_s: float
) -> dict[str, tuple[dict[str, Any] | None, float]]:
    """Return the replies of all hosts to ``state`` (protocols/control.md), each with the time it came.

    The time is that of the wall clock: a host that is slow does not make the others old. A host that is
    silent has None. The endpoint is ``zenoh://ROUTER:7447/*``, or has one host. `timeout_s` is for the
    slowest host. Tokens of bridge and boards make a host known.
    """
    address = parse_address(endpoint, keys)
    with open_session(address) as session:
        found: dict[str, tuple[dict[str, Any] | None, float]] = {}
        for reply in session.liveliness().get(f"tactile/{address.host}/*", timeout=timeout_s):
            if (sample := reply.ok) is not None:
                found.setdefault(str(sample.key_expr).split("/")[1], (None, time.time()))
        replies = session.get(
            address.control,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=msgpack.packb({"v": 1, "id": f"state-{session.zid()}", "do": "state"}),
            timeout=timeout_s,
        )
        for reply in replies:
            if (sample := reply.ok) is not None:
                with suppress(ValueError, msgpack.exceptions.UnpackException):
                    state = msgpack.unpackb(sample.payload.to_bytes())
                    found[str(sample.key_expr).split("/")[1]] = state, time.time()
        return found


def spread(endpoints: Sequence[str], keys: Path | None, timeout_s: float) -> tuple[str, ...]:
    """Replace endpoints of all hosts (``zenoh://ROUTER:7447/*``) by one for each host that is there now.

    `UnavailableError` where there is none, or the router does not answer.
    """
    found: list[str] = []
    for endpoint in endpoints:
        if not (endpoint.startswith(ZENOH_SCHEME) and endpoint.endswith("/*")):
            found.append(endpoint)
            continue
        hosts = sorted(states(endpoint, keys, timeout_s))
        if not hosts:
            raise UnavailableError(f"{endpoint}: no host of tactiled is on this network")
        found += [f"{endpoint[:-1]}{host}" for host in hosts]
    return tuple(found)
