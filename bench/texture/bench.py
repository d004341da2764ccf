"""``./run bench texture``: errors of the joint estimator over the Cramer-Rao bound, and what spoils answers.

Gratings drawn in white and coloured noise (`trials`); table 2 of the paper and plates drawn at random on
scenes that obey physics, the published procedure beside the joint estimator (`plates`); windows that break
the model, two gratings in view among them (`spoiled`); slides that are followed (`tracks`); cost (`cost`).
"""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
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
    stray_trials,
    track_trials,
)
from bench.texture.trials import (
    MEMORIES,
    MISFIT_S,
    Trial,
    coloured_trials,
    grid_trials,
    misfit_trials,
    two_wave_trials,
)
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
SNRS_DB = (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
COLOURED_SEED = 5001  # seeds of reports from here on; nothing is tuned on them
_TWO_WAVES_S, _SHORT_S, _SHORT_SNR_DB = 10.0, 4.0, 20.0
_BATCH = 50  # coloured windows at a time, so that both workers end together
_SLIDES = 5  # followed slides at a time, likewise


@dataclass(frozen=True)
class TextureSizes:
    """How much is measured; seeds are 0 to n - 1 everywhere but in coloured noise.

    Attributes
    ----------
    trials : int
        Windows a cell of the grid.
    coloured : int
        Windows in noise of each colour.
    scenes : int
        Slides a plate.
    drawn : int
        Plates drawn at random, a slide each.
    misfits : int
        Windows of each kind, speed known and not; so for two waves.
    tracks : int
        Slides of each kind that are followed, and slides over each change of grooves.
    arrays : int
        Arrays of each kind of strays, a slide each, speed known and not.
    """

    trials: int
    coloured: int
    plates: Sequence[Plate]
    scenes: int
    drawn: int
    misfits: int
    tracks: int
    arrays: int
    repeats: int


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


class BenchPart(NamedTuple):
    """Work that the worker processes share, and the seconds that two of them take (for the progress bar)."""

    seconds: float
    work: Callable[..., list[Trial]]
    jobs: Sequence[tuple[Any, ...]]


def _parts(sizes: TextureSizes) -> dict[str, BenchPart]:
    def known_and_not(names: Iterable[str], *fields: float) -> list[tuple[Any, ...]]:
        return [(name, *fields, is_known) for name in names for is_known in (True, False)]

    cells = [(cell,) for cell in itertools.product(WINDOWS_S, SNRS_DB, (True, False))]
    n, two_waves = sizes.misfits, known_and_not(spoiled.TWO_WAVES, _TWO_WAVES_S, spoiled.SNR_DB)
    two_waves += known_and_not(spoiled.TWO_WAVES_SHORT, _SHORT_S, _SHORT_SNR_DB)
    coloured = range(COLOURED_SEED, COLOURED_SEED + sizes.coloured)
    batches = [coloured[first : first + _BATCH] for first in range(0, len(coloured), _BATCH)]
    plates = list(itertools.product(sizes.plates, range(sizes.scenes)))
    tracked = [range(first, min(first + _SLIDES, sizes.tracks)) for first in range(0, sizes.tracks, _SLIDES)]
    strayed = [range(first, min(first + _SLIDES, sizes.arrays)) for first in range(0, sizes.arrays, _SLIDES)]
    return {
        "grid": BenchPart(1.15 * sizes.trials, partial(grid_trials, sizes.trials), cells),
        "coloured noise": BenchPart(
            0.028 * sizes.coloured, coloured_trials, list(itertools.product(MEMORIES, batches))
        ),
        "plates": BenchPart(2.2 * len(plates), paper_plate_trials, plates),
        "drawn plates": BenchPart(
            1.0 * sizes.drawn, drawn_plate_trials, [(seed,) for seed in range(sizes.drawn)]
        ),
        "misfits": BenchPart(
            1.2 * n, partial(misfit_trials, n), known_and_not(spoiled.MISFITS | spoiled.GROOVELESS)
        ),
        "two waves": BenchPart(0.5 * n, partial(two_wave_trials, n), two_waves),
        "tracks": BenchPart(
            8.0 * sizes.tracks, track_trials, list(itertools.product((*WHITE, *COLOURED, *STRAYS), tracked))
        ),
        "strays": BenchPart(0.45 * sizes.arrays, stray_trials, list(itertools.product(STRAY_KINDS, strayed))),
        "changes": BenchPart(1.0 * sizes.tracks, change_trials, list(itertools.product(CHANGES, tracked))),
    }


def bench_texture(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Error over bound, table 2, windows that break the model, slides, and cost."""
    sizes = QUICK if options.quick else FULL
    parts, cost_s = _parts(sizes), 5 + 0.3 * sizes.repeats
    progress.begin(cost_s + sum(part.seconds for part in parts.values()))
    trials: dict[str, list[Trial]] = {}
    with executor(BENCH_WORKERS, options.dask) as pool:
        costs = pool.submit(cost_table, sizes.repeats).result()  # nothing else at work, one thread
        progress.advance("cost", cost_s)
        for name, part in parts.items():
            found = pool.map(part.work, *zip(*part.jobs, strict=True))
            some = counted(found, progress, name, part.seconds / len(part.jobs))
            trials[name] = list(itertools.chain.from_iterable(some))
    return [
        *_sections(trials, sizes),
        "Cost of one fit (6.5 Hz, 20 dB):",
        costs,
        "Aims, worst case of what was measured; open: too few windows to tell.",
        aims_table(AIMS, {"measured": trials}),
    ]


def _sections(trials: Mapping[str, list[Trial]], sizes: TextureSizes) -> list[str]:
    grid, drawn = trials["grid"], trials["drawn plates"]
    firsts = [t for part in ("plates", "drawn plates") for t in tables.first_answers(trials[part])]
    return [
        f"Error over the Cramer-Rao bound, angle / period (answered); {sizes.trials} windows a cell "
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
        f"Channels whose phases stray, {STRAYED_S:g} s at {STRAYED_SNR_DB:g} dB "
        f"({seeds_in_words(sizes.arrays)}):",
        tables.answers_table("strays", tables.named(trials["strays"])),
        f"Grooves that change under the skin, {CHANGE_PERIODS_MM[0]:g} to {CHANGE_PERIODS_MM[1]:g} mm "
        f"before, {CHANGE_SNR_DB:g} dB: time until the old answer is withdrawn or replaced.",
        tables.after_table("change", grouped(trials["changes"], lambda t: t.name)),
    ]
