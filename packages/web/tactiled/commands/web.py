"""The verb that shows boards in a browser."""

import json
import os
import re
import secrets
from pathlib import Path

import click

from tactiled.cli.options import FILE, KEYS, need_extra, need_named, need_readable
from tactiled.client.transports import over_zenoh
from tactiled.errors import DataError
from tactiled.events.endpoints import ZENOH_SCHEME
from tactiled.outside import read_secret

_TOKEN_ENV = "TACTILED_WEB_TOKEN"
_HOSTS_S = 2.0  # for the slowest host of a zenoh network
# 16 characters are 80 bits even where they are letters and digits of one case. Each stands for itself in an
# address and in a request.
_TOKEN = re.compile(r"[A-Za-z0-9._~+/=-]{16,}")


@click.command()
@click.option(
    "-e", "--events", "endpoints", multiple=True, metavar="ENDPOINT",
    help="Endpoint of a daemon's events, or zenoh://ROUTER:7447/HOST (* for all hosts that are there now); "
    "several times for several daemons. [default: tcp://127.0.0.1:9872]",
)  # fmt: skip
@click.option("--port", default=8765, show_default=True, type=click.IntRange(0, 65535), help="0: a free one.")
@click.option(
    "--host", default="127.0.0.1", show_default=True,
    help="Address to listen at; 0.0.0.0 lets every host of the network look.",
)  # fmt: skip
@click.option(
    "--host-name", "host_names", multiple=True, help="Further name by which browsers call this host."
)
@click.option("--array", "arrays", multiple=True, help="Array file of a board whose array does not ship.")
@click.option(
    "--file", "files", multiple=True, type=FILE,
    help="Show this recording instead of live boards; several times for the parts of one recording.",
)  # fmt: skip
@click.option(
    "--recordings", type=click.Path(path_type=Path, file_okay=False, exists=True), metavar="DIRECTORY",
    help="Let the page list, open and download the recordings (.mcap) of this directory.",
)  # fmt: skip
@click.option(
    "--allow-commands", is_flag=True, help="Show buttons to who opens the printed address, which has a token."
)
@click.option(
    "--token-file", type=FILE, help=f"File with the token. [default: ${_TOKEN_ENV}, or drawn at random]"
)
@KEYS
def web(
    endpoints: tuple[str, ...],
    port: int,
    host: str,
    host_names: tuple[str, ...],
    arrays: tuple[str, ...],
    files: tuple[Path, ...],
    recordings: Path | None,
    allow_commands: bool,
    token_file: Path | None,
    keys: Path | None,
) -> None:
    """Show boards live in a browser: freshness, array, slips, grooves, timeline.

    The page needs nothing from the internet. It is read-only unless --allow-commands; the daemon accepts
    commands over ipc, and over TCP with --keys.

    Example: tactiled web --events ipc:///run/tactiled/left/events.ipc --port 8765
    """
    need_extra("aiohttp", "", "the page", "tactiled-web")
    need_readable(*files)
    for name in arrays:
        need_named(name, "config/arrays")
    if files and (endpoints or allow_commands or recordings):
        raise click.UsageError(
            "--file shows a recording: leave out --events, --allow-commands and --recordings"
        )
    endpoints = endpoints or (() if files else ("tcp://127.0.0.1:9872",))
    token = _token(token_file) if allow_commands else ""
    if (
        allow_commands
        and keys is None
        and (plain := [e for e in endpoints if not e.startswith(("ipc://", ZENOH_SCHEME))])
    ):
        raise click.UsageError(
            f"--allow-commands: the daemon accepts commands over ipc, or with --keys; {plain[0]} is neither"
        )
    from tactiled.array import load_array
    from tactiled.progress import ProgressBar
    from tactiled.web.guard import Guard, is_loopback
    from tactiled.web.replay import ReplayFile
    from tactiled.web.server import Listening, run_web

    if any(endpoint.startswith(ZENOH_SCHEME) for endpoint in endpoints):
        over_zenoh()
        from tactiled.zenoh.session import spread

        endpoints = spread(endpoints, keys, _HOSTS_S)
    array_files = {name: load_array(name) for name in arrays}
    loaded = [*array_files.values()]
    replay = None
    if files:
        with ProgressBar(f"read {files[0]}") as bar:
            replay = ReplayFile(files, loaded, bar.reach)

    def ready(url: str) -> None:
        # Output may end in a log that others read: a token that somebody gave is not repeated there.
        is_drawn = bool(token) and token_file is None and not os.environ.get(_TOKEN_ENV)
        address = f"{url}#token={token}" if is_drawn else url
        click.echo(json.dumps({"what": "page", "url": address}))
        click.echo(f"web: open {address}", err=True)
        if token and not is_drawn:
            source = f"${_TOKEN_ENV}" if token_file is None else str(token_file)
            click.echo(f"web: to give commands, add #token= and the token of {source}", err=True)
        if not is_loopback(host):
            click.echo(
                f"web: every host that reaches {host} can look; the connection is not encrypted", err=True
            )

    guard = Guard(token, host_names)
    run_web(Listening(endpoints, host, port, array_files, keys, guard, replay, recordings), ready)


def _token(file: Path | None) -> str:
    """Token of the commands: from a file, the environment, or drawn."""
    if file is None:
        source, token = f"${_TOKEN_ENV}", os.environ.get(_TOKEN_ENV) or secrets.token_urlsafe(24)
    else:
        source = f"--token-file {file}"
        try:
            token = read_secret(file, "token").strip()
        except OSError as error:
            raise DataError(f"{source}: cannot be read: {error.strerror}") from None
    if not _TOKEN.fullmatch(token):
        raise DataError(
            f"{source}: a token has at least 16 characters, only letters, digits and . _ ~ + / = -"
        )
    return token
