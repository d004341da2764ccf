"""Daemon with many boards and no sensing: the real sockets, store and requests, with made events."""

import asyncio
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

from bench.native.publish import STATUS
from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.daemon.zmq.requests import CommandRequest, Requester
from tactiled.events.types import (
    ContactEvent,
    Event,
    GripEvent,
    InfoEvent,
    RecordingEvent,
    ScanEvent,
    SlipEvent,
)

STATUS_S = 0.1
INFO_S = 1.0
N_CHANNELS = 36
_TURN_S = 0.005
_INFO = InfoEvent(
    time_s=0.0, board_serial="", firmware_version="1.4.2", protocol="tactiled-36", protocol_version=2,
    array_id="wang2019-3x3", channels=N_CHANNELS, taxels=9, x_mm=tuple(3.5 * (k % 3) for k in range(9)),
    y_mm=tuple(3.5 * (k // 3) for k in range(9)), rate_hz=100.0,
    channel_names=tuple(f"T{k // 4}R{k % 4}" for k in range(N_CHANNELS)),
    volts_per_count=3.0 / 4096, channel_offset_s=(0.0,) * N_CHANNELS, tactiled_version="0.1.0",
    zero=(0.0,) * N_CHANNELS,
)  # fmt: skip
_RECORDING = RecordingEvent(
    time_s=0.0, state="recording", reason="", file="TS0001-20261122T120000.mcap", parts=3,
    bytes_written=123456789, free_mb=45678.0, reads_dropped=0, reads_waiting=0,
)  # fmt: skip
_SLIP = SlipEvent(
    time_s=0.0, state="onset", kind="incipient", onset_s=0.0, onset_sd_s=0.004, direction_deg=31.4,
    direction_sd_deg=2.7, confidence=0.93, taxels=(0, 1, 3, 4, 6, 7), detector="slip", statistic=31.2,
    threshold=12.1, valid=True, detected_s=0.0,
)  # fmt: skip
_SCAN = ScanEvent(
    time_s=0.0, index=1, volts=tuple(1.0 + 0.01 * k for k in range(N_CHANNELS)), valid=(True,) * N_CHANNELS,
    time_sd_s=2e-5, age_s=0.004, late=False,
)  # fmt: skip
_GRIP = GripEvent(time_s=0.0, state="sticking", utilisation=0.31, valid=True)
_CONTACT = ContactEvent(time_s=0.0, state="holding", previous="loading", taxels=tuple(range(9)), valid=True)


@dataclass(frozen=True)
class Rates:
    """Messages of one board in a second, beside status, info and recording.

    Attributes
    ----------
    slips_hz : float
        Onsets and ends together, each with a change of contact.
    scans_hz : float
        Scans with grip messages; 0 for none.
    """

    slips_hz: float = 1.0
    scans_hz: float = 0.0


@dataclass(frozen=True)
class _SimulatedBoard:
    """Board that does nothing on each command."""

    serial: str
    commands: list[CommandRequest]

    def settings(self, _: float) -> dict[str, Any]:
        return {}

    def do(self, request: CommandRequest, _requester: Requester, _now_s: float) -> str:
        self.commands.append(request)
        return ""


class SimulatedDaemon:
    """Daemon in a thread, for as long as the block lasts.

    Parameters
    ----------
    endpoint : str
        To bind; requests are taken beside it.
    boards : sequence of str
        Serial numbers.
    """

    def __init__(self, endpoint: str, boards: Sequence[str], rates: Rates) -> None:
        self.endpoint = endpoint
        self._boards = tuple(boards)
        self._rates = rates
        self._end = threading.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._main()), name="simulated daemon")
        self.slips = dict.fromkeys(boards, 0)
        """Number of slip messages sent, by board."""
        self.commands: list[CommandRequest] = []
        """Commands that were carried out, which is to do nothing."""

    def __enter__(self) -> Self:
        self._thread.start()
        if not self._ready.wait(10.0):
            raise RuntimeError("the simulated daemon did not start")
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def stop_slips(self) -> None:
        """Publish no further slips; all else goes on."""
        self._rates = replace(self._rates, slips_hz=0.0)

    async def _main(self) -> None:
        params = PublishParams(endpoints=(self.endpoint,))
        boards = [_SimulatedBoard(serial, self.commands) for serial in self._boards]
        network = Network(params, boards, len(boards))
        serving = asyncio.create_task(network.run())
        try:
            await self._publish(network)
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            network.close()

    async def _publish(self, network: Network) -> None:
        """Publish each kind of message at its rate, boards out of step with each other."""
        begin_s = time.monotonic()
        last_s = 0.0
        self._ready.set()
        while not self._end.is_set():
            await asyncio.sleep(_TURN_S)
            now_s = time.monotonic() - begin_s
            for number, board in enumerate(self._boards):
                phase = number / len(self._boards)
                self._publish_board(network.publisher, board, _Turn(last_s, now_s, phase), begin_s + now_s)
            last_s = now_s

    def _publish_board(self, publisher: Publisher, board: str, turn: "_Turn", now_s: float) -> None:
        offset_s = time.time() - now_s

        def send(*events: Event) -> None:
            for event in events:
                publisher.send(replace(event, time_s=now_s), board=board, unix_offset_s=offset_s)

        for _ in range(turn.count(self._rates.scans_hz)):
            send(_SCAN, _GRIP)
        for _ in range(turn.count(self._rates.slips_hz)):
            state: Literal["onset", "end"] = "end" if self.slips[board] % 2 else "onset"
            send(replace(_SLIP, onset_s=now_s, detected_s=now_s, state=state), _CONTACT)
            self.slips[board] += 1
        if turn.count(1 / INFO_S):
            send(replace(_INFO, board_serial=board), _RECORDING)
        if turn.count(1 / STATUS_S):
            send(replace(STATUS, uptime_s=turn.now_s, sent=publisher.sent(board)))


@dataclass(frozen=True)
class _Turn:
    """Time since the start at the last turn and now, and the phase of a board in periods."""

    last_s: float
    now_s: float
    phase: float

    def count(self, rate_hz: float) -> int:
        """Return how often something at this rate is due."""
        return math.floor(self.now_s * rate_hz + self.phase) - math.floor(self.last_s * rate_hz + self.phase)
