"""Commands on a live board: run the daemon, print its messages, send it a request."""

import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tactiled.cli.options import BOARD, CONFIGS, FILE, JSON, KEYS, PORT, need_board, need_named, need_toml

if TYPE_CHECKING:
    from tactiled.config import Setup
    from tactiled.daemon.runner import ServedBoard


@click.command()
@CONFIGS
@PORT
@click.option("--record", "recording", type=FILE, help="Also record into this file (.mcap); for one board.")
@click.option("-v", "--verbose", is_flag=True, help="Log debug messages too.")
def run(configs: tuple[Path, ...], port: str | None, recording: Path | None, verbose: bool) -> None:
    """Read one or several boards and publish events until stopped.

    Several boards share one process, its sockets and its metrics page; each has a configuration of its own.

    Example: tactiled run --config /etc/tactiled/left.toml --config /etc/tactiled/right.toml
    """
    need_board(configs[0] if configs else None, port)
    need_toml(*(path for path in configs if not path.is_dir()))
    from tactiled.config import config_files, default_config, load_configs
    from tactiled.daemon.operations.log import set_up

    set_up(10 if verbose else 20)
    files = config_files(configs)
    if len(files) > 1 and port is not None:
        raise click.UsageError(f"--port is for one board, and there are {len(files)} configurations")
    if len(files) > 1 and recording is not None:
        raise click.UsageError("--record is for one board: set record.directory in each configuration")

    serve(load_configs(files, port) if files else [default_config(port or "")], recording)


def serve(
    setups: Sequence["Setup"],
    recording: Path | None,
    duration_s: float | None = None,
    *,
    only_records: bool = False,
) -> list["ServedBoard"]:
    """Run the daemon for some boards until it is stopped; return the boards.

    With `only_records`, it is an error (`DataError`) if the recording cannot be begun.
    """
    from tactiled.daemon.operations.background import BackgroundWorker
    from tactiled.daemon.operations.recorder import Recorder
    from tactiled.daemon.runner import ServedBoard
    from tactiled.daemon.service import run_service
    from tactiled.detect.grooves import window_fits

    with ExitStack() as stack:
        worker = stack.enter_context(BackgroundWorker(window_fits.load))
        boards = [
            ServedBoard(
                setup.config,
                setup.make_pipeline(worker.of_board()),
                stack.enter_context(Recorder(setup.config.record, setup.recording_header(), recording)),
            )
            for setup in setups
        ]
        try:
            if only_records:
                boards[0].recorder.check()
            run_service(boards, duration_s)
        finally:
            for board in boards:  # the files of all boards end at the same time
                board.recorder.finish()
    return boards


@click.command()
@click.argument("endpoint", default="tcp://127.0.0.1:9872")
@click.option("-t", "--topic", "topics", multiple=True, help="slip, texture, contact, scan, status, ...")
@click.option("-n", "--count", type=click.IntRange(1), help="Stop after this many lines.")
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(0),
    help="Stop after so many seconds; exit code 1 if no message came.",
)
@JSON
@KEYS
def listen(
    endpoint: str,
    topics: tuple[str, ...],
    count: int | None,
    timeout_s: float | None,
    as_json: bool,
    keys: Path | None,
) -> None:
    """Print the messages of a daemon, one line per message.

    In a terminal the lines are for people: slip, contact, texture and commands, and grip each second and when
    its state changes; other topics where --topic asks for them. Into a pipe or a file, or with --json, every
    message is one JSON line.

    Example: tactiled listen --topic slip --topic texture
    """
    from tactiled.client.listen import listen as run_listener

    sys.exit(run_listener(endpoint, topics, count=count, timeout_s=timeout_s, keys=keys, as_json=as_json))


@click.command()
@click.argument("name")
@click.argument("fields", nargs=-1, metavar="[FIELD=VALUE]...")
@click.option(
    "--endpoint", help="Endpoint where the daemon publishes. [default: ipc of the only daemon on this host]"
)
@BOARD
@KEYS
def command(name: str, fields: tuple[str, ...], endpoint: str | None, board: str, keys: Path | None) -> None:
    """Send a request to a running daemon and print its reply as JSON; exit code 1 if it is refused.

    NAME is tare, speed, friction, object-changed, motion, inhibit, expect-load-change, thresholds,
    record, mark or state; for the fields see protocols/control.md.

    Example: tactiled command thresholds grip.incipient_p=0.5
    """
    from tactiled.client.commander import Commander, fields_of

    arguments = fields_of(name, fields)
    if board:
        arguments["board"] = board
    with Commander(endpoint, "command line", keys=keys) as daemon:
        reply = daemon.send(name, **arguments)
    click.echo(json.dumps(reply.data))
    if not reply.ok:
        click.echo(f"{name}: {reply.reason}", err=True)
    sys.exit(0 if reply.ok else 1)


@click.command()
@click.argument("endpoint", default="tcp://127.0.0.1:9872")
@click.option("--array", help="Array file of a board whose array does not ship.")
@KEYS
def top(endpoint: str, array: str | None, keys: Path | None) -> None:
    """Show boards live in a terminal: freshness, array, rates, events, keys for commands.

    A cell is a taxel: colour and number are its load, the arrow is the way in which the skin is pushed; a dot
    is a touch, ! a slip. Keys i and e suppress slips for 0.5 s (inhibit, expect-load-change). Commands need
    ipc, or --keys: give the daemon's ipc endpoint.

    Example: tactiled top ipc:///run/tactiled/left/events.ipc
    """
    need_named(array, "config/arrays")
    from tactiled.array import load_array
    from tactiled.top.run import run_top

    run_top(endpoint, None if array is None else load_array(array), keys)
