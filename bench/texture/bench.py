"""``./run bench texture``: errors of the joint estimator over the Cramer-Rao bound, and what spoils answers.

Gratings drawn in white and coloured noise, and slides that are followed (`trials`); table 2 of the paper and
plates drawn at random on scenes that obey physics, the published procedure beside the joint estimator
(`plates`); windows that break the model (`spoiled`).
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from bench.report import BENCH_WORKERS, BenchOptions, aims_table, counted, seeds_in_words
from bench.texture import spoiled, tables
from bench.texture.plates import PLATES, Plate, drawn_plate_trials, paper_plate_trials
from bench.texture.trials import (
    MEMORIES,
    MISFIT_S,
    SLIDE_S,
    Trial,
    coloured_trial,
    grid_trial,
    misfit_trial,
    track_trials,
)
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
SNRS_DB = (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
# Noise of slides that are followed: dB, and memory from scan to scan.
TRACKS = (
    *((snr_db, 0.0) for snr_db in (0.0, 10.0, 20.0, 30.0, 40.0)),
    *((15.0, memory) for memory in MEMORIES),
)
COLOURED_SEED = 5001  # seeds of reports from here on; nothing is tuned on them
_BATCH = 5  # calls at a time, so that all workers end together


class TextureSizes(NamedTuple):
    """How much is measured; seeds are 0 to n - 1 everywhere but in coloured noise."""

    trials: int  # windows a cell of the grid
    coloured: int  # windows in noise of each colour
    plates: Sequence[Plate]
    scenes: int  # slides a plate
    drawn: int  # plates drawn at random, a slide each
    misfits: int  # windows of each kind, speed known and not
    tracks: int  # slides in each noise that are followed


# A fine plate, and one that the procedure mostly refuses.
QUICK = TextureSizes(
    trials=3, coloured=100, plates=((0.9, 0), (1.2, 30)), scenes=1, drawn=2, misfits=2, tracks=2
)
# Eighty windows a cell are 480 of a length or a noise, whose error over bound is known to 3 %. In coloured
# noise 3400 windows leave the 3000 answers without which "one in a thousand" cannot be shown.
FULL = TextureSizes(trials=80, coloured=3400, plates=PLATES, scenes=5, drawn=40, misfits=30, tracks=40)

Work = Callable[..., Trial | list[Trial]]


def _parts(sizes: TextureSizes) -> dict[str, tuple[Work, list[tuple[Any, ...]]]]:
    """Parts of the bench: a function that makes trials, and the arguments of each call."""
    either, product = (True, False), itertools.product
    coloured = range(COLOURED_SEED, COLOURED_SEED + sizes.coloured)
    spoils = spoiled.MISFITS | spoiled.GROOVELESS
    return {
        "grid": (grid_trial, list(product(WINDOWS_S, SNRS_DB, either, range(sizes.trials)))),
        "coloured noise": (coloured_trial, list(product(MEMORIES, coloured))),
        "plates": (paper_plate_trials, list(product(sizes.plates, range(sizes.scenes)))),
        "drawn plates": (drawn_plate_trials, [(seed,) for seed in range(sizes.drawn)]),
        "misfits": (misfit_trial, list(product(spoils, either, range(sizes.misfits)))),
        "tracks": (track_trials, [(*noise, seed) for noise, seed in product(TRACKS, range(sizes.tracks))]),
    }


def bench_texture(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Error over bound, table 2, windows that break the model, and slides."""
    sizes = QUICK if options.quick else FULL
    parts = {name: (work, _batches(calls)) for name, (work, calls) in _parts(sizes).items()}
    progress.begin(sum(len(batches) for _, batches in parts.values()))
    trials: dict[str, list[Trial]] = {}
    with executor(BENCH_WORKERS) as pool:
        for name, (work, batches) in parts.items():
            found = counted(pool.map(partial(_run, work), batches), progress, name)
            trials[name] = list(itertools.chain.from_iterable(found))
    return [
        *_sections(trials, sizes),
        "Aims, worst case of what was measured; open: too few windows to tell.",
        aims_table(tables.AIMS, {"measured": trials}),
    ]


def _batches(calls: Sequence[tuple[Any, ...]]) -> list[Sequence[tuple[Any, ...]]]:
    return [calls[first : first + _BATCH] for first in range(0, len(calls), _BATCH)]


def _run(work: Work, calls: Sequence[tuple[Any, ...]]) -> list[Trial]:
    found = [work(*arguments) for arguments in calls]
    return [trial for one in found for trial in (one if isinstance(one, list) else [one])]


def _sections(trials: Mapping[str, list[Trial]], sizes: TextureSizes) -> list[str]:
    grid, drawn = trials["grid"], trials["drawn plates"]
    return [
        "Error of the angle / of the period over the Cramer-Rao bound, and in brackets the part of the "
        f"windows that was answered; {sizes.trials} windows a cell "
        f"({seeds_in_words(sizes.trials)}) of three periods or more. Gratings of 0.6 to 6 mm, -75 to 75 "
        "degrees off the motion, 0.5 to 10 mm/s; 3x3 array, 20 mV of ripple in white noise. Speed known:",
        tables.over_bound_table(grid, True),
        "Speed unknown:",
        tables.over_bound_table(grid, False),
        "In all tables below: wrong: more than a quarter turn off somewhere on the array; then the largest "
        "rate that is not excluded with 95 % confidence (Clopper, Pearson 1934); errors and errors over the "
        "bound: root mean square of answers that are not wrong; within 95 %: intervals of 1.96 stated sigmas "
        "that hold the truth.",
        f"By noise; coloured: windows of 1 to 2 s at 10 to 20 dB, seeds {COLOURED_SEED} and on, on which "
        "nothing was tuned:",
        tables.answers_table("noise", tables.named([*grid, *trials["coloured noise"]])),
        "Plates of the paper, played by the contact model periodic, experiment protocol, "
        f"{sizes.scenes} slides a plate ({seeds_in_words(sizes.scenes)}):",
        tables.answers_table("D, angle", tables.plate_groups(trials["plates"])),
        "Single plates drawn at random, 0.8 to 2.5 mm, -60 to 60 degrees, played by the contact model "
        f"periodic ({seeds_in_words(sizes.drawn)}), direction from the slip event:",
        tables.answers_table("window", tables.named(tables.windows_of(drawn), with_window=True)),
        "First answers online, the speed given, since the true onset of slip:",
        tables.first_answers_table([*trials["plates"], *drawn]),
        f"Windows of {MISFIT_S:g} s at {spoiled.SNR_DB:g} dB, one thing wrong in each "
        f"({seeds_in_words(sizes.misfits)}). The last have no grating: any answer is wrong.",
        tables.answers_table("what is wrong", tables.named(trials["misfits"])),
        f"Slides of {SLIDE_S:g} s that are followed ({seeds_in_words(sizes.tracks)} of each kind, the speed "
        "given to every other), gains 0.7 to 1.3: the answer of every hop is counted.",
        tables.answers_table("noise", tables.named(trials["tracks"], with_speed=False)),
    ]
