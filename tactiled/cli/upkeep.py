"""Commands that set up a board and its array: configuration, diagnosis, keys."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tactiled import tomltext
from tactiled.cli.options import (
    COLUMNS,
    CONFIG,
    CONFIG_ENV,
    FILE,
    FILES,
    JSON,
    PORT,
    SPEED,
    TIME_UNIT,
    need_board,
    need_extra,
    need_named,
    need_toml,
)
from tactiled.cli.packages import OpenGroup
from tactiled.errors import DataError
from tactiled.plots import check_picture
from tactiled.progress import tell

if TYPE_CHECKING:
    from tactiled.array import Array
    from tactiled.recording.table_times import TableOptions, TimeUnit
    from tactiled.tomlfile import Params

_RATE_HZ = 100.0  # of the published board
FOLDER = click.option("--folder", type=click.Path(path_type=Path), default=Path("keys"), show_default=True)


@click.command("check-config")
@click.argument("files", type=FILES, nargs=-1, envvar=CONFIG_ENV, required=True)
@click.option("--plot", type=FILE, help="Draw the array into this picture (.png, .svg, .pdf).")
@click.option(
    "--rate",
    "rate_hz",
    type=click.FloatRange(0.1, 20_000),
    help="Scan rate (Hz), for what an array file can measure; that of the log, else 100.",
)
@click.option(
    "--speed", "speed_mm_s", type=SPEED, default=0.0, help="Sliding speed (mm/s), for the same; 0: unknown."
)  # fmt: skip
@click.option("--log", type=FILE, help="Table of the array: say how the file fits it.")
@COLUMNS
@TIME_UNIT
@JSON
def check_config(
    files: tuple[Path, ...],
    plot: Path | None,
    rate_hz: float | None,
    speed_mm_s: float,
    log: Path | None,
    columns: tuple[str, ...],
    time_unit: "TimeUnit | None",
    as_json: bool,
) -> None:
    """Check a configuration and the files it names without opening the port, or one file of another kind.

    Other kinds are array files, layout files and force calibrations. For an array, it is also said what it
    can measure: contact, slip, direction, and periods and angles of grooves. Of several configurations, or of
    those in a directory, it is also checked that one process can serve their boards, as `tactiled run` does.
    Says on stderr what is valid, and prints each file as a JSON line on stdout unless that is a terminal.

    Example: tactiled check-config /etc/tactiled/left.toml

    Example: tactiled check-config pad.toml --plot pad.png

    Example: tactiled check-config pad.toml --log log.csv
    """
    if log is None and (columns or time_unit):
        raise click.UsageError("--columns and --time-unit are of a log: give --log FILE")
    need_toml(*(path for path in files if not path.is_dir()))
    from tactiled.config import config_files, kind_of, load_configs

    paths = config_files(files)
    kinds = [kind_of(tomltext.read(path)) for path in paths]
    others = [str(path) for path, kind in zip(paths, kinds, strict=True) if kind != "configuration"]
    if len(paths) > 1 and others:
        raise click.UsageError(f"check arrays and layouts one by one: {', '.join(others)}")
    file, kind = paths[0], kinds[0]
    for option, value in (("--plot draws", plot), ("--log is compared with", log)):
        if value is not None and kind != "array":
            raise click.UsageError(f"{option} an array, and {file} is a {kind}")
    if plot is not None:
        need_extra("matplotlib", "plot", "check-config --plot")
        check_picture(plot)

    def show_valid(source: Path | str, words: str, checked: "Params") -> None:
        if as_json:
            click.echo(checked.model_dump_json())
        tell(f"{source}: valid ({words})")

    if kind == "layout":
        from tactiled.wire.layout import load_layout

        layout = load_layout(str(file.absolute()))
        scan = f"a scan has {layout.wire_bytes('scan')} bytes"
        words = f"layout {layout.name}: {layout.n_channels} channels, {layout.file.baud} baud, {scan}"
        show_valid(file, words, layout.file)
    elif kind == "array":
        from tactiled import tomlfile
        from tactiled.array import ArrayFile, build
        from tactiled.recording.table_times import TableOptions

        array_file = tomlfile.load(file, ArrayFile)
        array = build(array_file)
        show_valid(file, array.in_words(), array_file)
        if log is not None:
            found_hz = _tell_log_fit(array, log, TableOptions(rate_hz, columns, time_unit))
            rate_hz = rate_hz or found_hz
        _tell_abilities(array, rate_hz or _RATE_HZ, speed_mm_s, plot)
    elif kind == "calibration":
        from tactiled.force.calibration import load_calibration

        calibration = load_calibration(str(file.absolute()))
        show_valid(file, f"calibration {calibration.name} of {calibration.array}", calibration)
        tell("\n".join(calibration.verdict))
    else:
        from tactiled import compiled
        from tactiled.doctor.unplugged import check_files, resolved_in_words, settings_in_words

        for setup in load_configs(paths):
            warnings = check_files(setup, setup.source)
            show_valid(setup.source, f"{setup.array.name}, {setup.layout.name}", setup.config)
            for line in (
                *(f"warning: {warning}" for warning in warnings),
                *settings_in_words(setup),
                *resolved_in_words(setup),
            ):
                tell(line)
        tell(f"path of a scan: {compiled.path_words()}")


def _tell_log_fit(array: "Array", log: Path, options: "TableOptions") -> float:
    """Say how an array fits a log, and return the rate of the log (Hz)."""
    from tactiled.doctor.log_fit import log_fit
    from tactiled.recording.whole import read_table

    time_s, readings = read_table(log, options)
    if readings.shape[1] != array.n_channels:
        raise DataError(
            f"{log}: {readings.shape[1]} channels, but array {array.name} has {array.n_channels} "
            f"({array.n_taxels} taxels); choose columns with --columns"
        )
    found = log_fit(array, time_s, readings)
    tell("\n".join(each.line for each in found))
    return float(found[0].values["rate_hz"])


def _tell_abilities(array: "Array", rate_hz: float, speed_mm_s: float, plot: Path | None) -> None:
    """Say what an array can measure, and draw it where asked."""
    from tactiled.detect.grooves.params import JointParams
    from tactiled.doctor.abilities import abilities

    lines = [each.line for each in abilities(array, JointParams(), rate_hz, speed_mm_s)]
    tell("\n".join(lines))
    if plot is not None:
        from tactiled.plots.array_map import draw_array

        draw_array(plot, array, [f"at {rate_hz:g} scans a second:", *lines])
        tell(f"wrote {plot}")


@click.command()
@CONFIG
@PORT
@click.option(
    "--speed",
    "speed_mm_s",
    type=SPEED,
    default=0.0,
    help="Sliding speed (mm/s), to see whether grooves can be measured at it; 0: unknown.",
)
@click.option("--json", "json_lines", is_flag=True, help="Print one JSON line per check.")
def doctor(config: Path | None, port: str | None, speed_mm_s: float, json_lines: bool) -> None:
    """Check port, board, array, endpoints, keys and disk. Exit code 1 on failure.

    Each finding that is not good comes with a remedy.

    Example: tactiled doctor --config /etc/tactiled/left.toml
    """
    need_board(config, port, "check")
    from tactiled.doctor.examine import examine
    from tactiled.doctor.finding import as_json, as_text

    findings = examine(config, port, speed_mm_s)
    click.echo(as_json(findings) if json_lines else as_text(findings))
    sys.exit(int(any(finding.verdict == "fail" for finding in findings)))


@click.group(cls=OpenGroup, prefix="keys.")
def keys() -> None:
    """Manage keys of clients on other hosts: a folder for each daemon, or one for a zenoh network.

    Example: tactiled keys make left-gripper --folder /etc/tactiled/keys
    """


@keys.command("make")
@click.argument("name")
@FOLDER
@click.option("--out", type=FILE, help="Key file for the client; default: NAME.toml in this directory.")
def keys_make(name: str, folder: Path, out: Path | None) -> None:
    """Make the keys of a client, and of the daemon if it has none. Move the file to the client's host.

    Example: tactiled keys make left-gripper --folder /etc/tactiled/keys
    """
    from tactiled.daemon.zmq.security import KeyFolder

    carry = out or Path(f"{name}.toml")
    KeyFolder(folder).make(name, carry)
    click.echo(f"{carry}: for {name}, secret; {folder} lets it in", err=True)


@click.command()
@click.argument("name", required=False)
@PORT
@click.option("--array", help="Array file of a board whose array does not ship.")
@click.option(
    "--tcp-port",
    type=click.IntRange(1, 65534),
    help="Of its events; default: from 9872 on, the first free one.",
)
@click.option("--dry-run", is_flag=True, help="Print what would be written and run.")
@click.option("--remove", "removes", is_flag=True, help="Undo the setup of NAME.")
@click.option(
    "--root",
    type=click.Path(path_type=Path),
    default=Path("/"),
    help="Write below this folder, and run nothing.",
)
def setup(
    name: str | None,
    port: str | None,
    array: str | None,
    tcp_port: int | None,
    dry_run: bool,
    removes: bool,
    root: Path,
) -> None:
    """Find the board, and write configuration, unit, user and udev rule of its service.

    NAME is that of the instance, tactiled@NAME; by default the serial number of the adapter. Files that were
    edited are kept. A second call changes nothing.

    Example: sudo tactiled setup --dry-run
    """
    need_named(array, "config/arrays")
    from tactiled.setup.run import run_remove, run_setup

    if removes:
        if name is None:
            raise click.UsageError("--remove: say which NAME")
        run_remove(name, root)
        return
    sys.exit(run_setup(name, port, array, tcp_port, root, dry_run=dry_run))
