"""Logs of others: the array, and all times and readings of a table or a bag."""

from pathlib import Path
from typing import Literal, NamedTuple

from tactiled.array import Array, FloatArray, load_array
from tactiled.errors import ConfigError, DataError
from tactiled.recording.bag import BAGS, is_bag, read_bag
from tactiled.recording.table import TABLES, read_table
from tactiled.recording.table_times import TableOptions

DEFAULT_ARRAY = "wang2019-3x3"


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
