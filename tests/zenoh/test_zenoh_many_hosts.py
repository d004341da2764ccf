"""A thousand hosts on one router of zenoh are listed by one request."""

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial

import msgpack
import pytest
import zenoh
from routers import free_port, router
from zenoh_threads import zenoh_threads

from tactiled.zenoh.fleet import FleetList

HOSTS_A_SESSION, SESSIONS = 50, 20
# As long as what a daemon replies: 2.2 kB (docs/fleet.md)
STATUS = {
    "state": "running", "valid": True, "reason": "", "warning": "x" * 2000, "age_s": 0.01, "scans": 999,
    "scans_missing": 1, "loss_known": True,
}  # fmt: skip

__all__ = ["zenoh_threads"]  # a fixture for every test here


def answer(host: str, query: zenoh.Query) -> None:
    messages = {"tactile/B1/status": {**STATUS, "timestamp": time.time()}}
    query.reply(f"tactile/{host}/control", msgpack.packb({"messages": messages}))


@contextmanager
def hosts_on(port: int) -> Iterator[None]:
    """Connect sessions to a router, each with the tokens and answers of many hosts."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    with ExitStack() as stack:
        for first in range(0, HOSTS_A_SESSION * SESSIONS, HOSTS_A_SESSION):
            session = stack.enter_context(zenoh.open(config))
            for host in (f"robot{number}" for number in range(first, first + HOSTS_A_SESSION)):
                stack.enter_context(session.liveliness().declare_token(f"tactile/{host}/control"))
                stack.enter_context(
                    session.declare_queryable(f"tactile/{host}/control", partial(answer, host))
                )
        yield


@pytest.mark.system
@pytest.mark.alone  # a list is given up after 2 s
def test_a_thousand_hosts_are_listed_and_fresh() -> None:
    port = free_port()
    with closing(router(port)), hosts_on(port):
        rows = FleetList(f"zenoh://127.0.0.1:{port}/*").ask()
    assert len({row.host for row in rows}) == HOSTS_A_SESSION * SESSIONS
    assert all(row.valid for row in rows)
