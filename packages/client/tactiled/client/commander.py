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
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import msgpack
import zmq
import zmq.asyncio

from tactiled.client import nearby
from tactiled.client.items import Malformed
from tactiled.client.parse import parse_map
from tactiled.client.transports import RETRY_MS, Transport, open_requests
from tactiled.errors import DataError, OperatorError, UnavailableError
from tactiled.events.endpoints import control_endpoint
from tactiled.outside import json_of

TIMEOUT_S = 5.0  # a reply takes a millisecond; a daemon that is being restarted is back within this time
_LOOK_MS = 100  # between two looks at a request that may have to be repeated, over zenoh
# A request has at most 16,384 bytes (protocols/control.md); a bridge to zenoh adds some to them.
_MOST_BYTES = 16_128


@dataclass(frozen=True)
class Reply:
    """Reply of the daemon."""

    ok: bool
    reason: str  # for a refusal; empty where `ok`
    data: dict[str, Any]  # the whole map (protocols/control.md)


class _Request:
    """Request until it is answered, over a transport to `endpoint`."""

    def __init__(
        self, transport: Transport, endpoint: str, request: dict[str, Any], timeout_s: float
    ) -> None:
        self._transport, self._endpoint = transport, endpoint
        self._id, do = request["id"], request["do"]
        try:
            self._payload = msgpack.packb(request)
        except OverflowError:
            raise OperatorError(f"{do}: a whole number is beyond 64 bits (-2^63 to 2^64 - 1)") from None
        except ValueError as error:  # nested too deeply, or a lone surrogate
            raise OperatorError(f"{do}: a value cannot be sent: {error}") from None
        if len(self._payload) > _MOST_BYTES:
            raise OperatorError(f"{do}: {len(self._payload)} bytes, a request has at most {_MOST_BYTES}")
        self._until_s = time.monotonic() + timeout_s
        self._is_sent = False

    def advance(self) -> Reply | None:
        """Send it as soon as that is possible; return the reply once it has arrived.

        A refusal with an empty id is not taken: it may be of an earlier request.
        """
        self._is_sent = self._is_sent or self._transport.send(self._payload, self._until_s)
        while (payload := self._transport.take_reply()) is not None:
            data = parse_map(payload, "reply")
            if not isinstance(data, Malformed) and data.get("id") == self._id:
                return Reply(data.get("ok") is True, str(data.get("reason", "")), data)
        return None

    def wait_ms(self) -> int:
        """Return the time to wait before `advance`; raises OperatorError after the time limit.

        Where there never was a connection and the transport knows why, that is an UnavailableError.
        """
        left_s = self._until_s - time.monotonic()
        if left_s <= 0:
            if not self._is_sent and self._transport.fault:
                raise UnavailableError(self._transport.fault)
            raise OperatorError(f"{self._endpoint}: {_no_answer(self._endpoint)}")
        return min(max(1, round(1000 * left_s)), _LOOK_MS if self._is_sent else RETRY_MS)


def _no_answer(endpoint: str) -> str:
    """Return words on an endpoint that does not answer."""
    if not endpoint.startswith("ipc://"):
        return "no answer; is tactiled running there, and has it the key of this client?"
    try:
        Path(endpoint.removeprefix("ipc://")).stat()
    except OSError as error:
        return f"no answer: {error.strerror}; is tactiled running there?"
    return "no answer; is tactiled running there?"


class _Connected:
    """Transport of requests, with their numbers."""

    _make_context: type[zmq.Context[Any]] = zmq.Context

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
        self._transport = open_requests(
            self._make_context, self._endpoint, None if keys is None else Path(keys)
        )

    def _request(self, do: str, arguments: dict[str, Any], timeout_s: float) -> _Request:
        id_ = f"{self._name}-{next(self._numbers)}"
        request = {"v": 1, "id": id_, "do": do, "who": self._who, **arguments}
        return _Request(self._transport, self._endpoint, request, timeout_s)

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()


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

        `OperatorError` where none came in time. The command may have been carried out all the same.
        """
        request = self._request(do, arguments, timeout_s)
        poller = zmq.Poller()
        for pollable in self._transport.pollables:
            poller.register(pollable, zmq.POLLIN)
        while (reply := request.advance()) is None:
            poller.poll(request.wait_ms())
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
            Acceleration of the hand minus that of gravity, against the direction in which the object pulls at
            the skin: 9.81 for a hand at rest from which it hangs. At most 256 values.
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

    _make_context = zmq.asyncio.Context

    @cached_property
    def _one_at_a_time(self) -> asyncio.Lock:
        """Lock of tasks: a reply is read by whoever looks first."""
        return asyncio.Lock()

    async def send(self, do: str, timeout_s: float = TIMEOUT_S, **arguments: Any) -> Reply:
        """Send a request and wait for the reply; errors as for `Commander.send`.

        Requests of several tasks go one at a time; `timeout_s` counts from the turn of each.
        """
        async with self._one_at_a_time:
            request = self._request(do, arguments, timeout_s)
            poller = zmq.asyncio.Poller()
            for pollable in self._transport.pollables:
                poller.register(pollable, zmq.POLLIN)
            while (reply := request.advance()) is None:
                await poller.poll(request.wait_ms())
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

    `OperatorError` where a word has no ``=``.
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
