"""``./run bench texture``: errors of the joint estimator over the Cramer-Rao bound, and wrong answers.

Gratings drawn in white and coloured noise, slides that are followed (`trials`), and surfaces without a
grating (`grooveless`).
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from bench.report import BENCH_WORKERS, BenchOptions, aims_table, counted, seeds_in_words
from bench.texture import grooveless, tables
from bench.texture.trials import (
    MEMORIES,
    SLIDE_S,
    Trial,
    coloured_trial,
    grid_trial,
    grooveless_trial,
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
    grooveless: int  # windows of each surface, speed known and not
    tracks: int  # slides in each noise that are followed


QUICK = TextureSizes(trials=3, coloured=100, grooveless=2, tracks=2)
# Eighty windows a cell are 480 of a length or a noise, whose error over bound is known to 3 %. In coloured
# noise 3400 windows leave the 3000 answers without which "one in a thousand" cannot be shown.
FULL = TextureSizes(trials=80, coloured=3400, grooveless=30, tracks=40)

Work = Callable[..., Trial | list[Trial]]


def _parts(sizes: TextureSizes) -> dict[str, tuple[Work, list[tuple[Any, ...]]]]:
    """Parts of the bench: a function that makes trials, and the arguments of each call."""
    either, product = (True, False), itertools.product
    coloured = range(COLOURED_SEED, COLOURED_SEED + sizes.coloured)
    return {
        "grid": (grid_trial, list(product(WINDOWS_S, SNRS_DB, either, range(sizes.trials)))),
        "coloured noise": (coloured_trial, list(product(MEMORIES, coloured))),
        "grooveless": (grooveless_trial, list(product(grooveless.SURFACES, either, range(sizes.grooveless)))),
        "tracks": (track_trials, [(*noise, seed) for noise, seed in product(TRACKS, range(sizes.tracks))]),
    }


def bench_texture(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Error over bound, wrong answers, and slides that are followed."""
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
        aims_table(tables.aims(trials)),
    ]


def _batches(calls: Sequence[tuple[Any, ...]]) -> list[Sequence[tuple[Any, ...]]]:
    return [calls[first : first + _BATCH] for first in range(0, len(calls), _BATCH)]


def _run(work: Work, calls: Sequence[tuple[Any, ...]]) -> list[Trial]:
    found = [work(*arguments) for arguments in calls]
    return [trial for one in found for trial in (one if isinstance(one, list) else [one])]


def _sections(trials: Mapping[str, list[Trial]], sizes: TextureSizes) -> list[str]:
    grid = trials["grid"]
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
        f"Windows of {grooveless.WINDOW_S:g} s over surfaces without a grating "
        f"({seeds_in_words(sizes.grooveless)}): any answer is wrong.",
        tables.answers_table("surface", tables.named(trials["grooveless"])),
        f"Slides of {SLIDE_S:g} s that are followed ({seeds_in_words(sizes.tracks)} of each kind, the speed "
        "given to every other), gains 0.7 to 1.3: the answer of every hop is counted.",
        tables.answers_table("noise", tables.named(trials["tracks"], with_speed=False)),
    ]
