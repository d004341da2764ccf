"""Commands on recordings: record, replay, recover, export."""

import sys
from dataclasses import replace
from pathlib import Path

import click

from tactiled.cli.live import serve
from tactiled.cli.options import CONFIG, FILE, PORT, need_board, need_readable, need_toml
from tactiled.progress import ProgressBar

RECORDINGS = click.argument("files", type=FILE, nargs=-1, required=True)


@click.command()
@click.argument("file", type=FILE)
@CONFIG
@PORT
@click.option(
    "--seconds",
    "duration_s",
    type=click.FloatRange(0, min_open=True),
    help="Stop after so many seconds.",
)
def record(file: Path, config: Path | None, port: str | None, duration_s: float | None) -> None:
    """Record a board into FILE (.mcap) without publishing, until stopped.

    If a daemon already runs, use its `[record]` table or `tactiled run --record`: a port has one reader.

    Example: tactiled record slide.mcap --port /dev/ttyUSB0 --seconds 60
    """
    need_board(config, port)
    need_toml(config)
    from tactiled.config import default_config, load_config
    from tactiled.daemon.operations.log import set_up
    from tactiled.daemon.zmq.params import PublishParams

    set_up(20)
    setup = default_config(port or "") if config is None else load_config(config, port)
    alone = setup.config.model_copy(update={"publish": PublishParams(endpoints=())})
    [board] = serve([replace(setup, config=alone)], file, duration_s, only_records=True)
    n_scans = board.pipeline.health().scans
    click.echo(f"{file}: {n_scans} scans", err=True)
    sys.exit(0 if n_scans else 1)


@click.command()
@RECORDINGS
@click.option("-t", "--topic", "topics", multiple=True, help="slip, texture, contact, scan.")
@click.option("--verify", is_flag=True, help="Print no events; compare them with the recorded live events.")
def replay(files: tuple[Path, ...], topics: tuple[str, ...], verify: bool) -> None:
    """Run recordings through the pipeline and print the events, bit for bit as they were live.

    Give all parts of a rotated recording.

    Example: tactiled replay slide.mcap --topic slip
    """
    need_readable(*files)
    from tactiled.recording.replay import replay as run_again

    with ProgressBar("replay", writes_lines=not verify) as progress:
        write_line = (lambda _: None) if verify else click.echo
        verdict = run_again(files, write_line, topics=topics, reached=progress.reach)
    if verify:
        click.echo(verdict.words(), err=True)
        sys.exit(0 if verdict.is_good else 1)


@click.command()
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE|DIRECTORY")
@click.option("--out", type=FILE, help="Output file; default: the name without .active.")
@click.option(
    "--min-free-mb", default=0.0, type=click.FloatRange(0), show_default=True,
    help="DIRECTORY: skip a file if its copy would leave less free space than this (10^6 bytes).",
)  # fmt: skip
def recover(file: Path, out: Path | None, min_free_mb: float) -> None:
    """Copy all whole chunks of a cut or damaged recording into a new file; the original is only read.

    For a record DIRECTORY, recover every unfinished recording that no recorder is writing, and replace the
    originals; the daemon does the same when it begins to record. An original with damage before its end is
    kept as NAME.active.damaged. Exit code 1 if one could not be recovered.

    Example: tactiled recover slide.mcap.active
    """
    if not file.is_dir():
        need_readable(file)
    from tactiled.recording.recover import recover as save
    from tactiled.recording.recover import recover_directory

    if not file.is_dir():
        with ProgressBar(f"recover {file}") as progress:
            saved = save(file, out, progress.reach)
        click.echo(saved.words(), err=True)
        return
    if out is not None:
        raise click.UsageError("--out is for one FILE")
    is_good = True
    for is_recovered, words in recover_directory(file, min_free_mb):
        click.echo(words, err=True)
        is_good = is_good and is_recovered
    sys.exit(0 if is_good else 1)


@click.command()
@RECORDINGS
@click.option("--csv", "out", type=FILE, required=True, help="CSV file to write.")
def export(files: tuple[Path, ...], out: Path) -> None:
    """Write the scans of recordings as a table; `tactiled detect` reads it back.

    Example: tactiled export slide.mcap --csv slide.csv
    """
    need_readable(*files)
    from tactiled.recording.export import export_csv

    with ProgressBar(f"export {out}") as progress:
        n_scans = export_csv(files, out, progress.reach)
    click.echo(f"{out}: {n_scans} scans", err=True)
