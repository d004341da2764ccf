"""Commands to the daemon, and their replies: `Commander`, `AsyncCommander`.

A command is sent once, as soon as the daemon is connected. Without a reply within the time limit it may have
been carried out, or not; the caller decides whether to send it again.
"""

import asyncio
import itertools
import secrets
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import msgpack
import zmq
import zmq.asyncio

from tactiled.client import nearby
from tactiled.client.items import Malformed
from tactiled.client.parse import parse_map
from tactiled.client.transports import connect_requests
from tactiled.errors import DataError, OperatorError
from tactiled.events.endpoints import ZENOH_SCHEME, control_endpoint
from tactiled.outside import json_of

if TYPE_CHECKING:
    from tactiled.client.over_zenoh import Caller

TIMEOUT_S = 5.0  # a reply takes a millisecond; a daemon that is being restarted is back within this time
# A request has at most 16,384 bytes (protocols/control.md); a bridge to zenoh adds some to them.
_MOST_BYTES = 16_128


@dataclass(frozen=True)
class Reply:
    """Reply of the daemon."""

    ok: bool
    reason: str  # for a refusal; empty where `ok`
    data: dict[str, Any]  # the whole map (protocols/control.md)


def _unanswered(endpoint: str) -> OperatorError:
    return OperatorError(
        f"{endpoint}: no answer; is tactiled running there, and has it the key of this client?"
    )


class _Request:
    """Request until it is answered."""

    def __init__(self, do: str, id_: str, rest: dict[str, Any], timeout_s: float) -> None:
        self.id = id_
        try:
            self.payload = msgpack.packb({"v": 1, "id": id_, "do": do, **rest})
        except OverflowError:
            raise OperatorError(f"{do}: a whole number is beyond 64 bits (-2^63 to 2^64 - 1)") from None
        except ValueError as error:  # nested too deeply, or a lone surrogate
            raise OperatorError(f"{do}: a value cannot be sent: {error}") from None
        if len(self.payload) > _MOST_BYTES:
            raise OperatorError(f"{do}: {len(self.payload)} bytes, a request has at most {_MOST_BYTES}")
        self.until_s = time.monotonic() + timeout_s

    def wait_ms(self, endpoint: str) -> int:
        """Return the time to wait for the reply, milliseconds; raises OperatorError after the time limit."""
        left_s = self.until_s - time.monotonic()
        if left_s <= 0:
            raise _unanswered(endpoint)
        return max(1, round(1000 * left_s))

    def reply(self, payload: bytes) -> Reply | None:
        """Return the reply to this request, or None for another message.

        A request that could not be read is refused with an empty id.
        """
        data = parse_map(payload, "reply")
        if isinstance(data, Malformed) or data.get("id") not in (self.id, ""):
            return None
        return Reply(data.get("ok") is True, str(data.get("reason", "")), data)


class _Connected:
    """Socket for requests, with their numbers."""

    def __init__(
        self,
        endpoint: str | None = None,
        who: str = "",
        control: str | None = None,
        keys: Path | str | None = None,
    ) -> None:
        self._who = who
        self._name = secrets.token_hex(4)  # a relay of several clients tells them apart by their ids
        self._numbers = itertools.count(1)
        if control is not None:
            self._endpoint = control
        elif endpoint is not None:
            self._endpoint = control_endpoint(endpoint)
        else:
            self._endpoint = nearby.control()
        self._caller: Caller | None = None
        if self._endpoint.startswith(ZENOH_SCHEME):
            from tactiled.client import over_zenoh  # zenoh is an extra

            self._caller = over_zenoh.Caller(self._endpoint, None if keys is None else Path(keys))
            return
        self._context = zmq.Context()
        self._socket: zmq.Socket[bytes] = self._context.socket(zmq.DEALER)
        try:
            connect_requests(self._socket, self._endpoint, None if keys is None else Path(keys))
        except BaseException:
            self.close()
            raise

    def _request(self, do: str, arguments: dict[str, Any], timeout_s: float) -> _Request:
        rest = {"who": self._who, **arguments}
        return _Request(do, f"{self._name}-{next(self._numbers)}", rest, timeout_s)

    def _call(self, caller: "Caller", request: _Request) -> Reply:
        """Send a request through zenoh, and wait for its reply."""
        payload = caller.call(request.payload, 1e-3 * request.wait_ms(self._endpoint))
        reply = None if payload is None else request.reply(payload)
        if reply is None:
            raise _unanswered(self._endpoint)
        return reply

    def close(self) -> None:
        """Close the connection."""
        if self._caller is not None:
            self._caller.close()
            return
        self._socket.close(linger=0)
        self._context.term()


class Commander(_Connected):
    """Send commands to a daemon, one at a time.

    Parameters
    ----------
    endpoint : str, optional
        Endpoint for events of the daemon, or ``zenoh://ROUTER:7447/HOST``; left out: the one daemon of this
        host, over ipc (`nearby`).
    who : str
        Name of this client, for the recording.
    control : str, optional
        Endpoint for requests; left out: derived from `endpoint` (`control_endpoint`).
    keys : path, optional
        File of this client from `tactiled keys make`.

    Raises
    ------
    ConfigError
        The endpoint is invalid, or the file has no keys.
    OperatorError
        No endpoint is given, and this host has no daemon, several, or one that this user may not command.

    Examples
    --------
    ::

        with Commander(who="left gripper") as daemon:
            daemon.send("inhibit", duration_s=0.4)  # our own motion must not count as slip
    """

    def send(self, do: str, timeout_s: float = TIMEOUT_S, **arguments: Any) -> Reply:
        """Send a request and wait for the reply.

        Raises
        ------
        OperatorError
            No reply came in time. The command may have been carried out all the same.
        """
        request = self._request(do, arguments, timeout_s)
        if self._caller is not None:
            return self._call(self._caller, request)
        while not self._socket.poll(request.wait_ms(self._endpoint), zmq.POLLOUT):
            pass  # until the daemon is connected, or the time limit
        self._socket.send(request.payload)
        while True:
            if self._socket.poll(request.wait_ms(self._endpoint)):
                reply = request.reply(self._socket.recv_multipart()[-1])
                if reply is not None:
                    return reply

    def announce_motion(
        self,
        acceleration_m_s2: float | Iterable[float],
        time_s: float | Iterable[float] | None = None,
        timeout_s: float = TIMEOUT_S,
        **arguments: Any,
    ) -> Reply:
        """Announce the motion of the hand itself to the detectors, with 10 to 1000 values a second.

        Parameters
        ----------
        acceleration_m_s2 : float or iterable of float
            Acceleration of the hand along the pull, gravity's part included: 9.81 for a hand at rest. At most
            256 values.
        time_s : float or iterable of float, optional
            Instant of each value by ``time.monotonic()`` of this program, never decreasing, within 1 s of
            now. A value holds for 0.1 s. Left out: one value, which counts from its arrival on.
        timeout_s, **arguments
            As for `send`, such as ``board``.
        """
        return self.send("motion", timeout_s, **arguments, **_motion(acceleration_m_s2, time_s))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class AsyncCommander(_Connected):
    """Send commands to a daemon from asyncio; parameters and errors as for `Commander`."""

    async def send(self, do: str, timeout_s: float = TIMEOUT_S, **arguments: Any) -> Reply:
        """Send a request and wait for the reply, one at a time; errors as for `Commander.send`."""
        request = self._request(do, arguments, timeout_s)
        if self._caller is not None:
            return await asyncio.to_thread(self._call, self._caller, request)
        sock: zmq.asyncio.Socket = zmq.asyncio.Socket(shadow=self._socket)
        # pyzmq's stub lacks the flags.
        while not await sock.poll(request.wait_ms(self._endpoint), zmq.POLLOUT):  # type: ignore[call-arg]
            pass  # as in `Commander.send`
        self._socket.send(request.payload)
        while True:
            if await sock.poll(request.wait_ms(self._endpoint)):
                reply = request.reply(self._socket.recv_multipart()[-1])
                if reply is not None:
                    return reply

    async def announce_motion(
        self,
        acceleration_m_s2: float | Iterable[float],
        time_s: float | Iterable[float] | None = None,
        timeout_s: float = TIMEOUT_S,
        **arguments: Any,
    ) -> Reply:
        """Announce the motion of the hand itself; see `Commander.announce_motion`."""
        return await self.send("motion", timeout_s, **arguments, **_motion(acceleration_m_s2, time_s))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


def _motion(
    acceleration_m_s2: float | Iterable[float], time_s: float | Iterable[float] | None
) -> dict[str, Any]:
    """Return the fields of the command ``motion``, with the present time where there are instants."""
    values = {"acceleration_m_s2": _numbers(acceleration_m_s2)}
    if time_s is None:
        return values
    return {**values, "time_s": _numbers(time_s), "sent_s": time.monotonic()}


def _numbers(values: float | Iterable[float]) -> list[float]:
    return [float(value) for value in (values if isinstance(values, Iterable) else (values,))]


def fields_of(do: str, words: Sequence[str]) -> dict[str, Any]:
    """Parse arguments of a request from words like ``speed_mm_s=5``; values are JSON, or else text.

    Raises
    ------
    OperatorError
        A word has no ``=``.
    """
    fields: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or not name:
            raise OperatorError(f"{word}: give FIELD=VALUE, as in speed_mm_s=5")
        try:
            fields[name] = json_of(text)
        except DataError:
            fields[name] = text
    return {"values": fields} if do == "thresholds" else fields
