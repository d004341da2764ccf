"""Record of the force sensor of a calibration."""

from pathlib import Path

import numpy as np

from tactiled.calibrate.data import ReferenceTable
from tactiled.errors import DataError
from tactiled.force.calibration import OUTPUTS
from tactiled.recording.csv_table import read_named
from tactiled.recording.table_times import TableOptions

COLUMNS = tuple(f"{name}_{'n' if name[0] == 'f' else 'nmm'}" for name in OUTPUTS)
_LEAST_ROWS = 20


def read_reference(path: Path, *, are_poses: bool = False) -> ReferenceTable:
    """Read the CSV of a force sensor: times, and any of the forces and moments; rows with holes are left out.

    Rows of poses count from 0 where they have no time. `DataError` where the file is not such a table; the
    message names the line or the row.
    """
    options = TableOptions(rate_hz=1.0 if are_poses else None)
    time_s, outputs, unused = read_named(path, COLUMNS, options)
    row = np.arange(len(time_s))
    has = np.asarray(np.isfinite(outputs).any(axis=0))
    if not has[:3].any():
        raise DataError(f"{path}: needs a force: at least one of {', '.join(COLUMNS[:3])}")
    kept = np.isfinite(time_s) & np.isfinite(outputs[:, has]).all(axis=1)
    row, time_s, outputs = row[kept], time_s[kept], outputs[kept]
    if len(row) < _LEAST_ROWS:
        raise DataError(f"{path}: {len(row)} rows without holes; at least {_LEAST_ROWS} are needed")
    if (backwards := np.flatnonzero(np.diff(time_s) <= 0)).size:
        raise DataError(f"{path}: times do not grow at row {row[backwards[0] + 1] + 1}")
    return ReferenceTable(time_s, outputs, unused)
