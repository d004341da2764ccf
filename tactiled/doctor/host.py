"""The host around the daemon: endpoints, disk, systemd, threads."""

import contextlib
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import zmq

from tactiled.client import Message, Subscription
from tactiled.daemon.endpoints import RUNTIME, bind, runtime_directory
from tactiled.daemon.publisher import PublishParams, is_guarded
from tactiled.doctor.finding import Finding, Verdict, split
from tactiled.errors import TactiledError
from tactiled.recording.rotation import RecordParams

_STATUS_S = 0.5  # a living daemon sends five in that time
_UNITS = ("etc/systemd/system", "usr/lib/systemd/system", "lib/systemd/system")
_RULES = ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")


def running_daemon(publish: PublishParams) -> Finding | None:
    """What a daemon on these endpoints says of itself; None where none speaks."""
    for endpoint in publish.endpoints:
        if is_guarded(publish, endpoint):
            continue
        with contextlib.suppress(TactiledError), Subscription(_filled(endpoint), ("status",)) as status:
            until_s = time.monotonic() + _STATUS_S
            while (item := status.next_item(until_s)) is not None:
                if isinstance(item, Message):
                    data = item.data
                    said = data["reason"] or data.get("warning", "")
                    words = f"runs here: board {data['board'] or 'unknown'} is {data['state']}"
                    verdict: Verdict = "warn" if said else "ok"
                    return Finding("daemon", verdict if data["valid"] else "fail", words, said)
    return None


def check_endpoints(publish: PublishParams, daemon_runs: bool) -> list[Finding]:
    """Whether every endpoint can be bound, or is bound by the daemon that runs."""
    if daemon_runs:
        return [Finding("endpoints", "ok", f"bound by the daemon that runs: {', '.join(publish.endpoints)}")]
    findings = []
    with zmq.Context() as context:
        for endpoint in (*publish.endpoints, *publish.control):
            with context.socket(zmq.PUB) as socket:
                try:
                    bind(socket, endpoint)
                except TactiledError as error:
                    findings.append(split("endpoint", str(error), "fail"))
                else:
                    findings.append(Finding("endpoint", "ok", f"{endpoint} is free"))
    return findings or [Finding("endpoints", "warn", "none: nothing is published", "set publish.endpoints")]


def check_disk(record: RecordParams) -> list[Finding]:
    """Room and permission where recordings go; nothing to say where none are made."""
    if record.directory is None:
        return []
    directory = Path(record.directory)
    if not directory.is_dir():
        remedy = f"sudo install -d -o USER {directory}, or change record.directory"
        return [Finding("disk", "fail", f"{directory}: no such directory", remedy)]
    if not os.access(directory, os.W_OK | os.X_OK):
        remedy = f"make it writable for the daemon's user: ls -ld {directory}"
        return [Finding("disk", "fail", f"{directory}: this user may not write there", remedy)]
    free_mb = shutil.disk_usage(directory).free / 1e6
    words = f"{directory}: {free_mb:.0f} MB free, recording stops below {record.min_free_mb:g} MB"
    if free_mb < record.min_free_mb:
        return [Finding("disk", "fail", words, "make room, or lower record.min_free_mb")]
    if free_mb < 2 * record.min_free_mb:
        return [Finding("disk", "warn", words, "make room soon")]
    return [Finding("disk", "ok", words)]


def check_installation(root: Path = Path("/"), environ: Mapping[str, str] = os.environ) -> list[Finding]:
    """Whether unit and udev rule are where systemd and udev look, and threads are as they should be."""
    return [
        _installed(
            "systemd unit", root, _UNITS, "tactiled@.service",
            "for a daemon that starts with its board: sudo cp systemd/tactiled@.service /etc/systemd/system/ "
            "&& sudo systemctl daemon-reload",
        ),
        _installed(
            "udev rule", root, _RULES, "*tactiled*.rules",
            "for permissions, stable names and 1 ms latency: sudo cp systemd/99-tactiled.rules "
            "/etc/udev/rules.d/ && sudo udevadm control --reload && sudo udevadm trigger",
        ),
        _threads(environ),
    ]  # fmt: skip


def _installed(check: str, root: Path, places: Sequence[str], pattern: str, remedy: str) -> Finding:
    found = [path for place in places for path in sorted((root / place).glob(pattern))]
    if found:
        return Finding(check, "ok", f"{found[0]} is installed")
    return Finding(check, "warn", "not installed", remedy)


def _threads(environ: Mapping[str, str]) -> Finding:
    if environ.get("OPENBLAS_NUM_THREADS") == "1" or (os.cpu_count() or 1) == 1:
        return Finding("threads", "ok", "one BLAS thread")
    remedy = "the unit sets it; by hand: export OPENBLAS_NUM_THREADS=1"
    return Finding("threads", "warn", "BLAS may wake every core for 36 channels, which costs latency", remedy)


def _filled(endpoint: str) -> str:
    return endpoint.replace(RUNTIME, str(runtime_directory())) if RUNTIME in endpoint else endpoint
