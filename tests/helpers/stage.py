"""A publisher of events of a scene that are computed before: it needs little of a processor."""

import functools
import itertools
import math
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zmq
from messages import STATUS
from numpy.typing import NDArray
from recordings import SOURCE, simulated_reads

from tactiled.events.codec import encode
from tactiled.events.types import (
    ContactEvent,
    ContactState,
    Event,
    ForceEvent,
    InfoEvent,
    ScanEvent,
    SlipEvent,
    StatusEvent,
)
from tactiled.pipeline import Pipeline

PAUSE_S = 3.0  # between two plays, without a board
N_PER_V = 1.5  # of a calibration in which load and shear have one scale
_STATUS_S = 0.1
_SUBSCRIBED_MS = 100  # without a further subscription: the first subscriber has all its topics
_LAST_S = 0.1  # of a play, played again and again by a board that holds

Then = Literal["again", "gone", "hold", "gap"]
"""After a play: the next one, after a pause without a board; no board; its last instants for ever; or the
pause, one more play, and its last instants for ever."""


@functools.lru_cache
def events_of(scene: str, duration_s: float) -> tuple[tuple[float, Event], ...]:
    """Events of a scene with the instants at which a daemon would publish them, seconds from its start."""
    pipeline = Pipeline(SOURCE.layout, SOURCE.array)
    reads = simulated_reads(duration_s, scene)
    origin_s = reads[0].arrival_s
    return tuple(
        (read.arrival_s - origin_s, _at_origin(event, origin_s))
        for read in reads
        for event in pipeline.receive_data(read.data, read.arrival_s)
        if isinstance(event, Event)
    )


def _at_origin(event: Event, origin_s: float) -> Event:
    """Event with its instants from the start of the scene on."""
    shifted = {
        name: getattr(event, name) - origin_s
        for name in ("time_s", "onset_s", "detected_s", "answered_s")
        if hasattr(event, name)
    }
    return replace(event, **shifted)


@functools.cache
def _weights() -> NDArray[np.float64]:
    """Weights of the readings in the shears along x and y and the load of the whole array."""
    array = SOURCE.array
    return np.array([weights.sum(axis=0) for weights in (*array.shear_weights(), array.normal_weights())])


def info(array_id: str = "wang2019-3x3") -> InfoEvent:
    array = SOURCE.array
    return InfoEvent(
        time_s=0.0, board_serial="", firmware_version="1", protocol="board-v1", protocol_version=1,
        array_id=array_id, channels=array.n_channels, taxels=array.n_taxels, x_mm=tuple(array.x_mm.tolist()),
        y_mm=tuple(array.y_mm.tolist()), channel_names=tuple(array.channel_name), rate_hz=100.0,
        volts_per_count=1.0, channel_offset_s=(0.0,) * array.n_channels, tactiled_version="0",
        zero=tuple(array.zero.tolist()),
    )  # fmt: skip


class Stage:
    """Boards that play scenes on one endpoint.

    Parameters
    ----------
    endpoint : str
    plays : sequence of (board, scene, duration_s)
    forces : bool
        State a force beside each scan, as a calibration of this array would.
    then : {"again", "gone", "hold", "gap"}
    live_s : float
        Last seconds of the first play, which take their time; what comes before them is sent at once.
    """

    def __init__(
        self,
        endpoint: str,
        plays: Sequence[tuple[str, str, float]],
        *,
        forces: bool,
        then: Then,
        live_s: float = math.inf,
    ) -> None:
        self._endpoint = endpoint
        self._plays = []
        for board, scene, duration_s in plays:
            # A scene is computed once for all plays that end within it.
            computed = events_of(scene, max(12.0, duration_s))
            self._plays.append((board, [play for play in computed if play[0] <= duration_s]))
        self._forces = forces
        self._then = then
        self._live_s = live_s
        self._seq: dict[tuple[str, str, int], int] = {}
        self.ended = threading.Event()

    def run(self) -> None:
        boards = [self._board(board, events) for board, events in self._plays]
        with zmq.Context() as context, context.socket(zmq.XPUB) as socket:
            socket.linger = 0
            socket.sndhwm = 0  # a subscriber that a busy host holds up for seconds misses nothing
            socket.bind(self._endpoint)
            while not socket.poll(10) and not self.ended.is_set():
                pass
            while socket.poll(_SUBSCRIBED_MS):
                socket.recv()
            while not self.ended.wait(0.01):
                for board in boards:
                    for message in next(board):
                        socket.send_multipart(message)

    def _board(
        self, board: str, events: Sequence[tuple[float, Event]]
    ) -> Iterator[list[tuple[bytes, bytes]]]:
        """Yield what is due, each time it is asked."""
        status_s = info_s = 0.0
        play_s = events[-1][0]
        last = [
            event for at_s, event in events if at_s > play_s - _LAST_S and event.topic in ("scan", "grip")
        ]
        for run in itertools.count(1):  # as a daemon that was restarted: what is open at the end has no end
            began_s, waiting, held = time.time(), iter(events), itertools.cycle(last)
            contact: ContactState = "none"
            slips = False
            if run == 1:
                began_s -= max(0.0, play_s - self._live_s)
            following = next(waiting, None)
            ends = self._then == "again" or (self._then == "gap" and run == 1)
            holds = not ends and self._then != "gone"
            while (since_s := time.time() - began_s) < play_s + PAUSE_S or not ends:
                due: list[Event] = []
                while following is not None and following[0] <= since_s:
                    due.append(following[1])
                    following = next(waiting, None)
                contact = next((e.state for e in reversed(due) if isinstance(e, ContactEvent)), contact)
                slips = next((e.state == "onset" for e in reversed(due) if isinstance(e, SlipEvent)), slips)
                stays = following is None and holds
                if stays:
                    due += [self._now(next(held), since_s), self._now(next(held), since_s)]
                if since_s - status_s > _STATUS_S or since_s < status_s:
                    status_s = since_s
                    due.append(self._status(since_s, following is not None or stays, contact, slips))
                messages = []
                if since_s - info_s > 1.0 or since_s < info_s or info_s == 0.0:
                    info_s = since_s
                    messages.append(
                        self._message(board, replace(info(), board_serial=board), time.time(), run)
                    )
                messages += [
                    self._message(board, stated, began_s, run)
                    for event in due
                    for stated in self._stated(event)
                ]
                yield messages

    @staticmethod
    def _now(event: Event, since_s: float) -> Event:
        """Event of before, at this instant."""
        if isinstance(event, ScanEvent):
            return replace(event, time_s=since_s, index=round(100 * since_s))
        return replace(event, time_s=since_s)

    def _stated(self, event: Event) -> list[Event]:
        """Event as the daemon would state it, after the force of its scan where there is a calibration."""
        if not self._forces or not isinstance(event, ScanEvent):
            return [event]
        felt = np.array(event.volts) - SOURCE.array.zero
        x, y, load = (_weights() @ felt).tolist()
        force = ForceEvent(
            time_s=event.time_s, fx_n=-N_PER_V * x, fy_n=-N_PER_V * y, fz_n=N_PER_V * load, fx_sd_n=0.3,
            fy_sd_n=0.3, fz_sd_n=0.4, x_mm=3.6, y_mm=3.6, calibration="finger-7", valid=True,
        )  # fmt: skip
        return [force, event]

    @staticmethod
    def _status(since_s: float, plays: bool, contact: ContactState, slips: bool) -> StatusEvent:
        if plays:
            return replace(STATUS, time_s=since_s, contact=contact, slipping=slips)
        gone: dict[str, Any] = {"state": "no-device", "valid": False, "reason": "no such port"}
        return replace(STATUS, time_s=since_s, contact="none", slipping=False, **gone)

    def _message(self, board: str, event: Event, origin_s: float, run: int) -> tuple[bytes, bytes]:
        key = (board, event.topic, run)
        self._seq[key] = seq = self._seq.get(key, -1) + 1
        return encode(event, seq=seq, board=board, unix_offset_s=origin_s, run=run)


@contextmanager
def stage(
    folder: Path,
    *plays: tuple[str, str, float],
    forces: bool = False,
    then: Then = "again",
    live_s: float = math.inf,
) -> Iterator[str]:
    """Play scenes while the context lasts, from the first subscriber on; gives the endpoint."""
    endpoint = f"ipc://{folder}/stage.ipc"
    made = Stage(endpoint, plays, forces=forces, then=then, live_s=live_s)
    thread = threading.Thread(target=made.run)
    thread.start()
    try:
        yield endpoint
    finally:
        made.ended.set()
        thread.join()
