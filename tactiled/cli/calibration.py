"""Force calibration of an array against a force sensor."""

from pathlib import Path
from typing import Any

import click

from tactiled.cli.options import FILE, need_extra, need_named, need_readable


@click.command()
@click.argument("log", type=FILE)
@click.option(
    "--reference", required=True, type=FILE,
    help="CSV of the force sensor: time_s, any of fx_n, fy_n, fz_n, tx_nmm, ty_nmm, tz_nmm, and taxel.",
)  # fmt: skip
@click.option("-o", "--out", required=True, type=FILE, help="Calibration file to write (.toml).")
@click.option("--array", help="Array of a table: shipped name or TOML file. A recording contains its array.")
@click.option("--board", default="", help="Serial number of the board, for the file.")
@click.option("--temperature-c", type=float, help="Temperature of the room, for the file.")
@click.option("--columns", metavar="NAMES", help="Columns of a CSV in channel order, as for `detect`.")
@click.option("--time-unit", type=click.Choice(["s", "ms", "us", "ns"]), help="Unit of the times in a table.")
@click.option("--plot", type=FILE, help="Write a picture of the fit.")
def calibrate(
    log: Path,
    reference: Path,
    out: Path,
    array: str | None,
    columns: str | None,
    plot: Path | None,
    **about: Any,
) -> None:
    """Fit newtons to the readings of LOG with the record of a force sensor.

    LOG is a recording, a CSV or an npz file of somebody who presses the array, and pushes it sideways, for a
    minute. The clocks of both files may differ by up to 5 s. The verdict says what is known how well, and
    which motion to add.

    Example: tactiled calibrate log.npz --reference ft.csv -o mine.toml --plot mine.png
    """
    need_readable(log, reference)
    need_named(array, "config/arrays")
    if plot is not None:
        need_extra("matplotlib", "plot", "calibrate --plot")
    from tactiled.calibrate.run import calibrate_files

    names = tuple(name.strip() for name in columns.split(",")) if columns else ()
    calibrate_files(log, reference, out, array, columns=names, plot=plot, **about)
