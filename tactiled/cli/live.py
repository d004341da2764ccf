"""Commands on a live board: run the daemon, print its messages, send it a request."""

import json
import logging
import sys
from pathlib import Path

import click

from tactiled.cli.options import CONFIG, FILE, KEYS, PORT, need_board, need_toml


@click.command()
@CONFIG
@PORT
@click.option("--record", "recording", type=FILE, help="Also record into this file (.mcap).")
@click.option("-v", "--verbose", is_flag=True, help="Log debug messages too.")
def run(config: Path | None, port: str | None, recording: Path | None, verbose: bool) -> None:
    """Read the board and publish events until stopped.

    Example: tactiled run --config /etc/tactiled/left.toml
    """
    need_board(config, port)
    need_toml(config)
    from tactiled.config import Setup, default_config, load_config
    from tactiled.daemon.operations.background import BackgroundWorker
    from tactiled.daemon.operations.log import set_up
    from tactiled.daemon.operations.recorder import Recorder
    from tactiled.daemon.service import ServiceParams, run_service

    def load() -> Setup:
        return default_config(port or "") if config is None else load_config(config, port)

    def again() -> ServiceParams:
        new = load().config
        for name in ("board", "samples", "detect"):
            if getattr(new, name) != getattr(setup.config, name):
                logging.getLogger("tactiled").warning("[%s] changed: takes effect at the next start", name)
        return new.service

    set_up(10 if verbose else 20)
    setup = load()
    with (
        BackgroundWorker() as worker,
        Recorder(setup.config.record, setup.recording_header(), recording) as recorder,
    ):
        code = run_service(
            setup.config.service,
            setup.make_pipeline(worker),
            setup.layout,
            setup.array,
            None if config is None else again,
            recorder,
        )
    sys.exit(code)


@click.command()
@click.argument("endpoint", default="tcp://127.0.0.1:9872")
@click.option("-t", "--topic", "topics", multiple=True, help="slip, texture, contact, scan, status, ...")
@click.option("-n", "--count", type=click.IntRange(1), help="Stop after this many messages.")
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(0),
    help="Stop after so many seconds; exit code 1 if no message came.",
)
@KEYS
def listen(
    endpoint: str, topics: tuple[str, ...], count: int | None, timeout_s: float | None, keys: Path | None
) -> None:
    """Print the messages of a daemon, one JSON line per message.

    Example: tactiled listen --topic slip --topic texture
    """
    from tactiled.client.listen import listen as run_listener
    from tactiled.events.types import EVENT_TYPES

    if strangers := sorted(set(topics) - set(EVENT_TYPES)):
        raise click.UsageError(f"no topic {', '.join(strangers)}; there are: {', '.join(EVENT_TYPES)}")
    sys.exit(run_listener(endpoint, topics, count=count, timeout_s=timeout_s, keys=keys))


@click.command()
@click.argument("name")
@click.argument("fields", nargs=-1, metavar="[FIELD=VALUE]...")
@click.option(
    "--endpoint", help="Endpoint where the daemon publishes. [default: ipc of the only daemon on this host]"
)
@click.option(
    "--who", default="command line", show_default=True, help="Name of the requester, for log and recording."
)
@KEYS
def command(name: str, fields: tuple[str, ...], endpoint: str | None, who: str, keys: Path | None) -> None:
    """Send a request to a running daemon and print its reply as JSON; exit code 1 if it is refused.

    NAME is tare, speed, inhibit, expect-load-change, thresholds, rate, record, mark or state; for
    the fields see protocols/control.md.

    Example: tactiled command thresholds slip.false_alarms_per_hour=0.5
    """
    from tactiled.client.commander import Commander, fields_of

    arguments = fields_of(name, fields)
    with Commander(endpoint, who, keys=keys) as daemon:
        reply = daemon.send(name, **arguments)
    click.echo(json.dumps(reply.data))
    if not reply.ok:
        click.echo(f"{name}: {reply.reason}", err=True)
    sys.exit(0 if reply.ok else 1)
