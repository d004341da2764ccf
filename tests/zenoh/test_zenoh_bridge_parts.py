"""Parts of the bridge without a network: waiting for a router, thinning, names."""

import itertools
import os
import time
from typing import Any

import pytest
import zenoh

from tactiled.zenoh import bridge as module
from tactiled.zenoh.bridge import RateLimit, host_name, key_of, wait_for_session


def test_topics_of_each_scan_are_thinned_to_the_rate_that_was_asked_for() -> None:
    limit = RateLimit(10.0)
    topics = (b"tactile/A/scan", b"tactile/B/scan")
    sent = [topic for n in range(1001) for topic in topics if limit.admits(topic, 50.0 + n / 100)]
    assert 100 <= sent.count(topics[0]) <= 102  # 10 s at 100 Hz
    assert sent.count(topics[1]) == sent.count(topics[0])


def test_a_pause_is_not_made_up_for() -> None:
    limit = RateLimit(10.0)
    admitted = [limit.admits(b"x", at_s) for at_s in (50.0, 60.0, 60.01, 60.02, 60.03, 60.11)]
    assert 3 <= sum(admitted) <= 4


def test_none_or_every_scan_is_sent() -> None:
    assert not any(RateLimit(0.0).admits(b"x", at_s) for at_s in (50.0, 60.0))
    limit = RateLimit(None)
    assert all(limit.admits(b"x", 50.0) for _ in range(5))


@pytest.mark.parametrize(
    ("topic", "key"),
    [
        (b"tactile/a*b/slip", "tactile/h/a-b/slip"),
        *((topic, None) for topic in (b"tactile/A", b"tactile//slip", b"tactile/A/b/slip", b"", b"a//")),
    ],
)
def test_what_is_no_topic_has_no_key(topic: bytes, key: str | None) -> None:
    assert key_of("h", topic) == key


def test_a_router_that_comes_later_is_found(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    tried: list[float] = []

    def open_(_: object) -> str:
        tried.append(time.monotonic())
        if len(tried) < 3:
            raise zenoh.ZError("nobody there")
        return "session"

    monkeypatch.setattr(module, "_RETRY_S", 0.2)
    monkeypatch.setattr(zenoh, "open", open_)
    config: Any = None
    assert wait_for_session(config) == "session"  # type: ignore[comparison-overlap]
    assert all(later - earlier >= 0.2 for earlier, later in itertools.pairwise(tried))
    assert len(caplog.messages) == 1  # one line for one reason


@pytest.mark.parametrize(("node", "name"), [("robot7.lab.example", "robot7"), ("", "host")])
def test_the_name_of_a_host_is_a_part_of_keys(node: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Uname:
        nodename = node

    monkeypatch.setattr(os, "uname", Uname)
    assert host_name() == name
