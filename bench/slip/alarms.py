"""Tables of false alarms of ``./run bench slip``."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

from bench.slip.faults import FAULTS
from bench.slip.quiet import HELD, OUTSIDE, QUIET_NOISES_V, Alarms, Counted
from bench.slip.scenes import NOISES_V
from tactiled.emulator.scene.families import HELD_OUT_QUIET
from tactiled.plain_table import table

GROUPS: dict[str, Callable[[str], bool]] = {
    "tuned on": lambda family: family not in HELD_OUT_QUIET,
    "of these, line faults": lambda family: family in FAULTS,
    "held out": lambda family: family in HELD_OUT_QUIET,
}
"""Families by group."""


class Rate(NamedTuple):
    """False alarms an hour with the 95 % interval."""

    per_hour: float
    low: float
    high: float

    @property
    def in_words(self) -> str:
        """The rate with its interval, as "rate (low..high)"."""
        return f"{_short(self.per_hour)} ({_short(self.low)}..{_short(self.high)})"


def mean_rate(alarms: Sequence[Alarms], *, told: bool) -> Rate:
    """Mean of families of one weight each, with its 95 % interval.

    The interval is that of Fay and Feuer (Statistics in Medicine 16, 1997, 791) for weighted sums of Poisson
    counts; of one family it is the exact one. Readings of one motion that differ by their noise alone count
    once: they do not tell how other motions would do.
    """
    if not alarms:
        return Rate(np.nan, np.nan, np.nan)
    per_hour = np.array([(one.told_false if told else one.false) / one.hours for one in alarms])
    apart = np.array([one.apart_hours for one in alarms])
    weight = 1 / (len(alarms) * apart)
    mean, most = float(per_hour.mean()), float(weight.max())
    spread = float((weight**2 * per_hour * apart).sum())
    low = spread / mean * special.gammaincinv(mean**2 / spread, 0.025) if mean else 0.0
    wider = spread + most**2
    high = wider / (mean + most) * special.gammaincinv((mean + most) ** 2 / wider, 0.975)
    return Rate(mean, float(low), float(high))


def total(
    counted: Counted, name: str, group: str, noises_v: Sequence[float], *, told: bool, outside: bool = True
) -> Rate:
    """False alarms an hour of a group of families, at some of `QUIET_NOISES_V`.

    Parameters
    ----------
    told : bool
        The daemon is told of the controller's own motion.
    outside : bool
        With what nobody can tell of (`OUTSIDE`).
    """
    mine: dict[str, Alarms] = {}
    for (family, noise_v, who), alarms in counted.items():
        is_asked = who == name and noise_v in noises_v and GROUPS[group](family)
        if is_asked and (outside or family not in OUTSIDE):
            # The motion is the same at every noise.
            mine[family] = mine[family].again(alarms) if family in mine else alarms
    return mean_rate(list(mine.values()), told=told)


def hourly_table(counted: Counted, names: Sequence[str]) -> str:
    """False alarms an hour by group, unannounced and announced."""
    rows = []
    for noise_v in QUIET_NOISES_V:
        for group in GROUPS:
            for told, outside, words in (
                (False, True, "unannounced"),
                (True, True, "announced"),
                (True, False, "announced, but what nobody can tell of"),
            ):
                found = [total(counted, name, group, [noise_v], told=told, outside=outside) for name in names]
                if not np.isnan(found[0].per_hour):
                    cells = [one.in_words for one in found]
                    rows.append([f"{1e3 * noise_v:g} mV", group, words, *cells])
    return table(["noise", "scenes", "", *names], rows)


def quiet_table(counted: Counted, names: Sequence[str]) -> str:
    """False alarms a minute by family, told and not told."""
    rows = []
    for noise_v in QUIET_NOISES_V:
        for family in dict.fromkeys(family for family, _, _ in counted):
            some = [counted[family, noise_v, name] for name in names]
            whose = f"{family} (nobody's to tell)" if family in OUTSIDE else family
            whose += ", held out" if family in HELD_OUT_QUIET else ""
            minutes = 60 * max(one.hours for one in some)
            rows.append([f"{1e3 * noise_v:g} mV", whose, f"{minutes:.0f} min", *map(_alarms, some)])
    return table(["noise", "family", "of", *names], rows)


def hold_table(counted: Counted, per_hour: Mapping[str, Callable[[float], float]]) -> str:
    """False alarms in holds against the rate that each detector is set to."""
    rows = []
    for name, asked in per_hour.items():
        cells = []
        for noise_v in NOISES_V:
            alarms = counted[HELD, noise_v, name]
            said = alarms.false - alarms.on_press
            pressing = f", {alarms.on_press} on the press" if alarms.on_press else ""
            cells.append(f"{said} of {asked(noise_v) * alarms.hours:.3g}{pressing}")
        rows.append([name, *cells])
    hours = max(counted[HELD, NOISES_V[0], name].hours for name in per_hour)
    return (
        f"In up to {hours:.2g} h of holds at each noise, false alarms said of allowed; after one on the "
        "press that never ends, none is said any more.\n\n"
        + table(["detector", *(f"{1e3 * noise_v:g} mV" for noise_v in NOISES_V)], rows)
    )


def _alarms(one: Alarms) -> str:
    minutes = 60 * one.hours
    told = f"; told {one.told_false / minutes:.3f}" if one.told_false < one.false else ""
    gross = f", {one.gross} gross" if 0 < one.gross < one.false else ""
    partial = f" (+{one.partial} right)" if one.partial else ""
    return f"{one.false / minutes:.3f}{told}{gross}{partial}"


def _short(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"
