"""Recordings for `tactiled tune` from files."""

from pathlib import Path

from tactiled.errors import ConfigError, DataError
from tactiled.events.types import ScanEvent
from tactiled.recording.spacing import to_blocks
from tactiled.recording.steps import Replay
from tactiled.recording.whole import read_whole
from tactiled.tune.hold import Collector, Recording


def read_recording(path: Path, array: str | None = None, topic: str | None = None) -> Recording:
    """Read the scans of a recording, or of a table or bag (see `read_whole`)."""
    whole = read_whole(path, array, topic, None)
    if whole is not None:
        known, time_s, volts = whole
        return Recording(path.name, known, tuple(to_blocks(time_s, volts, None, known.in_range(volts))))
    replay = Replay([path])
    scans = Collector(replay.header.source.array)
    hello = None
    for step in replay:
        for replayed in step.now:
            if isinstance(replayed.event, ScanEvent):
                scans.add(replayed.event)
        # A recording that was ended regularly ends with a lost port, after which the board is unknown.
        hello = replay.pipeline.hello or hello
    if not scans or hello is None:
        raise DataError(
            f"{path}: contains no scans; check that the board was started and that its hello arrived"
        )
    return scans.recording(path.name, hello.rate_hz, hello.channel_offset_s)


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
