"""``./run bench slip``: detection latency, false alarms, errors of direction and onset, cost.

Scenes that obey physics, with known truth (`scenes`), are played without noise and read at several noises.
Every detector (`detectors`) is set to the same rate of false alarms in a hold; the bound is an oracle that
knows the shape of the coming onset (`oracle`). Thresholds and levels are tuned on seeds of their own
(`TUNE_SEED` and following). Reported are seeds on which nothing was set (`REPORT_SEED`), and families on
which nothing was set (`families.HELD_OUT_SLIPPING`, `HELD_OUT_QUIET`).
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from bench.report import BENCH_WORKERS, BenchOptions, BenchReport, aims_table, seeds_in_words
from bench.slip import tables
from bench.slip.aims import AIMS, SettingFound
from bench.slip.cost import DetectorCost, detector_costs
from bench.slip.detectors import PER_HOUR, Tuning, compared_detectors, sweep
from bench.slip.growth import GROWTHS, LATENCIES_S
from bench.slip.noise import NoiseTail, n_pieces, oracle_tail, rule_maxima, rule_tails
from bench.slip.oracle import Oracle
from bench.slip.quiet import (
    GROUPS,
    HOLD,
    QUIET_NOISES_V,
    QuietReading,
    QuietScene,
    family_exceedances,
    read_quiet,
)
from bench.slip.resting import LOADS, RestingLoad, read_load
from bench.slip.scenes import (
    ALL_QUIET,
    ALL_SLIPPING,
    HOLD_EXTRA_S,
    NOISES_V,
    TUNED_SLIPPING,
    PlayedScene,
    play,
)
from bench.slip.slips import CURVE_PER_HOUR, SlipReading, fastest_level, read_slips
from tactiled.detect.slip.detector import SETTINGS
from tactiled.emulator.scene.families import HELD_OUT_QUIET, HELD_OUT_SLIPPING, QUIET
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

R = TypeVar("R")

NOISE_SEED = 2001  # of the holds that thresholds come from
TUNE_SEED = 1001
# Constants of the coherent detector were set on family seeds below 200 and from 1001 to 1024: none of those
# is reported.
REPORT_SEED = 5001
_ORACLE_FAMILIES = ("0.25 mm/s", "20 mm/s", "turning", "partial-contact", "accelerating-slide")
# Seconds that two workers take for a job, for the progress bar: a piece of noise, a slip for the tuned values
# and for all detectors, a scene without slip, a resting load.
_PIECE_S, _TUNE_S, _SLIP_S, _QUIET_S, _LOAD_S = 0.3, 0.2, 0.4, 0.9, 0.8


@dataclass(frozen=True)
class SlipSizes:
    """Seeds of each family, hours of white noise, readings of each scene without slip."""

    n_tune: int
    n_slips: int
    n_quiet: int
    noise_hours: float
    n_draws: int
    n_cost_scans: int


QUICK = SlipSizes(n_tune=1, n_slips=2, n_quiet=1, noise_hours=0.5, n_draws=1, n_cost_scans=500)
FULL = SlipSizes(n_tune=2, n_slips=10, n_quiet=7, noise_hours=4.0, n_draws=3, n_cost_scans=3000)


@dataclass(frozen=True)
class SlipFound:
    """Everything that was measured."""

    sizes: SlipSizes
    tuning: Tuning
    oracle: NoiseTail
    slips: Sequence[SlipReading]
    quiet: Sequence[QuietScene]
    loads: Sequence[RestingLoad]
    costs: Mapping[str, DetectorCost]

    @property
    def quiet_readings(self) -> list[QuietReading]:
        """Readings of all scenes without slip."""
        return [reading for scene in self.quiet for reading in scene.readings]

    def of_setting(self, name: str, *, is_held_out: bool) -> SettingFound:
        """Readings of one setting on the families tuned on, or held out."""
        in_group = GROUPS["held out" if is_held_out else "tuned on"]
        quiet = [
            one
            for one in self.quiet_readings
            if one.detector == name and one.noise_v in QUIET_NOISES_V and in_group(one.family)
        ]
        return SettingFound(name, [slip for slip in self.slips if slip.is_held_out == is_held_out], quiet)


def bench_slip(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Aims, latency, false alarms, errors of direction and onset, cost, and the curve to choose from.

    The speed-accuracy curve is measured only where the picture, or all numbers, are written.
    """
    with_sweep = options.plot is not None or options.json is not None
    found = _measure(progress, QUICK if options.quick else FULL, options.dask, with_sweep=with_sweep)
    exceedances = family_exceedances(found.quiet)

    def draw(path: Path) -> None:
        from bench.slip.picture import draw_slip  # matplotlib is an extra

        draw_slip(path, found.slips, found.quiet_readings, exceedances, found.tuning)

    numbers = {
        "sizes": found.sizes,
        "window_level": found.tuning.window_level,
        "tails": _named(found.tuning.tails),
        "oracle_tail": found.oracle,
        "curve_per_hour": CURVE_PER_HOUR,
        "slips": [vars(slip) | {"rule_s": _named(slip.rule_s)} for slip in found.slips],
        "quiet": found.quiet_readings,
        "exceedances": {"latencies_s": LATENCIES_S, "growths": GROWTHS, "families": exceedances},
        "loads": found.loads,
        "costs": found.costs,
    }
    return BenchReport(_sections(found), numbers, draw)


def _named(by_rule: Mapping[tuple[str, int], R]) -> dict[str, R]:
    return {f"{rule}, level {level}": value for (rule, level), value in by_rule.items()}


def _measure(progress: ProgressBar, sizes: SlipSizes, dask: str | None, *, with_sweep: bool) -> SlipFound:
    pieces = [(piece, NOISE_SEED) for piece in range(n_pieces(sizes.noise_hours))]
    tune = list(itertools.product(TUNED_SLIPPING, range(TUNE_SEED, TUNE_SEED + sizes.n_tune)))
    slips = list(itertools.product(ALL_SLIPPING, range(REPORT_SEED, REPORT_SEED + sizes.n_slips)))
    # A hold takes the longest: it comes first, so that no worker waits for it at the end.
    quiet_families = sorted(ALL_QUIET, key=lambda family: family != HOLD)
    quiet = list(itertools.product(quiet_families, range(REPORT_SEED, REPORT_SEED + sizes.n_quiet)))
    loads = list(itertools.product(LOADS, range(REPORT_SEED, REPORT_SEED + sizes.n_slips)))
    progress.begin(
        _PIECE_S * len(pieces)
        + _TUNE_S * len(tune)
        + _SLIP_S * len(slips)
        + _QUIET_S * len(quiet)
        + _LOAD_S * len(loads)
    )
    with executor(BENCH_WORKERS, dask) as pool:

        def each(
            name: str, job_s: float, work: Callable[..., R], jobs: Sequence[tuple[object, ...]]
        ) -> list[R]:
            results = []
            for result in pool.map(work, *zip(*jobs, strict=True)):
                progress.advance(name, job_s)
                results.append(result)
            return results

        tails = rule_tails(each("noise", _PIECE_S, rule_maxima, pieces))
        shapes = [Oracle(_first_with_slip(family)) for family in _ORACLE_FAMILIES]
        oracle = oracle_tail(shapes, sizes.noise_hours, NOISE_SEED)
        tuned = each("slips to tune on", _TUNE_S, partial(read_slips, Tuning(tails, {}), oracle, ()), tune)
        tuning = Tuning(tails, fastest_level(list(itertools.chain(*tuned)), "any channel"))
        names = (*compared_detectors(tuning), *(sweep() if with_sweep else ()))
        slip_readings = each("slips", _SLIP_S, partial(read_slips, tuning, oracle, names), slips)
        quiet_scenes = each(
            "scenes without slip", _QUIET_S, partial(read_quiet, tuning, names, sizes.n_draws), quiet
        )
        load_readings = each("loads at rest", _LOAD_S, read_load, loads)
    return SlipFound(
        sizes,
        tuning,
        oracle,
        list(itertools.chain(*slip_readings)),
        sorted(quiet_scenes, key=lambda scene: list(ALL_QUIET).index(scene.family)),
        list(itertools.chain(*load_readings)),
        detector_costs(play(HOLD, QUIET[HOLD], TUNE_SEED), tuning, sizes.n_cost_scans),
    )


def _first_with_slip(family: str) -> PlayedScene:
    """First tuning seed with gross slip: a taxel in the middle that sticks keeps a turn from being gross."""
    played = (play(family, TUNED_SLIPPING[family], seed) for seed in itertools.count(TUNE_SEED))
    return next(one for one in played if one.slip is not None)


def _sections(found: SlipFound) -> list[str]:
    detectors, sizes = compared_detectors(found.tuning), found.sizes
    names, settings = list(detectors), [name for name, one in detectors.items() if one.is_setting]
    tuned = [slip for slip in found.slips if not slip.is_held_out]
    held_out = [slip for slip in found.slips if slip.is_held_out]
    quiet = found.quiet_readings
    exceedances = family_exceedances(found.quiet)
    levels = ", ".join(f"{found.tuning.window_level[noise]} at {1e3 * noise:g} mV" for noise in NOISES_V)
    read = [one for one in quiet if one.detector == settings[0]]
    in_words = "; ".join(
        f"{name} is set to {params.false_alarms_per_hour:g} false alarms an hour of a hand that moves "
        f"without announcement: the growth of shear must be {params.shear:.2g} of the pressure, and noise "
        f"may raise {params.noise_per_hour:.2g} alarms an hour"
        for name, params in SETTINGS.items()
    )

    def aims(*, is_held_out: bool) -> str:
        return aims_table(AIMS, {name: found.of_setting(name, is_held_out=is_held_out) for name in settings})

    families = ", ".join([*dict.fromkeys(slip.family for slip in tuned), *QUIET])
    return [
        f"Tuned on {seeds_in_words(sizes.n_tune, TUNE_SEED)} and {sizes.noise_hours:g} h of white noise "
        f"(seed {NOISE_SEED}). Reported are {seeds_in_words(sizes.n_slips, REPORT_SEED)} (slips) and "
        f"{seeds_in_words(sizes.n_quiet, REPORT_SEED)} (no slips). The detector's constants were set on "
        f"other seeds of the families {families}. Held out, nothing set on them: "
        f"{', '.join(HELD_OUT_SLIPPING | HELD_OUT_QUIET)}.",
        f"Thresholds: {PER_HOUR:g} false alarm an hour in a hold. Level of the plain window: {levels}. Every "
        f"hold is {HOLD_EXTRA_S:g} s longer than its family's.",
        f"{sum(bool(scene.readings) for scene in found.quiet)} scenes without slip were read for "
        f"{sum(one.hours for one in read):.1f} h, line faults included, at {len(QUIET_NOISES_V)} noises (the "
        f"hold at {len(NOISES_V)}); readings that differ by noise alone excluded, for "
        f"{sum(one.distinct_hours for one in read):.1f} h.",
        f"Settings: {in_words}.",
        "Aims, families tuned on.",
        aims(is_held_out=False),
        "Aims, families held out.",
        aims(is_held_out=True),
        "Bound on every detector of growing shear: the growth of shear over pressure that slips have reached "
        "at the latencies of the aims, and how often an hour unannounced motion without slip and without "
        "noise grows by as much in that time.",
        tables.bound_table(tuned, [exceedances[name] for name in exceedances if GROUPS["tuned on"](name)]),
        "Latency of the first event: from the beginning of shear (growth by 0.2 % of the grip) to the end of "
        "the scan that completed the evidence; negative where shear had grown by less. before gross: of "
        "slips that take 50 ms or more to become gross. incipient: median / p95 since 10 % slipped (number "
        "of such events). gross: median distance from 90 %. early, on the press: false alarms before the "
        "shear. Families tuned on:",
        tables.latency_table(tuned, names),
        "Families held out:",
        tables.latency_table(held_out, names),
        "Latency of the first event in steady slides by speed and noise, median / p95.",
        tables.speed_table(found.slips, names),
        f"Latency of the first event by family, median / p95, at {1e3 * tables.FAMILY_NOISE_V:g} mV.",
        tables.family_table(found.slips, names),
        "The largest latencies of each detector.",
        tables.worst_table(found.slips, names),
        "Errors of direction, onset (against the beginning of shear) and gross instant, and the part within "
        "one stated sigma.",
        tables.estimate_table(found.slips, names),
        "False alarms an hour, the mean of the families, with the 95 % interval of the counts; a motion "
        "counts once, however often it is read. announced: the daemon is told of the motion of gripper and "
        "arm as it begins.",
        tables.hourly_table(quiet, settings),
        "False alarms a minute by family; announced: those that remain with announcements; gross: those that "
        "report gross slip; correct: reports of incipient slip where a part of the contact slips. A false "
        "slip without end hides all that follow. Settings are read at every draw of the noise, the others "
        "at one.",
        tables.quiet_table(quiet, names),
        "False alarms in holds, of as many as the rate allows in that time. A false slip on the press "
        "without end hides all that follow.",
        tables.hold_table(quiet, detectors),
        "Loads that grow to a part of the friction limit and rest there, or swing: how many are reported as "
        "gross slip. The shear of a slip grows and stops in the same way. Below them: how many slips are "
        "reported as gross, and how many of the others as ended while they go on.",
        tables.resting_table(found.loads, found.slips),
        "Cost, 36 channels.",
        tables.cost_table(found.costs),
    ]
