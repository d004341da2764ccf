"""Endpoints of zenoh. No network."""

import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE_S

from tactiled.errors import ConfigError
from tactiled.zenoh.session import ZenohAddress, chunk_of, parse_address


@pytest.mark.parametrize(
    ("endpoint", "expected"),
    [
        ("zenoh://router/robot7", ZenohAddress("tcp/router:7447", "robot7", None)),
        ("zenoh://10.0.0.1:7000/robot7", ZenohAddress("tcp/10.0.0.1:7000", "robot7", None)),
        ("zenoh://[::1]:7000/*", ZenohAddress("tcp/[::1]:7000", "*", None)),
        ("zenoh:///robot7", ZenohAddress("tcp/127.0.0.1:7447", "robot7", None)),
    ],
)
def test_endpoints(endpoint: str, expected: ZenohAddress) -> None:
    assert parse_address(endpoint) == expected


def test_the_keys_of_a_client_are_its_configuration() -> None:
    keys = Path("k.json5")
    assert parse_address("zenoh://router/r", keys) == ZenohAddress("tls/router:7447", "r", keys)
    assert parse_address("zenoh:///r", keys) == ZenohAddress("", "r", keys)


@pytest.mark.parametrize(
    "endpoint",
    [
        "zenoh://",
        "nonsense",
        "tcp://127.0.0.1:9872/x",
        "zenoh://router",
        "zenoh://r/a/b",
        "zenoh://r:x/a",
        "zenoh://r/a$b",
        "zenoh://r/a?config=k.json5",
    ],
)
def test_endpoints_without_a_host_are_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="zenoh://"):
        parse_address(endpoint)


def test_boards_have_names_that_zenoh_takes() -> None:
    assert chunk_of("a*b$c?d#e@f") == "a-b-c-d-e-f"


def test_a_program_that_forgets_to_close_a_client_without_a_router_ends() -> None:
    code = "from tactiled.client import Subscription; Subscription('zenoh://127.0.0.1:9/robot', ('slip',))"
    subprocess.run([sys.executable, "-c", code], timeout=PATIENCE_S, check=True)
