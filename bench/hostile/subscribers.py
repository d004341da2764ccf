"""Subscribers that subscribe without end, stall, flood or are idle; what a good one sees meanwhile."""

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import zmq

from bench.hostile.attack import Attack, Outcome
from bench.hostile.sensing import address_of, sensing
from tactiled.daemon.zmq import zmtp
from tactiled.events.endpoints import control_endpoint

_ATTACK_S = 10.0  # in the full form
_SUBSCRIBER = zmtp.GREETING + zmtp.ready("SUB")
_SUBSCRIPTIONS = 40_000
_PREFIX_BYTES = 250


def _connect(endpoint: str, data: bytes = b"") -> socket.socket:
    sock = socket.create_connection(address_of(endpoint))
    sock.sendall(data)
    return sock


@contextmanager
def _flood(send: Callable[[threading.Event], None]) -> Iterator[None]:
    """Send beside the block until its end."""
    end = threading.Event()
    thread = threading.Thread(target=send, args=(end,), name="attack")
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def _keep_sending(sock: socket.socket, pieces: Iterator[bytes], end: threading.Event) -> int:
    """Send pieces until they or the time come to an end; returns how many the daemon took."""
    sock.settimeout(0.1)
    n = 0
    for piece in pieces:
        rest = piece
        while rest and not end.is_set():
            with suppress(TimeoutError):
                rest = rest[sock.send(rest) :]
        if rest:
            return n
        n += 1
    return n


def _subscriptions(folder: Path, scale: float) -> Outcome:
    sent = 0

    def flood(end: threading.Event) -> None:
        nonlocal sent
        with _connect(world.tcp, _SUBSCRIBER) as sock:
            topics = (b"\1" + b"%08d" % k + bytes(_PREFIX_BYTES - 8) for k in range(_SUBSCRIPTIONS))
            sent = _keep_sending(sock, (zmtp.message(topic) for topic in topics), end)
            end.wait()

    with sensing(folder) as world:
        began_s = time.time()
        with _flood(flood):
            time.sleep(_ATTACK_S * scale)
        return world.outcome(began_s, scale, f"{sent} subscriptions sent by hand")


def _subscriptions_of_libzmq(folder: Path, scale: float) -> Outcome:
    n = int(_SUBSCRIPTIONS * scale)
    with sensing(folder) as world, zmq.Context() as context, context.socket(zmq.SUB) as sub:
        began_s = time.time()
        sub.linger = 0
        sub.connect(world.tcp)
        for k in range(n):
            sub.subscribe(b"%08d" % k + bytes(_PREFIX_BYTES - 8))
        time.sleep(_ATTACK_S * scale)
        return world.outcome(began_s, scale, f"{n} subscriptions of libzmq")


def _stalled(folder: Path, scale: float) -> Outcome:
    n = 60
    with sensing(folder) as world, ExitStack() as stack:
        began_s = time.time()
        for _ in range(n):
            stack.enter_context(_connect(world.tcp, _SUBSCRIBER + zmtp.message(b"\1")))
        time.sleep(2 * _ATTACK_S * scale)
        return world.outcome(began_s, scale, f"{n} subscribers that never read")


def _connections(folder: Path, scale: float) -> Outcome:
    n = 100
    with sensing(folder) as world, ExitStack() as stack:
        began_s = time.time()
        for _ in range(n):
            stack.enter_context(_connect(world.tcp, _SUBSCRIBER))
        time.sleep(_ATTACK_S * scale)
        context = stack.enter_context(zmq.Context())
        late = stack.enter_context(context.socket(zmq.SUB))
        late.linger = 0
        late.subscribe("tactile/")
        late.connect(world.tcp)
        is_heard = bool(late.poll(10_000))
        seen = f"{n} idle connections, a new subscriber {'hears' if is_heard else 'hears nothing'}"
        return world.outcome(began_s, scale, seen, held=is_heard)


def _garbage(folder: Path, scale: float) -> Outcome:
    n = 0

    def flood(end: threading.Event) -> None:
        nonlocal n
        while not end.is_set():
            with suppress(OSError), socket.create_connection(address_of(world.tcp)) as sock:
                sock.sendall(os.urandom(4096))
            n += 1

    with sensing(folder) as world:
        began_s = time.time()
        with _flood(flood):
            time.sleep(_ATTACK_S * scale)
        return world.outcome(began_s, scale, f"{n} connections with random bytes")


def _endless(folder: Path, scale: float) -> Outcome:
    sent = [0] * 4

    def flood(end: threading.Event) -> None:
        frames = (b"\1\xff" + bytes(255), b"\1\0", b"\2" + bytes(7) + b"\4\0" + bytes(1024), b"\0\1\1")
        with ExitStack() as stack:
            socks = [stack.enter_context(_connect(world.tcp, _SUBSCRIBER)) for _ in frames]
            huge = stack.enter_context(_connect(world.tcp, _SUBSCRIBER + b"\3" + b"\x7f" * 8))
            threads = [
                threading.Thread(target=one, args=(k, sock, frame * 256, end))
                for k, (sock, frame) in enumerate(zip(socks, frames, strict=True))
            ]
            for thread in threads:
                thread.start()
            huge.settimeout(1.0)
            with suppress(OSError):
                huge.sendall(bytes(2**22))
            for thread in threads:
                thread.join()

    def one(k: int, sock: socket.socket, piece: bytes, end: threading.Event) -> None:
        with suppress(OSError):
            sent[k] = len(piece) * _keep_sending(sock, iter(lambda: piece, None), end)

    with sensing(folder) as world:
        began_s = time.time()
        with _flood(flood):
            time.sleep(_ATTACK_S * scale)
        return world.outcome(began_s, scale, f"{sum(sent) / 1e6:.1f} MB taken of messages without an end")


def _requests(folder: Path, scale: float) -> Outcome:
    sent = 0

    def flood(end: threading.Event) -> None:
        nonlocal sent
        requester = zmtp.GREETING + zmtp.ready("DEALER")
        part = b"\3" + (16384).to_bytes(8) + bytes(16384)
        with _connect(control_endpoint(world.tcp), requester) as sock:
            sent = len(part) * _keep_sending(sock, iter(lambda: part, None), end)

    with sensing(folder) as world:
        began_s = time.time()
        with _flood(flood):
            time.sleep(_ATTACK_S * scale)
        return world.outcome(began_s, scale, f"{sent / 1e6:.1f} MB taken of one request")


_EXPECTED = "memory at most 150 MB, no scan lost, none 100 ms late"
ATTACKS: tuple[Attack, ...] = (
    Attack(
        "subscriptions", "40,000 subscriptions of 250 bytes, libzmq", _EXPECTED, _subscriptions_of_libzmq, 0.1
    ),
    Attack(
        "subscriptions by hand",
        "as many, as fast as they are taken, by hand",
        _EXPECTED,
        _subscriptions,
        None,
    ),
    Attack(
        "stalled subscribers", "60 that subscribe to everything and never read", _EXPECTED, _stalled, None
    ),
    Attack(
        "idle connections",
        "100 without a subscription, then a new subscriber",
        f"{_EXPECTED}; the new one hears",
        _connections,
        None,
    ),
    Attack("garbage greetings", "random bytes, again and again", _EXPECTED, _garbage, None),
    Attack(
        "endless messages", "a frame of 2^63 bytes, messages without a last part", _EXPECTED, _endless, 0.1
    ),
    Attack("endless requests", "a request without a last part", _EXPECTED, _requests, None),
)
