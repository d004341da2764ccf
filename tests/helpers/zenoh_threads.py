"""Start of zenoh's threads, which the process keeps from its first sessions on."""

from contextlib import closing

import pytest
from routers import free_port, router

from tactiled.zenoh.session import open_session, parse_address


@pytest.fixture(scope="session", autouse=True)
def zenoh_threads() -> None:
    """Open and close two sessions, so that no test is blamed for what stays; imported by test modules."""
    port = free_port()
    with closing(router(port)), open_session(parse_address(f"zenoh://127.0.0.1:{port}/x")) as session:
        assert list(session.liveliness().get("x/*")) == []
