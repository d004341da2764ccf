"""Both kinds of subscription, and `listen`, against real sockets."""

import asyncio
import json
import math
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from messages import CONTACT, STATUS
from patience import PATIENCE_S

from tactiled.client import (
    Client,
    Fresh,
    Item,
    Lost,
    Malformed,
    Message,
    Recovered,
    Restarted,
    Stale,
    Subscription,
)
from tactiled.client.listen import listen
from tactiled.errors import ConfigError
from tactiled.events.codec import to_map
from tactiled.events.types import EVENT_TYPES


class Publisher:
    """A publisher in a thread: status at 20 Hz and a slip with each, until told otherwise."""

    def __init__(self, endpoint: str, run: int = 1) -> None:
        self.run = run
        self.extra: list[list[bytes]] = []
        self.silent = False
        self.skip = 0
        self._endpoint = endpoint
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        started_s, seq = time.monotonic(), 0
        with zmq.Context() as context, context.socket(zmq.PUB) as pub:
            pub.linger = 0
            pub.bind(self._endpoint)
            while not self._stop.wait(0.05):
                if self.silent:
                    continue
                seq += self.skip
                self.skip = 0
                head = {"v": 1, "timestamp": time.time(), "seq": seq, "board": "TS0001", "run": self.run}
                status = {"valid": True, "uptime_s": time.monotonic() - started_s, "age_s": 0.0}
                slip = {"state": "onset", "detected": head["timestamp"]}
                pub.send_multipart([b"tactile/TS0001/status", msgpack.packb(head | status)])
                pub.send_multipart([b"tactile/TS0001/slip", msgpack.packb(head | slip)])
                while self.extra:
                    pub.send_multipart(self.extra.pop())
                seq += 1


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"ipc://{tmp_path}/e.ipc"


@pytest.fixture
def publisher(endpoint: str) -> Iterator[Publisher]:
    running = Publisher(endpoint)
    yield running
    running.close()


@contextmanager
def limit(seconds: int = round(PATIENCE_S)) -> Iterator[None]:
    """Blocking reads have no timeout of their own: break them off."""

    def out_of_time(*_: object) -> None:
        raise AssertionError("it never came")

    before = signal.signal(signal.SIGALRM, out_of_time)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


async def collect(client: Client, enough: Callable[[Item], bool]) -> list[Item]:
    items: list[Item] = []
    async with asyncio.timeout(PATIENCE_S):
        async for item in client:
            items.append(item)
            if enough(item):
                break
    return items


def test_asyncio_client_from_fresh_over_loss_and_silence_to_restart(endpoint: str) -> None:
    async def scenario() -> None:
        publisher = Publisher(endpoint)
        try:
            async with Client(endpoint, topics=("slip",)) as client:
                await collect(client, lambda item: isinstance(item, Message))
                await collect(client, lambda _: client.fresh)
                publisher.skip = 7
                lost = (await collect(client, lambda item: isinstance(item, Lost)))[-1]
                assert lost == Lost("slip", "TS0001", 7)
                publisher.silent = True
                while client.fresh:
                    items = await collect(client, lambda item: isinstance(item, Stale))
                    assert isinstance(items[-1], Stale)
                await asyncio.to_thread(publisher.close)
                publisher = Publisher(endpoint, run=2)
                items = await collect(client, lambda item: isinstance(item, Fresh))
                assert Restarted("TS0001") in items
                assert client.fresh
        finally:
            await asyncio.to_thread(publisher.close)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(scenario())


@pytest.mark.usefixtures("publisher")
def test_a_cancelled_wait_loses_nothing(endpoint: str) -> None:
    async def scenario() -> None:
        async with Client(endpoint, topics=("slip",)) as client:
            seen: list[int] = []
            while len(seen) < 10:
                try:
                    async with asyncio.timeout(0.013):
                        item = await anext(client)
                except TimeoutError:
                    continue
                if isinstance(item, Message):
                    seen.append(item.seq)
            assert seen == list(range(seen[0], seen[0] + 10))
            assert client.lost == 0

    asyncio.run(asyncio.wait_for(scenario(), PATIENCE_S))


@pytest.mark.usefixtures("publisher")
def test_messages_without_asyncio(endpoint: str) -> None:
    with limit(), Subscription(endpoint, topics=("slip",), board="TS0001") as events:
        items = iter(events.next_item, None)
        messages = list(islice((item for item in items if isinstance(item, Message)), 8))
    assert {m.topic for m in messages} == {"slip"}
    assert 0.0 <= messages[0].age_s < PATIENCE_S


def test_a_wait_of_limited_length(endpoint: str) -> None:
    began_s = time.monotonic()
    with limit(), Subscription(endpoint, stale_after_s=0.1) as subscription:
        assert isinstance(subscription.next_item(began_s + PATIENCE_S), Stale)
        assert subscription.next_item(time.monotonic() + 0.05) is None
        assert time.monotonic() - began_s >= 0.15


def test_what_has_arrived_is_read_at_once_and_of_some_topics_the_newest(
    endpoint: str, publisher: Publisher
) -> None:
    with limit(), Subscription(endpoint) as subscription:
        assert isinstance(subscription.next_item(time.monotonic() + PATIENCE_S), Fresh | Message)
        head = {"v": 1, "timestamp": time.time(), "run": 1}
        publisher.extra += [
            [f"tactile/{board}/grip".encode(), msgpack.packb(head | {"board": board, "seq": seq})]
            for seq in reversed(range(5))
            for board in ("TS0002", "TS0001")
        ]
        while publisher.extra:
            time.sleep(0.01)
        time.sleep(0.5)
        items = subscription.arrived(1000, frozenset({"grip"}))
    found = [item for item in items if isinstance(item, Message)]
    assert [(item.board, item.seq) for item in found if item.topic == "grip"] == [
        ("TS0001", 4),
        ("TS0002", 4),
    ]
    slips = [item.seq for item in found if item.topic == "slip"]
    assert len(slips) > 2
    assert slips == [*range(slips[0], slips[0] + len(slips))]
    assert not any(isinstance(item, Lost) for item in items)


def test_what_has_arrived_waits_for_a_topic_and_is_then_read_in_order(
    endpoint: str, publisher: Publisher
) -> None:
    with limit(), Subscription(endpoint) as subscription:
        assert isinstance(subscription.next_item(time.monotonic() + PATIENCE_S), Fresh | Message)
        for _ in range(5):
            time.sleep(0.05)
            assert subscription.arrived(1000, only_with=frozenset({"contact"})) == []
        head = {"v": 1, "timestamp": time.time(), "run": 1, "board": "TS0001", "seq": 0}
        publisher.extra.append([b"tactile/TS0001/contact", msgpack.packb(head)])
        items: list[Item] = []
        until_s = time.monotonic() + PATIENCE_S
        while not items and time.monotonic() < until_s:
            items = subscription.arrived(1000, only_with=frozenset({"contact"}))
            time.sleep(0.01)
    slips = [item.seq for item in items if isinstance(item, Message) and item.topic == "slip"]
    assert len(slips) > 2
    assert slips == [*range(slips[0], slips[0] + len(slips))]
    assert "contact" in [item.topic for item in items if isinstance(item, Message)]
    assert not any(isinstance(item, Lost) for item in items)


def test_a_hostile_message_is_an_item_like_any_other(endpoint: str, publisher: Publisher) -> None:
    with limit(), Subscription(endpoint, topics=("slip",)) as subscription:
        while not isinstance(subscription.next_item(), Message):
            pass
        publisher.extra.append([b"tactile/TS0001/slip", b"\xc1\xff"])
        while not isinstance(subscription.next_item(), Malformed):
            pass
        while not isinstance(subscription.next_item(), Message):
            pass
        assert subscription.malformed == 1


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        (("grip", "slips"), f"no topic 'slips'; there are: {', '.join(EVENT_TYPES)}"),
        ("slip", "'slip' is a string; write a tuple of topics: ('slip',)"),
        ("", "'' is a string"),
    ],
)
@pytest.mark.parametrize("kind", [Client, Subscription])
def test_topics_that_would_never_come_are_refused(kind: Any, topics: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"topics: {words}")):
        kind("tcp://127.0.0.1:1", topics)


@pytest.mark.usefixtures("publisher")
def test_topics_may_be_any_iterable(endpoint: str) -> None:
    with limit(), Subscription(endpoint, iter(("status",))) as subscription:  # type: ignore[arg-type]
        until_s = time.monotonic() + 1.0
        items = [subscription.next_item(until_s) for _ in range(4)]
    assert {item.topic for item in items if isinstance(item, Message)} == {"status"}


def test_every_topic_of_the_daemon_is_known() -> None:
    topics: Any = [*EVENT_TYPES]
    Client("tcp://127.0.0.1:1", topics)
    with Subscription("tcp://127.0.0.1:1", topics, stale_after_s=0.0) as subscription:
        assert isinstance(subscription.next_item(), Stale)


@pytest.mark.parametrize("endpoint", ["9872", "tcp://127.0.0.1", "warp://x", ""])
def test_an_invalid_endpoint_is_a_config_error(endpoint: str) -> None:
    async def enter() -> None:
        async with Client(endpoint):
            pass

    with pytest.raises(ConfigError, match=r"endpoint: .*it should look like tcp://127\.0\.0\.1:9872"):
        Subscription(endpoint)
    with pytest.raises(ConfigError, match="it should look like"):
        asyncio.run(enter())


@pytest.mark.usefixtures("publisher")
def test_listen_prints_json_lines_until_it_has_its_count(
    endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with limit():
        assert listen(endpoint, ("slip",), count=3, timeout_s=PATIENCE_S) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["topic"] for row in rows] == ["slip"] * 3
    assert rows[0]["state"] == "onset"


@pytest.mark.usefixtures("publisher")
def test_listen_ends_when_the_time_is_up(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with limit():
        assert listen(endpoint, ("texture",), timeout_s=0.3) == 1
        duration_s = 0.5
        while listen(endpoint, ("slip",), timeout_s=duration_s) == 1:
            duration_s *= 2  # nothing came yet on this host
        assert listen(endpoint, ("slip",), count=10_000, timeout_s=0.3) == 1
    said = capsys.readouterr().err
    assert "0 messages in 0.3 s" in said
    assert "fresh" in said


def test_listen_ends_when_messages_come_faster_than_they_are_printed(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Subscription, "next_item", lambda *_: Fresh())
    with limit():
        assert listen(endpoint, timeout_s=0.1) == 1


def sent(topic: str, data: dict[str, Any]) -> Message:
    return Message(topic, "TS1", 0, 0.0, data, 0.0, 0.0, 0.0)


def test_listen_prints_no_line_that_is_no_json(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    items = iter([*(sent("grip", {"load": load}) for load in (math.nan, b"\0", math.inf, 1.5)), None])
    monkeypatch.setattr(Subscription, "next_item", lambda *_: next(items))
    assert listen(endpoint, timeout_s=1.0) == 0
    out, err = capsys.readouterr()
    assert out == '{"topic": "grip", "load": 1.5}\n'
    assert err.count("malformed: grip contains a value that JSON cannot represent") == 3


def test_listen_in_words_prints_a_line_for_an_event_and_none_for_scans(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    contact = to_map(CONTACT, seq=0, board="TS1", unix_offset_s=0.0)
    status = to_map(STATUS, seq=0, board="TS1", unix_offset_s=0.0)
    items = iter([
        Fresh(), sent("status", status), sent("contact", contact), Recovered(sent("contact", contact)),
        sent("contact", {**contact, "state": 5}), Stale("\x1b[2J", 0.5), None,
    ])  # fmt: skip
    monkeypatch.setattr(Subscription, "next_item", lambda *_: next(items))
    with limit():
        assert listen(endpoint, timeout_s=1.0, as_json=False) == 0
    out, err = capsys.readouterr()
    said = [re.fullmatch(r"\d\d:\d\d:\d\d\.\d{3}  (.*)", line) for line in out.splitlines()]
    assert [line and line[1] for line in said] == [
        "contact none -> loading",
        "contact none -> loading (recovered)",
    ]
    words = [line.split("  ")[-1] for line in err.splitlines()]
    assert words == [
        "fresh: the board runs", "malformed: contact: state is 5", "stale: ?[2J", "3 messages in 1 s",
    ]  # fmt: skip


@pytest.mark.usefixtures("publisher")
def test_listen_ends_when_its_reader_closes_the_pipe(endpoint: str) -> None:
    code = f"import sys; from tactiled.client.listen import listen; sys.exit(listen({endpoint!r}, ('slip',)))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        assert json.loads(child.stdout.readline())["topic"] == "slip"
        child.stdout.close()
        words = child.stderr.read()
        assert child.wait(PATIENCE_S) == 0
    assert "Traceback" not in words
    assert "Exception" not in words
