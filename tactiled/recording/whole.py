"""Logs of others: the array, and all times and readings of a table (text with a header, or npz) or a bag."""

import logging
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from tactiled.array import Array, FloatArray, load_array
from tactiled.errors import ConfigError, DataError
from tactiled.pipeline import RATES_HZ
from tactiled.recording.bag import BAGS, is_bag, read_bag
from tactiled.recording.csv_table import read_csv
from tactiled.recording.npz_table import read_npz
from tactiled.recording.spacing import spacing_of
from tactiled.recording.table_times import SECONDS, TableOptions, Times

logger = logging.getLogger(__name__)

DEFAULT_ARRAY = "wang2019-3x3"
TABLES = (".csv", ".tsv", ".txt", ".npz")
# A log slower than this more likely gives its times in milliseconds (10 kHz then reads as 10 Hz) or as row
# numbers than that it was recorded so slowly.
_SLOWEST_LIKELY_HZ = 10.0


class WholeLog(NamedTuple):
    """Readings of an array."""

    array: Array
    time_s: FloatArray  # (n,)
    readings: FloatArray  # (n, channels): NaN where missing


def kind_of(path: Path, topic: str | None) -> Literal["recording", "table", "bag"]:
    """Return the kind of a file: a recording of ours, a table, or a bag of ROS or MCAP of others.

    `DataError` if it is of no known kind, or cannot be read; `ConfigError` for a topic of what can be no bag.
    """
    if is_bag(path, topic):
        return "bag"
    if path.suffix == ".mcap":
        return "recording"
    if path.suffix.lower() not in TABLES:
        known = (
            f"our recordings (.mcap), tables ({', '.join(TABLES)}) and bags ({', '.join(BAGS)} or a folder)"
        )
        remedy = ""
        if path.suffix == ".parquet":
            remedy = f'; `pandas.read_parquet("{path}").to_csv("log.csv", index=False)` makes a table of it'
        raise DataError(f"{path}: unknown kind of file; known are {known}{remedy}")
    return "table"


def read_whole(
    path: Path, array: str | None, topic: str | None, options: TableOptions | None
) -> WholeLog | None:
    """Read a table or a topic of a bag (see `read_table`, `read_bag`); None for a recording of ours.

    `DataError` if the file is of no known kind, cannot be read, or has another number of channels than the
    array; `ConfigError` if the array is not known, or an option is not for files of this kind.

    Parameters
    ----------
    options : TableOptions or None
        None for a verb without such options, which errors then do not name.
    """
    given = options or TableOptions()
    kind = kind_of(path, topic)
    if kind == "recording":
        if array is not None or given != TableOptions():
            fault = "--array, --columns, --rate and --time-unit are for tables; a recording contains them"
            if options is None:
                fault = "--array is for tables and bags; a recording contains its array"
            raise ConfigError("command line", [fault])
        return None
    loaded = load_array(array or DEFAULT_ARRAY)
    if kind == "bag":
        if given.columns or given.time_unit is not None:
            fault = "--columns and --time-unit are for tables; a bag has --topic TOPIC.FIELD"
            raise ConfigError("command line", [fault])
        time_s, readings = read_bag(path, topic, given.rate_hz)
        choice = ", or the field of the message with --topic TOPIC.FIELD"
    else:
        time_s, readings = read_table(path, given)
        choice = "" if options is None else ", or the columns with --columns"
    if readings.shape[1] != loaded.n_channels:
        raise DataError(
            f"{path}: {readings.shape[1]} channels, but array {loaded.name} has {loaded.n_channels} "
            f"({loaded.n_taxels} taxels); name the array with --array NAME or --array FILE.toml{choice}"
        )
    return WholeLog(loaded, time_s, readings)


def read_table(path: Path, options: TableOptions | None = None) -> tuple[FloatArray, FloatArray]:
    """Read the times (n,) in seconds and the readings (n, channels) of a log, NaN where missing.

    Text (``.csv``, ``.tsv``, ``.txt``): a header, a column ``time_s`` (or ``stamp_ms``, ``Time [ms]`` and the
    like, or ``sec`` and ``nanosec``, or dates under a name of times), then one column per channel in channel
    order, with commas, semicolons, tabs or spaces between; an empty cell or ``nan`` is a missing reading, and
    a row without any reading a missing scan, which is left out. Without a column of times, the rate spaces
    the rows. Further columns of times are left out with a warning, unless `columns` names the channels, and
    so are columns without a name.
    ``.npz``: ``time_s (n,)`` and ``volts (n, channels)``, or one array (n, ...) of another name; optional
    ``valid`` of the shape of ``volts`` is True for valid readings.
    A `DataError` names the line or the array that is not valid, or says that the file is too large.
    """
    options = options or TableOptions()
    is_npz = path.suffix.lower() == ".npz"
    times, time_s, readings = (read_npz if is_npz else read_csv)(path, options)
    if times.unused and not options.columns:
        remedy = "" if is_npz else " (--columns keeps one of numbers as a channel)"
        left_out = ", ".join(times.unused)
        logger.warning("%s: times are those of %s; left out: %s%s", path, times.name, left_out, remedy)
    if time_s is None:
        assert options.rate_hz is not None  # which stands for the times
        time_s = np.arange(len(readings)) / options.rate_hz
    if not (is_number := np.isfinite(time_s)).all():
        raise DataError(f"{path}: {times.name} is not a number in row {int(np.argmin(is_number)) + 1}")
    if (backwards := np.flatnonzero(np.diff(time_s) <= 0)).size:
        at = int(backwards[0])
        raise DataError(
            f"{path}: {times.name} does not grow at row {at + 2} ({time_s[at]} s to {time_s[at + 1]} s); if "
            "rows are evenly spaced, delete the times and give --rate"
        )
    is_reading = np.isfinite(readings)
    readings[~is_reading] = np.nan
    if not (is_scan := is_reading.any(axis=1)).all():
        time_s, readings = time_s[is_scan], readings[is_scan]
    if len(time_s) < 2:
        raise DataError(
            f"{path}: {len(time_s)} scans (rows with a reading); at least two are needed to compute the rate"
        )
    if fault := _rate_fault(spacing_of(time_s).period_s, times, options):
        raise DataError(f"{path}: {fault}")
    return time_s, readings


def _rate_fault(spacing_s: float, times: Times, options: TableOptions) -> str:
    """Describe an implausible time spacing and its remedy; empty where the times are probably seconds."""
    slowest, fastest = RATES_HZ
    rate_hz = 1 / spacing_s
    given = times.units[0] if times.units else "s"
    rows = f"rows are {spacing_s:g} s apart by {times.name}, {rate_hz:g} Hz"
    if rate_hz > fastest:
        return f"{rows}, and no board is faster than {fastest:g} Hz; give it in seconds or say --time-unit"
    is_known = options.rate_hz is not None or options.time_unit is not None or given != "s" or times.are_dates
    if rate_hz >= (slowest if is_known else _SLOWEST_LIKELY_HZ):
        return ""
    unit_hz = rate_hz * SECONDS[given]
    likely = [unit for unit in SECONDS if _SLOWEST_LIKELY_HZ <= unit_hz / SECONDS[unit] <= fastest]
    unit = next((unit for unit in likely if unit != given), "")
    other = f"if they are in {unit} say --time-unit {unit}, " if unit else ""
    slow = f"; if scans are so slow, give --rate {rate_hz:g}" if rate_hz >= slowest else ""
    taken = "seconds" if given == "s" else given
    return f"{rows}; times are taken in {taken}: {other}if they count rows divide by the rate{slow}"
