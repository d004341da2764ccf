"""Commands for many robots: the bridge to zenoh, the list of the boards of a network, their certificates."""

import json
import logging
import signal
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TextIO

import click

from tactiled.cli.options import FILE, KEYS, need_extra

_ENDPOINT = "tcp://127.0.0.1:9872"


@click.command("zenoh")
@click.option(
    "-e", "--events", "endpoint", default=_ENDPOINT, show_default=True, metavar="ENDPOINT",
    help="Endpoint of the daemon's events.",
)  # fmt: skip
@click.option("-c", "--config", type=FILE, help="Configuration of zenoh (JSON5), with its certificates.")
@click.option(
    "--connect", multiple=True, metavar="LOCATOR",
    help="Router of zenoh, such as tls/router:7447; may be repeated. [default: tcp/127.0.0.1:7447]",
)  # fmt: skip
@click.option("--host", help="Name in the keys tactile/NAME/...; default: that of this host.")
@click.option(
    "--rate", "rate_hz", type=click.FloatRange(0, 1000),
    help="Highest rate of scan, grip and force messages; 0: none of them. [default: all of them]",
)  # fmt: skip
@click.option("--allow-commands", is_flag=True, help="Hand commands to the daemon; needs ipc, or --keys.")
@click.option("--insecure", is_flag=True, help="Accept connections to other hosts without certificates.")
@KEYS
def bridge(
    endpoint: str,
    config: Path | None,
    connect: tuple[str, ...],
    host: str | None,
    rate_hz: float | None,
    allow_commands: bool,
    insecure: bool,
    keys: Path | None,
) -> None:
    """Forward a daemon's messages to a zenoh network, and requests from there to the daemon.

    Keys are tactile/HOST/BOARD/TOPIC. Subscribers use zenoh://ROUTER:7447/HOST wherever an endpoint is asked
    for. One line of JSON on stdout says that the bridge runs.

    Example: tactiled zenoh --events ipc:///run/tactiled/left/events.ipc --config /etc/tactiled/zenoh.json5
    """
    need_extra("zenoh", "", "the bridge", "tactiled-zenoh")
    if allow_commands and keys is None and not endpoint.startswith("ipc://"):
        raise click.UsageError(
            f"--allow-commands: the daemon takes commands over ipc, or with --keys; not {endpoint}"
        )
    from tactiled.zenoh.bridge import ZenohBridge, ZenohBridgeParams, host_name, wait_for_session
    from tactiled.zenoh.safety import bridge_config
    from tactiled.zenoh.session import is_chunk

    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s", stream=sys.stderr)
    name = host_name() if host is None else host
    if not is_chunk(name):
        raise click.UsageError(f"--host {name!r}: a name without blanks, '/', '*', '$', '?', '#' and '@'")
    checked = bridge_config(config, connect, is_insecure=insecure)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit(0))
    with wait_for_session(checked) as session:
        running = ZenohBridge(ZenohBridgeParams(endpoint, name, rate_hz, allow_commands, keys), session)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: running.stop())
        click.echo(json.dumps({"what": "bridge", "keys": f"tactile/{name}/**", "events": endpoint}))
        sys.stdout.flush()
        try:
            running.run()
        finally:
            running.close()


@click.command()
@click.argument("endpoint", default="zenoh://127.0.0.1:7447/*")
@click.option("--once", is_flag=True, help="Print the list once; exit code 1 unless all boards are fresh.")
@click.option(
    "--expect", "expected", multiple=True, metavar="HOST[/BOARD]",
    help="Robot that must be on the network; one that is not is a row of its own, missing.",
)  # fmt: skip
@click.option(
    "--expect-file", type=click.File(encoding="utf-8", errors="replace"),
    help="File of such robots: a HOST or HOST/BOARD on each line; # begins a comment.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print one JSON line per board, each time.")
@click.option(
    "--every", "period_s", default=2.0, show_default=True, type=click.FloatRange(0.5), help="Seconds."
)
@KEYS
@click.option(
    "--serve", "port", type=click.IntRange(0, 65535), metavar="PORT",
    help="Also serve http://127.0.0.1:PORT/metrics with all boards, for Prometheus.",
)  # fmt: skip
def fleet(
    endpoint: str,
    once: bool,
    expected: tuple[str, ...],
    expect_file: TextIO | None,
    as_json: bool,
    period_s: float,
    keys: Path | None,
    port: int | None,
) -> None:
    """List the boards of a zenoh network: state, age, utilisation, loss, firmware, disk.

    ENDPOINT is zenoh://ROUTER:7447/* for all hosts. Each host is asked for its newest messages; nothing is
    subscribed, so that a list of many robots costs the network little.

    Example: tactiled fleet zenoh://router:7447/* --once --expect robot7
    """
    need_extra("zenoh", "", "the list", "tactiled-zenoh")
    from tactiled.errors import UnavailableError
    from tactiled.zenoh.fleet import FleetList, FleetMetrics, draw_table

    if expect_file is not None:
        expected += tuple(filter(None, (line.partition("#")[0].strip() for line in expect_file)))
    boards, metrics = FleetList(endpoint, keys, expected), None
    if once and port is not None:
        raise click.UsageError("--serve: leave out --once, since the page lasts as long as the list")
    with ExitStack() as stack:
        stack.enter_context(suppress(KeyboardInterrupt))
        if port is not None:
            metrics = FleetMetrics()
            port = stack.enter_context(metrics.serving(port))
            click.echo(f"fleet: http://127.0.0.1:{port}/metrics", err=True)
        while True:
            try:
                rows = boards.ask()
            except UnavailableError as error:
                if once:
                    raise
                click.echo(f"fleet: {error}", err=True)  # a router that restarts ends no list
                if metrics is not None:
                    metrics.lose()
                time.sleep(period_s)
                continue
            if as_json:
                for row in rows:
                    click.echo(json.dumps(asdict(row)))
            else:
                draw_table(rows, clear=not once and sys.stdout.isatty())
            if metrics is not None:
                metrics.rows = rows
            if once:
                sys.exit(0 if rows and all(row.valid for row in rows) else 1)
            time.sleep(period_s)


@click.command("fleet")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--router", "routers", multiple=True, metavar="NAME=ADDRESS[:PORT]",
    help="Router and its address; it listens at that port. [default port: 7447]",
)  # fmt: skip
@click.option("--robot", "robots", multiple=True, metavar="NAME", help="Host of a daemon, as in --host.")
@click.option("--reader", "readers", multiple=True, metavar="NAME", help="Who may read all robots.")
@click.option("--commander", "commanders", multiple=True, metavar="NAME", help="Who may command them, too.")
def keys_fleet(
    folder: Path,
    routers: tuple[str, ...],
    robots: tuple[str, ...],
    readers: tuple[str, ...],
    commanders: tuple[str, ...],
) -> None:
    """Make the certificates of a zenoh network: FOLDER/NAME.json5 for each member, for its host.

    Routers take it as their configuration, `tactiled zenoh` as --config, clients as --keys. A second call
    adds members; routers then need their new files. Prints one JSON line for each new member.

    Example: tactiled keys fleet fleet --router hall=10.0.0.1 --robot robot7 --robot robot8 --reader dashboard
    """
    from tactiled.zenoh.certificates import FleetMembers, make_fleet

    addresses = dict(word.partition("=")[::2] for word in routers)
    if nameless := [word for word in routers if not all(word.partition("="))]:
        raise click.UsageError(f"--router {nameless[0]}: give NAME=ADDRESS, as in hall=10.0.0.1")
    members = FleetMembers(addresses, list(robots), list(readers), list(commanders))
    for file in make_fleet(folder, members):
        click.echo(json.dumps({"name": file.stem, "file": str(file)}))
    click.echo(f"{folder}/ca-key.pem makes further members: keep it away from the network", err=True)
