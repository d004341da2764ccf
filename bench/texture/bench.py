"""``./run bench texture``: how near the joint estimator is to the bound, and what spoils it.

Five parts: error over the Cramer-Rao bound (`texture_bound`) on drawn gratings, and how often an answer is
wrong; table 2 of the paper on scenes that obey physics, and plates drawn at random there; windows that break
the model, two gratings in view among them; error against time since slip began; cost. Beside the joint
estimator stands the published procedure, faithful as it is.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.pool import workers
from bench.texture.aims import aims_table
from bench.texture.cost import Cost, OnlineCost, cost_table, online_table, run_cost
from bench.texture.count import FIRST_SEED, Counted, count_table, run_count
from bench.texture.curve import Slide, curve_table, run_curve
from bench.texture.drawn import Drawn, drawn_table, run_drawn
from bench.texture.grid import Trial, run_grid
from bench.texture.misfit import Spoiled, misfit_table, run_misfit
from bench.texture.paper import (
    PLATES,
    Answered,
    First,
    Plate,
    errors2,
    first_table,
    run_table2,
    table2,
)
from bench.texture.tables import by_band, over_bound, refusals, threshold, wrong_rate
from bench.texture.two import Twofold, run_two, two_table
from tactiled.progress import ProgressBar

_QUICK_PLATES = ((0.9, 0), (1.2, 30))  # a fine one, and one that the procedure mostly refuses


@dataclass(frozen=True)
class Sizes:
    """How much is measured; seeds are 0 to n - 1 everywhere but for `counted`.

    Attributes
    ----------
    trials, procedure_trials : int
        Windows a cell of the grid.
    counted : int
        Windows in noise of each colour.
    scenes : int
        Slides a plate.
    drawn : int
        Plates drawn at random, a slide each.
    misfits : int
        Windows of each kind, speed known and not; so for two gratings.
    """

    trials: int
    procedure_trials: int
    counted: int
    plates: Sequence[Plate]
    scenes: int
    drawn: int
    misfits: int
    slides: int
    repeats: int


QUICK = Sizes(
    trials=3,
    procedure_trials=5,
    counted=100,
    plates=_QUICK_PLATES,
    scenes=1,
    drawn=2,
    misfits=2,
    slides=2,
    repeats=2,
)
# Eighty windows a cell are 480 of a length or a noise, whose error over bound is known to 3 %. In coloured
# noise 3400 windows leave the 3000 answers without which "one in a thousand" cannot be shown.
FULL = Sizes(
    trials=80,
    procedure_trials=50,
    counted=3400,
    plates=PLATES,
    scenes=5,
    drawn=40,
    misfits=30,
    slides=16,
    repeats=10,
)


@dataclass(frozen=True)
class Found:
    """Everything that was measured."""

    joint: list[Trial]
    procedure: list[Trial]
    coloured: list[Counted]
    plates: list[Answered]
    firsts: list[First]
    drawn: list[Drawn]
    drawn_firsts: list[First]
    misfits: list[Spoiled]
    twofold: list[Twofold]
    slides: list[Slide]
    costs: list[Cost]
    online: list[OnlineCost]


def bench_texture(
    progress: ProgressBar, *, quick: bool, picture: Path | None = None, numbers: Path | None = None
) -> str:
    """Error over bound, table 2, misfits, error against time, and cost.

    Parameters
    ----------
    progress : ProgressBar
    quick : bool
        Few seeds and plates: about a minute, coarser numbers.
    picture : Path, optional
        PNG to write: where answers are to be had, and the speed-accuracy curve.
    numbers : Path, optional
        JSON to write: every trial with its seed.
    """
    sizes = QUICK if quick else FULL
    work_s = _work_s(sizes)
    progress.begin(sum(work_s.values()))

    def part(name: str) -> Callable[[float], None]:
        return lambda share: progress.advance(name, share * work_s[name])

    with workers() as pool:
        costs, online = pool.submit(run_cost, sizes.repeats).result()  # nothing else at work, one thread
        part("cost")(1.0)
        found = Found(
            run_grid(part("grid"), pool, "joint", n_trials=sizes.trials),
            run_grid(part("procedure"), pool, "procedure", n_trials=sizes.procedure_trials, knowing=(True,)),
            run_count(part("coloured noise"), pool, n_windows=sizes.counted),
            *run_table2(part("plates"), pool, n_seeds=sizes.scenes, plates=sizes.plates),
            *run_drawn(part("drawn plates"), pool, n_plates=sizes.drawn),
            run_misfit(part("misfits"), pool, n_windows=sizes.misfits),
            run_two(part("two gratings"), pool, n_windows=sizes.misfits),
            run_curve(part("slides"), pool, n_slides=sizes.slides),
            costs,
            online,
        )
    if picture is not None:
        from bench.texture.picture import draw_texture  # matplotlib is an extra

        draw_texture(picture, found.joint, found.plates, found.slides)
    if numbers is not None:
        numbers.write_text(json.dumps(_plain({"sizes": asdict(sizes), **asdict(found)})))
    return _text(found, sizes)


def _work_s(sizes: Sizes) -> dict[str, float]:
    """Seconds that each part takes, two workers at it: as measured, for the progress bar alone."""
    return {
        "cost": 10 + 0.6 * sizes.repeats,
        "grid": 1.15 * sizes.trials,
        "procedure": 0.08 * sizes.procedure_trials,
        "coloured noise": 0.028 * sizes.counted,
        "plates": 2.2 * len(sizes.plates) * sizes.scenes,
        "drawn plates": 1.0 * sizes.drawn,
        "misfits": 1.2 * sizes.misfits,
        "two gratings": 0.5 * sizes.misfits,
        "slides": 3.1 * sizes.slides,
    }


def _text(found: Found, sizes: Sizes) -> str:
    return "\n\n".join(
        [
            f"Error over the Cramer-Rao bound, angle / period (answered); {sizes.trials} windows a cell "
            f"({_seeds(sizes.trials)}) of three periods or more. Gratings of 0.6 to 6 mm, -75 to 75 degrees "
            "off the motion, 0.5 to 10 mm/s; 3x3 array, 20 mV of ripple in white noise. Speed known:",
            over_bound(found.joint, True),
            "Speed unknown:",
            over_bound(found.joint, False),
            f"The published procedure on such gratings ({_seeds(sizes.procedure_trials)}), told the speed:",
            over_bound(found.procedure, True),
            "The joint estimator by what the grating was. within 95 %: intervals of 1.96 stated sigmas that "
            "hold the truth. wrong: more than a quarter turn off somewhere on the array.",
            by_band(found.joint),
            refusals(found.joint),
            "How often an answer that says ok is wrong, and what coloured noise does to intervals "
            f"(coloured: seeds {FIRST_SEED} and on, on which nothing was tuned; white: the trials above):",
            count_table(found.joint, found.coloured),
            f"The procedure: {wrong_rate(found.procedure)}",
            "Noise from which on nine of ten windows of three periods are answered:",
            threshold(found.joint),
            f"Table 2 of the paper on the periodic rung, experiment protocol, {sizes.scenes} slides a plate "
            f"({_seeds(sizes.scenes)}); mean ± standard deviation (windows answered / full windows).",
            table2(found.plates),
            "Errors of the same, root mean square of the windows answered:",
            errors2(found.plates),
            "First answers online on these slides: time since the true onset (median, latest), errors (rms):",
            first_table(found.firsts),
            "Single plates drawn at random, 0.8 to 2.5 mm, -60 to 60 degrees, on the periodic rung "
            f"({_seeds(sizes.drawn)}), direction as slip says:",
            drawn_table(found.drawn, found.drawn_firsts),
            misfit_table(found.misfits),
            f"{two_table(found.twofold)}\n\nOf each of these: {_seeds(sizes.misfits)}.",
            "Error of the answer that stands at a time since the onset of slip, root mean square of "
            f"{sizes.slides} slides ({_seeds(sizes.slides)}) at 1.5 mm/s, 20 dB; bound: of all scans since.",
            curve_table(found.slides),
            "Cost of one fit (6.5 Hz, 20 dB); spectrum and trends are what running sums could spare:",
            cost_table(found.costs),
            "Cost online, over channels that stray; scans that come during the longest hop wait for it:",
            online_table(found.online),
            aims_table(
                found.joint,
                found.coloured,
                found.plates,
                found.firsts,
                found.drawn,
                found.misfits,
                found.twofold,
            ),
        ]
    )


def _seeds(number: int) -> str:
    return f"seeds 0..{number - 1}"


def _plain(value: Any) -> Any:
    """For JSON, which knows no NaN and no infinity."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
