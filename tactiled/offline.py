"""``tactiled detect FILE``: run the detectors on a recording or a log, without the daemon."""

import json
import logging
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from tactiled import tomlfile
from tactiled.array import Array, FloatArray
from tactiled.config import beside
from tactiled.detect.signal.slip_gate import KnownSliding
from tactiled.detect.suite import DETECTED_TOPICS, DetectParams, build_suite
from tactiled.detect.tuning import TunedSuite
from tactiled.errors import ConfigError, DataError
from tactiled.events.codec import to_map
from tactiled.events.types import Event, ForceEvent, GripEvent
from tactiled.events.words import EventLines
from tactiled.force.calibration import load_calibration
from tactiled.force.estimator import ForceEstimator, ForceSource
from tactiled.log_summary import LogTally, summary
from tactiled.pipeline import Pipeline, check_hello
from tactiled.plots import check_picture
from tactiled.recording.contents import Input, Read, RecordedBoard, load_board
from tactiled.recording.reader import Reached, batches, read_header, read_items
from tactiled.recording.spacing import to_blocks
from tactiled.recording.steps import run_input
from tactiled.recording.table_times import TableOptions, TimeUnit
from tactiled.recording.whole import DEFAULT_ARRAY, WholeLog, kind_of, read_whole
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import parse
from tactiled.wire.frames import Hello
from tactiled.wire.layout import Layout, load_layout

logger = logging.getLogger(__name__)

OFFLINE_TOPICS = (*DETECTED_TOPICS, "force")

_PART_SCANS = 1000  # ten seconds of the published board
# Inputs of a recording that are no settings of detectors, which the command line sets. Motion of the hand was
# measured, as the readings were.
_MEASURED = ("disconnected", "damaged", "dropped", "adapter", "ping", "motion")
# Of the range, beyond its ends: saturated readings are nearer, readings in another unit are farther.
_NO_READING_PART = 0.5


@dataclass(frozen=True)
class Choices:
    """Options of `detect` for one log: what is known of it, and what is wanted from it."""

    speed_mm_s: float | None = None  # speed of the skin over the surface, for texture
    direction_deg: float | None = None  # direction of that motion, from +x towards +y
    period_mm: tuple[float, float] | None = None  # shortest and longest groove period
    max_tilt_deg: float | None = None  # largest angle from groove normal to motion
    setting: str | None = None  # of the detectors: fast, balanced, quiet or wang2019
    # File whose table `detect` holds parameters; the options above replace its values
    config: Path | None = None
    # Time at the beginning of the log whose readings are the zero, in place of the array's own
    tare_s: float | None = None
    sliding: KnownSliding | None = None  # times at which the skin is known to slide
    topics: tuple[str, ...] = OFFLINE_TOPICS  # topics that are computed and printed
    grip_hz: float = 0.0  # grip events a second that are printed, besides changes of state; 0 for none
    calibration: str | None = None  # name or path of the force calibration; without one no force is computed
    force_hz: float = 10.0  # force events a second that are printed; 0 for none
    columns: tuple[str, ...] = ()  # columns of a table that have the channels; see `read_table`
    time_unit: TimeUnit | None = None  # unit of the times of a table, where it is not seconds
    topic: str | None = None  # topic of a bag; see `read_bag`
    # Name or path of the layout that reads the bytes of a recording, in place of its own
    layout: str | None = None

    def source_of(self, path: Path, array: str | None) -> RecordedBoard:
        """Return layout and array of a recording, or those that the user asks for.

        `ConfigError` for an array beside the own layout of a recording, or for another layout without one.
        """
        if self.layout is None:
            if array is not None:
                fault = "--array is for tables, or beside --layout; a recording contains its array"
                raise ConfigError("command line", [fault])
            return read_header(path).source
        assumed = load_layout(self.layout).file.assumed_hello
        if array is None and assumed is None:
            raise ConfigError("command line", [f"--layout {self.layout} needs --array: it assumes none"])
        return load_board(self.layout, array or ("" if assumed is None else assumed.array_id))

    def params(self) -> DetectParams:
        """Check all parameters: those of the file, replaced by those of the command line."""
        file = {} if self.config is None else tomlfile.read(self.config)
        if self.config is not None and not {"detect", "port", "board"} & set(file):
            raise ConfigError(str(self.config), ["no table [detect], [port] or [board]: no configuration"])
        source = "command line" if self.config is None else f"{self.config} and command line"
        table = _table(file, "detect", source)
        motion = {"speed_mm_s": self.speed_mm_s, "direction_deg": self.direction_deg}
        low, high = self.period_mm or (None, None)
        limits = {"min_period_mm": low, "max_period_mm": high, "max_tilt_deg": self.max_tilt_deg}
        table["texture"] = {**_table(table, "texture", source), **_given(motion | limits)}
        table["grip"] = {**_table(table, "grip", source), "publish": self.grip_hz > 0}
        return parse({**table, **_given({"setting": self.setting})}, DetectParams, source)

    def suite(self, array: Array, params: DetectParams) -> TunedSuite:
        """Make the detectors that are asked for; of a known slide, texture alone needs no slips."""
        if self.sliding is None or {"slip", "contact", "grip"} & set(self.topics):
            params.check_array(array, "command line")
        build = partial(build_suite, sliding=self.sliding, topics=self.topics)
        force: ForceSource | None = None
        if self.calibration is not None and self.force_hz > 0 and "force" in self.topics:
            force = ForceEstimator(array, load_calibration(self.calibration))
        return TunedSuite(array, params, build, force)

    def summary(self, log: LogTally) -> Iterator[str]:
        """Yield lines for people: rate, range, contact, slip, and why an event is missing."""
        params = self.params()
        told = self.topics
        if params.is_packaged:  # such detectors have no grip messages
            told = tuple(topic for topic in told if topic != "grip")
        yield from summary(log, told, params.texture.speed_mm_s, sliding_is_given=self.sliding is not None)
        if unread := params.unread():
            yield f"not read by setting {params.setting}: {', '.join(f'detect.{key}' for key in unread)}"

    def array_of(self, array: Array) -> Array:
        """Return the array with the zero that the user asks for."""
        if self.tare_s is None:
            return array
        return replace(array, zero=np.zeros(array.n_channels), zero_first_s=self.tare_s)


def detect_file(
    path: Path,
    array: str | None = None,
    rate_hz: float | None = None,
    choices: Choices | None = None,
    plot: Path | None = None,
    reached: Reached | None = None,
    *,
    as_json: bool = True,
) -> LogTally:
    """Print the events of a file, and return the log with them; see `detect_messages`.

    Every event is a JSON line; without `as_json` there are lines for people (`EventLines`).
    """
    choices = choices or Choices()
    if plot is not None:
        check_picture(plot)
    log, messages = detect_messages(path, array, rate_hz, choices, reached)
    log.keeps_events = plot is not None
    lines = EventLines("{:8.3f} s".format, choices.topics)
    for message in messages:
        log.n_events += 1
        line = json.dumps(message, allow_nan=False) if as_json else lines.line(message["topic"], message)
        if line is not None:
            click.echo(line)
            log.n_printed += 1
    if plot is not None:
        from tactiled.plots.log import draw_log

        draw_log(plot, log.array, log.time_s, log.readings, log.events, path.name)
    return log


def detect_messages(
    path: Path,
    array: str | None = None,
    rate_hz: float | None = None,
    choices: Choices | None = None,
    reached: Reached | None = None,
) -> tuple[LogTally, Iterator[dict[str, Any]]]:
    """Return the log of a file, and its messages, which are computed while the file is read.

    A recording is read in parts: neither readings nor events are kept. A log of others is read as a whole.
    `DataError` or `ConfigError` if the file, the array or a parameter is invalid; some faults are found while
    messages are computed.

    `reached` is called with the fraction of the file that has been read, 0 to 1. Of the grip events,
    `choices.grip_hz` a second become messages, and those at which the state changes; of the force events,
    `choices.force_hz` a second.
    """
    choices = choices or Choices()
    params = choices.params()
    kind = kind_of(path, choices.topic)
    if choices.layout is not None and kind != "recording":
        raise ConfigError("command line", ["--layout is for our recordings (.mcap), which hold bytes"])
    options = TableOptions(rate_hz, choices.columns, choices.time_unit)
    named = None if kind == "recording" else array or array_of_config(choices.config)
    whole = read_whole(path, named, choices.topic, options)
    if whole is None:
        source = choices.source_of(path, array)
        log = LogTally(choices.array_of(source.array), path.stem)
        found = _run_recording(path, log, source.layout, params, choices, reached)
    else:
        log = LogTally(choices.array_of(whole.array), path.stem)
        found = _run_whole(path, log, whole, rate_hz, params, choices, reached)
    return log, _messages(log, found, choices)


def _messages(log: LogTally, found: Iterator[Event], choices: Choices) -> Iterator[dict[str, Any]]:
    """Count every event, and yield the messages of the topics that are asked for."""
    seqs: dict[str, int] = {}
    for event in _thinned(found, choices.grip_hz, choices.force_hz):
        log.add_event(event)
        if event.topic not in choices.topics:
            continue
        seqs[event.topic] = seq = seqs.get(event.topic, -1) + 1
        yield {"topic": event.topic, **to_map(event, seq=seq, board=log.board, unix_offset_s=0.0)}
    log.finish()


def array_of_config(config: Path | None) -> str:
    """Return the array that a configuration names, or that of the published board."""
    if config is None:
        return DEFAULT_ARRAY
    board = _table(tomlfile.read(config), "board", str(config))
    return str(beside(config, board.get("array", DEFAULT_ARRAY)))


def _run_recording(
    path: Path,
    log: LogTally,
    layout: Layout,
    params: DetectParams,
    choices: Choices,
    reached: Reached | None,
) -> Iterator[Event]:
    """Run recorded bytes through the pipeline, without its limit on lateness."""
    header = read_header(path)
    # The command line chooses the calibration.
    pipeline_params = header.pipeline.model_copy(
        update={"detect": params, "calibration": None, "force": False}
    )
    pipeline = Pipeline(layout, log.array, pipeline_params, live=False)
    pipeline.tuning = choices.suite(log.array, params)
    foreign = ""
    if choices.layout is None:
        if header.hello is not None:  # a later part may contain none
            pipeline.know(header.hello)
        if pipeline.hello is not None:
            log.board = pipeline.hello.board_serial or log.board
    inputs = read_items(path, reached=reached, with_events=False)
    for batch in batches(inputs, lambda item: isinstance(item, Read), Pipeline.MOST_READS):
        for change in batch:
            if isinstance(change, Input) and change.name in _MEASURED:
                run_input(pipeline, change, path)
        received = [pipeline.receive(read.data, read.arrival_s) for read in batch if isinstance(read, Read)]
        for part in pipeline.process(received):
            if isinstance(part.item, ScanBlock):
                log.add_scans(part.item.time_s, part.item.volts)
            elif isinstance(part.item, Hello):
                log.board = part.item.board_serial or log.board
                if fault := check_hello(part.item, layout, log.array):
                    # As in the live run, the pipeline ignores the scans of this board until the next hello.
                    foreign = f"{path}: {fault}"
                    logger.warning("%s; its scans are left out", foreign)
            yield from part.events
    if not log.n_scans and foreign:
        raise DataError(foreign)
    if not log.n_scans:
        raise DataError(f"{path}: holds no scans; was the board started, and did its hello get through?")
    _check_sliding(path, log.first_s, log.last_s, choices.sliding)


def _run_whole(
    path: Path,
    log: LogTally,
    whole: WholeLog,
    rate_hz: float | None,
    params: DetectParams,
    choices: Choices,
    reached: Reached | None,
) -> Iterator[Event]:
    """Run the rows of a table, or the messages of a bag, through the detectors."""
    _, time_s, readings = whole
    _check_range(path, time_s, readings, log.array)
    log.add_scans(time_s, readings)
    _check_sliding(path, log.first_s, log.last_s, choices.sliding)
    items = to_blocks(time_s, readings, rate_hz, log.array.in_range(readings))
    log.n_repeats = len(time_s) - sum(len(item) for item in items if isinstance(item, ScanBlock))
    suite = choices.suite(log.array, params)
    n_done = 0
    for part in (part for item in items for part in _parts(item)):
        yield from suite.process(part)
        if isinstance(part, ScanBlock) and reached is not None:
            n_done += len(part)
            reached(n_done / len(time_s))


def _check_sliding(path: Path, first_s: float, last_s: float, sliding: KnownSliding | None) -> None:
    """Refuse a slide that is outside the log: its times are in another unit or clock."""
    if sliding is None or (sliding.from_s < last_s and sliding.to_s > first_s):
        return
    raise DataError(
        f"{path}: --sliding lies outside the log, whose times are {first_s:.10g} to {last_s:.10g} s"
    )


def _check_range(path: Path, time_s: FloatArray, readings: FloatArray, array: Array) -> None:
    """Refuse readings that are far outside the range of the array: they are in another unit."""
    low, high, unit = array.low, array.high, array.unit
    margin = _NO_READING_PART * (high - low)
    impossible = np.argwhere((readings < low - margin) | (readings > high + margin))
    if not len(impossible):
        return
    row, channel = impossible[0].tolist()
    of = {"V": "volts", "N": "newtons", "count": "counts"}.get(unit, unit)
    raise DataError(
        f"{path}: at {time_s[row]:.10g} s, channel {channel}: {readings[row, channel]:g} {unit}, but "
        f"{array.name} reads {low:g} to {high:g} {unit}; are these {of}? If so, widen `range` in the array "
        'file. If not, say so there (unit = "count" and range = [0, 65535], for example; --array FILE.toml). '
        "If that is no reading, leave the cell empty"
    )


def _parts(item: ScanBlock | Gap) -> Iterator[ScanBlock | Gap]:
    """Split a long block, to show progress in between; the split does not change the events."""
    if isinstance(item, Gap):
        yield item
        return
    for start in range(0, len(item), _PART_SCANS):
        yield item[start : start + _PART_SCANS]


def _thinned(events: Iterator[Event], grip_hz: float, force_hz: float) -> Iterator[Event]:
    """Leave out force events and grip events between those that are due, unless the state has changed."""
    state, next_s, force_s = "", -math.inf, -math.inf
    for event in events:
        if isinstance(event, GripEvent):
            if event.state == state and event.time_s < next_s:
                continue
            # Half a millisecond less: instants of scans are not exact.
            state, next_s = event.state, event.time_s + 1 / grip_hz - 0.0005
        elif isinstance(event, ForceEvent):
            if event.time_s < force_s:
                continue
            force_s = event.time_s + 1 / force_hz - 0.0005
        yield event


def _table(document: Mapping[str, Any], key: str, source: str) -> dict[str, Any]:
    """Return a table of a document, empty where it is left out."""
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise ConfigError(source, [f"{key}: should be a table"])
    return dict(table)


def _given(values: Mapping[str, float | str | None]) -> dict[str, float | str]:
    return {name: value for name, value in values.items() if value is not None}
