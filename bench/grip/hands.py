"""``./run bench hands``: false alarms of hands that hold, over two hours.

Random worlds as in ``./run bench grip``, but a minute long, and the hand rests, sways, walks, taps, hums or
drifts and never uses half of the friction limit. Whatever is reported there is a false alarm.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from bench.report import BENCH_WORKERS, NONE, Aim, BenchOptions, aim, aims_table, counted, table
from bench.slip.cases import run_settings
from bench.worlds.laws import HELD_OUT_LAW, LAWS, Population, draw_worlds
from bench.worlds.world import INCIPIENT_USED, World
from tactiled.detect.contact.filter import SETTINGS
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


@dataclass
class HandCount:
    """False slip events of one kind of hand, by setting, and the most gross slips that one minute had."""

    hours: float = 0.0
    onsets: Counter[str] = field(default_factory=Counter)
    gross: Counter[str] = field(default_factory=Counter)
    most_gross: Counter[str] = field(default_factory=Counter)

    def add(self, other: "HandCount") -> None:
        """Add the hours and counts of other worlds."""
        self.hours += other.hours
        self.onsets.update(other.onsets)
        self.gross.update(other.gross)
        self.most_gross |= other.most_gross


def bench_hands(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Slip events an hour of hands below half of the limit.

    Quick: 12 minutes instead of two hours.
    """
    hours = _QUICK_HOURS if options.quick else _HOURS
    n = math.ceil(3600 * hours / _DURATION_S / _BATCH) * _BATCH
    progress.begin(n)
    counts = {hand: HandCount() for hand in HANDS}
    batches = [range(start, start + _BATCH) for start in range(_FROM, _FROM + n, _BATCH)]
    with executor(BENCH_WORKERS) as pool:
        found = list(chain.from_iterable(counted(pool.map(_measure, batches), progress, "worlds", _BATCH)))
    for hand, count in found:
        if count is not None:
            counts[hand].add(count)
    left_out = sum(count is None for _, count in found)
    everything = HandCount()
    for count in counts.values():
        everything.add(count)
    rows = {**counts, "all": everything}
    return [
        f"{n - left_out} random worlds of {_DURATION_S:g} s (seeds {_FROM}..{_FROM + n - 1}; "
        f"{left_out} used half of the limit or more and were left out), "
        f"{everything.hours:.1f} h in contact.",
        aims_table(_aims(everything)),
        "False slip events an hour, by setting: onsets where less than a tenth of the area has slipped "
        "so far / gross slips.",
        table(_event_row(hand, count) for hand, count in rows.items()),
    ]


def _measure(seeds: range) -> list[tuple[str, HandCount | None]]:
    """Count a batch of worlds; None for one that used half of the limit."""
    is_held_out = (seeds[0] // _BATCH) % _HELD_OUT_EACH == 0
    laws = (HELD_OUT_LAW,) if is_held_out else LAWS
    worlds = draw_worlds(seeds, Population(laws, HANDS, _DURATION_S, _MOST_USED))
    return [
        (world.hand, count_reports(world) if world.utilisation.max() < _BELOW else None) for world in worlds
    ]


def count_reports(world: World) -> HandCount:
    """Count what the filter reports of a world in which nothing slips."""
    has_slipped = np.maximum.accumulate(world.utilisation) >= INCIPIENT_USED
    count = HandCount()
    for name, events in run_settings(world.array, world.block).items():
        if name == _AIM_SETTING:
            touches = sum(isinstance(event, GripEvent) and event.state != "none" for event in events)
            count.hours = touches / world.rate_hz / 3600
        for event in events:
            if isinstance(event, SlipEvent) and event.state == "onset":
                k = min(round((event.detected_s or 0.0) * world.rate_hz), len(has_slipped) - 1)
                count.gross[name] += event.kind == "gross"
                count.onsets[name] += event.kind != "gross" and not has_slipped[k]
    count.most_gross = count.gross.copy()
    return count


def _event_row(hand: str, count: HandCount) -> dict[str, str]:
    row = {"hand": hand}
    for name in SETTINGS:
        both = (count.onsets[name], count.gross[name])
        row[name] = " / ".join(f"{n / count.hours:.1f}" if count.hours else NONE for n in both)
    return row


def _aims(count: HandCount) -> list[Aim]:
    per_hour, most = count.gross[_AIM_SETTING] / max(count.hours, 1e-9), count.most_gross[_AIM_SETTING]
    words, is_quick = f"{per_hour:.1f} over {count.hours:.1f} h", count.hours < 0.9 * _HOURS
    is_met = not is_quick and per_hour <= _MOST_PER_HOUR  # some worlds are left out
    return [
        aim(
            f"false gross slips an hour, {_AIM_SETTING}",
            f"at most {_MOST_PER_HOUR:g}",
            words,
            is_met,
            is_open=is_quick,
        ),
        aim("the most in a minute", f"at most {_MOST_IN_A_MINUTE}", f"{most}", most <= _MOST_IN_A_MINUTE),
    ]
