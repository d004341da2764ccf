"""Scans of an array as calibration and tuning take them: from a file, or from a running daemon."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactiled.array import Array, FloatArray, load_array
from tactiled.client.items import Fresh, Message, Recovered, Restarted, Stale
from tactiled.client.subscriber import Subscription, first_info
from tactiled.errors import ConfigError, DataError
from tactiled.events.types import ScanEvent
from tactiled.recording.spacing import to_blocks
from tactiled.recording.steps import Replay
from tactiled.recording.table_times import TableOptions
from tactiled.recording.whole import read_whole
from tactiled.samples.block import Gap, ScanBlock

_SET_BACK_S = 1.0  # a clock that is corrected by less costs a few scans


@dataclass(frozen=True, eq=False)
class ScanLog:
    """Readings of an array."""

    array: Array
    time_s: FloatArray  # (n,): increasing
    readings: FloatArray  # (n, channels): NaN where missing or not valid
    board: str = ""  # serial number; empty where it is not known
    channel_offset_s: tuple[float, ...] = ()  # of the channels within a scan; empty where it is not known

    def blocks(self) -> tuple[ScanBlock | Gap, ...]:
        """Split the scans where some are missing."""
        items = to_blocks(self.time_s, self.readings, None, np.isfinite(self.readings))
        offset_s = np.array(self.channel_offset_s or [0.0] * self.array.n_channels)
        return tuple(
            item if isinstance(item, Gap) else replace(item, channel_offset_s=offset_s) for item in items
        )


def read_log(
    path: Path, array: str | None = None, topic: str | None = None, options: TableOptions | None = None
) -> ScanLog:
    """Read a recording, or a table or bag; parameters and errors as for `read_whole`."""
    whole = read_whole(path, array, topic, options or TableOptions())
    if whole is None:
        return _from_mcap(path)
    known, time_s, readings = whole
    return ScanLog(known, time_s, np.where(known.in_range(readings), readings, np.nan))


def _from_mcap(path: Path) -> ScanLog:
    """Replay a recording through the pipeline and keep its scans."""
    replay = Replay([path])
    hello = None
    time_s: list[float] = []
    readings: list[FloatArray] = []
    for step in replay:
        for replayed in step.now:
            event = replayed.event
            if isinstance(event, ScanEvent) and (not time_s or event.time_s > time_s[-1]):
                time_s.append(event.time_s)
                readings.append(np.where(event.valid, event.volts, np.nan))
        # A recording that was ended regularly ends with a lost port, after which the board is unknown.
        hello = replay.pipeline.hello or hello
    if len(time_s) < 2 or hello is None:
        raise DataError(f"{path}: contains no scans; was the board started, and did its hello arrive?")
    array = replay.header.source.array
    return ScanLog(array, np.array(time_s), np.array(readings), hello.board_serial, hello.channel_offset_s)


class LiveScans:
    """Scans of the first board on a subscription; `report` gets lines for the person at the sensor.

    The constructor raises `DataError` or `ConfigError` where there is no daemon or no board, or where the
    array (`array`, if it is not a shipped one) is not known or not the board's.
    """

    def __init__(
        self, subscription: Subscription, endpoint: str, array: str | None, report: Callable[[str], None]
    ) -> None:
        self._subscription, self._endpoint, self._report = subscription, endpoint, report
        described = first_info(subscription, endpoint)
        self.board = described.board
        self.array = _array_of(described.data, array)
        self._offset_s = tuple(described.data.get("channel_offset_s", ()))
        self._is_interrupted = False
        self._time_s: list[float] = []
        self.readings: list[FloatArray] = []  # (channels,) each

    def listen(self, seconds: float) -> None:
        """Keep the scans of the next `seconds`; `DataError` where their times go back."""
        until_s = time.monotonic() + seconds
        while (item := self._subscription.next_item(until_s)) is not None:
            message = item.message if isinstance(item, Recovered) else item
            if isinstance(message, Message) and (message.topic, message.board) == ("scan", self.board):
                scan = message.data
                back_s = self._time_s[-1] - scan["timestamp"] if self._time_s else -1.0
                if back_s > _SET_BACK_S:
                    raise DataError(
                        f"the clock of the daemon's host was set back by {back_s:.1f} s; try again"
                    )
                if back_s < 0.0:
                    self._time_s.append(scan["timestamp"])
                    self.readings.append(np.where(scan["valid"], scan["volts"], np.nan))
            elif isinstance(item, Stale):
                self._is_interrupted = True
                self._report(f"stale: {item.reason}")
            elif isinstance(item, Restarted):
                self._report("the daemon was restarted")
            elif isinstance(item, Fresh) and self._is_interrupted:
                self._is_interrupted = False
                self._report("the board runs")
            if time.monotonic() >= until_s:
                break

    def drop(self) -> None:
        """Forget the scans that were kept."""
        self._time_s, self.readings = [], []

    def log(self) -> ScanLog:
        """Return the scans that were kept, in epoch seconds; `DataError` for less than two."""
        if len(self._time_s) < 2:
            where = "see the state with `tactiled listen -t status`"
            raise DataError(f"no scans from {self._endpoint}; {where}")
        time_s, readings = np.array(self._time_s), np.array(self.readings)
        return ScanLog(self.array, time_s, readings, self.board, self._offset_s)


def _array_of(info: dict[str, Any], array: str | None) -> Array:
    try:
        known = load_array(array or str(info["array_id"]))
    except ConfigError as error:
        if array is not None:
            raise
        fault = f"the board carries {info['array_id']!r}: give its file with --array FILE.toml ({error})"
        raise ConfigError("--array", [fault]) from None
    if known.n_channels != info["channels"]:
        fault = f"{known.name} has {known.n_channels} channels, the board {info['channels']}"
        raise ConfigError("--array", [fault])
    return known


def start_zero(time_s: FloatArray, readings: FloatArray, array: Array) -> FloatArray:
    """Zero (channels,) as a run of the detectors has it: the array's, or the median of the first scans."""
    if not array.zero_first_s:
        return array.zero
    first = readings[time_s - time_s[0] < array.zero_first_s]
    known = np.isfinite(first).any(axis=0)
    zero = np.zeros(readings.shape[1])
    zero[known] = np.nanmedian(first[:, known], axis=0)
    return zero
