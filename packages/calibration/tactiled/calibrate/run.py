"""``tactiled calibrate``: read the files, fit, write the calibration, print the verdict."""

import json
import time
from pathlib import Path
from typing import Any

import click
import numpy as np

from tactiled.calibrate.data import ReferenceTable
from tactiled.calibrate.study import N_STAGES, CalibrationStudy, calibrate
from tactiled.errors import ConfigError, DataError
from tactiled.events.types import ForceEvent
from tactiled.force.calibration import OUTPUTS, save_calibration
from tactiled.outside import shown
from tactiled.progress import ProgressBar, tell
from tactiled.recording.csv_table import read_named
from tactiled.recording.table_times import TableOptions
from tactiled.scan_log import read_log

COLUMNS = tuple(f"{name}_{'n' if name[0] == 'f' else 'nmm'}" for name in OUTPUTS)
_LEAST_ROWS = 20  # of a reference
_TAKEN = sorted(ForceEvent.UNCALIBRATED)
_MOST_NAMES = 12  # of columns, in a line for people
_LONGEST = 64  # characters of the field `calibration` of messages


def calibrate_files(
    log: Path,
    reference: Path,
    out: Path,
    array: str | None,
    topic: str | None,
    options: TableOptions,
    *,
    board: str,
    is_same_clock: bool,
    are_poses: bool,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Write a calibration file; the verdict to stderr, numbers as one JSON line to stdout if asked.

    `DataError` or `ConfigError` where a file is invalid, or the data cannot give a calibration.
    """
    if not out.parent.is_dir() or out.suffix != ".toml":
        raise ConfigError("-o", [f"{out}: name a .toml in a folder that exists"])
    if out.stem in _TAKEN or len(out.stem) > _LONGEST:
        fault = f"{out.name}: the name of the file becomes the name in messages; at most {_LONGEST} letters, "
        raise ConfigError("-o", [fault + f"and not {' or '.join(_TAKEN)}, which have a meaning there"])
    data = read_log(log, array, topic, options)
    table = read_reference(reference, are_poses=are_poses)
    if table.unused:
        names = ", ".join(map(shown, table.unused[:_MOST_NAMES]))
        more = ", ..." if len(table.unused) > _MOST_NAMES else ""
        tell(f"{reference}: columns not used: {names}{more}; known are {', '.join(COLUMNS)}")
    with ProgressBar("calibrate", N_STAGES) as bar:
        found = calibrate(
            data.array,
            data.time_s,
            data.readings,
            table,
            out.stem,
            bar.advance,
            board=board or data.board,
            date=time.strftime("%Y-%m-%d"),
            is_same_clock=is_same_clock,
            are_poses=are_poses,
        )
    try:
        save_calibration(out, found.file)
    except OSError as error:
        raise DataError(f"{out}: cannot be written: {error.strerror}") from None
    tell("\n".join((f"{out}: force calibration of {found.file.array}", *in_words(found))))
    if as_json:
        click.echo(json.dumps(as_map(found), allow_nan=False))
    if plot is not None:
        from tactiled.plots.calibration import draw_calibration

        draw_calibration(plot, found.time_s, found.reference, found.left_out, found.sd, found.used, out.stem)


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


def in_words(found: CalibrationStudy) -> list[str]:
    """Return lines for people."""
    model = {"pairs": "physics of rubber and divider", "smooth": "ridge regression"}[found.model]
    clock = f"clock of the reference: {found.late_s:+.3f} s"
    if found.late_sd_s:
        clock += f" (± {found.late_sd_s:.3f} s)"
    return [
        f"{clock} and {found.drift_ppm:+.0f} ppm from that of the log",
        f"model: {model}, chosen in segments that were left out",
        *found.file.verdict,
    ]


def as_map(found: CalibrationStudy) -> dict[str, Any]:
    """Return a plain map for JSON; rms differences are those in segments that were left out."""
    rms, baseline = found.rms.tolist(), found.baseline.tolist()
    return {
        "name": found.file.name,
        "array": found.file.array,
        "model": found.model,
        "late_s": found.late_s,
        "late_sd_s": found.late_sd_s,
        "drift_ppm": found.drift_ppm,
        "seconds": float(found.time_s[-1] - found.time_s[0]),
        "rms": {COLUMNS[k]: rms[k] for k in found.used},
        "rms_of_ridge_with_squares": {COLUMNS[k]: baseline[k] for k in found.used},
        "range": found.file.range.model_dump(),
        "verdict": found.file.verdict,
    }
