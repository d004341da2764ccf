"""The two recordings of ``tactiled tune``: from files, or from a running daemon with prompts for the user."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tactiled.array import Array
from tactiled.client.commander import Commander
from tactiled.client.subscriber import Subscription
from tactiled.detect.tuning import relative_to
from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.recording.table_times import TableOptions
from tactiled.samples.block import ScanBlock
from tactiled.scan_log import LiveScans, read_log, start_zero
from tactiled.tune.study import Recording, contact_gate, contact_level

_GRIP_S = 60.0  # time for the user to pick up an object
_READY_S = 3.0  # from the prompt to move to the first scan used
_ZERO_S = 1.0  # listened to beyond what gives the zero: a slow board has few scans in that
_PROGRESS_S = 10.0  # interval of progress messages

Report = Callable[[str], None]
Pair = tuple[Recording, Recording]


def read_pair(
    quiet: Path,
    motion: Path,
    array: str | None = None,
    topic: str | None = None,
    options: TableOptions | None = None,
) -> Pair:
    """Read the files of a quiet hold and of motion without slip; see `read_log`.

    `DataError` or `ConfigError` where a file is invalid, or they are of different arrays.
    """
    logs = [(path.name, read_log(path, array, topic, options)) for path in (quiet, motion)]
    first, second = (Recording(name, log.array, log.blocks()) for name, log in logs)
    if first.array.channel_name != second.array.channel_name:
        fault = f"{quiet} is of the array {first.array.name}, {motion} of {second.array.name}"
        raise ConfigError("command line", [f"{fault}: record both with one board"])
    return first, second


def record_live(
    endpoint: str,
    quiet_s: float,
    motion_s: float,
    array: str | None,
    board: str,
    keys: Path | None,
    report: Report,
) -> Pair:
    """Record a quiet hold and a motion from a daemon; `report` is called with prompts for the user.

    `array` is the file of an array that is not shipped; without `board`, the first one is taken. `DataError`
    or `ConfigError` where there is no daemon, board or contact, the endpoint is invalid, or the array does
    not match the board.
    """
    with Subscription(endpoint, ("scan", "info"), board or None, keys=keys) as subscription:
        scans = LiveScans(subscription, endpoint, array, report)
        if warning := _warning_of_tare(endpoint, scans.board, keys):
            report(warning)
        zeroed = _at_zero(scans, report)
        report(f"Grip an object firmly and hold it still for {quiet_s:g} s after contact.")
        _await_hold(scans, zeroed)
        quiet = _record(scans, zeroed, "quiet hold", quiet_s, report)
        report(
            f"Now move arm and gripper as in normal work, without slip, for {motion_s:g} s; recording "
            f"starts in {_READY_S:g} s."
        )
        scans.listen(_READY_S)
        motion = _record(scans, zeroed, "motion", motion_s, report)
        report("Done; you may release the object.")
    return quiet, motion


def _at_zero(scans: LiveScans, report: Report) -> Array:
    """Return the array with its zero as numbers: that of the first scans is measured before the grip."""
    array = scans.array
    if not array.zero_first_s:
        return array
    report(f"Let nothing touch the array for {_READY_S + _ZERO_S + array.zero_first_s:g} s.")
    scans.listen(_READY_S)
    scans.drop()
    scans.listen(_ZERO_S + array.zero_first_s)
    log = scans.log()
    return replace(array, zero=start_zero(log.time_s, log.readings, array), zero_first_s=0.0)


def _await_hold(scans: LiveScans, array: Array) -> None:
    """Wait until an object is held: the load no longer rises, or was there before."""
    until_s, gate = time.monotonic() + _GRIP_S, None
    scans.drop()
    while time.monotonic() < until_s:
        scans.listen(0.1)
        if len(scans.readings) < 2:
            continue
        items = [relative_to(array.zero, item) for item in scans.log().blocks()]
        blocks = [item for item in items if isinstance(item, ScanBlock)]
        scans.drop()
        gate = gate or contact_gate(array, blocks[0].rate_hz)
        for block in blocks:
            gate.measure(block)
            for scan in range(len(block)):
                gate.step(scan)
        if gate.state in ("holding", "unknown"):
            return
    level = contact_level(array)
    raise DataError(f"no contact within {_GRIP_S:g} s (no taxel above {level}): run again and grip an object")


def _record(scans: LiveScans, array: Array, name: str, seconds: float, report: Report) -> Recording:
    """Record the scans of the next `seconds`, with a countdown."""
    scans.drop()
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        report(f"  {left_s:.0f} s")
        scans.listen(min(_PROGRESS_S, left_s))
    return Recording(name, array, scans.log().blocks())


def _warning_of_tare(endpoint: str, board: str, keys: Path | None) -> str:
    """Warn of a tared daemon: it publishes untared scans, while its detectors use tared ones."""
    try:
        with Commander(endpoint, "tactiled tune", keys=keys) as daemon:
            state = daemon.send("state", board=board)
    except OperatorError:
        return "the daemon does not answer requests: if it was tared, the proposed values do not apply"
    if not state.ok:
        return f"the daemon does not say whether it was tared ({state.reason}): if so, values do not apply"
    words = "the daemon was tared: the proposed values apply to an untared daemon; restart it first"
    return words if state.data["settings"]["tared"] else ""
