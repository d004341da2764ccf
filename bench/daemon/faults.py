"""``./run bench faults``: faults of cable and board, caused many times in a running daemon.

The whole daemon reads an emulated board on a real pty (`pty`), at a rate that is not the board's default, so
that a recovery must set it again. Each fault comes while the link runs, or in the state in its name. Measured
are the time to the first fresh scan after it, and the missing scans.
"""

import asyncio
import logging
import tempfile
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from bench.daemon.fault_cases import CALM_S, CASES, FaultCase, FaultSpan
from bench.daemon.pty import RATE_HZ, SERIAL, DaemonOnPty, ReceivedMessage
from bench.report import NONE, Aim, BenchOptions, BenchReport, Reading, aims_table, judge, never, ratio, table
from tactiled.daemon.board.session import SILENT_PERIODS
from tactiled.progress import ProgressBar

_IN_FLIGHT_S = 0.03  # a scan is sampled and sent in 15 ms; the host needs the rest
_OLDEST_VALID_S = (
    2 * SILENT_PERIODS / RATE_HZ + 0.01
)  # rule of the status, with a margin for errors of instants
_SURELY = 0.75  # of a period: up to this distance the count is right and the instant is in error
_BEHIND = 40  # scans: fewer than before the next fault; a new clock fit needs some ten


@dataclass(frozen=True)
class FaultRecovery:
    """One fault and the recovery from it.

    Attributes
    ----------
    before, after : ReceivedMessage
        Statuses of calm moments around it.
    fresh : ReceivedMessage
        The first fresh scan that was taken after it.
    """

    span: FaultSpan
    before: ReceivedMessage
    fresh: ReceivedMessage
    after: ReceivedMessage

    @property
    def recovery_s(self) -> float:
        """Time from the end of the fault until the subscriber had that scan; a scan itself takes 16 ms."""
        return self.fresh.received_s - self.span.end_s

    def counted(self, name: str) -> int:
        """Growth of a counter of the status."""
        return int(self.after.data[name] - self.before.data[name])

    def lost(self, case: FaultCase, lost_s: list[float]) -> tuple[int, int, int]:
        """Count scans lost to the fault, lost until the recovery, and lost otherwise."""
        from_s, until_s = self.before.time_s - _IN_FLIGHT_S, self.after.time_s - _IN_FLIGHT_S
        all_s = [at_s for at_s in lost_s if from_s <= at_s < until_s]
        begin_s, end_s = self.span.begin_s, self.span.end_s
        if case.scans_hit is None:
            n_own = sum(begin_s - _IN_FLIGHT_S <= at_s < end_s for at_s in all_s)
            n_behind = sum(end_s <= at_s < self.fresh.time_s for at_s in all_s)
        else:
            n_own = min(sum(abs(at_s - begin_s) <= _IN_FLIGHT_S for at_s in all_s), case.scans_hit)
            n_behind = 0
        return n_own, n_behind, len(all_s) - n_own - n_behind


@dataclass(frozen=True)
class FaultResult:
    """A fault case with all its recoveries; counts are sums over them.

    Attributes
    ----------
    lost : (own, until recovered, besides)
        Scans, as `FaultRecovery.lost` has them.
    missing, overruns, restarts : int
        As the daemon counted them.
    """

    case: FaultCase
    recoveries: list[FaultRecovery]
    lost: tuple[int, ...]
    missing: int
    overruns: int
    restarts: int


@dataclass(frozen=True)
class FaultsFound:
    """Results of all cases, valid statuses with old scans, and scan instants missed by this host."""

    results: list[FaultResult]
    false_fresh: int
    overruns_of_host: int


def _in_no_case(name: str, is_wrong: Callable[[FaultResult], bool]) -> Aim[FaultsFound]:
    def measure(found: FaultsFound) -> Reading:
        wrong = [result.case.name for result in found.results if is_wrong(result)]
        return judge(", ".join(wrong) or ratio(map(is_wrong, found.results)), not wrong)

    return Aim(name, "none", measure)


AIMS: tuple[Aim[FaultsFound], ...] = (
    _in_no_case(
        "faults with overruns miscounted", lambda r: r.overruns != r.case.overruns * len(r.recoveries)
    ),
    _in_no_case(
        "faults with restarts miscounted", lambda r: r.restarts != r.case.restarts * len(r.recoveries)
    ),
    _in_no_case("faults that cost more scans than they may", lambda r: bool(r.lost[-1])),
    _in_no_case(
        "faults with lost scans miscounted", lambda r: r.case.is_countable and r.missing != sum(r.lost)
    ),
    never("scan instants missed because this host was too slow", lambda found: found.overruns_of_host),
    never("statuses that call old scans fresh", lambda found: found.false_fresh),
)


def bench_faults(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Tables of lost scans and recovery times by fault."""
    logging.getLogger("tactiled.daemon").setLevel(logging.ERROR)  # it reports each fault
    with tempfile.TemporaryDirectory(prefix="tactiled-") as folder:
        found, daemon = asyncio.run(_play(progress, Path(folder), 2 if options.quick else 10))
    lost_s = lost_scans(daemon.board.taken_s, daemon.scans)
    results = []
    for case, recoveries in zip(CASES, found, strict=True):
        lost = zip(*(recovery.lost(case, lost_s) for recovery in recoveries), strict=True)
        names = ("scans_missing", "scans_overrun", "restarts")
        counts = (sum(recovery.counted(name) for recovery in recoveries) for name in names)
        results.append(FaultResult(case, recoveries, tuple(map(sum, lost)), *counts))
    rows = table(_row(result, daemon.statuses) for result in results)
    measured = FaultsFound(results, false_fresh(daemon), daemon.board.overruns_of_host)
    return BenchReport([rows, aims_table(AIMS, {"measured": measured})])


async def _play(
    progress: ProgressBar, folder: Path, most: int
) -> tuple[list[list[FaultRecovery]], DaemonOnPty]:
    found = []
    progress.begin(len(CASES))
    async with DaemonOnPty(folder) as daemon:
        await daemon.until_status("running")
        for case in CASES:
            found.append([await once(case, daemon) for _ in range(min(case.times, most))])
            progress.advance(case.name)
    return found, daemon


async def once(case: FaultCase, daemon: DaemonOnPty) -> FaultRecovery:
    """Cause a fault in a calm daemon, and wait until it is calm again."""
    before = await _calm(daemon, case.calm_s)
    span = await case.play(daemon)
    fresh = await daemon.until_fresh_scan(span.end_s)
    return FaultRecovery(span, before, fresh, await _calm(daemon, CALM_S))


async def _calm(daemon: DaemonOnPty, calm_s: float) -> ReceivedMessage:
    """Wait until statuses have been valid for `calm_s`, and return the last one."""

    def is_calm() -> bool:
        recent = [status for status in daemon.statuses[-20:] if status.time_s >= from_s]
        since_s = next((s.time_s for s in reversed(recent) if not s.data["valid"]), from_s)
        return bool(recent) and recent[-1].time_s >= since_s + calm_s

    from_s = time.monotonic()
    await daemon.until(is_calm, "calm")
    return daemon.statuses[-1]


def lost_scans(taken_s: Sequence[float], scans: Sequence[ReceivedMessage]) -> list[float]:
    """Instants of the board's scans that the subscriber did not get.

    Instants may be in error by a period while a new clock fit settles on a busy machine, so scans are
    matched by the daemon's count. Where an instant is far from that of the count, the offset of the counts
    is determined again, from most of the scans that follow.
    """
    board_s = np.array(taken_s)
    came_s = np.array([scan.time_s for scan in scans])
    counts = np.array([scan.data["index"] for scan in scans])
    right = np.clip(np.searchsorted(board_s, came_s), 1, len(board_s) - 1)
    nearest = right - (came_s - board_s[right - 1] < board_s[right] - came_s)
    offset, got = 0, set()
    for k, count in enumerate(counts.tolist()):
        place = count + offset
        if not (0 <= place < len(board_s) and abs(board_s[place] - came_s[k]) < _SURELY / RATE_HZ):
            first = max(0, min(k, len(scans) - _BEHIND))
            behind = slice(first, first + _BEHIND)
            offset = round(float(np.median(nearest[behind] - counts[behind])))
        got.add(count + offset)
    return [at_s for place, at_s in enumerate(taken_s) if place not in got]


def false_fresh(daemon: DaemonOnPty) -> int:
    """Count statuses that were valid although the newest scan was too old."""
    received_s = [scan.received_s for scan in daemon.scans]
    n = 0
    for status in daemon.statuses:
        if status.data["valid"] and status.data["board"] == SERIAL:
            newest = daemon.scans[max(0, bisect_right(received_s, status.received_s) - 1)]
            n += status.time_s - newest.time_s > _OLDEST_VALID_S
    return n


def _row(result: FaultResult, statuses: list[ReceivedMessage]) -> dict[str, str]:
    recovery_ms = [1e3 * one.recovery_s for one in result.recoveries]
    states = dict.fromkeys(
        status.data["state"]
        for one in result.recoveries
        for status in statuses
        if one.span.begin_s <= status.time_s <= one.fresh.received_s
    )
    return {
        "fault": result.case.name,
        "times": f"{len(result.recoveries)}",
        "scans lost to it": f"{result.lost[0]}",
        "until recovered": f"{result.lost[1]}",
        "besides": f"{result.lost[2]}",
        "counted: missing": f"{result.missing}",
        "counted: overruns": f"{result.overruns}",
        "counted: restarts": f"{result.restarts}",
        "time to recover: median": f"{median(recovery_ms):.0f} ms",
        "longest": f"{max(recovery_ms):.0f} ms",
        "states meanwhile": ", ".join(state for state in states if state != "running") or NONE,
    }
