"""``./run bench slip``: what a controller asks of slip events, for every setting.

Random worlds of two generators are asked the same questions (`score`): `laws`, whose physics have nothing in
common with the detector's, and `plates`, the emulator's skin. Nothing was set on these seeds.
"""

from itertools import chain

from bench.report import BENCH_WORKERS, BenchOptions, counted, seeds_in_words, table
from bench.slip.cases import NAMES, REPORTED_FROM, Reported, draw_reported, run_case
from bench.slip.gratings import GRATINGS_FROM, LENGTH_S, read_grating, rows
from bench.slip.minutes import MINUTES_FROM, minute_rows, read_minute
from bench.slip.score import AHEAD_S, SLOW_S, settings_table
from bench.worlds.generators import draw
from bench.worlds.world import INCIPIENT_USED
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

PLATES_FROM, PLATE_MINUTES = 240_000, 0.2  # seeds, of which none was learnt from, and length of a world
_BATCH = 12
# Worlds of each generator, gratings, and slides and rests of a minute.
FULL, QUICK = (240, 40, 100, 60), (48, 12, 10, 6)


def bench_slip(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Answers of each setting, by kind of world and noise.

    Quick: 48 worlds of each generator instead of 240, a tenth of the minutes.
    """
    n_worlds, n_gratings, n_slides, n_rests = QUICK if options.quick else FULL
    minutes = [(MINUTES_FROM + k, k < n_slides) for k in range(n_slides + n_rests)]
    starts = range(0, n_worlds, _BATCH)
    sections = [
        f"{n_worlds} worlds of laws ({seeds_in_words(n_worlds, REPORTED_FROM)}) and {n_worlds} of plates "
        f"({seeds_in_words(n_worlds, PLATES_FROM)}). In a slow slip, {SLOW_S:g} s or more pass between the "
        "slip of a tenth of the area and that of all of it; it is reported ahead if an event is open "
        f"{1e3 * AHEAD_S:.0f} ms before it becomes gross, and was reported at most 0.1 s before a tenth of "
        "the area slipped. A gross slip that is reported more than 0.1 s before it begins does not count as "
        'reported in 100 or 300 ms. "Nothing slips" is the time of contact in which less than a tenth of the '
        "area slips, now and in the last 0.1 s; a tenth is taken to slip from a utilisation of "
        f'{INCIPIENT_USED:.3f} on, even while the contact rests. "Rests" are cases without gross slip. '
        '"Ended" counts cases in which an end was reported while all of the contact slid, and no new slip '
        'within 0.1 s. Of directions, "inside" counts errors within one stated standard deviation, and '
        '"reversed" errors beyond 90 deg with a standard deviation below 30 deg. Columns name the '
        "probabilities from which incipient and gross slip are reported."
    ]
    progress.begin(2 * len(starts) + n_gratings + len(minutes))
    with executor(BENCH_WORKERS) as pool:
        for name, read, first in (("laws", read_laws, REPORTED_FROM), ("plates", read_plates, PLATES_FROM)):
            batches = [range(first + start, first + start + _BATCH) for start in starts]
            some = list(chain.from_iterable(counted(pool.map(read, batches), progress, "worlds")))
            slips = sum(one[NAMES[0]].case.slips for one in some)
            sections.append(f"Worlds of {name}: {len(some)} cases, {slips} with gross slip.")
            sections.append(settings_table(some))
        slides = range(GRATINGS_FROM, GRATINGS_FROM + n_gratings)
        gratings = counted(pool.map(read_grating, slides), progress, "gratings")
        read_minutes = counted(pool.map(read_minute, *zip(*minutes, strict=True)), progress, "minutes")
    long = [one for one in read_minutes if one is not None]
    return [
        *sections,
        f"Slides over gratings ({seeds_in_words(len(gratings), GRATINGS_FROM)}) of smooth, even friction, in "
        f"worlds of {LENGTH_S:g} s, with ripples of 5 to 24 dB: how many are reported as gross slip, and how "
        "many the groove estimator answers, to which the speed is given.",
        table(rows(gratings)),
        f"Slides and rests of a minute ({seeds_in_words(len(minutes), MINUTES_FROM)}), with noise of 0.3 to "
        f"3 mV, at the setting balanced. Rests that slipped are left out ({len(minutes) - len(long)} here). "
        "Slides have a constant speed of 0.25 to 20 mm/s, and are scored from 0.5 s after they begin. Rests "
        "use 80 to 97 % of the friction limit. p of sliding is a median: over the slides that are reported "
        "for less than 95 % of their time, and over all rests.",
        table(minute_rows(long)),
    ]


def read_laws(seeds: range) -> list[dict[str, Reported]]:
    """Run all detectors over a batch of worlds of laws."""
    return [run_case(world) for world in draw_reported(seeds)]


def read_plates(seeds: range) -> list[dict[str, Reported]]:
    """Run all detectors over a batch of worlds of plates."""
    return [run_case(world) for world in draw("plates", seeds, PLATE_MINUTES)]
