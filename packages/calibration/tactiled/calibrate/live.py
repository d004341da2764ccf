"""``tactiled calibrate --guide``: record scans of a running daemon, and say which way to press next."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tactiled.array import load_array
from tactiled.calibrate.guide import Guide
from tactiled.client.items import Message, Recovered, Stale
from tactiled.client.subscriber import Subscription, first_info
from tactiled.errors import ConfigError, DataError

_LOOK_S = 1.0  # between two looks at what is lacking
_LEAST_S = 15.0  # even if all is well before: creep takes seconds to show

Report = Callable[[str], None]


class GuidedLog(NamedTuple):
    """What was recorded."""

    scans: int
    duration_s: float
    lacking: str  # motion that is still lacking; empty where every sensitivity can be known


def record_guided(
    log: Path,
    endpoint: str,
    array: str | None,
    keys: Path | None,
    most_s: float,
    report: Report,
    board: str = "",
) -> GuidedLog:
    """Record until every sensitivity can be known, and write the scans.

    Parameters
    ----------
    log : Path
        npz file to write, for `tactiled calibrate LOG --reference ...`; times are epoch seconds.
    endpoint : str
        Endpoint where the daemon publishes.
    array : str, optional
        TOML file of the board's array, if it is not a shipped one.
    most_s : float
        Longest duration.
    report : callable
        Called with a line for the person who presses.
    board : str
        Serial number of the board; empty for the first of the daemon.

    Raises
    ------
    DataError
        No daemon, no board, or no scans.
    ConfigError
        The array is not known here.
    """
    if log.suffix != ".npz" or not log.parent.is_dir():
        raise ConfigError("command line", [f"{log}: name an .npz in a folder that exists, to be written"])
    with Subscription(endpoint, ("scan", "info"), board=board or None, keys=keys) as subscription:
        described = first_info(subscription, endpoint)
        info, serial = described.data, described.board
        known = load_array(array or str(info["array_id"]))
        if known.n_channels != info["channels"]:
            fault = f"{known.name} has {known.n_channels} channels, the board {info['channels']}"
            raise ConfigError("--array", [fault])
        guide = Guide(known)
        report("Start the record of the force sensor now. Let nothing touch the array for the first second.")
        time_s: list[float] = []
        volts: list[list[float]] = []
        valid: list[list[bool]] = []
        said, is_good, seen = "", False, 0
        began_s = time.monotonic()
        while not is_good and time.monotonic() - began_s < most_s:
            until_s = time.monotonic() + _LOOK_S
            while (item := subscription.next_item(until_s)) is not None:
                message = item.message if isinstance(item, Recovered) else item
                if isinstance(message, Message) and (message.topic, message.board) == ("scan", serial):
                    if not time_s or message.data["timestamp"] > time_s[-1]:
                        time_s.append(message.data["timestamp"])
                        volts.append(message.data["volts"])
                        valid.append(message.data["valid"])
                elif isinstance(item, Stale):
                    report(f"stale: {item.reason}")
                if time.monotonic() >= until_s:
                    break
            if len(volts) > seen:
                guide.add(np.where(valid[seen:], volts[seen:], np.nan))
                seen = len(volts)
            advice = guide.advice()
            elapsed_s = time.monotonic() - began_s
            is_good = not advice.motion and elapsed_s >= _LEAST_S
            motion = advice.motion or "go on pressing"
            if motion != said and not is_good:
                report(f"{elapsed_s:4.0f} s  {motion} (now {100 * advice.worst:.0f} %)")
                said = motion
    if len(time_s) < 2:
        raise DataError(f"no scans from {endpoint}; see the state with `tactiled listen -t status`")
    np.savez_compressed(log, time_s=time_s, volts=volts, valid=valid)
    lacking = "" if is_good else f"; still lacking: {advice.motion}"
    report(f"{log}: {len(time_s)} scans{lacking}. Stop the record of the force sensor.")
    return GuidedLog(len(time_s), time_s[-1] - time_s[0], "" if is_good else advice.motion)
