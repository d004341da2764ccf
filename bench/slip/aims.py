"""What ``./run bench slip`` was to reach, for each setting, and what limits it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.slip.alarms import GROUPS, Rate, total
from bench.slip.latency import Case
from bench.slip.limit import LATENCIES_S, Exceeded, per_hour
from bench.slip.quiet import QUIET_NOISES_V, Counted
from bench.slip.scenes import NOISES_V
from bench.slip.score import Found, coverage, median, quantile
from bench.slip.tables import ORACLE, SLOW_S, first_s
from tactiled.plain_table import table

FloatArray = NDArray[np.float64]

MEDIAN_X, P95_X = 1.5, 2.5  # of the oracle's
_COVERED, _WITHIN = 68.0, 5.0  # percent inside one sigma of a normal error, and points around it


@dataclass(frozen=True)
class Aim:
    """A limit, in words, and what is measured of a setting.

    Attributes
    ----------
    measure : callable
        Name of a setting to what is printed, and whether the aim is met.
    """

    name: str
    limit: str
    measure: Callable[[str], tuple[str, bool]]


def aims_table(cases: Sequence[Case], counted: Counted, group: str, names: Sequence[str]) -> str:
    """Aims by setting.

    Parameters
    ----------
    group : str
        Of `slip_alarms.GROUPS`, for false alarms.
    """
    rows = []
    for aim in [*_latency_aims(cases), *_alarm_aims(counted, group), *_estimate_aims(cases)]:
        cells = [f"{words}, {'met' if met else 'MISSED'}" for words, met in map(aim.measure, names)]
        rows.append([aim.name, aim.limit, *cells])
    return table(["aim", "limit", *names], rows)


def _latency_aims(cases: Sequence[Case]) -> list[Aim]:
    aims = []
    for part, times, words in ((0.5, MEDIAN_X, "median"), (0.95, P95_X, "p95")):
        for noise_v in NOISES_V:
            some = [case for case in cases if case.noise_v == noise_v]

            def over(name: str, some: list[Case] = some, part: float = part) -> float:
                return quantile(first_s(some, name), part) / quantile(first_s(some, ORACLE), part)

            aims.append(
                _at_most(f"first event, {words}, {1e3 * noise_v:g} mV", times, " x oracle", over, "{:.1f} x")
            )

    def early(name: str) -> tuple[str, bool]:
        slow = [case.found[name].to_gross_s > 0 for case in cases if case.becoming_s >= SLOW_S]
        part = 100 * float(np.mean(slow)) if slow else np.nan
        return f"{part:.1f} % of {len(slow)}", part >= 99

    def gross_ms(name: str) -> float:
        return 1e3 * median(np.abs([case.found[name].gross_s for case in cases]))

    aims.append(Aim("an event before gross, slips of 50 ms and more", "at least 99 %", early))
    aims.append(_at_most("gross event, median distance from truth", 50, " ms", gross_ms, "{:.0f} ms"))
    return aims


def _alarm_aims(counted: Counted, group: str) -> list[Aim]:
    def counts(name: str, limit: float, found: Callable[[str], Rate]) -> Aim:
        def measure(setting: str) -> tuple[str, bool]:
            return found(setting).in_words, found(setting).per_hour <= limit

        return Aim(name, f"at most {limit:g} an hour", measure)

    def told(name: str) -> Rate:
        return total(counted, name, group, QUIET_NOISES_V, told=True)

    def tellable(name: str) -> Rate:
        return total(counted, name, group, QUIET_NOISES_V, told=True, outside=False)

    def untold(name: str) -> Rate:
        return total(counted, name, group, QUIET_NOISES_V, told=False)

    return [
        counts("false alarms, announced", 1, told),
        counts("the same without what nobody can tell of", 1, tellable),
        counts("false alarms, unannounced", 6, untold),
    ]


def _estimate_aims(cases: Sequence[Case]) -> list[Aim]:
    def each(name: str, field: Callable[[Found], tuple[float, float]]) -> FloatArray:
        return np.array([field(case.found[name]) for case in cases])

    def turn(one: Found) -> tuple[float, float]:
        return one.direction_error_deg, one.direction_sd_deg

    def onset(one: Found) -> tuple[float, float]:
        return one.onset_error_s, one.onset_sd_s

    def gross(one: Found) -> tuple[float, float]:
        return one.gross_onset_error_s, one.gross_onset_sd_s

    def turn_deg(name: str) -> float:
        error = np.abs(each(name, turn)[:, 0])
        return float(np.median(error[np.isfinite(error)])) if np.isfinite(error).any() else np.nan

    def covered(name: str, field: Callable[[Found], tuple[float, float]]) -> Aim:
        def measure(setting: str) -> tuple[str, bool]:
            part = 100 * coverage(*each(setting, field).T)
            return f"{part:.0f} %", abs(part - _COVERED) <= _WITHIN

        return Aim(name, f"{_COVERED:.0f} % within {_WITHIN:.0f} points", measure)

    return [
        _at_most("direction error, median", 5, " deg", turn_deg, "{:.1f} deg"),
        covered("direction inside one stated sigma", turn),
        covered("onset inside one stated sigma", onset),
        covered("gross instant inside one stated sigma", gross),
    ]


def _at_most(name: str, limit: float, unit: str, value: Callable[[str], float], form: str) -> Aim:
    def measure(setting: str) -> tuple[str, bool]:
        got = value(setting)
        return (form.format(got) if np.isfinite(got) else "-"), got <= limit

    return Aim(name, f"at most {limit:g}{unit}", measure)


def limit_table(cases: Sequence[Case], exceeded: Mapping[str, Exceeded]) -> str:
    """What a detector of growing shear must raise, on families tuned on, at the instants of the aims."""
    rows, found = [], tuned_on(exceeded)
    for noise_v in NOISES_V:
        some = [case for case in cases if case.noise_v == noise_v]
        bound = first_s(some, ORACLE)
        by_s = MEDIAN_X * median(bound)
        all_by_s = P95_X * quantile(bound, 0.95)
        rows.append(
            [
                f"{1e3 * noise_v:g} mV",
                f"{1e3 * by_s:.0f} ms",
                f"{_growth(some, by_s, 0.5):.4f} / {_growth(some, by_s, 0.9):.4f}",
                f"{_least(some, found, by_s, 0.5):.0f} / {_least(some, found, by_s, 0.9):.0f}",
                f"{1e3 * all_by_s:.0f} ms",
                f"{_growth(some, all_by_s, 0.95):.4f}",
                f"{_least(some, found, all_by_s, 0.95):.0f}",
            ]
        )
    return table(
        [
            "noise", f"{MEDIAN_X:g} x oracle's median", "grown by then: half of the slips / nine tenths",
            "an hour that grow so without slip", f"{P95_X:g} x oracle's p95", "95 %", "an hour",
        ],
        rows,
    )  # fmt: skip


def limit_curve(cases: Sequence[Case], exceeded: Mapping[str, Exceeded], part: float) -> FloatArray:
    """(latencies, 2): seconds, and false alarms an hour that saying so much of all slips by then costs."""
    found = tuned_on(exceeded)
    return np.array([(latency_s, _least(cases, found, latency_s, part)) for latency_s in LATENCIES_S])


def tuned_on(exceeded: Mapping[str, Exceeded]) -> list[Exceeded]:
    """The families that false alarms of the settings are counted in."""
    return [one for family, one in exceeded.items() if GROUPS["tuned on"](family)]


def _least(cases: Sequence[Case], found: list[Exceeded], latency_s: float, part: float) -> float:
    return per_hour(found, latency_s, _growth(cases, latency_s, part))


def _growth(cases: Sequence[Case], latency_s: float, part: float) -> float:
    """Growth that so much of all slips have reached; between latencies, that at the longer one."""
    row = min(int(np.searchsorted(LATENCIES_S, latency_s - 1e-9)), len(LATENCIES_S) - 1)
    return float(np.quantile([case.growth[row] for case in cases], 1 - part))
