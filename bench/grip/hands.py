"""``./run bench hands``: false alarms of hands that hold, over two hours.

Random worlds as in ``./run bench grip``, but a minute long, and the hand rests, sways, walks, taps, hums or
drifts and never uses half of the friction limit. Whatever is reported there is a false alarm.
"""

import math
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from bench.report import BENCH_WORKERS, NONE, Aim, BenchOptions, aim, aims_table, counted, table
from bench.slip.cases import run_settings
from bench.worlds.laws import HELD_OUT_LAW, LAWS, Population, draw_worlds
from bench.worlds.world import INCIPIENT_USED, World
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.events.types import GripEvent, SlipEvent
from tactiled.jobs import executor
from tactiled.progress import ProgressBar

HANDS = ("rest", "sway", "lift", "tap", "hum", "drift")
_FROM = 40_000  # seeds on which nothing was set
_DURATION_S = 60.0
_MOST_USED = 0.45  # planned; the mass of the object and the tremor of the hand add to it
_BELOW = 0.5
_HOURS, _QUICK_HOURS = 2.0, 0.2
_BATCH = 12
_HELD_OUT_EACH = 5  # one batch in so many has the law on which nothing was set: one of the five laws
_AIM_SETTING = "balanced"
_MOST_PER_HOUR, _MOST_IN_A_MINUTE = 10.0, 3


class Minute(NamedTuple):
    """False slip events of one world, by setting, and its time in contact."""

    hand: str
    hours: float
    unslipped_hours: float  # of these, until a tenth of the area has slipped: onsets are false only there
    onsets: Counter[str]
    gross: Counter[str]


def bench_hands(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Slip events an hour of hands below half of the limit.

    Quick: 12 minutes instead of two hours.
    """
    hours = _QUICK_HOURS if options.quick else _HOURS
    n = math.ceil(3600 * hours / _DURATION_S / _BATCH) * _BATCH
    progress.begin(n)
    batches = [range(start, start + _BATCH) for start in range(_FROM, _FROM + n, _BATCH)]
    with executor(BENCH_WORKERS) as pool:
        read = chain.from_iterable(counted(pool.map(_measure, batches), progress, "worlds", _BATCH))
    found = [minute for minute in read if minute is not None]
    left_out = n - len(found)
    rows = {hand: [minute for minute in found if minute.hand == hand] for hand in HANDS} | {"all": found}
    return [
        f"{n - left_out} emulated worlds of {_DURATION_S:g} s (seeds {_FROM}..{_FROM + n - 1}). Worlds in "
        f"which a hand uses half of the friction limit or more are left out ({left_out} here). Contacts "
        f"last {_hours(found):.1f} h. Incipient onsets are counted only in the {_unslipped_hours(found):.2f} "
        "h before a tenth of the area first slips, which happens at a utilisation of "
        f"{INCIPIENT_USED:.3f}.",
        aims_table(_aims(found)),
        "False slip events by setting. First number: incipient onsets per hour before a tenth of the area "
        "first slips. Second number: gross slips per hour of contact. In parentheses: their number.",
        table(_event_row(hand, some) for hand, some in rows.items()),
    ]


def _measure(seeds: range) -> list[Minute | None]:
    """Count a batch of worlds; None for one that used half of the limit."""
    is_held_out = (seeds[0] // _BATCH) % _HELD_OUT_EACH == 0
    laws = (HELD_OUT_LAW,) if is_held_out else LAWS
    worlds = draw_worlds(seeds, Population(laws, HANDS, _DURATION_S, _MOST_USED))
    return [count_reports(world) if world.utilisation.max() < _BELOW else None for world in worlds]


def count_reports(world: World) -> Minute:
    """Count what the filter reports of a world in which nothing slips."""
    has_slipped = np.maximum.accumulate(world.utilisation) >= INCIPIENT_USED
    onsets, gross, touches_s = Counter[str](), Counter[str](), list[float]()
    for name, events in run_settings(world.array, world.block).items():
        if name == _AIM_SETTING:
            touches_s = [e.time_s for e in events if isinstance(e, GripEvent) and e.state != "none"]
        for event in events:
            if isinstance(event, SlipEvent) and event.state == "onset":
                k = min(round((event.detected_s or 0.0) * world.rate_hz), len(has_slipped) - 1)
                gross[name] += event.kind == "gross"
                onsets[name] += event.kind != "gross" and not has_slipped[k]
    an_hour = world.rate_hz * 3600
    scans = np.rint(np.array(touches_s) * world.rate_hz).astype(np.int64)
    unslipped = int((~has_slipped[scans]).sum())
    return Minute(world.hand, len(scans) / an_hour, unslipped / an_hour, onsets, gross)


def _hours(some: Sequence[Minute]) -> float:
    return sum(minute.hours for minute in some)


def _unslipped_hours(some: Sequence[Minute]) -> float:
    return sum(minute.unslipped_hours for minute in some)


def _event_row(hand: str, some: Sequence[Minute]) -> dict[str, str]:
    row = {"hand": hand}
    for name in SETTINGS:
        parts = (
            (sum(one.onsets[name] for one in some), _unslipped_hours(some)),
            (sum(one.gross[name] for one in some), _hours(some)),
        )
        row[name] = " / ".join(f"{n / hours:.1f} ({n})" if hours else NONE for n, hours in parts)
    return row


def _aims(some: Sequence[Minute]) -> list[Aim]:
    each, hours = [minute.gross[_AIM_SETTING] for minute in some], _hours(some)
    per_hour, most = sum(each) / max(hours, 1e-9), max(each, default=0)
    is_quick = hours < 0.9 * _HOURS  # some worlds are left out
    return [
        aim(
            f"false gross slips an hour, {_AIM_SETTING}",
            f"at most {_MOST_PER_HOUR:g}",
            f"{per_hour:.1f} over {hours:.1f} h",
            not is_quick and per_hour <= _MOST_PER_HOUR,
            is_open=is_quick,
        ),
        aim("the most in a minute", f"at most {_MOST_IN_A_MINUTE}", f"{most}", most <= _MOST_IN_A_MINUTE),
    ]
