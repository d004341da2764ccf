"""``./run bench texture``: errors of the joint estimator over the Cramer-Rao bound, and what spoils answers.

Gratings drawn in white and coloured noise (`trials`); table 2 of the paper and plates drawn at random on
scenes that obey physics, the published procedure beside the joint estimator (`plates`); windows that break
the model, two gratings in view among them (`spoiled`); slides that are followed (`tracks`); cost (`cost`).
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from bench.report import (
    BENCH_WORKERS,
    BenchOptions,
    aims_table,
    counted,
    grouped,
    seeds_in_words,
)
from bench.texture import spoiled, tables
from bench.texture.aims import AIMS
from bench.texture.cost import cost_table
from bench.texture.plates import PLATES, Plate, drawn_plate_trials, paper_plate_trials
from bench.texture.tracks import (
    CHANGE_PERIODS_MM,
    CHANGE_SNR_DB,
    CHANGES,
    COLOURED,
    SLIDE_S,
    STRAY_KINDS,
    STRAYED_S,
    STRAYED_SNR_DB,
    STRAYS,
    WHITE,
    change_trials,
    stray_trial,
    track_trials,
)
from bench.texture.trials import (
    MEMORIES,
    MISFIT_S,
    Trial,
    coloured_trial,
    grid_trial,
    misfit_trial,
    two_wave_trial,
)
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
SNRS_DB = (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
COLOURED_SEED = 5001  # seeds of reports from here on; nothing is tuned on them
_TWO_WAVES_S, _SHORT_S, _SHORT_SNR_DB = 10.0, 4.0, 20.0
_BATCH = 5  # calls at a time, so that all workers end together


class TextureSizes(NamedTuple):
    """How much is measured; seeds are 0 to n - 1 everywhere but in coloured noise."""

    trials: int  # windows a cell of the grid
    coloured: int  # windows in noise of each colour
    plates: Sequence[Plate]
    scenes: int  # slides a plate
    drawn: int  # plates drawn at random, a slide each
    misfits: int  # windows of each kind, speed known and not; so for two waves
    tracks: int  # slides of each kind that are followed, and slides over each change of grooves
    arrays: int  # arrays of each kind of strays, a slide each, speed known and not
    repeats: int  # of the cost


# A fine plate, and one that the procedure mostly refuses.
QUICK = TextureSizes(
    trials=3, coloured=100, plates=((0.9, 0), (1.2, 30)), scenes=1, drawn=2, misfits=2, tracks=2, arrays=2,
    repeats=2,
)  # fmt: skip
# Eighty windows a cell are 480 of a length or a noise, whose error over bound is known to 3 %. In coloured
# noise 3400 windows leave the 3000 answers without which "one in a thousand" cannot be shown.
FULL = TextureSizes(
    trials=80, coloured=3400, plates=PLATES, scenes=5, drawn=40, misfits=30, tracks=40, arrays=400, repeats=10
)

Work = Callable[..., Trial | list[Trial]]


def _parts(sizes: TextureSizes) -> dict[str, tuple[Work, list[tuple[Any, ...]]]]:
    """Parts of the bench: a function that makes trials, and the arguments of each call."""
    either = (True, False)
    two_waves = [
        *((name, _TWO_WAVES_S, spoiled.SNR_DB) for name in spoiled.TWO_WAVES),
        *((name, _SHORT_S, _SHORT_SNR_DB) for name in spoiled.TWO_WAVES_SHORT),
    ]
    coloured = range(COLOURED_SEED, COLOURED_SEED + sizes.coloured)
    product, windows, slides = itertools.product, range(sizes.misfits), range(sizes.tracks)
    spoils = spoiled.MISFITS | spoiled.GROOVELESS
    return {
        "grid": (grid_trial, list(product(WINDOWS_S, SNRS_DB, either, range(sizes.trials)))),
        "coloured noise": (coloured_trial, list(product(MEMORIES, coloured))),
        "plates": (paper_plate_trials, list(product(sizes.plates, range(sizes.scenes)))),
        "drawn plates": (drawn_plate_trials, [(seed,) for seed in range(sizes.drawn)]),
        "misfits": (misfit_trial, list(product(spoils, either, windows))),
        "two waves": (
            two_wave_trial,
            [(*kind, is_known, seed) for kind, is_known, seed in product(two_waves, either, windows)],
        ),
        "tracks": (track_trials, list(product((*WHITE, *COLOURED, *STRAYS), slides))),
        "strays": (stray_trial, list(product(STRAY_KINDS, range(sizes.arrays), either))),
        "changes": (change_trials, list(product(CHANGES, slides))),
    }


def bench_texture(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Error over bound, table 2, windows that break the model, slides, and cost."""
    sizes = QUICK if options.quick else FULL
    parts = {name: (work, _batches(calls)) for name, (work, calls) in _parts(sizes).items()}
    progress.begin(1 + sum(len(batches) for _, batches in parts.values()))
    trials: dict[str, list[Trial]] = {}
    with executor(BENCH_WORKERS, options.dask) as pool:
        costs = pool.submit(cost_table, sizes.repeats).result()  # nothing else at work, one thread
        progress.advance("cost")
        for name, (work, batches) in parts.items():
            found = counted(pool.map(partial(_run, work), batches), progress, name)
            trials[name] = list(itertools.chain.from_iterable(found))
    return [
        *_sections(trials, sizes),
        "Cost of one fit (6.5 Hz, 20 dB):",
        costs,
        "Aims, worst case of what was measured; open: too few windows to tell.",
        aims_table(AIMS, {"measured": trials}),
    ]


def _batches(calls: Sequence[tuple[Any, ...]]) -> list[Sequence[tuple[Any, ...]]]:
    return [calls[first : first + _BATCH] for first in range(0, len(calls), _BATCH)]


def _run(work: Work, calls: Sequence[tuple[Any, ...]]) -> list[Trial]:
    found = [work(*arguments) for arguments in calls]
    return [trial for one in found for trial in (one if isinstance(one, list) else [one])]


def _sections(trials: Mapping[str, list[Trial]], sizes: TextureSizes) -> list[str]:
    grid, drawn = trials["grid"], trials["drawn plates"]
    firsts = [t for part in ("plates", "drawn plates") for t in tables.first_answers(trials[part])]
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
        "First answers online, the speed given, since the true onset of slip: on the plates of the paper by "
        "preset, then on those drawn at random:",
        tables.after_table("preset", grouped(firsts, lambda t: t.name)),
        f"Windows of {MISFIT_S:g} s at {spoiled.SNR_DB:g} dB, one thing wrong in each "
        f"({seeds_in_words(sizes.misfits)}). The last have no grating: any answer is wrong.",
        tables.answers_table("what is wrong", tables.named(trials["misfits"])),
        f"Two waves in view, windows of {_TWO_WAVES_S:g} s, the first at {spoiled.SNR_DB:g} dB "
        f"({_SHORT_S:g} s: {_SHORT_SNR_DB:g} dB), {spoiled.SPEED_MM_S:g} mm/s "
        f"({seeds_in_words(sizes.misfits)}). Either grating is a right answer; `several-gratings` is the "
        "right refusal.",
        tables.answers_table("what is in view", tables.named(trials["two waves"], with_window=True)),
        f"Slides of {SLIDE_S:g} s that are followed ({seeds_in_words(sizes.tracks)} of each kind, the speed "
        "given to every other), gains 0.7 to 1.3: the answer of every hop is counted.",
        tables.answers_table("noise", tables.named(trials["tracks"], with_speed=False)),
        f"Channels with phase offsets, {STRAYED_S:g} s at {STRAYED_SNR_DB:g} dB "
        f"({seeds_in_words(sizes.arrays)}):",
        tables.answers_table("phase offsets", tables.named(trials["strays"])),
        f"Grooves that change under the skin, {CHANGE_PERIODS_MM[0]:g} to {CHANGE_PERIODS_MM[1]:g} mm "
        f"before, {CHANGE_SNR_DB:g} dB: time until the old answer is withdrawn or replaced.",
        tables.after_table("change", grouped(trials["changes"], lambda t: t.name)),
    ]
