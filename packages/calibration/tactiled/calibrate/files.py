"""Files of a calibration: the log of the array, and the record of the force sensor."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactiled.array import Array, FloatArray, load_array
from tactiled.calibrate.data import NO_TAXEL, ReferenceTable
from tactiled.errors import ConfigError, DataError
from tactiled.events.types import ScanEvent
from tactiled.force.calibration import OUTPUTS
from tactiled.outside import need_regular
from tactiled.recording.bag import is_bag, read_bag
from tactiled.recording.rows import TimeUnit
from tactiled.recording.steps import Replay
from tactiled.recording.table import read_table

_DEFAULT_ARRAY = "wang2019-3x3"
_COLUMNS = tuple(f"{name}_{'n' if name[0] == 'f' else 'nmm'}" for name in OUTPUTS)
_LEAST_ROWS = 20


@dataclass(frozen=True, eq=False)
class ArrayLog:
    """Readings of an array."""

    array: Array
    time_s: FloatArray  # (n,)
    readings: FloatArray  # (n, channels): NaN where missing or not valid
    board: str = ""  # serial number; empty where it is not known


def read_log(
    path: Path,
    array: str | None = None,
    columns: tuple[str, ...] = (),
    time_unit: TimeUnit | None = None,
    topic: str | None = None,
    rate_hz: float | None = None,
) -> ArrayLog:
    """Read a recording, a CSV or an npz file, or a topic of a bag (see `read_bag`).

    Raises
    ------
    DataError, ConfigError
    """
    is_of_ros = topic is not None or is_bag(path)
    if is_of_ros and (columns or time_unit is not None):
        raise ConfigError("command line", ["--columns and --time-unit are for tables; a bag has --topic"])
    if path.suffix == ".mcap" and not is_of_ros:
        if array is not None or columns or time_unit is not None or rate_hz is not None:
            fault = "--array, --columns, --rate and --time-unit are for tables; a recording contains them"
            raise ConfigError("command line", [fault])
        return _from_mcap(path)
    if not is_of_ros and path.suffix not in (".csv", ".npz"):
        raise DataError(
            f"{path}: unknown file type; supported are .mcap (recordings of tactiled), .csv, .npz and bags"
        )
    known = load_array(array or _DEFAULT_ARRAY)
    time_s, readings = (
        read_bag(path, topic, rate_hz) if is_of_ros else read_table(path, rate_hz, columns, time_unit)
    )
    if readings.shape[1] != known.n_channels:
        raise DataError(
            f"{path}: {readings.shape[1]} channels, but array {known.name} has {known.n_channels}; name the "
            "array with --array NAME or --array FILE.toml, or the columns with --columns"
        )
    return ArrayLog(known, time_s, np.where(known.in_range(readings), readings, np.nan))


def _from_mcap(path: Path) -> ArrayLog:
    """Replay a recording through the pipeline and keep its scans."""
    replay = Replay([path])
    array, board = replay.header.source.array, ""
    time_s: list[float] = []
    readings: list[FloatArray] = []
    for step in replay:
        for replayed in step.now:
            event = replayed.event
            if isinstance(event, ScanEvent) and (not time_s or event.time_s > time_s[-1]):
                time_s.append(event.time_s)
                readings.append(np.where(event.valid, event.volts, np.nan))
        if replay.pipeline.hello is not None:
            board = replay.pipeline.hello.board_serial
    if len(time_s) < 2:
        raise DataError(f"{path}: contains no scans; was the board started, and did its hello arrive?")
    return ArrayLog(array, np.array(time_s), np.array(readings), board)


def read_reference(path: Path, n_taxels: int) -> ReferenceTable:
    """Read the CSV of a force sensor: time_s, any of the forces and moments, optionally taxel.

    Raises
    ------
    DataError
        The file is not such a table; the message names the line.
    """
    rows: list[list[float]] = []
    try:
        need_regular(path)
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = [name.strip() for name in next(reader, [])]
            wanted = ["time_s", *_COLUMNS, "taxel"]
            if "time_s" not in header or not set(_COLUMNS[:3]) & set(header):
                raise DataError(
                    f"{path}: the header needs time_s and at least one of {', '.join(_COLUMNS[:3])}; it has "
                    f"{', '.join(header[:8]) or 'nothing'}"
                )
            places = [header.index(name) if name in header else None for name in wanted]
            for cells in reader:
                if cells:
                    if len(cells) != len(header):
                        raise DataError(
                            f"{path}: line {reader.line_num} has {len(cells)} cells, the header has "
                            f"{len(header)}"
                        )
                    rows.append([_number(cells, place, path, reader.line_num) for place in places])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(wanted))
    return check_table(table, str(path), n_taxels)


def check_table(table: FloatArray, source: str, n_taxels: int) -> ReferenceTable:
    """Make a reference of columns time, six outputs, taxel; rows with holes are left out.

    Raises
    ------
    DataError
        Times do not grow, a taxel does not exist, or there are too few rows.
    """
    has = ~np.isnan(table[:, 1:7]).all(axis=0)
    good = np.isfinite(table[:, 0]) & np.isfinite(table[:, 1:7][:, has]).all(axis=1)
    table = table[good]
    if len(table) < _LEAST_ROWS or not has.any():
        raise DataError(f"{source}: {len(table)} rows without holes; at least {_LEAST_ROWS} are needed")
    if np.any(np.diff(table[:, 0]) <= 0):
        row = int(np.argmax(np.diff(table[:, 0]) <= 0)) + 2
        raise DataError(f"{source}: time_s does not grow at row {row}")
    taxel = np.where(np.isfinite(table[:, 7]), table[:, 7], NO_TAXEL).astype(np.int64)
    if np.any((taxel < NO_TAXEL) | (taxel >= n_taxels)):
        raise DataError(
            f"{source}: taxel {taxel[np.argmax(np.abs(taxel))]} does not exist; there are 0 to {n_taxels - 1}"
        )
    return ReferenceTable(table[:, 0], table[:, 1:7], taxel)


def _number(cells: list[str], place: int | None, path: Path, line: int) -> float:
    if place is None or not cells[place].strip():
        return float("nan")
    try:
        return float(cells[place])
    except ValueError:
        raise DataError(f"{path}: line {line}: {cells[place]!r} is not a number") from None
