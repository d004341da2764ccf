"""Record of the force sensor of a calibration."""

import csv
import math
from pathlib import Path

import numpy as np

from tactiled.array import FloatArray
from tactiled.calibrate.data import ReferenceTable
from tactiled.errors import DataError
from tactiled.force.calibration import OUTPUTS
from tactiled.outside import need_regular, shown

COLUMNS = tuple(f"{name}_{'n' if name[0] == 'f' else 'nmm'}" for name in OUTPUTS)
_LEAST_ROWS = 20


def read_reference(path: Path) -> ReferenceTable:
    """Read the CSV of a force sensor: time_s, and any of the forces and moments.

    `DataError` where the file is not such a table; the message names the line.
    """
    rows: list[list[float]] = []
    wanted = ("time_s", *COLUMNS)
    try:
        need_regular(path)
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = [name.strip() for name in next(reader, [])]
            if "time_s" not in header or not set(COLUMNS[:3]) & set(header):
                raise DataError(
                    f"{path}: the header needs time_s and at least one of {', '.join(COLUMNS[:3])}; it has "
                    f"{', '.join(map(shown, header[:8])) or 'nothing'}"
                )
            for cells in filter(None, reader):
                where = f"{path}: line {reader.line_num}"
                if len(cells) != len(header):
                    raise DataError(f"{where} has {len(cells)} cells, the header has {len(header)}")
                row = dict(zip(header, cells, strict=True))
                rows.append([reader.line_num, *(_number(row.get(name, ""), where) for name in wanted)])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    unused = tuple(name for name in header if name not in wanted)
    return _checked(np.array(rows, dtype=np.float64).reshape(len(rows), 1 + len(wanted)), unused, path)


def _checked(table: FloatArray, unused: tuple[str, ...], path: Path) -> ReferenceTable:
    """Reference of columns line, time and six outputs; rows with holes are left out."""
    has = ~np.isnan(table[:, 2:]).all(axis=0)
    table = table[np.isfinite(table[:, 1]) & np.isfinite(table[:, 2:][:, has]).all(axis=1)]
    if len(table) < _LEAST_ROWS or not has.any():
        raise DataError(f"{path}: {len(table)} rows without holes; at least {_LEAST_ROWS} are needed")
    line, time_s = table[:, :2].T
    if (backwards := np.flatnonzero(np.diff(time_s) <= 0)).size:
        raise DataError(f"{path}: line {line[backwards[0] + 1]:.0f}: time_s does not grow")
    return ReferenceTable(time_s, table[:, 2:], unused)


def _number(cell: str, where: str) -> float:
    try:
        return float(cell) if cell.strip() else math.nan
    except ValueError:
        raise DataError(f"{where}: {shown(cell)} is not a number") from None
