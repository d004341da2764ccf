"""``tactiled detect FILE``: run the detectors on a recording or a log, without the daemon."""

import json
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, load_array
from tactiled.detect.suite import DetectParams
from tactiled.detect.tuning import TunedSuite
from tactiled.errors import ConfigError, DataError
from tactiled.events.codec import to_map
from tactiled.events.types import Event, GripEvent, ScanEvent
from tactiled.pipeline import Pipeline, check_hello
from tactiled.recording.contents import Input, Read
from tactiled.recording.reader import Reached, read_header, read_items
from tactiled.recording.table import read_table, to_blocks
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import parse
from tactiled.wire.frames import Hello

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]
PICTURES = (".png", ".pdf", ".svg")
_PART_SCANS = 1000  # ten seconds of the published board
# Of the range, beyond its ends: saturated readings are nearer, readings in another unit are farther.
_NO_READING_PART = 0.5


@dataclass
class Log:
    """Readings and events of a file, collected while it is processed.

    Attributes
    ----------
    time_s : list of float
    volts : list of (channels,) float64
    """

    array: Array
    time_s: list[float] = field(default_factory=list)
    volts: list[FloatArray] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)


def detect_file(
    path: Path,
    array: str | None = None,
    rate_hz: float | None = None,
    speed_mm_s: float | None = None,
    setting: str | None = None,
    plot: Path | None = None,
    reached: Reached | None = None,
    grip_hz: float = 0.0,
) -> int:
    """Print every event of a file as a JSON line and return their number.

    `reached` is called with the fraction of the file that has been read, 0 to 1. Of the grip events,
    `grip_hz` a second are printed, and those at which the state changes.

    Raises
    ------
    DataError, ConfigError
        The file, the array or a parameter is invalid.
    """
    params = _params(speed_mm_s, setting, with_grip=grip_hz > 0)
    if plot is not None and not (plot.parent.is_dir() and plot.suffix in PICTURES):
        raise ConfigError("--plot", [f"{plot}: name a {', '.join(PICTURES)} in a folder that exists"])
    if path.suffix == ".mcap":
        if array is not None or rate_hz is not None:
            fault = "--array and --rate are for tables; a recording knows its own"
            raise ConfigError("command line", [fault])
        log = Log(read_header(path).source.array)
        found = _run_recording(path, log, params, reached)
    elif path.suffix in (".csv", ".npz"):
        log = Log(load_array(array or "wang2019-3x3"))
        found = _run_table(path, log, rate_hz, params, reached)
    else:
        raise DataError(f"{path}: what is it? Known are .mcap (our recordings), .csv and .npz")
    seqs: dict[str, int] = {}
    for event in _thinned(found, grip_hz):
        seqs[event.topic] = seq = seqs.get(event.topic, -1) + 1
        message = to_map(event, seq=seq, board=path.stem, unix_offset_s=0.0)
        click.echo(json.dumps({"topic": event.topic, **message}, allow_nan=False))
        log.events.append(event)
    if plot is not None:
        from tactiled.plots.log import draw_log

        try:
            draw_log(
                plot, log.array, np.array(log.time_s), np.array(log.volts), log.events, params, path.name
            )
        except OSError as error:
            raise DataError(f"{plot}: the picture cannot be written: {error.strerror}") from None
    return len(log.events)


def _run_recording(path: Path, log: Log, params: DetectParams, reached: Reached | None) -> Iterator[Event]:
    """Run recorded bytes through the pipeline, without its limit on lateness."""
    header = read_header(path)
    layout = header.source.layout
    pipeline = Pipeline(layout, log.array, header.pipeline.model_copy(update={"detect": params}), live=False)
    foreign = ""
    pipeline.receive_data(header.hello, 0.0)  # a later part of a rotated recording may contain no hello
    for item in read_items(path, reached=reached):
        if isinstance(item, Input) and item.name == "disconnected":
            pipeline.disconnected()
        elif isinstance(item, Input) and item.name in ("damaged", "dropped"):
            pipeline.interrupted()
        elif isinstance(item, Input) and item.name in ("adapter", "ping"):
            pipeline.command(item.name, item.values(), item.time_s)
        if not isinstance(item, Read):
            continue
        for output in pipeline.receive_data(item.data, item.arrival_s):
            if isinstance(output, ScanEvent):
                log.time_s.append(output.time_s)
                log.volts.append(np.array(output.volts))
            elif isinstance(output, Event):
                yield output
            elif isinstance(output, Hello) and (fault := check_hello(output, layout, log.array)):
                # As in the live run, the pipeline ignores the scans of this board until the next hello.
                foreign = f"{path}: {fault}"
                logger.warning("%s; its scans are left out", foreign)
    if not log.time_s and foreign:
        raise DataError(foreign)
    if not log.time_s:
        raise DataError(f"{path}: holds no scans; was the board started, and did its hello get through?")


def _run_table(
    path: Path, log: Log, rate_hz: float | None, params: DetectParams, reached: Reached | None
) -> Iterator[Event]:
    """Run the rows of a log through the detectors."""
    time_s, volts = read_table(path, rate_hz)
    if volts.shape[1] != log.array.n_channels:
        raise DataError(
            f"{path}: {volts.shape[1]} channels, but array {log.array.name} has {log.array.n_channels} "
            f"({log.array.n_taxels} taxels); say which array with --array NAME or --array FILE.toml"
        )
    _check_range(path, volts, log.array)
    log.time_s, log.volts = time_s.tolist(), list(volts)
    suite = TunedSuite(log.array, params)
    n_scans = 0
    for item in to_blocks(time_s, volts, rate_hz, log.array.in_range(volts)):
        for part in _parts(item):
            yield from suite.process(part)
            n_scans += len(part) if isinstance(part, ScanBlock) else 0
            if reached is not None:
                reached(n_scans / len(time_s))


def _check_range(path: Path, readings: FloatArray, array: Array) -> None:
    """Refuse readings that are far outside the range of the array: they are in another unit."""
    low, high, unit = array.low, array.high, array.unit
    margin = _NO_READING_PART * (high - low)
    impossible = np.argwhere((readings < low - margin) | (readings > high + margin))
    if not len(impossible):
        return
    row, channel = impossible[0].tolist()
    of = {"V": "volts", "N": "newtons", "count": "counts"}.get(unit, unit)
    raise DataError(
        f"{path}: row {row + 1}, channel {channel}: {readings[row, channel]:g} {unit}, but {array.name} "
        f"reads {low:g} to {high:g} {unit}; are these {of}? If not, say so in the array file "
        '(unit = "count" and range = [0, 65535], for example; --array FILE.toml). '
        "If that is no reading, leave the cell empty"
    )


def _parts(item: ScanBlock | Gap) -> Iterator[ScanBlock | Gap]:
    """Split a long block, to show progress in between; the split does not change the events."""
    if isinstance(item, Gap):
        yield item
        return
    for start in range(0, len(item), _PART_SCANS):
        yield item[start : start + _PART_SCANS]


def _thinned(events: Iterator[Event], grip_hz: float) -> Iterator[Event]:
    """Leave out grip events between those that are due, unless the state has changed."""
    state, next_s = "", -math.inf
    for event in events:
        if isinstance(event, GripEvent):
            if event.state == state and event.time_s < next_s:
                continue
            # Half a millisecond less: instants of scans are not exact.
            state, next_s = event.state, event.time_s + 1 / grip_hz - 0.0005
        yield event


def _params(speed_mm_s: float | None, setting: str | None, *, with_grip: bool) -> DetectParams:
    texture = {} if speed_mm_s is None else {"speed_mm_s": speed_mm_s}
    named = {} if setting is None else {"setting": setting}
    grip = {"enabled": with_grip}
    return parse(
        {"texture": texture, "wang2019": {"texture": texture}, "grip": grip, **named},
        DetectParams,
        "command line",
    )
