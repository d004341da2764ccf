"""Force calibration of an array against a force sensor."""

import json
import sys
from pathlib import Path
from typing import Any

import click

from tactiled.cli.options import (
    COLUMNS,
    FILE,
    JSON,
    KEYS,
    TIME_UNIT,
    TOPIC,
    need_extra,
    need_named,
    need_readable,
)
from tactiled.plots import check_picture
from tactiled.progress import tell

RATE = click.option(
    "--rate", "rate_hz", type=click.FloatRange(min=0, min_open=True),
    help="Scans a second of a table without times.",
)  # fmt: skip


@click.command()
@click.argument("log", type=FILE)
@click.option(
    "--reference", type=FILE,
    help="CSV of the force sensor: times, any of fx_n, fy_n, fz_n, tx_nmm, ty_nmm, tz_nmm.",
)  # fmt: skip
@click.option("-o", "--out", type=FILE, help="Calibration file to write (.toml).")
@click.option("--array", help="Array of a table: shipped name or TOML file. A recording contains its array.")
@click.option("--board", default="", help="Serial number of the board, for the file and for --guide.")
@COLUMNS
@TIME_UNIT
@RATE
@click.option(
    "--same-clock", "is_same_clock", is_flag=True, help="Times of LOG and reference are of one clock."
)
@click.option(
    "--poses", "are_poses", is_flag=True,
    help="LOG and reference are static poses in any order; time_s is the number of the pose in both.",
)  # fmt: skip
@TOPIC
@click.option("--plot", type=FILE, help="Write a picture of the fit.")
@click.option(
    "--guide", is_flag=False, flag_value="tcp://127.0.0.1:9872", metavar="[ENDPOINT]",
    help="Record LOG (.npz) from a running daemon, and say which way to press next.",
)  # fmt: skip
@click.option(
    "--guide-s", default=180.0, show_default=True, type=click.FloatRange(5, 3600), help="Longest recording."
)
@JSON
@KEYS
def calibrate(
    log: Path,
    reference: Path | None,
    out: Path | None,
    array: str | None,
    plot: Path | None,
    guide: str | None,
    guide_s: float,
    keys: Path | None,
    topic: str | None,
    columns: tuple[str, ...],
    time_unit: Any,
    rate_hz: float | None,
    **about: Any,
) -> None:
    """Fit newtons to the readings of LOG with the record of a force sensor.

    LOG is a recording, a CSV or npz file or a bag of somebody who presses the array, and pushes it sideways,
    for a minute. The clocks of both files may differ by up to 5 s, or by more if both begin within 5 s of
    each other. The verdict says what is known how well, and which motion to add; its numbers are one JSON
    line on stdout unless that is a terminal. With --guide, LOG is recorded first; the exit code is 1 if a
    motion is lacking.

    Example: tactiled calibrate log.npz --reference ft.csv -o mine.toml --plot mine.png
    """
    need_named(array, "config/arrays")
    if guide is not None:
        from tactiled.calibrate.guide import record_guided

        found = record_guided(log, guide, array, keys, guide_s, tell, about["board"])
        if about["as_json"]:
            click.echo(json.dumps(found._asdict()))
        sys.exit(1 if found.lacking else 0)
    if reference is None or out is None:
        raise click.UsageError("give --reference FILE and -o FILE, or --guide to record LOG first")
    need_readable(*(path for path in (log, reference) if not path.is_dir()))
    if plot is not None:
        need_extra("matplotlib", "plot", "calibrate --plot")
        check_picture(plot)
    from tactiled.calibrate.run import calibrate_files
    from tactiled.recording.table_times import TableOptions

    # Numbers of poses are no times, and a table without them has a pose in each row.
    table = TableOptions(rate_hz or (1.0 if about["are_poses"] else None), columns, time_unit)
    calibrate_files(log, reference, out, array, topic, table, plot=plot, **about)
