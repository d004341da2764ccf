"""Recordings for `tactiled tune` from a running daemon: prompt the user and collect scans."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tactiled.array import Array, load_array
from tactiled.client.commander import Commander
from tactiled.client.items import Fresh, Message, Recovered, Restarted, Stale
from tactiled.client.subscriber import Subscription, first_info
from tactiled.detect.wang2019.slip import PUBLISHED_CONTACT
from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.events.types import ScanEvent
from tactiled.tune.hold import LOADING_S, Collector, Recording

_GRIP_S = 60.0  # time for the user to pick up an object
_READY_S = 3.0  # from the prompt to move to the first scan used
_PROGRESS_S = 10.0  # interval of progress messages

Report = Callable[[str], None]


def record_live(
    endpoint: str,
    quiet_s: float,
    motion_s: float,
    array: str | None,
    board: str,
    keys: Path | None,
    report: Report,
) -> tuple[Recording, Recording]:
    """Record a quiet hold and a motion from a daemon; `report` is called with prompts for the user.

    `array` is the file of an array that is not shipped; without `board`, the first one is taken.

    Raises
    ------
    DataError, ConfigError
        No daemon, no board, no contact; the endpoint is invalid, or the array does not match the board.
    """
    with Subscription(endpoint, ("scan", "info"), board or None, keys=keys) as subscription:
        feed = _Feed(subscription, endpoint, array, report)
        if warning := _warning_of_tare(endpoint, feed.serial, keys):
            report(warning)
        report(f"Grip an object firmly and hold it still for {quiet_s:g} s after contact.")
        feed.until_touch()
        quiet = feed.record("quiet hold", LOADING_S + quiet_s)
        report(
            f"Now move arm and gripper as in normal work, without slip, for {motion_s:g} s; recording "
            f"starts in {_READY_S:g} s."
        )
        feed.listen(_READY_S)
        motion = feed.record("motion", motion_s)
        report("Done; you may release the object.")
    return quiet, motion


class _Feed:
    """Scans of the first board found on a subscription."""

    def __init__(self, subscription: Subscription, endpoint: str, array: str | None, report: Report) -> None:
        self._subscription, self._endpoint, self._report = subscription, endpoint, report
        described = first_info(subscription, endpoint)
        self.serial, self._info = described.board, described.data
        self._array = _array_of(self._info, array)

    def listen(self, seconds: float) -> list[ScanEvent]:
        """Return the scans of the next `seconds`."""
        until_s = time.monotonic() + seconds
        scans = []
        while (item := self._subscription.next_item(until_s)) is not None:
            message = item.message if isinstance(item, Recovered) else item
            if isinstance(message, Message) and (message.topic, message.board) == ("scan", self.serial):
                scans.append(_scan(message.data))
            elif isinstance(item, Stale):
                self._report(f"stale: {item.reason}")
            elif isinstance(item, Restarted):
                self._report("the daemon was restarted")
            elif isinstance(item, Fresh):
                self._report("the board runs")
            if time.monotonic() >= until_s:
                break
        return scans

    def record(self, name: str, seconds: float) -> Recording:
        """Record the scans of the next `seconds`, with a countdown."""
        until_s = time.monotonic() + seconds
        scans = Collector(self._array)
        while (left_s := until_s - time.monotonic()) > 0:
            self._report(f"  {left_s:.0f} s")
            for scan in self.listen(min(_PROGRESS_S, left_s)):
                scans.add(scan)
        if not scans:
            raise DataError(
                f"{name}: no scans from {self._endpoint}; see the state with `tactiled listen -t status`"
            )
        return scans.recording(name, self._info["rate_hz"], self._info["channel_offset_s"])

    def until_touch(self) -> None:
        """Wait until an object is in contact."""
        until_s = time.monotonic() + _GRIP_S
        least_v = PUBLISHED_CONTACT.contact_volts
        weights = self._array.normal_weights()
        while time.monotonic() < until_s:
            scans = self.listen(0.1)
            if scans and (weights @ np.nan_to_num(np.array(scans[-1].volts))).max() > least_v:
                return
        raise DataError(
            f"no contact within {_GRIP_S:g} s (no taxel above {least_v:g} V): run again and grip an object"
        )


def _warning_of_tare(endpoint: str, board: str, keys: Path | None) -> str:
    """Warn of a tared daemon: it publishes untared scans, while its detectors use tared ones."""
    try:
        with Commander(endpoint, "tactiled tune", keys=keys) as daemon:
            is_tared = daemon.send("state", board=board).data["settings"]["tared"]
    except OperatorError:
        return "the daemon does not answer requests: if it was tared, the proposed values do not apply"
    words = "the daemon was tared: the proposed values apply to an untared daemon; restart it first"
    return words if is_tared else ""


def _array_of(info: dict[str, Any], array: str | None) -> Array:
    try:
        known_array = load_array(array or info["array_id"])
    except ConfigError as error:
        if array is not None:
            raise
        fault = f"the board carries {info['array_id']!r}: give its file with --array FILE.toml ({error})"
        raise ConfigError("--array", [fault]) from None
    if known_array.n_channels != info["channels"]:
        fault = f"{known_array.name} has {known_array.n_channels} channels, the board {info['channels']}"
        raise ConfigError("--array", [fault])
    return known_array


def _scan(data: dict[str, Any]) -> ScanEvent:
    """Convert a message to a scan in epoch seconds."""
    return ScanEvent(
        time_s=data["timestamp"],
        index=data["index"],
        volts=tuple(data["volts"]),
        valid=tuple(data["valid"]),
        time_sd_s=data["time_sd_s"],
        age_s=data["age_s"],
        late=data["late"],
    )
