"""Faults of cable and board, caused in a running daemon: it recovers, and calls nothing old fresh.

The daemon runs at a rate that it must set again. That every lost scan is counted is tested in simulated time
(`tests/daemon/test_daemon_accounting.py`), where this host's other programs take none.
"""

import asyncio
import time
from bisect import bisect_right
from pathlib import Path

import pytest
from daemon_on_pty import RATE_HZ, SERIAL, DaemonOnPty, ReceivedMessage
from fault_cases import CALM_S, CASES, FaultCase

from tactiled.daemon.board.session import SILENT_PERIODS

pytestmark = pytest.mark.system
RECOVERS_S = 5.0  # 0.03 to 0.2 s on a quiet machine
# A status is valid up to twice the silence that is a stall; with a margin for errors of instants.
OLDEST_VALID_S = 2 * SILENT_PERIODS / RATE_HZ + 0.01


async def calm(daemon: DaemonOnPty, calm_s: float) -> ReceivedMessage:
    """Wait until statuses have been valid for `calm_s`, and return the last one."""

    def is_calm() -> bool:
        recent = [status for status in daemon.statuses[-20:] if status.time_s >= from_s]
        since_s = next((s.time_s for s in reversed(recent) if not s.data["valid"]), from_s)
        return bool(recent) and recent[-1].time_s >= since_s + calm_s

    from_s = time.monotonic()
    await daemon.until(is_calm, "calm")
    return daemon.statuses[-1]


def false_fresh(daemon: DaemonOnPty) -> int:
    """Count statuses that were valid although the newest scan was too old."""
    received_s = [scan.received_s for scan in daemon.scans]
    n = 0
    for status in daemon.statuses:
        if status.data["valid"] and status.data["board"] == SERIAL:
            newest = daemon.scans[max(0, bisect_right(received_s, status.received_s) - 1)]
            n += status.time_s - newest.time_s > OLDEST_VALID_S
    return n


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_the_daemon_recovers(case: FaultCase, tmp_path: Path) -> None:
    async def play() -> None:
        async with DaemonOnPty(tmp_path) as daemon:
            await daemon.until_status("running")
            before = await calm(daemon, case.calm_s)
            span = await case.play(daemon)
            fresh = await daemon.until_fresh_scan(span.end_s)
            after = await calm(daemon, CALM_S)
            # When the daemon sent it: this process may have read it later.
            assert fresh.time_s + fresh.data["age_s"] - span.end_s < RECOVERS_S
            assert after.data["restarts"] - before.data["restarts"] == case.restarts
            assert after.data["scans_overrun"] - before.data["scans_overrun"] >= case.overruns
            assert after.data["rate_hz"] == RATE_HZ
            assert false_fresh(daemon) == 0

    asyncio.run(play())
