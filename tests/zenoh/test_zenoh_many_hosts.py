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


def client_of(port: int) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    return config


@contextmanager
def hosts_on(port: int) -> Iterator[None]:
    """Connect sessions to a router, each with the tokens and answers of many hosts."""
    config = client_of(port)
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


@pytest.mark.system
def test_a_daemon_that_hangs_makes_no_other_host_silent() -> None:
    """Its bridge keeps the request for longer than the others' statuses are recent."""
    port, kept = free_port(), list[zenoh.Query]()
    with (
        closing(router(port)),
        zenoh.open(client_of(port)) as session,
        session.liveliness().declare_token("tactile/robot1/control"),
        session.liveliness().declare_token("tactile/robot2/control"),
        session.declare_queryable("tactile/robot1/control", partial(answer, "robot1")),
        session.declare_queryable("tactile/robot2/control", kept.append),
    ):
        rows = FleetList(f"zenoh://127.0.0.1:{port}/*").ask()
        kept.clear()
    assert [(row.host, row.state, row.valid) for row in rows] == [
        ("robot1", "running", True),
        ("robot2", "silent", False),
    ]
