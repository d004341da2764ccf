"""Recordings for `tactiled tune` from files: MCAP, or CSV and npz as for `tactiled detect`."""

from pathlib import Path

from tactiled.array import load_array
from tactiled.errors import ConfigError, DataError
from tactiled.events.types import ScanEvent
from tactiled.recording.bag import is_bag, read_bag
from tactiled.recording.steps import Replay
from tactiled.recording.table import read_table, to_blocks
from tactiled.tune.hold import Collector, Recording

_DEFAULT_ARRAY = "wang2019-3x3"


def read_recording(path: Path, array: str | None = None, topic: str | None = None) -> Recording:
    """Read the scans of a file.

    Parameters
    ----------
    path : Path
        ``.mcap``, ``.csv`` or ``.npz`` as `recording.table` reads them, or a bag.
    array : str, optional
        Array of a table or bag: shipped name or TOML file.
    topic : str, optional
        Topic of a bag; see `read_bag`.
    """
    is_of_ros = topic is not None or is_bag(path)
    if path.suffix == ".mcap" and not is_of_ros:
        if array is not None:
            raise ConfigError("command line", ["--array is for tables; a recording contains its array"])
        return _from_mcap(path)
    if not is_of_ros and path.suffix not in (".csv", ".npz"):
        raise DataError(
            f"{path}: unknown file type; supported are .mcap (recordings of tactiled), .csv, .npz and bags"
        )
    known_array = load_array(array or _DEFAULT_ARRAY)
    time_s, volts = read_bag(path, topic) if is_of_ros else read_table(path)
    if volts.shape[1] != known_array.n_channels:
        raise DataError(
            f"{path}: {volts.shape[1]} channels, but array {known_array.name} has {known_array.n_channels}; "
            "name the array with --array NAME or --array FILE.toml"
        )
    return Recording(
        path.name, known_array, tuple(to_blocks(time_s, volts, None, known_array.in_range(volts)))
    )


def _from_mcap(path: Path) -> Recording:
    """Replay a recording through the pipeline and keep its scans."""
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
