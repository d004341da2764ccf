"""``./run bench grip``: how well the contact model tells what is in use, and what comes.

Worlds are drawn with their contact law, materials, sensor and hand (`bench.worlds.laws`). Constants of the
model were set on seeds from `TUNED_FROM`; what is printed is measured on seeds from `REPORTED_FROM`, a
quarter of them of a contact law on which nothing was set.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bench.grip.ablation import ABLATIONS, WHOLE, without
from bench.grip.bound import bounds
from bench.grip.cost import SHIPPED, ScanCost, cost_rows, scan_costs
from bench.grip.score import (
    GripRecord,
    by_hand,
    forecast,
    gross_told,
    margin,
    rests_called_gross,
    tell,
    threshold_for,
    warned,
    without_falling_friction,
)
from bench.report import (
    BENCH_WORKERS,
    NONE,
    Aim,
    BenchOptions,
    BenchReport,
    Reading,
    aims_table,
    grouped,
    judge,
    ratio,
    seeds_in_words,
    table,
)
from bench.worlds.laws import HELD_OUT_LAW, USUAL, Population, draw_worlds
from bench.worlds.world import World
from tactiled.detect.grip.detector import GripParams
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

TUNED_FROM = 20_000  # seeds on which constants were set
REPORTED_FROM = 3_000  # nothing was set on these
HELD_OUT = Population(laws=(HELD_OUT_LAW,))
N_WORLDS, N_QUICK, N_ABLATED = 240, 48, 48
OTHERS: Mapping[str, Population] = {
    "2 x 2 taxels": Population(side=2),
    "4 x 4 taxels": Population(side=4),
    "10 Hz": Population(rates_hz=(10.0,)),
    "500 Hz": Population(rates_hz=(500.0,)),
    "1000 Hz": Population(rates_hz=(1000.0,)),
}
"""Other arrays and scan rates; nothing was set on any of them."""
N_OTHERS, N_OTHERS_QUICK = 48, 12  # worlds of each
_BATCH = 12  # worlds that are simulated at once, and by one process
_HELD_OUT_EACH = 4  # one batch in so many has the law on which nothing was set
_TIME_IN_ALARM = 0.015
_LEAST_SLIPS = 10  # below, a share of slips decides nothing
_CLEAR = 0.8  # utilisation below which a contact that holds is far from gross slip
_GAIN_SD = 0.1  # of the taxels, in the bound of utilisation
_KNOWN_SD = 0.1  # of log friction, where it is known


@dataclass(frozen=True, eq=False)
class GripFound:
    """Estimates of all worlds, with friction unknown and with friction known."""

    told: list[GripRecord]
    informed: list[GripRecord]
    costs: dict[str, dict[str, ScanCost]]

    @property
    def usual(self) -> list[GripRecord]:
        """Estimates of the worlds but those whose friction falls at constant load."""
        return without_falling_friction(self.told)


def bench_grip(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Margins, forecasts, alarms and gross slips over random worlds.

    Quick: 48 worlds instead of 240.
    """
    n = N_QUICK if options.quick else N_WORLDS
    n_ablated = N_ABLATED if options.ablate else 0
    n_others = N_OTHERS_QUICK if options.quick else N_OTHERS
    progress.begin(n + n_others * len(OTHERS) + n_ablated * len(ABLATIONS))
    told: list[GripRecord] = []
    informed: list[GripRecord] = []
    with executor(BENCH_WORKERS, options.dask) as pool:
        seeds = range(REPORTED_FROM, REPORTED_FROM + n)
        batches = [seeds[start : start + _BATCH] for start in range(0, n, _BATCH)]
        for some, some_informed in pool.map(_measure, batches):
            told += some
            informed += some_informed
            for _ in some:
                progress.advance("world")
        others = {
            name: [
                record
                for records in pool.map(partial(_measure_others, name), batches[: n_others // _BATCH])
                for record in _counted(records, progress)
            ]
            for name in OTHERS
        }
        ablated = {
            part: [
                record
                for records in pool.map(partial(_measure_without, part), batches[: n_ablated // _BATCH])
                for record in _counted(records, progress)
            ]
            for part in (ABLATIONS if options.ablate else ())
        }
    found = GripFound(told, informed, scan_costs())

    def draw(path: Path) -> None:
        from bench.grip.picture import draw_grip  # matplotlib is an extra

        draw_grip(path, found.told)

    return BenchReport(
        [
            f"{n} random worlds of {USUAL.duration_s:g} s ({seeds_in_words(n, REPORTED_FROM)}), "
            f"{sum(t.world.slips for t in told)} with gross slip, and "
            f"{sum(t.world.law == HELD_OUT_LAW for t in told)} with the law {HELD_OUT_LAW}. "
            "Worlds whose friction falls at constant load are in rows of their own.",
            aims_table(AIMS, {"measured": found}),
            "Rows by kind of hand. u: rms error, bias and coverage of the 90 % intervals of utilisation from "
            "0.5 up; gross: first gross slips called gross within 100 and 300 ms; rests called gross: of the "
            "worlds without gross slip, those ever called gross.",
            table(_row(name, some) for name, some in by_hand(told).items()),
            "The same by contact law of the world.",
            table(_row(name, some) for name, some in grouped(found.usual, lambda t: t.world.law).items()),
            "The same for other arrays and scan rates, 3 x 3 taxels and 50 to 250 Hz where nothing is said.",
            table(_row(name, without_falling_friction(some)) for name, some in others.items()),
            "Calibration of p_gross_300ms over scans without gross slip.",
            table(_reliability(found.usual)),
            "Processor time of a scan while shear grows, 100 Hz. "
            "Hot: scan after scan; live: a scan each 10 ms.",
            table(cost_rows(found.costs)),
            *_ablation(ablated),
        ],
        draw=draw,
    )


def _measure(seeds: range) -> tuple[list[GripRecord], list[GripRecord]]:
    """Run the model over some worlds, with friction unknown and with friction known."""
    worlds = draw_reported(seeds)
    told = [tell(world, GripParams()) for world in worlds]
    informed = [
        tell(world, GripParams(friction=world.static_friction, friction_log_sd=_KNOWN_SD)) for world in worlds
    ]
    return told, informed


def _measure_others(name: str, seeds: range) -> list[GripRecord]:
    """Run the model over worlds of another array or scan rate."""
    return [tell(world, GripParams()) for world in draw_worlds(seeds, OTHERS[name])]


def _measure_without(part: str, seeds: range) -> list[GripRecord]:
    """Run the model without a part over some worlds."""
    with without(part):
        return [tell(world, GripParams()) for world in draw_reported(seeds)]


def draw_reported(seeds: range) -> list[World]:
    """Draw a batch of worlds; one batch in `_HELD_OUT_EACH` has the law on which nothing was set."""
    is_held_out = (seeds[0] // _BATCH) % _HELD_OUT_EACH == 0
    return draw_worlds(seeds, HELD_OUT if is_held_out else USUAL)


def _counted(records: list[GripRecord], progress: ProgressBar) -> list[GripRecord]:
    for _ in records:
        progress.advance("world")
    return records


def _ablation(ablated: dict[str, list[GripRecord]]) -> Iterator[str]:
    if ablated:
        yield f"Without parts of the model, on {len(ablated[WHOLE])} worlds."
        yield table(_ablation_row(part, some) for part, some in ablated.items())


def _ablation_row(part: str, told: Sequence[GripRecord]) -> dict[str, str]:
    usual = without_falling_friction(told)
    found = margin(usual)
    return {
        "left out": part,
        "Brier skill, 300 ms": f"{forecast(usual, 2).brier_skill:.2f}",
        "100 ms": f"{forecast(usual, 1).brier_skill:.2f}",
        "u rms": _number(found.rms),
        "u coverage": _number(found.coverage),
        "gross in 300 ms": ratio(gross_told(told, 0.3)),
        "rests called gross": ratio(rests_called_gross(told)),
    }


def _row(name: str, told: Sequence[GripRecord]) -> dict[str, str]:
    found = margin(told)
    return {
        "worlds": name,
        "number": f"{len(told)}",
        "u rms": _number(found.rms),
        "u bias": _number(found.bias),
        "u coverage": _number(found.coverage),
        "gross in 100 ms": ratio(gross_told(told, 0.1)),
        "gross in 300 ms": ratio(gross_told(told, 0.3)),
        "rests called gross": ratio(rests_called_gross(told)),
    }


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else NONE


def _reliability(told: Sequence[GripRecord]) -> Iterator[dict[str, str]]:
    found = forecast(told, 2)
    for said, seen, time_s in zip(found.said, found.seen, found.time_s, strict=True):
        if time_s > 0:
            yield {"said": f"{said:.2f}", "seen": f"{seen:.2f}", "time (s)": f"{time_s:.1f}"}


def _skill(horizon: int, least: float) -> Callable[[GripFound], Reading]:
    def measure(found: GripFound) -> Reading:
        skill = forecast(found.usual, horizon).brier_skill
        bound = forecast(found.usual, horizon, bound=True).brier_skill
        everything = forecast(found.told, horizon).brier_skill
        words = f"{skill:.2f} ({bound:.2f} if utilisation were known; {everything:.2f} with falling friction)"
        return judge(words, skill >= least)

    return measure


def _calibration(found: GripFound) -> Reading:
    error = forecast(found.usual, 2).calibration_error
    return judge(f"{error:.2f}", error <= 0.1)


def _rms(low_mv: float, high_mv: float, most: float) -> Callable[[GripFound], Reading]:
    def measure(found: GripFound) -> Reading:
        some = [t for t in found.usual if low_mv < t.world.noise_mv <= high_mv]
        rms = margin(some).rms
        words = f"{_number(rms)} (one scan: {_bound(some, 0.0)} with gains known, "
        words += f"{_bound(some, _GAIN_SD)} with gains known to {_GAIN_SD:.0%})"
        return judge(words, rms <= most, is_open=not np.isfinite(rms))

    return measure


def _bound(told: Sequence[GripRecord], gain_sd: float) -> str:
    """Return the Cramer-Rao bound of the rms error of utilisation in one scan."""
    sd = np.concatenate([bounds(t.world, gain_sd) for t in told] or [np.zeros(0)])
    return _number(float(np.sqrt((sd**2).mean()))) if len(sd) else NONE


def _coverage(found: GripFound) -> Reading:
    coverage = margin(found.usual).coverage
    return judge(f"{100 * coverage:.0f} %", 0.85 <= coverage <= 0.95)


def _ahead(told: Callable[[GripFound], Sequence[GripRecord]], least: float) -> Callable[[GripFound], Reading]:
    def measure(found: GripFound) -> Reading:
        some = told(found)
        threshold = threshold_for(some, _TIME_IN_ALARM)
        seen = warned(some, threshold)
        part = float(np.mean(seen.ahead)) if seen.ahead else float("nan")
        words = (
            f"{ratio(seen.ahead)} at p > {threshold:.2f}, {100 * seen.time_in_alarm:.1f} % of the time, "
            f"{seen.per_hour:.0f} alarms an hour"
        )
        return judge(words, part >= least, is_open=len(seen.ahead) < _LEAST_SLIPS)

    return measure


def _gross(within_s: float, least: float, *, falling: bool) -> Callable[[GripFound], Reading]:
    def measure(found: GripFound) -> Reading:
        chosen = [t for t in found.told if t.world.hand == "falling-friction"] if falling else found.usual
        cases = gross_told(chosen, within_s)
        part = float(np.mean(cases)) if cases else float("nan")
        return judge(ratio(cases), part >= least, is_open=len(cases) < _LEAST_SLIPS)

    return measure


def _rests(found: GripFound) -> Reading:
    cases = rests_called_gross(found.told)
    clear = rests_called_gross(found.told, _CLEAR)
    words = f"{ratio(cases)}; {ratio(clear)} of those below {_CLEAR:.0%} of the limit"
    return judge(words, float(np.mean(cases)) <= 0.02, is_open=len(cases) < 150 and not any(cases))


def _cost(way: str, most_us: float) -> Callable[[GripFound], Reading]:
    def measure(found: GripFound) -> Reading:
        if way not in found.costs:
            return judge(NONE, False, is_open=True)
        cost = found.costs[way][SHIPPED]
        return judge(f"{cost.hot_us:.0f} us hot, {cost.live_us:.0f} us live", cost.hot_us <= most_us)

    return measure


AIMS: Sequence[Aim[GripFound]] = (
    Aim("Brier skill of p_gross_300ms", "at least 0.30", _skill(2, 0.30)),
    Aim("Brier skill of p_gross_100ms", "above 0", _skill(1, 0.0)),
    Aim("Brier skill of p_gross_50ms", "above 0", _skill(0, 0.0)),
    Aim("calibration error of p_gross_300ms above 0.1", "at most 0.10", _calibration),
    Aim("rms error of utilisation from 0.5 up, noise to 1 mV", "at most 0.15", _rms(0.0, 1.0, 0.15)),
    Aim("the same, noise from 1 to 3 mV", "at most 0.20", _rms(1.0, 3.0, 0.20)),
    Aim("90 % intervals of utilisation hold", "85 to 95 %", _coverage),
    Aim(
        "slow slips told 100 ms ahead, friction unknown",
        "70 % with 1.5 % of the time in alarm",
        _ahead(lambda found: found.usual, 0.7),
    ),
    Aim(
        "slow slips told 100 ms ahead, friction known to 10 %",
        "80 % with 1.5 % of the time in alarm",
        _ahead(lambda found: without_falling_friction(found.informed), 0.8),
    ),
    Aim("gross slips told within 100 ms", "90 %", _gross(0.1, 0.90, falling=False)),
    Aim("gross slips told within 300 ms", "95 %", _gross(0.3, 0.95, falling=False)),
    Aim(
        "gross slips told within 300 ms where friction falls",
        "none was ever told",
        _gross(0.3, 0.5, falling=True),
    ),
    Aim("rests called gross", "at most 2 %", _rests),
    Aim("processor time of a scan, compiled", "at most 100 us", _cost("compiled", 100)),
    Aim("processor time of a scan, without compiled code", "at most 1 ms", _cost("numpy", 1000)),
)
