"""Logs of others that are read as a whole: the array, and all times and readings of a table or a bag."""

from pathlib import Path
from typing import NamedTuple

from tactiled.array import Array, FloatArray, load_array
from tactiled.errors import ConfigError, DataError
from tactiled.recording.bag import BAGS, is_bag, read_bag
from tactiled.recording.rows import TableOptions
from tactiled.recording.table import TABLES, read_table

_DEFAULT_ARRAY = "wang2019-3x3"


class WholeLog(NamedTuple):
    """Readings of an array."""

    array: Array
    time_s: FloatArray  # (n,)
    readings: FloatArray  # (n, channels): NaN where missing


def read_whole(
    path: Path, array: str | None, topic: str | None, options: TableOptions | None
) -> WholeLog | None:
    """Read a table or a topic of a bag (see `read_table`, `read_bag`); None for a recording of ours.

    Parameters
    ----------
    options : TableOptions or None
        None for a verb without such options, which errors then do not name.

    Raises
    ------
    DataError
        The file is of no known kind, cannot be read, or has another number of channels than the array.
    ConfigError
        The array is not known, or an option is not for files of this kind.
    """
    given = options or TableOptions()
    is_of_ros = is_bag(path, topic)
    if is_of_ros and (given.columns or given.time_unit is not None):
        raise ConfigError("command line", ["--columns and --time-unit are for tables; a bag has --topic"])
    if path.suffix == ".mcap" and not is_of_ros:
        if array is not None or given != TableOptions():
            fault = "--array, --columns, --rate and --time-unit are for tables; a recording contains them"
            if options is None:
                fault = "--array is for tables and bags; a recording contains its array"
            raise ConfigError("command line", [fault])
        return None
    if not is_of_ros and path.suffix not in TABLES:
        known = (
            f"our recordings (.mcap), tables ({', '.join(TABLES)}) and bags ({', '.join(BAGS)} or a folder)"
        )
        raise DataError(f"{path}: unknown file type; known are {known}")
    loaded = load_array(array or _DEFAULT_ARRAY)
    if is_of_ros:
        time_s, readings = read_bag(path, topic, given.rate_hz)
        choice = ", or the field of the message with --topic TOPIC.FIELD"
    else:
        time_s, readings = read_table(path, given.rate_hz, given.columns, given.time_unit)
        choice = "" if options is None else ", or the columns with --columns"
    if readings.shape[1] != loaded.n_channels:
        raise DataError(
            f"{path}: {readings.shape[1]} channels, but array {loaded.name} has {loaded.n_channels}; name "
            f"the array with --array NAME or --array FILE.toml{choice}"
        )
    return WholeLog(loaded, time_s, readings)
