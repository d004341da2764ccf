"""``./run train NAME``: learn what the daemon ships as data."""

import json
from pathlib import Path

import click

from tactiled.cli import run_command
from tactiled.cli.options import FILE
from tactiled.progress import ProgressBar


@click.command()
@click.argument("name", type=click.Choice(["slip"]))
@click.option("--quick", is_flag=True, help="Few worlds: a minute, and trees that know little; needs --to.")
@click.option("--to", type=FILE, help="Write here, not over the trees that are shipped.")
def train(name: str, quick: bool, to: Path | None) -> None:
    """Learn the trees of a detector from worlds of known truth.

    slip: the contact filter, from every generator of bench/worlds; 12 to 45 minutes on two cores. What
    was learnt from, and what was tuned, stands beside the trees in a file with the ending .json. How well
    they do on generators that are left out prints `./run bench grip`.

    Example: ./run train slip --quick --to /tmp/slip.npz
    """
    from bench.train.slip import train_slip  # scikit-learn takes seconds to load

    assert name == "slip"
    if quick and to is None:
        raise click.UsageError("--quick needs --to FILE: such trees are not to be shipped")
    with ProgressBar(f"train {name}", None) as progress:
        about = train_slip(progress, is_quick=quick, to=to)
    click.echo(json.dumps(about["learnt_from"]))


if __name__ == "__main__":
    run_command(train)
