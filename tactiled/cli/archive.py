"""Commands on stores of recordings: archive push."""

import sys
from pathlib import Path

import click

from tactiled.cli.options import need_extra
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar


@click.group()
def archive() -> None:
    """Keep copies of recordings in a store of files."""


@archive.command()
@click.argument("directory", type=click.Path(path_type=Path))
@click.option(
    "--to", "url", required=True, metavar="URL", help="Folder in a store: s3://BUCKET/..., file:///..., ..."
)
@click.option("--remove", is_flag=True, help="Remove each recording here once its copy is confirmed.")
def push(directory: Path, url: str, remove: bool) -> None:
    """Copy the finished recordings of DIRECTORY into a store, and confirm each copy by its SHA-256.

    What the store has already is not sent again. Exit code 1 if a copy could not be confirmed; the recording
    then stays here, and the next call tries again. Credentials and the address of an S3 server come from the
    environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_ENDPOINT_URL) or from ~/.aws.

    Example: tactiled archive push /var/lib/tactiled --to s3://touch/hand-3 --remove
    """
    need_extra("fsspec", "archive", "archive push")
    from tactiled.archive.push import open_store, recordings, size_of
    from tactiled.archive.push import push as push_all

    if "://" not in url:
        raise OperatorError(
            f"--to {url}: give a URL, e.g. s3://BUCKET/FOLDER or file://{Path(url).absolute()}"
        )
    total = sum(size_of(path) for path in recordings(directory))
    store, folder = open_store(url)
    n_copied = n_there = n_failed = 0
    with ProgressBar(f"archive push {directory}", total) as progress:
        for copy in push_all(directory, store, folder, remove, progress.advance):
            n_copied += copy.state == "copied"
            n_there += copy.state == "there already"
            if copy.state == "failed":
                n_failed += 1
                click.echo(f"{copy.path}: not confirmed, kept here: {copy.reason}", err=True)
    failed = f", {n_failed} not confirmed" if n_failed else ""
    click.echo(f"{url}: {n_copied} copied, {n_there} there already{failed}", err=True)
    sys.exit(1 if n_failed else 0)
