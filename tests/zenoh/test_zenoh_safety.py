"""Configurations of zenoh that would let plaintext leave the host are refused."""

import json
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tactiled.errors import ConfigError
from tactiled.zenoh.safety import bridge_config, faults_of, is_wide

_MTLS = {"link": {"tls": {"enable_mtls": True}}}


def faults(document: dict[str, Any]) -> list[str]:
    return faults_of(zenoh.Config.from_json5(json.dumps(document)))


@pytest.mark.parametrize(
    ("locator", "wide"),
    [
        ("tcp/127.0.0.1:7447", False), ("tcp/[::1]:7447", False), ("tcp/localhost:7447", False),
        ("unixsock-stream//run/zenoh.sock", False), ("tcp/[::]:7447", True), ("tcp/0.0.0.0:7447", True),
        ("udp/10.0.0.1:7447", True), ("tls/robot7:7447", True), ("ws/example.org:80", True),
        ("tcp/10.0.0.1:7447#iface=lo", True), ("tcp/127.0.0.1:7447?rel=1", False), ("", True),
    ],
)  # fmt: skip
def test_what_other_hosts_reach(locator: str, wide: bool) -> None:
    assert is_wide(locator) is wide


@pytest.mark.parametrize(
    ("document", "named"),
    [
        ({"mode": "client", "connect": {"endpoints": ["tcp/10.0.0.1:7447"]}}, "tcp/10.0.0.1"),
        ({"mode": "peer"}, "tcp/[::]:0"),  # what zenoh listens at when nothing is said
        ({"mode": "router"}, "tcp/[::]:7447"),
        ({"mode": "router", "listen": {"endpoints": ["tls/[::]:7447"]}}, "enable_mtls"),
        ({"mode": "client", "scouting": {"multicast": {"enabled": True}}}, "multicast"),
        (
            {
                "mode": "peer",
                "listen": {"endpoints": ["tcp/127.0.0.1:0"]},
                "scouting": {"gossip": {"enabled": True}},
            },
            "gossip",
        ),
        (
            {
                "mode": "router",
                "listen": {"endpoints": ["tls/[::]:7447#enable_mtls=false"]},
                "transport": _MTLS,
            },
            "move enable_mtls",
        ),
        (
            {"mode": "client", "connect": {"endpoints": ["tls/10.0.0.1:7447#verify_name_on_connect=false"]}},
            "move verify_name_on_connect",
        ),
        ({"mode": "client", "connect": {"endpoints": {"client": ["ws/10.0.0.1:80"]}}}, "ws/10.0.0.1"),
    ],
)
def test_plaintext_to_other_hosts_is_refused(document: dict[str, Any], named: str, tmp_path: Path) -> None:
    assert [fault for fault in faults(document) if named in fault]
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps(document))
    with pytest.raises(ConfigError, match="--insecure"):
        bridge_config(file, (), is_insecure=False)
    assert bridge_config(file, (), is_insecure=True)


@pytest.mark.parametrize(
    "document",
    [
        {"mode": "client", "connect": {"endpoints": ["tls/10.0.0.1:7447"]}},
        {"mode": "router", "listen": {"endpoints": ["tls/[::]:7447"]}, "transport": _MTLS},
        {"mode": "peer", "listen": {"endpoints": ["tcp/127.0.0.1:0"]}},
        {"mode": "client", "scouting": {"gossip": {"enabled": True}}},  # a client connects to nobody else
        {"mode": "client", "listen": {"endpoints": ["tcp/0.0.0.0:7447"]}},  # a client listens nowhere
        {"mode": "client", "connect": {"endpoints": ["tcp/127.0.0.1:7447", "tls/10.0.0.1:7447"]}},
        {"mode": "client", "connect": {"endpoints": {"router": ["tcp/10.0.0.1:7447"], "client": []}}},
    ],
)
def test_certificates_loopback_and_what_is_not_used_are_accepted(document: dict[str, Any]) -> None:
    assert faults(document) == []


def test_without_a_file_nothing_is_searched_and_nothing_listens() -> None:
    config = bridge_config(None, (), is_insecure=False)
    assert json.loads(config.get_json("mode")) == "client"
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:7447"]


def test_a_file_that_is_none_ends_in_its_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.json5"):
        bridge_config(tmp_path / "missing.json5", (), is_insecure=False)


def test_every_place_of_plaintext_is_named() -> None:
    found = faults(
        {
            "mode": "router",
            "listen": {"endpoints": ["tcp/127.0.0.1:1", "tcp/0.0.0.0:1", "tls/0.0.0.0:2"]},
            "connect": {"endpoints": ["udp/10.0.0.1:3", "tls/10.0.0.1:4"]},
            "transport": {"link": {"tls": {"verify_name_on_connect": False}}},
            "scouting": {"multicast": {"enabled": True}},
        }
    )
    assert [(fault.split(": ")[0], fault.split(": ")[1].split(" ")[0]) for fault in found] == [
        ("listen/endpoints", "tcp/0.0.0.0:1"),
        ("listen/endpoints", "tls/0.0.0.0:2"),
        ("connect/endpoints", "udp/10.0.0.1:3"),
        ("connect/endpoints", "tls/10.0.0.1:4"),
        ("scouting/multicast/enabled", "any"),
    ]
    assert "verify_name_on_connect must not be false" in found[3]


def test_routers_that_are_named_replace_those_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"mode": "peer", "listen": {"endpoints": ["tcp/127.0.0.1:0"]}}))
    config = bridge_config(file, ("tcp/[::1]:7447",), is_insecure=False)
    assert json.loads(config.get_json("mode")) == "peer"
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/[::1]:7447"]
    for way in ("multicast", "gossip"):
        assert json.loads(config.get_json(f"scouting/{way}/enabled")) is False
    assert json.loads(config.get_json("transport/shared_memory/enabled")) is False
    kept = bridge_config(file, (), is_insecure=False)
    assert json.loads(kept.get_json("connect/endpoints")) != ["tcp/127.0.0.1:7447"]
