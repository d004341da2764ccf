"""Error against time since the onset of slip, for each preset, with the bound of the time that it had.

Slides over gratings of moderate period at 1.5 mm/s and 20 dB a channel, the motion given. The bound is that
of the window which the estimator has by then: from `settle_s` after the onset, of `max_window_s` at most.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import get_args

import numpy as np

from bench.texture.bound import Bound, bound
from bench.texture.online import answers, slip_at
from bench.texture.signal import RATE_HZ
from bench.texture.window import Window, perfect
from tactiled.array import load_array
from tactiled.detect.grooves.estimator import JointParams, Preset
from tactiled.plain_table import table

PRESETS: tuple[Preset, ...] = get_args(Preset)
TIMES_S = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0)
SNR_DB = 20.0


@dataclass(frozen=True)
class Slide:
    """One slide under one preset; errors are signed, NaN before the first answer.

    Attributes
    ----------
    first_s : float
        Time from onset to the first answer; NaN where there was none.
    period_error_mm, angle_error_deg : tuple of float
        Of the answer that stands at each of `TIMES_S`.
    period_bound_mm, angle_bound_deg : tuple of float
    """

    preset: Preset
    seed: int
    first_s: float
    first_period_error_mm: float
    first_angle_error_deg: float
    period_error_mm: tuple[float, ...]
    angle_error_deg: tuple[float, ...]
    period_bound_mm: tuple[float, ...]
    angle_bound_deg: tuple[float, ...]


def run_curve(advance: Callable[[float], None], pool: Executor, *, n_slides: int) -> list[Slide]:
    """Slides of seeds 0 to n_slides - 1 under each preset."""
    found: list[Slide] = []
    for preset in PRESETS:
        for one in pool.map(partial(slide, preset), range(n_slides)):
            found.append(one)
            advance(1 / len(PRESETS) / n_slides)
    return found


def slide(preset: Preset, seed: int) -> Slide:
    """One of them."""
    array = load_array("wang2019-3x3")
    rng = np.random.default_rng(seed)
    window = perfect(array, rng, TIMES_S[-1], SNR_DB)
    params = JointParams(preset=preset, direction_deg=window.wave.direction_deg)
    said = answers(
        array,
        params,
        window.volts(rng),
        window.sensed.offset_s,
        slip_at(0.0, window.wave.direction_deg),
        given_mm_s=window.given_mm_s,
    )
    events = [e for e in said if e.status == "ok"]
    # An event is about the scans up to its own: the next one begins a scan later.
    ready_s = np.array([e.time_s + 1 / RATE_HZ for e in events])
    errors = np.array(
        [(e.period_mm - window.wave.period_mm, e.angle_deg - window.wave.angle_deg) for e in events]
    ).reshape(-1, 2)
    errors = np.vstack([np.full(2, np.nan), errors])
    standing = errors[np.searchsorted(ready_s, np.array(TIMES_S) + 1e-6, side="right")]
    bounds = [_bound(window, params, time_s) for time_s in TIMES_S]
    return Slide(
        preset=preset,
        seed=seed,
        first_s=float(ready_s[0]) if len(ready_s) else float("nan"),
        first_period_error_mm=float(errors[min(1, len(events)), 0]),
        first_angle_error_deg=float(errors[min(1, len(events)), 1]),
        period_error_mm=tuple(standing[:, 0].tolist()),
        angle_error_deg=tuple(standing[:, 1].tolist()),
        period_bound_mm=tuple(b.period_sd_mm for b in bounds),
        angle_bound_deg=tuple(b.angle_sd_deg for b in bounds),
    )


def _bound(window: Window, params: JointParams, until_s: float) -> Bound:
    begin_s = max(params.settle_s, until_s - params.criteria.max_window_s)
    time_s = window.time_s[(window.time_s >= begin_s - 1e-9) & (window.time_s < until_s - 1e-9)]
    return bound(window.wave, window.sensed, time_s, is_speed_known=True)


@dataclass(frozen=True)
class Point:
    """All slides of a preset at one time; roots of mean squares."""

    preset: Preset
    time_s: float
    slides: int
    answered: int
    period_mm: float
    angle_deg: float
    period_bound_mm: float
    angle_bound_deg: float


def points(slides: Sequence[Slide]) -> list[Point]:
    """The curve."""
    found = []
    for preset in dict.fromkeys(s.preset for s in slides):
        mine = [s for s in slides if s.preset == preset]
        for k, time_s in enumerate(TIMES_S):
            here = [s for s in mine if np.isfinite(s.period_error_mm[k])]
            found.append(
                Point(
                    preset,
                    time_s,
                    len(mine),
                    len(here),
                    _rms([s.period_error_mm[k] for s in here]),
                    _rms([s.angle_error_deg[k] for s in here]),
                    _rms([s.period_bound_mm[k] for s in mine]),
                    _rms([s.angle_bound_deg[k] for s in mine]),
                )
            )
    return found


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def curve_table(slides: Sequence[Slide]) -> str:
    """Errors of the answer that stands at each time, and of the first one."""
    head = ["time since onset", *(f"{preset}: D, angle (answered)" for preset in PRESETS), "bound: D, angle"]
    rows = []
    curve = points(slides)
    for time_s in TIMES_S:
        here = {p.preset: p for p in curve if p.time_s == time_s}
        last = here[PRESETS[-1]]
        rows.append(
            [
                f"{time_s:g} s",
                *(_said(here[preset]) for preset in PRESETS),
                f"{1e3 * last.period_bound_mm:.2f} um, {last.angle_bound_deg:.4f} deg",
            ]
        )
    first = [_first(preset, [s for s in slides if s.preset == preset]) for preset in PRESETS]
    first_head = ["preset", "first answer, median", "90 %", "latest", "error then: D", "angle", "answered"]
    return f"{table(head, rows)}\n\n{table(first_head, first)}"


def _said(point: Point) -> str:
    if not point.answered:
        return "-"
    share = f"{100 * point.answered / point.slides:.0f} %"
    return f"{1e3 * point.period_mm:.2f} um, {point.angle_deg:.4f} deg ({share})"


def _first(preset: Preset, slides: Sequence[Slide]) -> list[str]:
    said = [s for s in slides if np.isfinite(s.first_s)]
    if not said:
        return [preset, *["-"] * 5, f"0 of {len(slides)}"]
    times_s = [s.first_s for s in said]
    return [
        preset,
        *(f"{np.percentile(times_s, part):.1f} s" for part in (50, 90, 100)),
        f"{1e3 * _rms([s.first_period_error_mm for s in said]):.2f} um",
        f"{_rms([s.first_angle_error_deg for s in said]):.3f} deg",
        f"{len(said)} of {len(slides)}",
    ]
