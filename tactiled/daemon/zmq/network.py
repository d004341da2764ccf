"""All ZeroMQ sockets of the daemon: for events, for requests, and for the authentication of other hosts.

A request costs at most some 0.3 ms, and the server takes at most `REQUESTS_PER_S`. A client that floods it
fills only its own queue, because ROUTER takes from its clients in turn. Nothing here is on the path from
board to subscriber, and the queues below bound the memory that a stalled client can occupy.

libzmq does not bound the subscriptions of a peer, nor the frames of a message before the last one has
arrived. A process of this host, or one with a key, can exhaust the memory in this way; ``MemoryMax=`` in the
unit and a restart limit the damage (protocols/control.md has the numbers).
"""

import asyncio
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import zmq
import zmq.asyncio

from tactiled.daemon.zmq.control import Control, Do, Settings
from tactiled.daemon.zmq.endpoints import bind, is_wide
from tactiled.daemon.zmq.publisher import Publisher, PublishParams, is_guarded
from tactiled.daemon.zmq.requests import LONGEST_BYTES, Requester
from tactiled.daemon.zmq.security import CurveAuthenticator, KeyFolder
from tactiled.events.endpoints import DEAD_PEER_OPTIONS

REQUESTS_PER_S = 500.0
_BURST = 50  # requests at once before the limit holds, for a client that catches up on every topic
_TELL_S = 1.0  # period of logging counts of repeated conditions
# Length of the queues of each client: 16 requests of at most 16 KiB, 16 replies of at most some 140 kB.
_HIGH_WATER = 16
# Frames of a request: identity, number of a correlating REQ, empty frame of a REQ, payload; one more is an
# error.
_MOST_FRAMES = 5
# Name that libzmq gives to an ipc peer: uid, gid and process id from the kernel (SO_PEERCRED).
# The name of a TCP peer is its IP address, which never has this form.
_LOCAL_PEER = re.compile(r"localhost:([0-9]{1,10}):[0-9]{1,10}:[0-9]{1,10}")


class Network:
    """Publisher and control server with their common context and authenticator.

    Parameters
    ----------
    params : PublishParams
    do, settings, boards : callable
        See `Control`.
    n_boards : int
        Number of boards whose messages are published.

    Raises
    ------
    ConfigError, OperatorError
        An endpoint cannot be bound, or there are no keys; the message says what to do.
    """

    def __init__(
        self,
        params: PublishParams,
        do: Do,
        settings: Settings,
        boards: Callable[[], Sequence[str]] = lambda: (),
        n_boards: int = 1,
        environ: Mapping[str, str] = os.environ,
    ) -> None:
        self._context: zmq.Context[Any] = zmq.Context()
        self._authenticator: CurveAuthenticator | None = None
        self._server: ControlServer | None = None
        try:
            if any(is_guarded(params, endpoint) for endpoint in (*params.endpoints, *params.control)):
                self._authenticator = CurveAuthenticator(self._context, KeyFolder(Path(params.keys or "")))
            self.publisher = Publisher(params, environ, self._context, self._authenticator, n_boards)
            self.control = Control(self.publisher, do, settings, boards)
            self._server = ControlServer(params, self.control, self._context, self._authenticator, environ)
        except BaseException:
            self.close()
            raise

    async def run(self) -> None:
        """Serve until cancelled."""
        async with asyncio.TaskGroup() as group:
            if self._authenticator is not None:
                group.create_task(self._authenticator.run())
            if self._server is not None:
                group.create_task(self._server.run())
            group.create_task(self.publisher.subscribers.run())
            loop = asyncio.get_running_loop()
            while True:  # also without endpoints
                self.control.bad.write_counts(loop.time())
                self.publisher.subscribers.refused.write_counts(loop.time())
                self.control.commanded.write_counts(loop.time())
                if self._authenticator is not None:
                    self._authenticator.denied.write_counts(loop.time())
                    self._authenticator.accepted.write_counts(loop.time())
                await asyncio.sleep(_TELL_S)

    def close(self) -> None:
        """Send queued events, then close all sockets."""
        if self._server is not None:
            self._server.close()
        if hasattr(self, "publisher"):
            self.publisher.close()
        if self._authenticator is not None:
            self._authenticator.close()
        self._context.term()


class ControlServer:
    """ROUTER sockets that pass requests to a `Control`.

    Parameters
    ----------
    params : PublishParams
    control : Control
    context : zmq.Context
    authenticator : CurveAuthenticator, optional
        Required for guarded endpoints.

    Raises
    ------
    OperatorError
        An endpoint cannot be bound; the message says what to do.
    """

    def __init__(
        self,
        params: PublishParams,
        control: Control,
        context: zmq.Context[Any],
        authenticator: CurveAuthenticator | None = None,
        environ: Mapping[str, str] = os.environ,
    ) -> None:
        self.unsent = 0
        """Number of replies that were not sent, because the client had left or did not read."""
        self._control = control
        # With a plain endpoint on the network anyone there may command, so a limit at loopback would protect
        # nothing.
        self._commands_over_tcp = params.allow_commands_over_tcp or any(
            is_wide(endpoint) and not is_guarded(params, endpoint) for endpoint in params.control
        )
        self._sockets: dict[bool, zmq.asyncio.Socket] = {}
        try:
            for endpoint in params.control:
                guarded = is_guarded(params, endpoint)
                if guarded not in self._sockets:
                    self._sockets[guarded] = _make(context, authenticator if guarded else None)
                bind(self._sockets[guarded], endpoint, environ)
        except BaseException:
            self.close()
            raise

    async def run(self) -> None:
        """Serve until cancelled."""
        async with asyncio.TaskGroup() as group:
            for sock in self._sockets.values():
                group.create_task(self._serve(sock))

    def close(self) -> None:
        """Close the sockets, without sending queued replies."""
        for sock in self._sockets.values():
            sock.close(0)

    async def _serve(self, sock: zmq.asyncio.Socket) -> None:
        loop = asyncio.get_running_loop()
        plain: zmq.Socket[bytes] = zmq.Socket.shadow(sock.underlying)
        ready_s = loop.time()
        while True:
            await sock.poll()
            frames = await _receive(plain)
            if frames:
                try:
                    self._take(plain, frames, loop.time())
                except Exception as error:  # a bug in the control channel must not stop sensing
                    self._control.bad.add(f"a fault of tactiled, please report it: {error!r}", loop.time())
            # The event loop runs between two requests, and their rate is limited.
            ready_s = max(ready_s, loop.time() - _BURST / REQUESTS_PER_S) + 1 / REQUESTS_PER_S
            await asyncio.sleep(max(0.0, ready_s - loop.time()))

    def _take(self, sock: zmq.Socket[bytes], frames: list[zmq.Frame], now_s: float) -> None:
        *envelope, payload = (frame.bytes for frame in frames)
        if len(frames) > _MOST_FRAMES - 1 or len(frames) < 2 or (len(frames) > 2 and envelope[-1]):
            self._control.bad.add(f"{len(frames) - 1} frames: send one", now_s)
            return

        def respond(reply: bytes) -> None:
            try:
                sock.send_multipart([*envelope, reply], zmq.NOBLOCK)
            except zmq.ZMQError:  # the client has left, or does not read its replies
                self.unsent += 1

        self._control.take(payload, self._requester(envelope[0], frames[-1]), now_s, respond)

    def _requester(self, routing_id: bytes, frame: zmq.Frame) -> Requester:
        key, peer = _property(frame, "User-Id"), _property(frame, "Peer-Address")
        uid = uid_of(peer)
        return Requester(
            connection=f"{routing_id.hex()} {peer}",
            key=key,
            uid=uid,
            address=peer.removeprefix("::ffff:") if uid < 0 else "",  # an IPv4 address in IPv6 notation
            may_command=bool(key) or uid >= 0 or self._commands_over_tcp,
        )


def uid_of(peer: str) -> int:
    """Return the user id of an ipc peer from its name in libzmq; -1 for another peer."""
    local = _LOCAL_PEER.fullmatch(peer)
    return -1 if local is None else int(local[1])


async def _receive(sock: zmq.Socket[bytes]) -> list[zmq.Frame]:
    """Receive one message, without frames beyond `_MOST_FRAMES`; empty when there is none."""
    frames: list[zmq.Frame] = []
    dropped = 0
    try:
        while not frames or frames[-1].more:
            frame = sock.recv(zmq.NOBLOCK, copy=False)
            if len(frames) == _MOST_FRAMES:
                frames.pop()
                dropped += 1
                if dropped % 100 == 0:
                    await asyncio.sleep(0)  # a million frames must not block the event loop
            frames.append(frame)
    except zmq.Again:
        pass
    return frames


def _property(frame: zmq.Frame, name: str) -> str:
    """Property of the sender as libzmq has it, empty for none; User-Id is the name of its key."""
    try:
        return str(frame.get(name))
    except zmq.ZMQError:
        return ""


def _make(context: zmq.Context[Any], authenticator: CurveAuthenticator | None) -> zmq.asyncio.Socket:
    sock = zmq.asyncio.Socket(context, zmq.ROUTER)
    sock.setsockopt(zmq.MAXMSGSIZE, LONGEST_BYTES)
    sock.setsockopt(zmq.RCVHWM, _HIGH_WATER)
    sock.setsockopt(zmq.SNDHWM, _HIGH_WATER)
    sock.setsockopt(zmq.ROUTER_MANDATORY, 1)  # so that a reply that cannot be sent is counted
    sock.setsockopt(zmq.HANDSHAKE_IVL, 5000)
    for name, value in DEAD_PEER_OPTIONS.items():
        sock.setsockopt(getattr(zmq, name), value)
    sock.setsockopt(zmq.LINGER, 0)
    sock.setsockopt(zmq.IPV6, 1)
    if authenticator is not None:
        authenticator.guard(sock)
    return sock
