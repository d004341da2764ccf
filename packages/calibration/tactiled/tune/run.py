"""``tactiled tune``: read two recordings, evaluate them and print the result."""

import json
from pathlib import Path

import click

from tactiled.errors import ConfigError
from tactiled.progress import ProgressBar, tell
from tactiled.tune.files import read_recording
from tactiled.tune.hold import Recording
from tactiled.tune.study import N_STAGES, study
from tactiled.tune.words import as_map, as_toml, in_words


def read_pair(
    quiet: Path, motion: Path, array: str | None = None, topic: str | None = None
) -> tuple[Recording, Recording]:
    """Read the files of a quiet hold and of motion without slip.

    Raises
    ------
    DataError, ConfigError
        A file is invalid, or they are of different arrays.
    """
    first, second = read_recording(quiet, array, topic), read_recording(motion, array, topic)
    if first.array.channel_name != second.array.channel_name:
        fault = f"{quiet} is of the array {first.array.name}, {motion} of {second.array.name}"
        raise ConfigError("command line", [f"{fault}: record both with one board"])
    return first, second


def judge(quiet: Recording, motion: Recording, accepted_per_hour: float, *, as_json: bool = True) -> None:
    """Evaluate two recordings; report to stderr, all numbers as one JSON line to stdout if asked."""
    with ProgressBar("count the reports of each setting", N_STAGES) as bar:
        found = study(quiet, motion, accepted_per_hour, bar.advance)
    tell(f"\n{in_words(found)}\n\nfor tactiled.toml:\n\n{as_toml(found)}")
    if as_json:
        click.echo(json.dumps(as_map(found), allow_nan=False))
