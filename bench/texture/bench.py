"""``./run bench texture``: errors of the joint estimator over the Cramer-Rao bound, and wrong answers.

Gratings drawn in white and coloured noise, slides that are followed (`trials`), and surfaces without a
grating (`grooveless`).
"""

from itertools import chain, product
from typing import Any

from bench.report import BENCH_WORKERS, BenchOptions, aims_table, counted, seeds_in_words
from bench.texture.grooveless import SURFACES
from bench.texture.tables import aims, over_bound_table
from bench.texture.trials import MEMORIES, coloured_trial, grid_trial, grooveless_trial, track_trials
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

_WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_SNRS_DB = (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
# Noise of slides that are followed: dB, and memory from scan to scan.
_TRACKS = (*product((0.0, 10.0, 20.0, 30.0, 40.0), (0.0,)), *product((15.0,), MEMORIES))
_COLOURED_SEED = 5001  # the first of those in coloured noise; nothing is tuned on them
# Windows a cell of the grid, in noise of each colour, and over each surface with the speed known and not; and
# slides in each noise. Eighty windows a cell are 480 of a length or a noise, whose error over bound is known
# to 3 %. In coloured noise 3400 windows leave the 3000 answers without which "one in a thousand" cannot be
# shown.
_FULL, _QUICK = (80, 3400, 30, 40), (3, 100, 2, 2)
_CHUNK = 5  # calls at a time, so that all workers end together


def bench_texture(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Error over bound, wrong answers, and slides that are followed."""
    n, n_coloured, n_grooveless, n_tracks = _QUICK if options.quick else _FULL
    either, coloured = (True, False), range(_COLOURED_SEED, _COLOURED_SEED + n_coloured)
    parts: dict[str, tuple[Any, list[tuple[Any, ...]]]] = {
        "grid": (grid_trial, list(product(_WINDOWS_S, _SNRS_DB, either, range(n)))),
        "coloured noise": (coloured_trial, list(product(MEMORIES, coloured))),
        "grooveless": (grooveless_trial, list(product(SURFACES, either, range(n_grooveless)))),
        "tracks": (track_trials, [(*noise, seed) for noise, seed in product(_TRACKS, range(n_tracks))]),
    }
    progress.begin(sum(len(calls) for _, calls in parts.values()))
    found: dict[str, list[Any]] = {}
    with executor(BENCH_WORKERS) as pool:
        for name, (work, calls) in parts.items():
            trials = pool.map(work, *zip(*calls, strict=True), chunksize=_CHUNK)
            found[name] = counted(trials, progress, name)
    found["tracks"] = list(chain.from_iterable(found["tracks"]))
    return [
        "Error of the angle / of the period over the Cramer-Rao bound, and in brackets the part of the "
        f"windows that was answered; {n} windows a cell ({seeds_in_words(n)}) of three periods or more. "
        "Gratings of 0.6 to 6 mm, -75 to 75 degrees off the motion, 0.5 to 10 mm/s; 3x3 array, 20 mV of "
        "ripple in white noise. Speed known:",
        over_bound_table(found["grid"], True),
        "Speed unknown:",
        over_bound_table(found["grid"], False),
        "Aims, worst case of what was measured; open: too few windows to tell. Wrong: more than a quarter "
        "turn off somewhere on the array. Coloured noise, AR(1): windows of 1 to 2 s at 10 to 20 dB (seeds "
        f"{_COLOURED_SEED} and on). Slides of 12.6 s are followed with gains of 0.7 to 1.3, and the answer "
        "of every hop is counted.",
        aims_table(aims(found)),
    ]
