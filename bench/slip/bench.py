"""``./run bench slip``: what a controller asks of slip events, for every setting.

Random worlds (`bench.worlds.laws`) and the emulator's families (`scenes`, `resting`) are asked the same
questions (`score`). Everything is measured on seeds on which nothing was set.
"""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.report import BENCH_WORKERS, BenchOptions, BenchReport, grouped, seeds_in_words, table
from bench.slip import tables
from bench.slip.cases import (
    RANDOM,
    REPORTED_FROM,
    SCENES,
    draw_reported,
    from_scene,
    from_world,
    in_mv,
)
from bench.slip.cost import cost_table, detector_costs
from bench.slip.faults import FAULTS, HOLD, FaultEvents, no_fault
from bench.slip.gratings import (
    GRATINGS_FROM,
    LENGTH_S,
    N_GRATINGS,
    N_QUICK_GRATINGS,
    GratingAnswer,
    read_grating,
    rows,
)
from bench.slip.replay import CaseEvents, run_case, run_stream
from bench.slip.scenes import ALL_QUIET, ARRAY, NOISES_V, play
from bench.slip.score import AHEAD_S, LEADS_TO_S, SLOW_S
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

# The filter learnt from random worlds from 100000 on, and from none of the families.
REPORT_SEED = 5001
N_WORLDS, N_QUICK_WORLDS = 240, 48
N_SCENES, N_QUICK_SCENES = 5, 1  # seeds of each family
FAULT_NOISES_V = (NOISES_V[0], NOISES_V[2])
_IN_SUMMARY = (RANDOM, in_mv(NOISES_V[0]), in_mv(NOISES_V[2]))
_BATCH = 12
_FAULT_SEED = 11


def bench_slip(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Answers of each setting, by kind of world, noise, family, load and fault; curves; cost.

    Quick: 48 random worlds instead of 240, one seed of each family instead of five.
    """
    n_worlds = N_QUICK_WORLDS if options.quick else N_WORLDS
    n_scenes = N_QUICK_SCENES if options.quick else N_SCENES
    seeds = range(REPORTED_FROM, REPORTED_FROM + n_worlds)
    batches = [seeds[start : start + _BATCH] for start in range(0, n_worlds, _BATCH)]
    scene_seeds = range(REPORT_SEED, REPORT_SEED + n_scenes)
    scenes = list(itertools.product(SCENES, scene_seeds))
    n_gratings = N_QUICK_GRATINGS if options.quick else N_GRATINGS
    progress.begin(len(batches) + len(scenes) + n_scenes + n_gratings)
    events: list[CaseEvents] = []
    faults: list[FaultEvents] = []
    with executor(BENCH_WORKERS, options.dask) as pool:
        for some in pool.map(read_worlds, batches):
            events += some
            progress.advance("random worlds")
        for some in pool.map(read_scene, *zip(*scenes, strict=True)):
            events += some
            progress.advance("families")
        for holds in pool.map(read_faults, scene_seeds):
            faults += holds
            progress.advance("faults")
        gratings = []
        for answer in pool.map(read_grating, range(GRATINGS_FROM, GRATINGS_FROM + n_gratings)):
            gratings.append(answer)
            progress.advance("gratings")

    def draw(path: Path) -> None:
        from bench.slip.picture import draw_slip  # matplotlib is an extra

        draw_slip(path, groups_of(events))

    return BenchReport([*_sections(events, faults, n_worlds, n_scenes), *_over_gratings(gratings)], draw=draw)


def read_worlds(seeds: range) -> list[CaseEvents]:
    """Run all detectors over a batch of random worlds."""
    return [run_case(from_world(world)) for world in draw_reported(seeds)]


def read_scene(name: str, seed: int) -> list[CaseEvents]:
    """Run all detectors over a scene, read at every noise."""
    played = SCENES[name](seed)
    return [run_case(from_scene(name, played, noise_v)) for noise_v in NOISES_V]


def read_faults(seed: int) -> list[FaultEvents]:
    """Run all detectors over a hold without and with each fault."""
    played = play(HOLD, ALL_QUIET[HOLD], seed)
    return [
        FaultEvents(name, stream, run_stream(ARRAY, stream))
        for noise_v in FAULT_NOISES_V
        for name, fault in ({"none": no_fault} | FAULTS).items()
        for stream in [fault(played.counts(noise_v, 0), np.random.default_rng([seed, 0, _FAULT_SEED]))]
    ]


def groups_of(events: Sequence[CaseEvents]) -> dict[str, list[CaseEvents]]:
    """Cases by kind of world and noise."""
    return grouped(events, lambda one: one.case.group)


def _sections(
    events: Sequence[CaseEvents], faults: Sequence[FaultEvents], n_worlds: int, n_scenes: int
) -> Iterator[str]:
    groups = groups_of(events)
    families = [one for one in events if one.case.group != RANDOM]
    noises = ", ".join(name for name in groups if name != RANDOM)
    yield (
        f"{n_worlds} random worlds ({seeds_in_words(n_worlds, REPORTED_FROM)}) and {len(SCENES)} families "
        f"({seeds_in_words(n_scenes, REPORT_SEED)}), these at {noises}. Slow slips take {SLOW_S:g} s or more "
        "from a tenth of the area to all of it; a slip is reported ahead if an event is open "
        f"{1e3 * AHEAD_S:.0f} ms before it becomes gross. Nothing slips where less than a tenth of the area "
        "does, and did so in the last 0.1 s. Rests: cases without gross slip. Ended: an end was reported "
        "while all of the contact slid, and no new slip within 0.1 s. Inside: errors of direction within one "
        "stated standard deviation. Reversed: an error beyond 90 deg with a standard deviation below 30 deg. "
        "Heads name the probabilities at which incipient and gross slip are reported."
    )
    summary = {group: groups[group] for group in _IN_SUMMARY}
    yield f"In short: {'; '.join(map(_in_words, summary))}."
    yield tables.summary_table(summary)
    for group, some in groups.items():
        slips = sum(one.case.slips for one in some)
        yield f"{_in_words(group)}: {len(some)} cases, {slips} with gross slip."
        yield tables.settings_table(some)
    yield (
        f"Families with slip, setting {tables.DEFAULT}, at {noises}. Announced: an onset was reported at "
        f"most {LEADS_TO_S:g} s before gross slip."
    )
    yield tables.slips_table(families)
    yield (
        "Families without gross slip: onsets an hour where nothing slips, at all noises together; after the "
        "stroke, those that remain where gripper and arm announce their motion."
    )
    yield tables.quiet_table(families)
    yield f"Loads below the friction limit: how many are reported as gross slip, at {noises}."
    yield tables.resting_table(families)
    fault_noises = " and ".join(map(in_mv, FAULT_NOISES_V))
    yield (
        f"Holds with faults of wires and bytes, one in 5 s, at {fault_noises} together: valid onsets, and "
        "how many of these are gross."
    )
    yield tables.fault_table(faults)
    for words, some in (("Random worlds", groups[RANDOM]), (f"Families at {noises}, together", families)):
        yield f"{words}: curves over the probabilities."
        yield tables.curves_table(some)
    yield (
        "Probability that a tenth of the area slips, against the truth, in random worlds, where shear over "
        "load grows beyond what was borne before."
    )
    yield tables.reliability_table(groups[RANDOM])
    yield "Processor time of the slip detector for a scan with 36 channels."
    yield cost_table(detector_costs())


def _over_gratings(found: Sequence[GratingAnswer]) -> Iterator[str]:
    yield (
        f"Slides over gratings ({seeds_in_words(len(found), GRATINGS_FROM)}) of smooth, even friction, in "
        f"worlds of {LENGTH_S:g} s, with ripples of 5 to 24 dB: told as gross slip, and answered by the "
        "groove estimator, whose speed is given."
    )
    yield table(rows(found))


def _in_words(group: str) -> str:
    return "Random worlds" if group == RANDOM else f"Families at {group}"
