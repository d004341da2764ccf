"""Options for reading a table, and which of its columns or arrays have the times, in which unit."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.errors import DataError

TimeUnit = Literal["s", "ms", "us", "ns"]
SECONDS: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Of the readings as float64: 14 h of 36 channels at 100 Hz. `detect` takes 3.5 times as much memory, which a
# host of 8 GB has. An npz of 18 MB may claim more than twice as much.
MOST_BYTES = 1_500_000_000
TIME_ADVICE = "times named time, t, timestamp or stamp need a unit, as in stamp_ms"
OPTION_ADVICE = " or by --time-unit, and a log without times needs --rate"
_TIME_NAMES = "time", "timestamp", "stamp"
# How names spell the units of times.
_UNIT_WORDS: dict[str, TimeUnit] = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "micros", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), "ns"),
}
# Stamps of ROS 2 and ROS 1, and of C: whole seconds, and the rest.
_SPLIT_STAMPS = {"sec": ("nanosec", "nsec", "usec"), "secs": ("nsecs", "nsec")}


@dataclass(frozen=True)
class TableOptions:
    """Options for reading a table that the file itself does not answer."""

    # Rate of the rows. Without it, a log slower than 10 Hz is refused: its times may not be in seconds
    rate_hz: float | None = None
    # Names of the columns of a CSV in channel order, ``*`` for several; all but the time if left out
    columns: Sequence[str] = ()
    # Unit of the times, where the name of their column or array does not say it
    time_unit: TimeUnit | None = None


class Times(NamedTuple):
    """Columns or arrays with the times of a log: none where a rate stands for them, two of a split stamp."""

    used: tuple[str, ...]
    units: tuple[TimeUnit, ...]  # of the used ones
    unused: tuple[str, ...]  # that have times, too
    are_dates: bool = False

    @property
    def name(self) -> str:
        """Name for errors."""
        return " and ".join(self.used) or "--rate"

    def seconds(self, path: Path, stamps: Sequence[FloatArray]) -> FloatArray:
        """Return the times of the used columns, one at least, (n,) each.

        Raises
        ------
        DataError
            The second column is no fraction of a second.
        """
        columns = [SECONDS[unit] * stamp for unit, stamp in zip(self.units, stamps, strict=True)]
        if len(columns) > 1 and np.any(columns[1] >= 1):
            raise DataError(
                f"{path}: {self.used[1]} should be a fraction of a second, but has more than a second; if it "
                f"is the whole time, say --time-unit {self.units[1]}"
            )
        time_s: FloatArray = np.sum(columns, axis=0)
        return time_s


def check_size(path: Path, n_bytes: int) -> None:
    """Refuse a table that is too large to be held."""
    if n_bytes > MOST_BYTES:
        raise DataError(f"{path}: has more than {MOST_BYTES / 1e9:g} GB of readings; split it")


def find_times(
    path: Path, names: Sequence[str], options: TableOptions, dates: Sequence[str] = ()
) -> Times | None:
    """Find the times among the names of columns or arrays; None without times or a rate.

    A name without a unit has that of the options. `time_s` comes first, then a stamp that is split into
    seconds and a fraction, then the first name with a unit. Columns of `dates` come last: many programs
    round them to seconds, and a rate replaces them. `DataError` if all times have another unit than that of
    the options.
    """
    given = options.time_unit
    found = {name: unit for name in names if (unit := unit_of(name)) is not None}
    dated = [name for name in found if name in dates]
    found = {name: unit for name, unit in found.items() if name not in dates}

    def times(used: Sequence[str], units: Sequence[TimeUnit]) -> Times:
        unused = (name for name in (*found, *dated) if name not in used)
        return Times(tuple(used), tuple(units), tuple(unused))

    if "time_s" in found:
        return times(["time_s"], [given or "s"])
    if given is None and (pair := _split_stamp(list(found))):
        return times(pair, ["s", found[pair[1]] or "ns"])
    for name, unit in found.items():
        if unit and given in (None, unit):
            return times([name], [unit])
        if given is not None and not unit:
            return times([name], [given])
    if given is not None and (found or dated):
        named = ", ".join((*found, *dated))
        raise DataError(f"{path}: --time-unit {given}, but the times are in {named}: which is it?")
    if options.rate_hz is not None:
        return times([], [])
    return times(dated[:1], ["s"])._replace(are_dates=True) if dated else None


def unit_of(name: str) -> TimeUnit | Literal[""] | None:
    """Return the unit of the times that a column or array has by its name, "" unknown; None for no times."""
    *stem, last = _words(name) or [""]
    if name == "t" or last in _TIME_NAMES:
        return ""
    # s alone may be anything, sec is a unit.
    is_time = len(last) > len("ms") if not stem else stem[-1] in _TIME_NAMES or stem == ["t"]
    return _UNIT_WORDS.get(last) if is_time else None


def _words(name: str) -> list[str]:
    """Return the words of a name: time, ms of ``Time [ms]``; header, stamp, sec of ``header.stamp.sec``."""
    return re.findall("[a-z0-9]+", re.sub("[\u00b5\u03bc]", "u", name.lower()))


def _split_stamp(names: Sequence[str]) -> tuple[str, str] | None:
    """Return the names of a stamp's seconds and of their fraction; None for no such stamp."""
    by_words = {tuple(_words(name)): name for name in names}
    for words, name in by_words.items():
        for last in _SPLIT_STAMPS.get(words[-1], ()):
            if (rest := by_words.get((*words[:-1], last))) is not None:
                return name, rest
    return None
