"""Commands on stores of recordings: archive push, list, verify, pull."""

import json
import sys
from collections import Counter
from pathlib import Path

import click

from tactiled.cli.options import need_extra
from tactiled.progress import ProgressBar


@click.group()
def archive() -> None:
    """Keep copies of recordings in a store of files."""
    need_extra("fsspec", "", "archive", "tactiled-archive")


@archive.command()
@click.argument("directory", type=click.Path(path_type=Path))
@click.option(
    "--to", "url", required=True, metavar="URL", help="Folder in a store: s3://BUCKET/..., file:///..., ..."
)
@click.option("--remove", is_flag=True, help="Remove each recording here once its copy was read back.")
def push(directory: Path, url: str, remove: bool) -> None:
    """Copy the finished recordings of DIRECTORY into a store, and confirm each copy by its SHA-256.

    What the store has already is not sent again. With --remove every copy is read back before its recording
    is removed here, however old the copy is; one that was damaged is made anew. A store that may end with
    this command, such as memory://, is then refused, and always one inside DIRECTORY or around it.

    Exit code 1 if a copy could not be confirmed; the recording then stays here, and the next call tries
    again. Credentials and the address of an S3 server come from the environment (AWS_ACCESS_KEY_ID,
    AWS_SECRET_ACCESS_KEY, AWS_ENDPOINT_URL) or from ~/.aws.

    Example: tactiled archive push /var/lib/tactiled --to s3://touch/hand-3 --remove
    """
    from tactiled.archive import copies
    from tactiled.archive.store import check_apart, open_store

    total = sum(map(copies.size_of, copies.recordings(directory)))
    check_apart(directory, url)
    store, folder = open_store(url, must_last=remove)
    states: Counter[str] = Counter()
    with ProgressBar(f"archive push {directory}", total) as progress:
        for copy in copies.push(directory, store, folder, remove=remove):
            states[copy.state] += 1
            progress.advance(copy.path.name, copy.n_bytes)
            if copy.state == "failed":
                click.echo(f"{copy.path}: not confirmed, kept here: {copy.reason}", err=True)
            elif copy.state == "repaired":
                click.echo(
                    f"{copy.path}: its copy was damaged, and was made anew; check that store", err=True
                )
    repaired = f", {states['repaired']} repaired" if states["repaired"] else ""
    failed = f", {states['failed']} not confirmed" if states["failed"] else ""
    click.echo(
        f"{url}: {states['copied']} copied, {states['there already']} there already{repaired}{failed}",
        err=True,
    )
    sys.exit(1 if failed else 0)


@archive.command("list")
@click.argument("url")
def list_recordings(url: str) -> None:
    """Print the recordings in a store: one JSON line for each with its name, bytes and confirmed SHA-256.

    The SHA-256 is empty where a copy was not confirmed. Nothing is read back: see `archive verify`.

    Example: tactiled archive list s3://touch/hand-3
    """
    from tactiled.archive.store import open_store, stored_recordings

    for recording in stored_recordings(*open_store(url, "URL")):
        _print({"name": recording.name, "bytes": recording.n_bytes, "sha256": recording.sha256})


@archive.command()
@click.argument("url")
@click.argument("names", nargs=-1)
def verify(url: str, names: tuple[str, ...]) -> None:
    """Read the recordings in a store back, and compare each with the SHA-256 that was confirmed at its push.

    Prints one JSON line for each: name, health (whole, damaged, unconfirmed, unreadable) and reason. NAMES
    (with *) choose recordings. Exit code 1 unless all are whole.

    Example: tactiled archive verify s3://touch/hand-3
    """
    from tactiled.archive.copies import chosen
    from tactiled.archive.store import examine, open_store, stored_recordings

    store, folder = open_store(url, "URL")
    found = chosen(stored_recordings(store, folder), names)
    states: Counter[str] = Counter()
    with ProgressBar(f"archive verify {url}", sum(r.n_bytes for r in found), writes_lines=True) as progress:
        for recording in found:
            health, reason = examine(store, recording)
            states[health] += 1
            _print({"name": recording.name, "health": health, "reason": reason})
            progress.advance(recording.name, recording.n_bytes)
    click.echo(f"{url}: " + ", ".join(f"{n} {state}" for state, n in sorted(states.items())), err=True)
    sys.exit(0 if states["whole"] == len(found) else 1)


@archive.command()
@click.argument("url")
@click.argument("names", nargs=-1)
@click.option("--to", "directory", required=True, type=click.Path(path_type=Path), help="Directory here.")
def pull(url: str, names: tuple[str, ...], directory: Path) -> None:
    """Fetch recordings of a store into a directory, and confirm each by its SHA-256.

    NAMES (with *) choose recordings; all without. A file that is here already is never replaced. Exit code 1
    if a recording could not be confirmed; nothing then has its name here.

    Example: tactiled archive pull s3://touch/hand-3 'left/*' --to runs
    """
    from tactiled.archive import copies
    from tactiled.archive.store import open_store, stored_recordings

    store, folder = open_store(url, "URL")
    found = copies.chosen(stored_recordings(store, folder), names)
    states: Counter[str] = Counter()
    with ProgressBar(f"archive pull {url}", sum(r.n_bytes for r in found)) as progress:
        for copy in copies.pull(store, found, directory):
            states[copy.state] += 1
            progress.advance(copy.path.name, copy.n_bytes)
            if copy.state == "failed":
                click.echo(f"{copy.path}: not fetched: {copy.reason}", err=True)
    failed = f", {states['failed']} not fetched" if states["failed"] else ""
    click.echo(
        f"{directory}: {states['copied']} fetched, {states['there already']} there already{failed}", err=True
    )
    sys.exit(1 if failed else 0)


def _print(message: dict[str, object]) -> None:
    click.echo(json.dumps(message))
