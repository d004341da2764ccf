"""``./run bench NAME``: measure one trade and print its table."""

from importlib import import_module
from pathlib import Path

import click

from tactiled.cli import run_command
from tactiled.cli.options import FILE, need_extra
from tactiled.progress import ProgressBar

# Name of a bench to its module; each has a function `bench_NAME`.
BENCHES = {
    "clock": "bench.daemon.clock",
    "faults": "bench.daemon.faults",
    "soak": "bench.daemon.soak",
    "paper": "bench.paper.bench",
    "contact": "bench.contact.bench",
    "slip": "bench.slip.bench",
    "texture": "bench.texture.bench",
}


@click.command()
@click.argument("name", type=click.Choice(list(BENCHES)))
@click.option("--quick", is_flag=True, help="Fewer seeds and cases: about a minute, coarser numbers.")
@click.option("--plot", type=FILE, help="contact, slip, texture: also write a picture.")
@click.option("--json", "numbers", type=FILE, help="slip, texture: also write every number, case by case.")
def bench(name: str, quick: bool, plot: Path | None, numbers: Path | None) -> None:
    """Measure, and print the table that README shows.

    clock: how true are the instants of scans? paper: the published experiments, ours beside theirs. contact:
    what each contact model costs and what it gets wrong. soak: days of board time, every frame accounted for.
    faults: what a line and a board can do wrong, done to a daemon on a pty. slip: how soon a slip is said,
    and how often one that was none. texture: grooves against the Cramer-Rao bound, and what spoils them.

    Example: ./run bench slip --plot slip.png --json slip.json
    """
    if plot is not None and name not in ("contact", "slip", "texture"):
        raise click.UsageError("--plot is for `bench contact`, `bench slip` and `bench texture`")
    if numbers is not None and name not in ("slip", "texture"):
        raise click.UsageError("--json is for `bench slip` and `bench texture`")
    if plot is not None:
        need_extra("matplotlib", "plot", "bench --plot")
    measure = getattr(import_module(BENCHES[name]), f"bench_{name}")
    written = {"picture": plot, "numbers": numbers}
    more = {"contact": {"picture": plot}, "slip": written, "texture": written}.get(name, {})
    with ProgressBar(f"bench {name}", None) as progress:
        text = measure(progress, quick=quick, **more)
    click.echo(text)


if __name__ == "__main__":
    run_command(bench)
