"""``./run bench hold``: drops, grip force and reaction of a grasp controller on unknown objects.

Objects, grippers and events are drawn from a seed (`families.holding`). Simulated time uses the emulator's
contact model and electronics in arrays (`batch`), the detector scan by scan, and `GripController` of the
client. The controller's numbers were set on seeds from 500; what is printed is measured on others.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.hold.play import DOWN_S, RESTART_S, GraspResult, play
from bench.report import (
    BENCH_WORKERS,
    NONE,
    Aim,
    BenchOptions,
    Table,
    aim,
    aims_table,
    at_most,
    counted,
    largest_rate,
    seeds_in_words,
    table,
)
from tactiled.client.grip_controller import TARGET, GripController
from tactiled.emulator.scene.families.holding import EVENTS, hold
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

REPORTED_FROM = 10_000
N_MARGIN, N_OTHERS, N_QUICK = 1000, 120, 40
_BATCH = 40  # grasps that are simulated at once, and by one process
_PARTS = (0.7, 0.85, 1.0, 1.15)  # of the controller's own target
_MOST_DROPPED, _MOST_OVER = 0.005, 1.4


class Arm(NamedTuple):
    """Grasps by one target: target, number of grasps, and their name in a table."""

    target: float
    n: int
    restarts: bool = False  # the daemon is started anew while the object hangs

    @property
    def words(self) -> str:
        """Return the name."""
        return f"margin, target {self.target:g}" + ", restart" * self.restarts


def measure(arm: Arm, seeds: range) -> list[GraspResult]:
    """Play grasps of some seeds."""
    controllers = [GripController(arm.target) for _ in seeds]
    return play([hold(seed) for seed in seeds], controllers, restarts=arm.restarts).results()


def bench_hold(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Drops and grip of the margin, by its target.

    Quick: 40 grasps of each instead of 120 or 1000.
    """
    n, n_chosen = (N_QUICK,) * 2 if options.quick else (N_OTHERS, N_MARGIN)
    chosen, restarted = Arm(round(TARGET, 2), n_chosen), Arm(TARGET, n, restarts=True)
    others = {part: Arm(round(TARGET * part, 2), n) for part in _PARTS}
    compared = [*(others | {1.0: chosen}).values(), restarted]
    jobs = [
        (arm, range(start, min(start + _BATCH, REPORTED_FROM + arm.n)))
        for arm in compared
        for start in range(REPORTED_FROM, REPORTED_FROM + arm.n, _BATCH)
    ]
    progress.begin(len(jobs))
    found: dict[Arm, list[GraspResult]] = {arm: [] for arm in compared}
    with executor(BENCH_WORKERS) as pool:
        measured = counted(pool.map(measure, *zip(*jobs, strict=True)), progress, "batch")
    for (arm, _), some in zip(jobs, measured, strict=True):
        found[arm] += some
    return [
        f"Grasps of 7 s ({seeds_in_words(chosen.n, REPORTED_FROM)}; rows with fewer grasps use the "
        "first seeds). The needed grip is the smallest with which friction holds the object. Grip over the "
        "needed: for each grasp without a drop, the mean grip while the object hangs freely is divided by "
        "the mean needed grip of the same time; the table has the average over these grasps.",
        aims_table(aims(found[chosen]), chosen.words),
        table({"grip": arm.words, **_numbers(some)} for arm, some in found.items()),
        f"Grasps of the margin with target {TARGET:g}, by event.",
        _by_event(found[chosen]),
        f"The same, but the daemon is stopped after {RESTART_S:g} s, starts again {DOWN_S:g} s later, and "
        "then finds the object in the hand. No event begins before 3 s.",
        _by_event(found[restarted]),
    ]


def _by_event(some: Sequence[GraspResult]) -> Table:
    return table({"event": event, **_numbers([r for r in some if r.event == event])} for event in EVENTS)


def over_least(some: Sequence[GraspResult]) -> float:
    """Mean of grip over the needed of the grasps that held."""
    held = [r.over_least for r in some if not r.dropped]
    return float(np.mean(held)) if held else float("nan")


def aims(some: Sequence[GraspResult]) -> list[Aim]:
    """Judge grasps by the margin."""
    n, over = sum(r.dropped for r in some), over_least(some)
    words = f"{100 * n / len(some):.1f} % ({n} of {len(some)})"
    holds = largest_rate(n, len(some)) <= _MOST_DROPPED  # not by the luck of few grasps
    return [
        aim("dropped", "at most 0.5 %", words, holds, is_open=n <= _MOST_DROPPED * len(some)),
        at_most("mean grip over the needed", _MOST_OVER, over, ".2f"),
    ]


def _numbers(some: Sequence[GraspResult]) -> dict[str, str]:
    slips = [1e3 * r.reaction_s for r in some if not np.isnan(r.reaction_s)]
    reaction_ms = float(np.median(slips)) if slips else np.nan
    reaction = f"{reaction_ms:.0f}" if np.isfinite(reaction_ms) else "none"  # most of them had none
    return {
        "grasps": f"{len(some)}",
        "dropped": f"{sum(r.dropped for r in some)}",
        "grip over the needed": f"{over_least(some):.2f}" if any(not r.dropped for r in some) else NONE,
        "slid 1 mm or more": f"{sum(r.slid_mm >= 1 for r in some)}",
        "gross slips": f"{len(slips)}",
        "reaction (ms, median)": reaction if slips else NONE,
    }
