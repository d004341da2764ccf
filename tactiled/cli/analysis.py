"""Commands on the user's own data: detect events in a file, and tune slip parameters."""

from pathlib import Path

import click

from tactiled.cli.options import FILE, KEYS, SPEED, need_extra, need_named, need_readable
from tactiled.progress import ProgressBar


@click.command()
@click.argument("file", type=FILE)
@click.option("--array", help="Array of the log: shipped name or TOML file. A recording contains its array.")
@click.option(
    "--rate", "rate_hz", type=click.FloatRange(0, min_open=True), help="Scans per second; required below 10."
)
@click.option("--speed", "speed_mm_s", type=SPEED, help="Sliding speed (mm/s), for texture.")
@click.option("--setting", help="Named set of detectors; wang2019: the published methods.")
@click.option(
    "--grip-hz",
    default=10.0,
    show_default=True,
    type=click.FloatRange(0, 1000),
    help="Grip lines a second of contact, besides changes of state; 0 for none.",
)
@click.option("--plot", type=FILE, help="Write a picture of the log and the events.")
def detect(
    file: Path,
    array: str | None,
    rate_hz: float | None,
    speed_mm_s: float | None,
    setting: str | None,
    grip_hz: float,
    plot: Path | None,
) -> None:
    """Find slip, contact, grip and texture in a recording, a CSV or an npz file.

    CSV: a header with `time_s` in seconds, then one column of volts per channel in channel order. Every event
    is one JSON line on stdout, with times in the file's own clock. Late scans of a recording are used like
    others; `tactiled replay` reproduces the live events.

    Example: tactiled detect log.csv --array xyz-two-pads-4x4 --speed 5 --plot log.png
    """
    need_readable(file)
    need_named(array, "config/arrays")
    if plot is not None:
        need_extra("matplotlib", "plot", "detect --plot")
    from tactiled.offline import detect_file

    with ProgressBar(f"detect {file}", writes_lines=True) as bar:
        found = detect_file(file, array, rate_hz, speed_mm_s, setting, plot, bar.reach, grip_hz)
    click.echo(f"{file}: {found} events", err=True)


@click.command()
@click.argument("endpoint", default="tcp://127.0.0.1:9872")
@click.option(
    "--quiet", type=FILE, help="File (recording, CSV, npz) of an object held still, instead of a live hold."
)
@click.option("--motion", type=FILE, help="File of the object moved as in normal work, without slip.")
@click.option(
    "--false-alarms-per-hour", "per_hour", default=1.0, show_default=True,
    type=click.FloatRange(0, 3600, min_open=True), help="Acceptable rate of false alarms.",
)  # fmt: skip
@click.option(
    "--quiet-s", default=20.0, show_default=True, type=click.FloatRange(5, 3600), help="Duration of the hold."
)
@click.option(
    "--motion-s",
    default=30.0,
    show_default=True,
    type=click.FloatRange(5, 14_400),
    help="Duration of the motion.",
)
@click.option(
    "--array", help="Array of a table, or of a board whose array is not shipped: name or TOML file."
)
@KEYS
def tune(
    endpoint: str,
    quiet: Path | None,
    motion: Path | None,
    per_hour: float,
    quiet_s: float,
    motion_s: float,
    array: str | None,
    keys: Path | None,
) -> None:
    """Propose slip parameters from your own noise and motion, with false alarms and latency of each setting.

    Listens to a running daemon while you hold an object still, then move it without slip; or takes two files.
    Prints a report and TOML to stderr, and all numbers as one JSON line to stdout.

    Example: tactiled tune --quiet hold.mcap --motion carry.mcap
    """
    if (quiet is None) != (motion is None):
        raise click.UsageError("say both --quiet FILE and --motion FILE, or neither to record them now")
    need_readable(quiet, motion)
    need_named(array, "config/arrays")
    from tactiled.tune.run import tune_files, tune_live

    if quiet is not None and motion is not None:
        tune_files(quiet, motion, array, per_hour)
    else:
        tune_live(endpoint, quiet_s, motion_s, array, keys, per_hour)
