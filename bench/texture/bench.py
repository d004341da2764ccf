"""``./run bench texture``: errors of the joint estimator over the Cramer-Rao bound, and wrong answers.

Gratings drawn in white noise (`trials`), and surfaces without a grating (`grooveless`).
"""

from itertools import product
from typing import Any

from bench.report import BENCH_WORKERS, BenchOptions, aims_table, counted, seeds_in_words
from bench.texture.grooveless import SURFACES
from bench.texture.tables import aims, over_bound_table
from bench.texture.trials import grid_trial, grooveless_trial
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

_WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_SNRS_DB = (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0)
# Windows a cell of the grid, and over each surface with the speed known and not. Eighty windows a cell are
# 480 of a length or a noise, whose error over bound is known to 3 %.
_FULL, _QUICK = (80, 30), (3, 2)
_CHUNK = 5  # calls at a time, so that all workers end together


def bench_texture(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Error over bound, and wrong answers."""
    n, n_grooveless = _QUICK if options.quick else _FULL
    either = (True, False)
    parts: dict[str, tuple[Any, list[tuple[Any, ...]]]] = {
        "grid": (grid_trial, list(product(_WINDOWS_S, _SNRS_DB, either, range(n)))),
        "grooveless": (grooveless_trial, list(product(SURFACES, either, range(n_grooveless)))),
    }
    progress.begin(sum(len(calls) for _, calls in parts.values()))
    found: dict[str, list[Any]] = {}
    with executor(BENCH_WORKERS) as pool:
        for name, (work, calls) in parts.items():
            trials = pool.map(work, *zip(*calls, strict=True), chunksize=_CHUNK)
            found[name] = counted(trials, progress, name)
    return [
        "Errors of the angle / of the period, each divided by its Cramer-Rao bound; in brackets, the part of "
        f"the windows that are answered. Each cell has {n} windows ({seeds_in_words(n)}); those with less "
        "than three periods are left out, and errors of wrong answers, too. Gratings have periods of 0.6 to "
        "6 mm, and are turned by -75 to 75 degrees from the motion; speeds are 0.5 to 10 mm/s. A 3x3 array "
        "feels a ripple of 20 mV in white noise. Speed known:",
        over_bound_table(found["grid"], True),
        "Speed unknown:",
        over_bound_table(found["grid"], False),
        "Each aim is judged by the worst of its measured cases; it is open where too few windows were "
        "measured. An answer is wrong if the phase of its wave is off by more than a quarter turn somewhere "
        "on the array.",
        aims_table(aims(found)),
    ]
