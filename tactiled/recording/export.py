"""Export of recordings to CSV or npz; `tactiled detect` reads both formats.

Scans are decoded from the recorded bytes. Times are those of the recording (host monotonic seconds); a
missing scan is a missing row.
"""

import contextlib
import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from tactiled.errors import DataError
from tactiled.events.types import ScanEvent
from tactiled.recording.reader import Reached
from tactiled.recording.steps import Replay


def export_csv(paths: Sequence[Path], out: Path, reached: Reached | None = None) -> int:
    """Write a CSV table of ``time_s`` and one column of volts per channel; every number reads back exactly.

    A reading that is not valid (saturated, reference fault) is an empty cell.

    Parameters
    ----------
    paths : sequence of Path
        One recording, or consecutive parts.
    reached : callable, optional
        Called with the completed fraction, 0 to 1.

    Returns
    -------
    int
        Scans written.

    Raises
    ------
    DataError
        A file is not a recording or holds no scans, or `out` exists or cannot be written.
    """
    replay = Replay(paths, reached)
    n_scans = 0
    with _new_file(out), out.open("x", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["time_s", *replay.header.source.array.channel_name])
        for scan, _ in _scans(replay):
            cells = (repr(v) if good else "" for v, good in zip(scan.volts, scan.valid, strict=True))
            table.writerow([repr(scan.time_s), *cells])
            n_scans += 1
    return n_scans


def export_npz(paths: Sequence[Path], out: Path, reached: Reached | None = None) -> int:
    """Write the scans as numpy arrays; parameters, result and errors as for `export_csv`.

    Arrays: ``time_s``, ``time_sd_s``, ``unix_offset_s``, ``index``, ``late`` (n,), ``volts`` and ``valid``
    (n, channels), ``channel_name`` (channels,). ``time_s + unix_offset_s`` is epoch time. Invalid readings
    keep their value.
    """
    replay = Replay(paths, reached)
    names = np.array(replay.header.source.array.channel_name)
    columns: dict[str, list[object]] = {
        name: [] for name in ("time_s", "time_sd_s", "unix_offset_s", "index", "late", "volts", "valid")
    }
    for scan, unix_offset_s in _scans(replay):
        columns["unix_offset_s"].append(unix_offset_s)
        columns["volts"].append(np.array(scan.volts))
        columns["valid"].append(np.array(scan.valid))
        for name in ("time_s", "time_sd_s", "index", "late"):
            columns[name].append(getattr(scan, name))
    arrays = {name: np.array(values) for name, values in columns.items()}
    with _new_file(out), out.open("xb") as stream:
        np.savez_compressed(stream, allow_pickle=False, channel_name=names, **arrays)
    return len(columns["time_s"])


def _scans(replay: Replay) -> Iterator[tuple[ScanEvent, float]]:
    """Yield scans with their epoch offsets; `DataError` when there are none."""
    is_empty = True
    for step in replay:
        for recorded in step.now:
            if isinstance(recorded.event, ScanEvent):
                is_empty = False
                yield recorded.event, recorded.unix_offset_s
    if is_empty:
        raise DataError(
            "the recording contains no scans; check that the board was started and that its hello arrived"
        )


@contextlib.contextmanager
def _new_file(out: Path) -> Iterator[None]:
    """Refuse an existing file, report write errors as `DataError`, and remove a partly written file."""
    if out.exists():
        raise DataError(f"{out}: exists already; choose another name or move it away")
    try:
        yield
    except BaseException as error:
        out.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise DataError(f"{out}: cannot be written: {error.strerror}") from None
        raise
