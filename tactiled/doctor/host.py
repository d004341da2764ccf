"""Checks of the host: running daemon, endpoints, disk."""

import contextlib
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zmq

from tactiled.client import Message, Subscription
from tactiled.daemon.serial import device
from tactiled.daemon.zmq.endpoints import bind, filled
from tactiled.daemon.zmq.params import PublishParams
from tactiled.doctor.finding import Finding, Severity, split
from tactiled.errors import TactiledError
from tactiled.events.incoming import checked_map
from tactiled.recording.session import RecordParams

_STATUS_S = 0.5  # a running daemon sends five in that time


def running_daemon(publish: PublishParams, board_serial: str | None = None) -> dict[str, Any] | None:
    """Status of the daemon on these endpoints; None where there is none, or no status as we declare it.

    Of a daemon with several boards it is that of `board_serial`, or of any board where it sends none of that.
    """
    other: dict[str, Any] | None = None
    for endpoint in publish.endpoints:
        if publish.is_guarded(endpoint):
            continue
        with contextlib.suppress(TactiledError), Subscription(filled(endpoint), ("status",)) as status:
            until_s = time.monotonic() + _STATUS_S
            while time.monotonic() < until_s and (item := status.next_item(until_s)) is not None:
                if isinstance(item, Message):
                    found = checked_map("status", item.data)
                    if board_serial in (None, found["board"]):
                        return found
                    other = other or found
    return other


def check_daemon(status: Mapping[str, Any], url: str, *, is_configured: bool = True) -> tuple[Finding, bool]:
    """Check a running daemon; the flag is True if it reads this port.

    Without a configuration, a daemon of another board on the default endpoints is no fault of this port.
    """
    words = f"board {status['board'] or 'unknown'} is {status['state']}"
    verdict: Severity
    if status["state"] != "no-device" and device.is_free(url):
        what = f"another daemon runs on these endpoints and does not read {url}: {words}"
        verdict = "fail" if is_configured else "warn"
        return Finding("daemon", verdict, what, "give each daemon its own endpoints in [publish]"), False
    said = status["reason"] or status.get("warning", "")
    verdict = "warn" if said else "ok"
    return Finding("daemon", verdict if status["valid"] else "fail", f"runs here: {words}", said), True


def check_endpoints(
    publish: PublishParams, daemon_runs: bool, *, is_configured: bool = True
) -> list[Finding]:
    """Check that every endpoint can be bound or is bound by the running daemon.

    Default endpoints that somebody else has bound are a warning: no configuration asks for them.
    """
    if daemon_runs:
        bound = ", ".join(map(filled, publish.endpoints))
        return [Finding("endpoints", "ok", f"bound by the daemon that runs: {bound}")]
    findings = []
    with zmq.Context() as context:
        for endpoint in (*publish.endpoints, *publish.control):
            with context.socket(zmq.PUB) as socket:
                try:
                    bind(socket, endpoint)
                except TactiledError as error:
                    findings.append(split("endpoint", str(error), "fail" if is_configured else "warn"))
                else:
                    findings.append(Finding("endpoint", "ok", f"{filled(endpoint)} is free"))
    return findings or [Finding("endpoints", "warn", "none: nothing is published", "set publish.endpoints")]


def check_disk(record: RecordParams) -> list[Finding]:
    """Check free space and permissions of the record directory."""
    if record.directory is None:
        return [Finding("disk", "ok", "not checked: record.directory is not set, nothing is recorded")]
    directory = Path(record.directory)
    verdict: Severity = "fail"
    if not directory.is_dir():
        words = "no such directory"
        remedy = f"sudo install -d -o USER {directory} (the unit makes its own), or change record.directory"
    elif not os.access(directory, os.W_OK | os.X_OK):
        words = "this user may not write there"
        remedy = f"make it writable for the daemon's user: ls -ld {directory}"
    else:
        free_mb, least_mb = shutil.disk_usage(directory).free / 1e6, record.min_free_mb
        words, remedy = f"{free_mb:.0f} MB free, recording stops below {least_mb:g} MB", ""
        if free_mb < least_mb:
            remedy = "make room, or lower record.min_free_mb"
        elif free_mb < 2 * least_mb:
            verdict, remedy = "warn", "make room soon"
        else:
            verdict = "ok"
    return [Finding("disk", verdict, f"{directory}: {words}", remedy)]
