"""Commands that need no hardware: the emulated board, the demo on it, and the material of its skin."""

import json
import sys
from pathlib import Path
from typing import Any

import click

from tactiled.cli.options import FILE, need_extra, need_named, need_toml
from tactiled.cli.packages import find
from tactiled.errors import ConfigError


@click.command()
@click.option("--out", type=FILE, default=Path("demo.png"), show_default=True, help="Picture of the slips.")
@click.option("--web", "page", is_flag=True, help="Show the live page instead, until Ctrl-C.")
@click.option("--port", default=8765, show_default=True, type=click.IntRange(0, 65535), help="Of the page.")
@click.option("--no-browser", is_flag=True, help="With --web: only print the address.")
def demo(out: Path, page: bool, port: int, no_browser: bool) -> None:
    """Run board emulator, daemon and subscriber for half a minute; print a table and write two pictures.

    One shows the slips; the other, with -log at the end of its name, all that was read and found. The
    exit code is 1 if an estimate is wrong or missing, or if this host is too slow for the test.

    Example: tactiled demo --out /tmp/demo.png
    """
    if page:
        find("web", "the page")
        from tactiled.demo.play import run_page_demo

        run_page_demo(port, opens=not no_browser)
        return
    need_extra("matplotlib", "plot", "the picture of the demo")
    from tactiled.demo.play import run_demo

    sys.exit(0 if run_demo(out) else 1)


@click.command()
@click.option(
    "-s", "--scene", default="demo", show_default=True,
    help="Shipped scene, TOML file, or hold-SEED.",
)  # fmt: skip
@click.option("--link", type=FILE, help="Name under which the emulated serial port appears.")
@click.option("--tcp", help="Listen on host:port instead; the daemon connects to socket://host:port.")
@click.option(
    "--layout", "--protocol", "protocol", default="board-v1", show_default=True,
    help="Shipped layout of the frames, or TOML file.",
)  # fmt: skip
@click.option("--array", help="Shipped array or TOML file. [default: that of the scene or of the layout]")
@click.option("--board", type=FILE, help="TOML file of the board: serial number, rate, crystal, ...")
@click.option("--faults", type=FILE, help="TOML file of the faults on the serial line.")
@click.option(
    "--seed", default=0, show_default=True, type=click.IntRange(0), help="Random seed of the faults."
)
@click.option("--scans", is_flag=True, help="Report the true instant of each scan.")
@click.option("--control", help="Accept grip commands of a controller at unix:///PATH.")
@click.option(
    "--rig",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write log and reference of a calibration on an emulated rig, drawn by --seed, into this folder.",
)
@click.option(
    "--rig-s", default=60.0, show_default=True, type=click.FloatRange(5, 3600), help="Its duration."
)
def emulate(
    scene: str,
    link: Path | None,
    tcp: str | None,
    protocol: str,
    array: str | None,
    board: Path | None,
    faults: Path | None,
    seed: int,
    scans: bool,
    control: str | None,
    rig: Path | None,
    rig_s: float,
) -> None:
    """Emulate a board: play a scene on a pty or TCP port, and print its ground truth to stdout.

    An unknown scene name prints all known names. hold-7 is the random grasp of seed 7.

    Example: tactiled emulate --scene demo --link /tmp/board

    Example: tactiled emulate --rig /tmp/rig
    """
    if rig is not None:
        _write_rig(rig, array or "wang2019-3x3", seed, rig_s)
        return
    if (link is None) == (tcp is None):
        raise click.UsageError("give either --link NAME or --tcp HOST:PORT")
    need_named(protocol, "protocols")
    if array is not None:
        need_named(array, "config/arrays")
    need_toml(board, faults, Path(scene) if scene.endswith(".toml") else None)
    from tactiled import tomlfile
    from tactiled.emulator.board.identity import EmulatedBoardParams
    from tactiled.emulator.line.faults import FaultParams
    from tactiled.emulator.line.links import PtyLink, make_control_link, make_tcp_link
    from tactiled.emulator.realtime import Emulator
    from tactiled.emulator.scene.named import named_scene
    from tactiled.wire.layout import load_layout

    played = named_scene(scene)
    if array is not None:
        played = played.model_copy(update={"array": array})

    def report(what: dict[str, Any]) -> None:
        print(json.dumps(what), flush=True)
        if what["what"] == "behind":
            late = f"the board is {what['behind_s']:.1f} s late"
            click.echo(f"emulate: the host is too slow for this scene: {late}", err=True)
        elif what["what"] == "preparing":
            played_s, duration_s = what["played_s"], what["duration_s"]
            done = f"{played_s:.1f} of {duration_s:.1f} s of the scene"
            click.echo(f"emulate: solving grooves before the port appears: {done}", err=True)

    Emulator(
        played,
        load_layout(protocol),
        make_tcp_link(tcp or "") if link is None else PtyLink(link),
        board=None if board is None else tomlfile.load(board, EmulatedBoardParams),
        faults=None if faults is None else tomlfile.load(faults, FaultParams),
        seed=seed,
        report=report,
        with_scans=scans,
        control=None if control is None else make_control_link(control),
    ).run_until_signal()


def _write_rig(folder: Path, array: str, seed: int, seconds: float) -> None:
    """Write the files of an emulated calibration, and print their names."""
    need_named(array, "config/arrays")
    from tactiled.array import load_array
    from tactiled.emulator.rig.session import write_rig

    try:
        written = write_rig(folder, load_array(array), seed, seconds)
    except OSError as error:
        fault = f"{folder}: {error.strerror or error}; name a folder that can be written"
        raise ConfigError("--rig", [fault]) from None
    for path in written:
        click.echo(path)
