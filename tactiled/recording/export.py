"""Export of recordings to CSV, which `tactiled detect` reads.

Scans are decoded from the recorded bytes. Times are those of the recording (host monotonic seconds); a
missing scan is a missing row.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

from tactiled.errors import DataError
from tactiled.events.types import ScanEvent
from tactiled.recording.reader import Reached
from tactiled.recording.steps import Replay


def export_csv(paths: Sequence[Path], out: Path, reached: Reached | None = None) -> int:
    """Write a CSV table of ``time_s`` and one column of volts per channel; every number reads back exactly.

    A reading that is not valid (saturated, reference fault) is an empty cell. Returns the number of scans.
    `DataError` if a file holds no scans, or `out` exists or cannot be written.
    """
    if out.exists():
        raise DataError(f"{out}: exists already; choose another name or move it away")
    replay = Replay(paths, reached)
    n_scans = 0
    try:
        with out.open("x", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream, lineterminator="\n")
            table.writerow(["time_s", *replay.header.source.array.channel_name])
            for scan in (recorded.event for step in replay for recorded in step.now):
                if isinstance(scan, ScanEvent):
                    cells = (repr(v) if good else "" for v, good in zip(scan.volts, scan.valid, strict=True))
                    table.writerow([repr(scan.time_s), *cells])
                    n_scans += 1
    except BaseException as error:
        out.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise DataError(f"{out}: cannot be written: {error.strerror}") from None
        raise
    if not n_scans:
        out.unlink()
        raise DataError(
            "the recording contains no scans; check that the board was started and that its hello arrived"
        )
    return n_scans
