"""Files of a calibration: the log of the array, and the record of the force sensor."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.calibrate.data import NO_TAXEL, ReferenceTable
from tactiled.errors import DataError
from tactiled.events.types import ScanEvent
from tactiled.force.calibration import OUTPUTS
from tactiled.outside import need_regular
from tactiled.recording.steps import Replay
from tactiled.recording.table import TableOptions, TimeUnit
from tactiled.recording.whole import read_whole

COLUMNS = tuple(f"{name}_{'n' if name[0] == 'f' else 'nmm'}" for name in OUTPUTS)
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
    """Read a recording, or a table or bag (see `read_whole`).

    Raises
    ------
    DataError, ConfigError
    """
    whole = read_whole(path, array, topic, TableOptions(rate_hz, columns, time_unit))
    if whole is None:
        return _from_mcap(path)
    known, time_s, readings = whole
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
    wanted = ("time_s", *COLUMNS, "taxel")
    try:
        need_regular(path)
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = [name.strip() for name in next(reader, [])]
            if "time_s" not in header or not set(COLUMNS[:3]) & set(header):
                raise DataError(
                    f"{path}: the header needs time_s and at least one of {', '.join(COLUMNS[:3])}; it has "
                    f"{', '.join(header[:8]) or 'nothing'}"
                )
            for cells in filter(None, reader):
                where = f"{path}: line {reader.line_num}"
                if len(cells) != len(header):
                    raise DataError(f"{where} has {len(cells)} cells, the header has {len(header)}")
                row = dict(zip(header, cells, strict=True))
                rows.append([_number(row.get(name, ""), where) for name in wanted])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    return _checked(np.array(rows, dtype=np.float64).reshape(len(rows), len(wanted)), path, n_taxels)


def _checked(table: FloatArray, path: Path, n_taxels: int) -> ReferenceTable:
    """Reference of columns time, six outputs, taxel; rows with holes are left out."""
    has = ~np.isnan(table[:, 1:7]).all(axis=0)
    good = np.isfinite(table[:, 0]) & np.isfinite(table[:, 1:7][:, has]).all(axis=1)
    table = table[good]
    if len(table) < _LEAST_ROWS or not has.any():
        raise DataError(f"{path}: {len(table)} rows without holes; at least {_LEAST_ROWS} are needed")
    if np.any(np.diff(table[:, 0]) <= 0):
        row = int(np.argmax(np.diff(table[:, 0]) <= 0)) + 2
        raise DataError(f"{path}: time_s does not grow at row {row}")
    taxel = np.where(np.isfinite(table[:, 7]), table[:, 7], NO_TAXEL).astype(np.int64)
    if np.any((taxel < NO_TAXEL) | (taxel >= n_taxels)):
        raise DataError(
            f"{path}: taxel {taxel[np.argmax(np.abs(taxel))]} does not exist; there are 0 to {n_taxels - 1}"
        )
    return ReferenceTable(table[:, 0], table[:, 1:7], taxel)


def _number(cell: str, where: str) -> float:
    try:
        return float(cell) if cell.strip() else math.nan
    except ValueError:
        raise DataError(f"{where}: {cell!r} is not a number") from None
