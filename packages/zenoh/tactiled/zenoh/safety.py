"""Check of zenoh's configuration: no plaintext that other hosts can reach.

zenoh's defaults listen on all interfaces without encryption, and connect to whoever answers a multicast or is
named by a router (gossip). Here, what is not said in the file is off; what is said must be loopback, or
TLS with certificates of both sides.
"""

import ipaddress
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh

from tactiled.errors import ConfigError
from tactiled.outside import read_text
from tactiled.zenoh.session import DEFAULT_ROUTER, quiet_config, words_of

_ENCRYPTED = ("tls", "quic")
_CHECKED = ("enable_mtls", "verify_name_on_connect")  # settings in a locator come before those of the file
_OF_THIS_HOST = ("unixsock-stream", "unixpipe", "vsock")


def bridge_config(file: Path | None, connect: tuple[str, ...], *, is_insecure: bool) -> "zenoh.Config":
    """Make the configuration of a bridge from one of zenoh (JSON5).

    The locators `connect` replace those of the file; `is_insecure` accepts what other hosts can reach without
    certificates. `ConfigError` where the file cannot be read, or lists every place where plaintext would
    leave this host.
    """
    source = str(file or "zenoh")
    if file is not None:
        with suppress(OSError):  # zenoh says which
            read_text(file)  # zenoh itself reads a device without end
    try:
        config = quiet_config(file)
        if connect or file is None:
            config.insert_json5("connect/endpoints", json.dumps(connect or [DEFAULT_ROUTER]))
    except zenoh.ZError as error:
        raise ConfigError(source, [words_of(error)]) from None
    if not is_insecure and (faults := faults_of(config)):
        raise ConfigError(
            source, [*faults, "docs/fleet.md says how to make certificates; or give --insecure"]
        )
    return config


def faults_of(config: "zenoh.Config") -> list[str]:
    """Return what other hosts could reach or forge without a certificate, one line each."""
    mode = _value(config, "mode") or "peer"
    faults = []
    tls = _value(config, "transport/link/tls") or {}
    for way in ("listen", "connect"):
        if way == "listen" and mode == "client":
            continue  # a client listens nowhere
        for locator in _locators(_value(config, f"{way}/endpoints"), mode):
            if not is_wide(locator):
                continue
            if locator.split("/", 1)[0] not in _ENCRYPTED:
                faults.append(f"{way}/endpoints: {locator} is not encrypted and leaves this host: use tls/")
            elif way == "listen" and tls.get("enable_mtls") is not True:
                faults.append(
                    f"listen/endpoints: {locator} takes anyone: set transport/link/tls/enable_mtls to true"
                )
            elif way == "connect" and tls.get("verify_name_on_connect") is False:
                faults.append(f"connect/endpoints: {locator}: verify_name_on_connect must not be false")
            elif hidden := [name for name in _CHECKED if name in locator.partition("#")[2]]:
                faults.append(f"{way}/endpoints: {locator}: move {hidden[0]} to transport/link/tls")
    if _value(config, "scouting/multicast/enabled") is True:
        faults.append("scouting/multicast/enabled: any host of the network may answer: set it to false")
    if mode != "client" and _value(config, "scouting/gossip/enabled") is True:
        faults.append("scouting/gossip/enabled: it connects to whoever a router names: set it to false")
    return faults


def is_wide(locator: str) -> bool:
    """Return True when a locator such as ``tcp/127.0.0.1:7447`` leads to other hosts, or from them."""
    protocol, _, address = locator.partition("/")
    if protocol in _OF_THIS_HOST:
        return False
    host = address.split("?")[0].split("#")[0].rsplit(":", 1)[0].strip("[]")
    if host == "localhost":
        return False
    with suppress(ValueError):
        return not ipaddress.ip_address(host).is_loopback
    return True


def _value(config: "zenoh.Config", key: str) -> Any:
    return json.loads(config.get_json(key))


def _locators(value: Any, mode: str) -> list[str]:
    """Locators of one mode: zenoh takes a list, or a map from mode to list; each entry is a text or a map."""
    entries = value.get(mode, []) if isinstance(value, dict) else value or []
    return [entry["endpoint"] if isinstance(entry, dict) else str(entry) for entry in entries]
