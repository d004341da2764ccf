"""The verb that proposes a setting and the friction from a hold and a motion."""

from pathlib import Path
from typing import Any

import click

from tactiled.cli.options import BOARD, COLUMNS, FILE, JSON, KEYS, TIME_UNIT, TOPIC, need_named, need_readable
from tactiled.commands.calibration import RATE
from tactiled.progress import tell


@click.command()
@click.argument("endpoint", default="tcp://127.0.0.1:9872")
@click.option(
    "--quiet", type=FILE, help="File (recording, CSV, npz, bag) of an object held still, not a live hold."
)
@click.option("--motion", type=FILE, help="File of the object moved as in normal work, without slip.")
@click.option(
    "--reports-per-hour", "per_hour", default=60.0, show_default=True,
    type=click.FloatRange(0, 3600, min_open=True), help="Acceptable rate of slip reports without slip.",
)  # fmt: skip
@click.option(
    "--quiet-s", default=20.0, show_default=True, type=click.FloatRange(5, 3600), help="Duration of the hold."
)
@click.option(
    "--motion-s", default=30.0, show_default=True, type=click.FloatRange(5, 3600),
    help="Duration of the motion.",
)  # fmt: skip
@click.option(
    "--array", help="Array of a table or bag, or of a board whose array is not shipped: name or TOML file."
)
@COLUMNS
@TIME_UNIT
@RATE
@BOARD
@TOPIC
@JSON
@KEYS
def tune(
    endpoint: str,
    quiet: Path | None,
    motion: Path | None,
    per_hour: float,
    quiet_s: float,
    motion_s: float,
    array: str | None,
    board: str,
    as_json: bool,
    keys: Path | None,
    topic: str | None,
    **of_table: Any,
) -> None:
    """Count what each setting reports in your own hold and motion; propose a setting and the friction.

    Listens to a running daemon while you hold an object still, then move it without slip; or takes two files.
    Prints a report and TOML to stderr, and all numbers as one JSON line to stdout unless that is a terminal.

    Example: tactiled tune --quiet hold.mcap --motion carry.mcap
    """
    if (quiet is None) != (motion is None):
        raise click.UsageError("give both --quiet FILE and --motion FILE, or neither to record them now")
    need_readable(*(path for path in (quiet, motion) if path is not None and not path.is_dir()))
    need_named(array, "config/arrays")
    from tactiled.recording.table_times import TableOptions
    from tactiled.tune.recordings import read_pair, record_live
    from tactiled.tune.run import judge

    if quiet is not None and motion is not None:
        recordings = read_pair(quiet, motion, array, topic, TableOptions(**of_table))
    else:
        recordings = record_live(endpoint, quiet_s, motion_s, array, board, keys, tell)
    judge(*recordings, per_hour, as_json=as_json)
