"""Aims of the slip detector, measured for each of its settings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bench.report import Aim, Reading, at_most, judge
from bench.slip.quiet import AlarmRate, QuietReading, alarm_rate
from bench.slip.scenes import NOISES_V
from bench.slip.score import coverage, median, quantile
from bench.slip.slips import ORACLE, SLOW_S, SlipReading
from bench.slip.tables import MEDIAN_X, P95_X, at_noise, latencies_s, scores_of, stated

_COVERED, _WITHIN = 68.0, 5.0  # percent within one sigma of a normal error, and points around it


@dataclass(frozen=True)
class SettingFound:
    """Readings of one setting: slips, and scenes without slip at `QUIET_NOISES_V`."""

    name: str
    slips: Sequence[SlipReading]
    quiet: Sequence[QuietReading]


def _over_oracle(part: float, noise_v: float, found: SettingFound) -> float:
    slips = at_noise(found.slips, noise_v)
    return quantile(latencies_s(slips, found.name), part) / quantile(latencies_s(slips, ORACLE), part)


def _before_gross(found: SettingFound) -> Reading:
    slow = [slip.scores[found.name].lead_s > 0 for slip in found.slips if slip.to_gross_s >= SLOW_S]
    percent = 100 * float(np.mean(slow)) if slow else np.nan
    return judge(f"{percent:.1f} % of {len(slow)}", percent >= 99)


def _gross_error_ms(found: SettingFound) -> float:
    return 1e3 * median(np.abs([one.gross_latency_s for one in scores_of(found.slips, found.name)]))


def _direction_error_deg(found: SettingFound) -> float:
    error_deg = np.abs(stated(scores_of(found.slips, found.name), "direction")[0])
    error_deg = error_deg[np.isfinite(error_deg)]
    return float(np.median(error_deg)) if len(error_deg) else np.nan


def _false_alarms(
    name: str, per_hour: float, rate: Callable[[Sequence[QuietReading]], AlarmRate]
) -> Aim[SettingFound]:
    def measure(found: SettingFound) -> Reading:
        measured = rate(found.quiet)
        return judge(str(measured), measured.per_hour <= per_hour)

    return Aim(name, f"at most {per_hour:g} an hour", measure)


def _covered(name: str, quantity: str) -> Aim[SettingFound]:
    def measure(found: SettingFound) -> Reading:
        percent = 100 * coverage(*stated(scores_of(found.slips, found.name), quantity))
        return judge(f"{percent:.0f} %", abs(percent - _COVERED) <= _WITHIN)

    return Aim(f"{name} within one stated sigma", f"{_COVERED:.0f} % within {_WITHIN:.0f} points", measure)


AIMS: tuple[Aim[SettingFound], ...] = (
    *(
        at_most(
            f"latency over the oracle's, {words}, {1e3 * noise_v:g} mV",
            times,
            " x",
            partial(_over_oracle, part, noise_v),
            ".1f",
        )
        for part, times, words in ((0.5, MEDIAN_X, "median"), (0.95, P95_X, "p95"))
        for noise_v in NOISES_V
    ),
    Aim("an event before gross slip, slips of 50 ms and more", "at least 99 %", _before_gross),
    at_most("gross event, median distance from truth", 50, " ms", _gross_error_ms, ".0f"),
    _false_alarms("false alarms, announced", 1, partial(alarm_rate, is_announced=True)),
    _false_alarms(
        "false alarms, announced, external disturbances excluded",
        1,
        partial(alarm_rate, is_announced=True, with_external=False),
    ),
    _false_alarms("false alarms, unannounced", 6, alarm_rate),
    at_most("direction error, median", 5, " deg", _direction_error_deg, ".1f"),
    _covered("direction", "direction"),
    _covered("onset", "onset"),
    _covered("gross instant", "gross_onset"),
)
