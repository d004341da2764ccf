"""Subscribers of every kind at one endpoint: those of libzmq, and strangers that send what they like."""

import asyncio
import contextlib
import logging
import socket
import struct
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest
import zmq
import zmq.asyncio
from boards import descriptors
from patience import PATIENCE_S
from ports import free_pair

from tactiled.daemon.zmq import peers, zmtp
from tactiled.daemon.zmq.publisher import BOUNDS, MOST_SUBSCRIPTIONS, QUEUE_BYTES, EventServer
from tactiled.daemon.zmq.zmtp import GREETING

SUBSCRIBE_ALL = zmtp.ready("SUB") + b"\x00\x01\x01"


class Endpoint:
    """Subscribers at an endpoint, and who connects to it."""

    def __init__(self, endpoint: str, log: pytest.LogCaptureFixture) -> None:
        self.endpoint = endpoint
        self.log = log
        self.server = EventServer()
        self.server.listen(endpoint)
        self.context = zmq.asyncio.Context()
        self.strangers: list[asyncio.StreamWriter] = []
        self.sockets: list[zmq.asyncio.Socket] = []

    def socket(self, kind: int = zmq.SUB) -> zmq.asyncio.Socket:
        sock = self.context.socket(kind)
        sock.linger = 0
        self.sockets.append(sock)
        return sock

    def connect(self, *prefixes: str, kind: int = zmq.SUB) -> zmq.asyncio.Socket:
        sock = self.socket(kind)
        for prefix in prefixes:
            sock.subscribe(prefix)
        sock.connect(self.endpoint)
        return sock

    async def stranger(self, data: bytes) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Connect without libzmq, and send some bytes."""
        if self.endpoint.startswith("ipc"):
            reader, writer = await asyncio.open_unix_connection(self.endpoint.removeprefix("ipc://"))
        else:
            host, _, port = self.endpoint.removeprefix("tcp://").rpartition(":")
            reader, writer = await asyncio.open_connection(host, int(port))
        self.strangers.append(writer)
        writer.write(data)
        return reader, writer

    async def heard(self, sub: zmq.asyncio.Socket, topic: str = "t") -> list[bytes]:
        """Publish on a topic until a subscriber hears it; returns all topics that it heard."""
        topics: list[bytes] = []
        while topic.encode() not in topics:
            self.server.send(topic.encode(), b"payload", "board")
            while await sub.poll(10):
                heard, payload = await sub.recv_multipart()
                assert payload == b"payload"
                topics.append(heard)
        return topics

    async def until_logged(self, words: str) -> None:
        while words not in self.log.text:
            await asyncio.sleep(0.005)


Play = Callable[[Callable[[Endpoint], Awaitable[None]]], None]


@pytest.fixture(params=["ipc", "tcp"])
def play(request: pytest.FixtureRequest, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> Play:
    caplog.set_level(logging.INFO)
    address = f"ipc://{tmp_path}/e.ipc" if request.param == "ipc" else f"tcp://127.0.0.1:{free_pair()}"

    def run(story: Callable[[Endpoint], Awaitable[None]]) -> None:
        async def main() -> None:
            endpoint = Endpoint(address, caplog)
            serving = asyncio.create_task(endpoint.server.run())
            try:
                async with asyncio.timeout(PATIENCE_S):
                    await story(endpoint)
                assert not serving.done()
            finally:
                for writer in endpoint.strangers:
                    writer.close()
                serving.cancel()
                await asyncio.gather(serving, return_exceptions=True)
                endpoint.server.close()
                for sock in endpoint.sockets:
                    sock.close()
                endpoint.context.term()

        before = descriptors()
        asyncio.run(main())
        assert descriptors() == before

    return run


def test_each_subscriber_receives_the_topics_that_it_asked_for(play: Play) -> None:
    async def story(endpoint: Endpoint) -> None:
        left, both, late = endpoint.connect("a/"), endpoint.connect("a/", "b/"), endpoint.connect()
        for topic in ("a/1", "b/1"):
            await endpoint.heard(both, topic)
        assert set(await endpoint.heard(left, "a/2")) <= {b"a/1", b"a/2"}
        late.subscribe("c/")
        await endpoint.heard(late, "c/1")
        late.unsubscribe("c/")
        late.subscribe("d/")
        await endpoint.heard(late, "d/1")  # the subscriptions before it have arrived
        for cancelled in (b"c/1", b"c/2"):
            endpoint.server.send(cancelled, b"payload", "board")
        assert set(await endpoint.heard(late, "d/2")) <= {b"d/1", b"d/2"}

    play(story)


def test_a_topic_that_was_published_reaches_those_who_subscribe_later(play: Play) -> None:
    async def story(endpoint: Endpoint) -> None:
        first = endpoint.connect("")
        await endpoint.heard(first, "t")
        second = endpoint.connect("")
        await endpoint.heard(second, "t")
        first.close()
        third = endpoint.connect("other")
        third.subscribe("t")
        await endpoint.heard(third, "t")
        await endpoint.heard(second, "t")

    play(story)


def test_an_xsub_and_a_peer_of_version_3_0_are_subscribers(play: Play) -> None:
    async def story(endpoint: Endpoint) -> None:
        xsub = endpoint.connect(kind=zmq.XSUB)
        await xsub.send(b"\x01t")
        await endpoint.heard(xsub)
        old = GREETING[:11] + b"\0" + GREETING[12:]
        reader, _ = await endpoint.stranger(old + SUBSCRIBE_ALL)
        await reader.readexactly(len(GREETING + zmtp.ready("PUB")))
        await endpoint.heard(xsub)
        expected = zmtp.message(b"t", b"payload")
        assert await reader.readexactly(len(expected)) == expected

    play(story)


def test_a_ping_is_answered(play: Play) -> None:
    async def story(endpoint: Endpoint) -> None:
        sub = endpoint.socket()
        sub.heartbeat_ivl, sub.heartbeat_timeout = 20, 5000
        sub.subscribe("")
        sub.connect(endpoint.endpoint)
        await endpoint.heard(sub)
        reader, _ = await endpoint.stranger(GREETING + zmtp.ready("SUB") + b"\x04\x0a\x04PING\x00\x0aabc")
        await reader.readexactly(len(GREETING + zmtp.ready("PUB")))
        assert await reader.readexactly(10) == zmtp.pong(b"abc")
        await endpoint.heard(sub)

    play(story)


def test_a_dropped_answer_to_a_ping_counts_for_no_board() -> None:
    ours, theirs = socket.socketpair()
    dropped: Counter[str] = Counter()
    with ours, theirs:
        peer = peers.Peer(ours, replace(BOUNDS, queue_bytes=50), dropped)
        peer.add(peers.Queued(zmtp.pong(b"abc")))
        peer.add(peers.Queued(zmtp.message(b"t", bytes(30)), "board"))
        peer.add(peers.Queued(zmtp.message(b"t", bytes(40)), "board"))
    assert dropped == {"board": 1}


@pytest.mark.parametrize("kind", [zmq.ROUTER, zmq.DEALER, zmq.REQ, zmq.PUSH, zmq.PUB, zmq.PAIR])
def test_another_socket_type_is_refused_with_the_reason(play: Play, kind: int) -> None:
    async def story(endpoint: Endpoint) -> None:
        endpoint.connect(kind=kind)
        await endpoint.until_logged(f"a socket '{zmq.SocketType(kind).name}' where SUB or XSUB may connect")

    play(story)


def test_too_many_subscriptions_are_ignored_and_the_first_ones_hold(play: Play) -> None:
    async def story(endpoint: Endpoint) -> None:
        greedy = endpoint.connect(*(f"t{k:04}" for k in range(MOST_SUBSCRIPTIONS + 50)))
        await endpoint.until_logged(f"{MOST_SUBSCRIPTIONS} subscriptions are the most")
        good = endpoint.connect("")
        await endpoint.heard(good, "other")
        last, beyond = (f"t{MOST_SUBSCRIPTIONS + k:04}" for k in (-1, 0))
        await endpoint.heard(greedy, "t0000")
        endpoint.server.send(beyond.encode(), b"payload", "board")
        assert set(await endpoint.heard(greedy, last)) <= {b"t0000", last.encode()}
        greedy.unsubscribe("t0000")  # makes room for another
        await asyncio.sleep(0.05)
        greedy.subscribe("again")
        await endpoint.heard(greedy, "again")

    play(story)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"GET /metrics HTTP/1.1\r\n\r\n", "no greeting of ZeroMQ"),
        (bytes(100_000), "no greeting of ZeroMQ"),
        (GREETING + b"\x04\xff" * 1000, "no READY"),
        (GREETING + zmtp.ready("SUB") + b"\x02" + b"\x7f" * 8, "9187201950435737471 bytes; 1024 are allowed"),
    ],
)
def test_a_stranger_is_closed_with_a_line_in_the_log(play: Play, data: bytes, says: str) -> None:
    async def story(endpoint: Endpoint) -> None:
        good = endpoint.connect("")
        reader, _ = await endpoint.stranger(data)
        with contextlib.suppress(ConnectionError):  # what we did not read resets the connection
            await reader.read()
        await endpoint.until_logged(says)
        await endpoint.heard(good)

    play(story)


def test_a_peer_that_never_greets_is_closed(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "HANDSHAKE_S", 0.1)

    async def story(endpoint: Endpoint) -> None:
        good = endpoint.connect("")
        await endpoint.heard(good)
        reader, _ = await endpoint.stranger(GREETING[:30])
        assert await reader.read() == GREETING
        await endpoint.until_logged("no handshake within 0.1 s")
        await endpoint.heard(good)

    play(story)


def test_idle_connections_make_room_and_subscribers_stay(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "MOST_PEERS", 4)

    async def story(endpoint: Endpoint) -> None:
        first = endpoint.connect("")
        await endpoint.heard(first)
        idle = [await endpoint.stranger(GREETING + zmtp.ready("SUB")) for _ in range(8)]
        await endpoint.until_logged("4 connections are open already")
        second = endpoint.connect("")
        await endpoint.heard(second)
        await idle[0][0].read()  # the oldest is closed
        while await first.poll(0):
            await first.recv_multipart()
        await endpoint.heard(first)
        assert len(descriptors()) < 100

    play(story)


def test_subscribers_in_every_place_refuse_the_next(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "MOST_PEERS", 2)

    async def story(endpoint: Endpoint) -> None:
        subs = [endpoint.connect(""), endpoint.connect("")]
        for sub in subs:
            await endpoint.heard(sub)
        reader, _ = await endpoint.stranger(GREETING + SUBSCRIBE_ALL)
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        await endpoint.until_logged("2 connections are open already")
        subs[0].close()
        await endpoint.heard(endpoint.connect(""))

    play(story)


def test_a_connection_that_is_reset_is_forgotten(play: Play) -> None:
    async def story(endpoint: Endpoint) -> None:
        good = endpoint.connect("")
        for data in (b"", GREETING, GREETING + SUBSCRIBE_ALL):
            _, writer = await endpoint.stranger(data)
            await endpoint.heard(good)
            raw = writer.get_extra_info("socket")
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            writer.transport.abort()
            for _ in range(3):
                await endpoint.heard(good)

    play(story)


def test_nothing_is_queued_for_a_subscriber_that_left(play: Play) -> None:
    async def story(endpoint: Endpoint) -> None:
        reader, writer = await endpoint.stranger(GREETING + zmtp.ready("SUB") + b"\x00\x02\x01g")
        good = endpoint.connect("t")
        while True:  # until the stranger has heard its topic
            await endpoint.heard(good)
            endpoint.server.send(b"gone", b"payload", "board")
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(reader.readuntil(b"gone"), 0.01)
                break
        writer.close()
        for _ in range(3):
            await endpoint.heard(good)
        for _ in range(3):
            endpoint.server.send(b"gone", bytes(QUEUE_BYTES // 2), "board")
        assert not endpoint.server.dropped

    play(story)
