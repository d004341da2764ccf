"""``./run bench faults``: everything that happens to a cable, done to one, many times over.

The whole daemon reads an emulated board on a real pty (`stage`), at a rate that is not the board's own, so
that a recovery is one of its settings too. Each fault is done while all is well (or in the state that its
name says); then come the first fresh scan that was taken behind it, and what is missing.
"""

import asyncio
import logging
import tempfile
import time
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from bench.daemon.fault_cases import CALM_S, CASES, Case, Span
from bench.daemon.stage import RATE_HZ, SERIAL, Heard, Stage
from tactiled.daemon.board.session import SILENT_PERIODS
from tactiled.plain_table import table
from tactiled.progress import ProgressBar

_IN_FLIGHT_S = 0.03  # a scan is sampled and sent in 15 ms, the rest is the host's
_OLDEST_VALID_S = 2 * SILENT_PERIODS / RATE_HZ + 0.01  # as the status has it, by instants that err a little
_SURELY = 0.75  # of a period: nearer than that, the count is right and the instant is not
_BEHIND = 40  # scans: less than come before the next fault, and a new clock fit needs some ten of them


@dataclass(frozen=True)
class Time:
    """One time that a fault was done.

    Attributes
    ----------
    span : Span
    before, after : Heard
        Statuses of calm moments around it.
    fresh : Heard
        The first fresh scan that was taken behind it.
    """

    span: Span
    before: Heard
    fresh: Heard
    after: Heard

    @property
    def recovery_s(self) -> float:
        """From its end until the subscriber had that scan; 16 ms of it are the scan's own way."""
        return self.fresh.received_s - self.span.end_s

    def counted(self, name: str) -> int:
        """How far a counter of the status moved."""
        return int(self.after.data[name] - self.before.data[name])

    def lost(self, case: Case, lost_s: list[float]) -> tuple[int, int, int]:
        """Scans that the fault took, that went by until the recovery, and that were lost besides."""
        from_s, until_s = self.before.time_s - _IN_FLIGHT_S, self.after.time_s - _IN_FLIGHT_S
        all_s = [at_s for at_s in lost_s if from_s <= at_s < until_s]
        if case.scans_hit is None:
            n_own = sum(self.span.begin_s - _IN_FLIGHT_S <= at_s < self.span.end_s for at_s in all_s)
        else:
            near = sum(abs(at_s - self.span.begin_s) <= _IN_FLIGHT_S for at_s in all_s)
            n_own = min(near, case.scans_hit)
        n_behind = sum(self.span.end_s <= at_s < self.fresh.time_s for at_s in all_s)
        n_behind = 0 if case.scans_hit is not None else n_behind
        return n_own, n_behind, len(all_s) - n_own - n_behind


async def once(case: Case, stage: Stage) -> Time:
    """Do it when all is well, and wait until all is well again."""
    before = await _calm(stage, case.calm_s)
    span = await case.play(stage)
    fresh = await stage.until_fresh_scan(span.end_s)
    return Time(span, before, fresh, await _calm(stage, CALM_S))


async def _calm(stage: Stage, calm_s: float) -> Heard:
    """The status at the end of a time in which all was well."""

    def is_calm() -> bool:
        recent = [status for status in stage.statuses[-20:] if status.time_s >= from_s]
        since_s = next((s.time_s for s in reversed(recent) if not s.data["valid"]), from_s)
        return bool(recent) and recent[-1].time_s >= since_s + calm_s

    from_s = time.monotonic()
    await stage.until(is_calm, "all is well")
    return stage.statuses[-1]


def lost_scans(taken_s: Sequence[float], scans: Sequence[Heard]) -> list[float]:
    """Instants of the scans that were due and the subscriber never got.

    Instants alone may err by a period while a new clock fit settles on a busy machine, so scans go by the
    daemon's count. Where an instant is far from what the count says, the count is tied to the board's anew,
    as most of the scans behind it have it.
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


def false_fresh(stage: Stage) -> int:
    """Statuses that were valid while the newest scan that had come was older than may be."""
    received_s = [scan.received_s for scan in stage.scans]
    n = 0
    for status in stage.statuses:
        if status.data["valid"] and status.data["board"] == SERIAL:
            newest = stage.scans[max(0, bisect_right(received_s, status.received_s) - 1)]
            n += status.time_s - newest.time_s > _OLDEST_VALID_S
    return n


async def _play(progress: ProgressBar, folder: Path, most: int) -> tuple[list[list[Time]], Stage]:
    found = []
    progress.begin(len(CASES))
    async with Stage(folder) as stage:
        await stage.until_said("running")
        for case in CASES:
            times = [await once(case, stage) for _ in range(min(case.times, most))]
            found.append(times)
            progress.advance(case.name)
    return found, stage


def bench_faults(progress: ProgressBar, *, quick: bool) -> str:
    """Table of what faults cost and how long they last."""
    logging.getLogger("tactiled.daemon").setLevel(logging.ERROR)  # it says each fault, as it should
    with tempfile.TemporaryDirectory(prefix="tactiled-") as folder:
        found, stage = asyncio.run(_play(progress, Path(folder), 2 if quick else 10))
    lost_s = lost_scans(stage.board.taken_s, stage.scans)
    rows, wrong = [], []
    for case, times in zip(CASES, found, strict=True):
        lost = [sum(column) for column in zip(*(time.lost(case, lost_s) for time in times), strict=True)]
        missing = sum(time.counted("scans_missing") for time in times)
        overruns = sum(time.counted("scans_overrun") for time in times)
        restarts = sum(time.counted("restarts") for time in times)
        rows.append(_row(case, times, [*lost, missing, overruns, restarts], stage.statuses))
        if overruns != case.overruns * len(times):
            wrong.append(f"{case.name}: {overruns} overruns counted, {case.overruns * len(times)} injected")
        if restarts != case.restarts * len(times):
            wrong.append(f"{case.name}: restarts miscounted")
        if lost[-1] or (case.counts and missing != sum(lost)):
            wrong.append(f"{case.name}: scans lost besides, or miscounted")
    if n := stage.board.overruns_of_host:
        wrong.append(f"this host is too slow: {n} scan instants were missed that no fault took")
    if stale := false_fresh(stage):
        wrong.append(f"{stale} statuses called old scans fresh")
    head = ["fault", "times", "scans lost to it", "until recovered", "besides", "counted: missing",
            "overruns", "restarts", "time to recover: median", "worst", "states meanwhile"]  # fmt: skip
    return f"{table(head, rows)}\n\n{'wrong: ' + '; '.join(wrong) if wrong else 'Nothing wrong was found.'}"


def _row(case: Case, times: list[Time], counts: list[int], statuses: list[Heard]) -> list[str]:
    recovery_s = [time.recovery_s for time in times]
    states = dict.fromkeys(
        status.data["state"]
        for time in times
        for status in statuses
        if time.span.begin_s <= status.time_s <= time.fresh.received_s
    )
    return [
        case.name,
        str(len(times)),
        *map(str, counts),
        f"{1e3 * median(recovery_s):.0f} ms",
        f"{1e3 * max(recovery_s):.0f} ms",
        ", ".join(state for state in states if state != "running") or "-",
    ]
