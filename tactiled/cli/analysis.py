"""Commands on the user's own data: detect events in a file, and tune the slip detector."""

import gc
from pathlib import Path
from typing import Any

import click

from tactiled.cli import packages
from tactiled.cli.options import (
    COLUMNS,
    FILE,
    JSON,
    SPEED,
    TIME_UNIT,
    TOPIC,
    Names,
    need_extra,
    need_named,
    need_readable,
    need_toml,
)
from tactiled.progress import ProgressBar, tell

_TOPICS = ("slip", "contact", "grip", "texture", "force")


class Interval(click.ParamType[tuple[float, float]]):
    """Two numbers with a colon between, as in 0.5:3; either may be left out where `open_ends` says so."""

    name = "FROM:TO"

    def __init__(self, *, open_ends: bool) -> None:
        self._open_ends = open_ends

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        """Return both numbers; an end that is left out is infinite."""
        if isinstance(value, tuple):
            return value
        ends = str(value).split(":")
        if len(ends) != 2 or not (self._open_ends or all(ends)):
            self.fail(f"{value!r} is not two numbers with a colon between, as in 0.5:3", param, ctx)
        try:
            low, high = float(ends[0] or "-inf"), float(ends[1] or "inf")
        except ValueError:
            self.fail(f"{value!r} is not two numbers with a colon between, as in 0.5:3", param, ctx)
        if not low < high:
            self.fail(f"{value!r}: the second number must be larger than the first", param, ctx)
        return low, high


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option("--array", help="Array of the log: shipped name or TOML file. A recording contains its array.")
@click.option(
    "--layout",
    help="Read the bytes of a recording with this layout: shipped name or TOML file, with its array.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=click.FloatRange(0, min_open=True),
    help="Scans per second; required below 10, and where the log has no times.",
)
@click.option("--speed", "speed_mm_s", type=SPEED, help="Sliding speed (mm/s), for texture.")
@click.option(
    "--direction",
    "direction_deg",
    type=click.FloatRange(-180, 180),
    help="Direction of the skin's motion (degrees from +x towards +y), for texture.",
)
@click.option(
    "--sliding",
    is_flag=False,
    flag_value=":",
    type=Interval(open_ends=True),
    metavar="[FROM:TO]",
    help="The log, or this part of it (seconds), is known to slide: texture needs no slip event.",
)
@click.option(
    "--period",
    "period_mm",
    type=Interval(open_ends=False),
    metavar="MIN:MAX",
    help="Groove periods to consider (mm).",
)
@click.option(
    "--max-tilt",
    "max_tilt_deg",
    type=click.FloatRange(0, 90, min_open=True, max_open=True),
    help="Largest angle from groove normal to motion (degrees).",
)
@click.option("--setting", help="Named set of detectors; wang2019: the published methods.")
@click.option(
    "--grip-hz",
    default=10.0,
    show_default=True,
    type=click.FloatRange(0, 1000),
    help="Grip lines a second of contact, besides changes of state; 0 for none. In a terminal one at most.",
)
@click.option(
    "--calibration",
    help="Force calibration: file of `tactiled calibrate`, or shipped name; prints force lines.",
)
@click.option(
    "--force-hz",
    default=10.0,
    show_default=True,
    type=click.FloatRange(0, 10_000),
    help="Force lines a second, with --calibration; 0 for none. In a terminal one at most.",
)
@click.option("-c", "--config", type=FILE, help="File whose [detect] tables hold parameters, as of a daemon.")
@click.option(
    "--tare-s", type=click.FloatRange(0, 60, min_open=True), help="Take the first seconds of the log as zero."
)
@click.option(
    "--only",
    "topics",
    type=Names("topic", _TOPICS),
    metavar="TOPICS",
    help="slip, contact, grip, texture, force: the topics to compute and print, with commas between.",
)
@COLUMNS
@TOPIC
@TIME_UNIT
@click.option("--plot", type=FILE, help="Write a picture of the log and the events.")
@click.option(
    "--to",
    type=FILE,
    metavar="TABLE.parquet",
    help="Analyse many files, and write all events into one table.",
)
@click.option("--jobs", type=click.IntRange(1), help="With --to: files at a time. [default: number of cores]")
@JSON
def detect(
    files: tuple[str, ...],
    array: str | None,
    rate_hz: float | None,
    sliding: tuple[float, float] | None,
    topics: tuple[str, ...] | None,
    plot: Path | None,
    to: Path | None,
    jobs: int | None,
    as_json: bool,
    **choices: Any,
) -> None:
    """Find slip, contact, grip, texture and force in a recording, a table or a bag of ROS.

    Tables (.csv, .tsv, .txt, .npz): a header with `time_s` in seconds, then one column per channel in
    channel order, in the unit that the array file states. Bags: the folder of a rosbag2, or a file .mcap,
    .db3 or .bag. Every event is one line on stdout, in a terminal words, else JSON, with times in the
    file's own clock. Late scans of a recording are used like others; `tactiled replay` reproduces the live
    events.

    With --to, FILE may be many files or patterns ('runs/**/*.mcap'), analysed on all cores. A file that
    cannot be read is a row with its error.

    Example: tactiled detect log.csv --array mine.toml --tare-s 0.3 --sliding 2:9 --speed 5
    """
    if to is None and (len(files) > 1 or jobs):
        raise click.UsageError("give --to TABLE.parquet for many files or --jobs; or give one FILE")
    file = Path(files[0])
    if to is None and not file.is_dir():  # of a rosbag2
        need_readable(file)
    need_named(array, "config/arrays")
    need_named(choices["layout"], "protocols")
    need_named(choices["calibration"], "config/calibration")
    need_toml(choices["config"])
    if plot is not None:
        need_extra("matplotlib", "plot", "detect --plot")
    if to is not None:
        need_table(to, plot)
    from tactiled.detect.signal.slip_gate import KnownSliding
    from tactiled.offline import Choices, detect_file

    gc.freeze()  # a full collection of the objects of all modules takes as long as 10 s of a file
    asked = Choices(
        sliding=None if sliding is None else KnownSliding(*sliding),
        topics=topics or _TOPICS,
        **choices,
    )
    if to is not None:
        detect_patterns = packages.find("detect.files", "detect --to").load()
        outcome = detect_patterns(files, to, array, rate_hz, asked, jobs)
        for name, error in outcome.failed:
            click.echo(error if error.startswith(name) else f"{name}: {error}", err=True)
        click.echo(outcome.words(to), err=True)
        return
    with ProgressBar(f"detect {file}", writes_lines=True) as bar:
        log = detect_file(file, array, rate_hz, asked, plot, bar.reach, as_json=as_json)
    n_events = f"{log.n_events} events"
    if log.n_printed < log.n_events:
        n_events += f", {log.n_printed} of them shown; all with --json"
    for line in (*asked.summary(log), n_events):
        tell(f"{file}: {line}")


def need_table(to: Path, plot: Path | None) -> None:
    """Refuse a table that cannot be written, and what a run over many files cannot do."""
    if plot is not None:
        raise click.UsageError("--plot draws one file; leave out --to")
    if to.suffix != ".parquet" or not to.absolute().parent.is_dir():
        raise click.BadParameter(f"{to}: name a .parquet in a folder that exists", param_hint="--to")
    packages.find("detect.files", "detect --to")
    need_extra("pyarrow", "parquet", "detect --to")
