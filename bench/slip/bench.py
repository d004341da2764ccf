"""``./run bench slip``: how soon a slip is said, how often one that was none, and what both cost.

Physical scenes with known truth (`slip_scenes`), played without noise and read at several noises. Every
detector (`slip_rivals`) is set to the same rate of false alarms in a hold; the bound is an oracle that knows
the shape of the coming onset (`slip_oracle`). Thresholds and levels are tuned on seeds of their own
(`TUNE_SEED` and following); what is reported is of seeds that nothing was set on (`REPORT_SEED`), and of
families that nothing was set on beside (`families.HELD_OUT_SLIPPING`, `HELD_OUT_QUIET`).
"""

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.pool import workers
from bench.report import BenchOptions, BenchReport
from bench.slip.cost import costs
from bench.slip.latency import fastest_level, measure
from bench.slip.noise import oracle_tail, rule_maxima, rule_pieces, rule_tails
from bench.slip.oracle import Oracle
from bench.slip.quiet import HELD, Quiet, count, quiet_families
from bench.slip.report import Measured, numbers_of, text_of
from bench.slip.rest import rests, tasks
from bench.slip.rivals import Knobs, rivals, sweep
from bench.slip.scenes import Played, play, slipping_families, tuned_families
from tactiled.emulator.scene.families import QUIET, Family
from tactiled.progress import ProgressBar

NOISE_SEED = 2001  # of the holds that thresholds come from
TUNE_SEED = 1001
# Constants of the coherent detector were set on family seeds below 200 and from 1001 to 1024: none of those
# is reported.
REPORT_SEED = 5001
_ORACLE_SHAPES = ("0.25 mm/s", "20 mm/s", "turning", "partial-contact", "accelerating-slide")
# Seconds of one core, for the bar: a second of a held object, an hour of noise for all rules, a slip for all
# detectors.
_HELD_S, _NOISE_S, _SLIP_S = 0.1, 3.0, 0.5
_REST_S = 1.5  # a load that rests, for all settings


@dataclass(frozen=True)
class Sizes:
    """How much is measured: seeds, hours of white noise, readings of each scene without slip."""

    tune: int
    slips: int
    quiet: int
    noise_hours: float
    readings: int
    cost_scans: int


QUICK = Sizes(tune=1, slips=2, quiet=1, noise_hours=0.5, readings=1, cost_scans=500)
FULL = Sizes(tune=2, slips=10, quiet=7, noise_hours=4.0, readings=3, cost_scans=3000)


def bench_slip(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Aims, latency, false alarms, errors of direction and onset, cost, and the curve to choose from.

    The speed-accuracy curve is measured only where the picture, or all numbers, are written.
    """
    with_sweep = options.plot is not None or options.json is not None
    found = _measured(progress, QUICK if options.quick else FULL, with_sweep=with_sweep)

    def draw(path: Path) -> None:
        from bench.slip.picture import draw_slip  # matplotlib is an extra

        draw_slip(path, found.cases, found.quiet, found.knobs)

    return BenchReport([text_of(found)], numbers_of(found), draw)


def _measured(progress: ProgressBar, sizes: Sizes, *, with_sweep: bool) -> Measured:
    tune_seeds = range(TUNE_SEED, TUNE_SEED + sizes.tune)
    slip_seeds = range(REPORT_SEED, REPORT_SEED + sizes.slips)
    quiet_seeds = range(REPORT_SEED, REPORT_SEED + sizes.quiet)
    tuned, slips, quiet = tuned_families(), slipping_families(), quiet_families()
    to_tune = [(name, seed) for name in tuned for seed in tune_seeds]
    to_measure = [(name, seed) for name in slips for seed in slip_seeds]
    to_count = [(name, seed) for name in quiet for seed in quiet_seeds]
    to_rest = tasks(range(REPORT_SEED, REPORT_SEED + sizes.slips))
    work = [
        _NOISE_S * sizes.noise_hours,
        sum(_play_s(tuned[name], seed) + _SLIP_S / 4 for name, seed in to_tune),
        sum(_play_s(slips[name], seed) + _SLIP_S for name, seed in to_measure),
        sum(_play_s(quiet[name], seed) + _count_s(name, sizes.readings) for name, seed in to_count),
        _REST_S * len(to_rest),
    ]
    progress.begin(sum(work))
    with workers() as pool:
        each = Each(pool, progress)
        pieces = rule_pieces(sizes.noise_hours)
        tails = rule_tails(
            each(
                "noise",
                rule_maxima,
                [(piece, NOISE_SEED) for piece in range(pieces)],
                [work[0] / pieces] * pieces,
            )
        )
        shapes = [Oracle(_first_that_slips(name, tuned[name])) for name in _ORACLE_SHAPES]
        oracle = oracle_tail(shapes, sizes.noise_hours, NOISE_SEED)
        untuned = Knobs(tails, {})
        cases = each(
            "slips to tune on",
            measure,
            [(name, seed, untuned, oracle, ()) for name, seed in to_tune],
            [_play_s(tuned[name], seed) + _SLIP_S / 4 for name, seed in to_tune],
        )
        knobs = Knobs(tails, fastest_level(list(itertools.chain(*cases)), "any channel"))
        names = [*rivals(knobs), *(sweep() if with_sweep else ())]
        cases = each(
            "slips",
            measure,
            [(name, seed, knobs, oracle, names) for name, seed in to_measure],
            [_play_s(slips[name], seed) + _SLIP_S for name, seed in to_measure],
        )
        without = Quiet()
        for part in each(
            "scenes without slip",
            count,
            [(name, seed, sizes.readings, knobs, names) for name, seed in to_count],
            [_play_s(quiet[name], seed) + _count_s(name, sizes.readings) for name, seed in to_count],
        ):
            without.add(part)
        resting = each("loads that rest", rests, to_rest, [_REST_S] * len(to_rest))
    return Measured(
        seeds={
            "tune": list(tune_seeds),
            "slips": list(slip_seeds),
            "quiet": list(quiet_seeds),
            "noise": [NOISE_SEED],
        },
        noise_hours=sizes.noise_hours,
        knobs=knobs,
        oracle=oracle,
        cases=list(itertools.chain(*cases)),
        quiet=without,
        resting=list(itertools.chain(*resting)),
        cost=costs(play(HELD, QUIET[HELD], TUNE_SEED), knobs, scans=sizes.cost_scans),
    )


class Each:
    """Work for a pool: the longest first, so that no worker waits for the last; results in order."""

    def __init__(self, pool: Executor, progress: ProgressBar) -> None:
        self._pool, self._progress = pool, progress

    def __call__(
        self, what: str, work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], takes_s: Sequence[float]
    ) -> list[Any]:
        """Run `work` on each task, longest first by `takes_s`; results are in the order of the tasks."""
        order = sorted(range(len(tasks)), key=lambda k: -takes_s[k])
        found: list[Any] = [None] * len(tasks)
        results = self._pool.map(work, *zip(*(tasks[k] for k in order), strict=True))
        for k, result in zip(order, results, strict=True):
            found[k] = result
            self._progress.advance(what, takes_s[k])
        return found


def _play_s(family: Family, seed: int) -> float:
    """About what it takes to play a scene."""
    scene = family(seed)
    return _HELD_S * (scene.duration_s if scene.held_object is not None else 0.1 * scene.duration_s)


def _count_s(family: str, readings: int) -> float:
    """About what it takes to read a scene; a hold is long, and has more noises and the faults."""
    return (0.4 + 0.15 * readings) * (35.0 if family == HELD else 1.0)


def _first_that_slips(name: str, family: Family) -> Played:
    """Of the tuning seeds: a middle taxel that holds on keeps a turn from being gross."""
    played = (play(name, family, seed) for seed in itertools.count(TUNE_SEED))
    return next(p for p in played if p.slip is not None)
