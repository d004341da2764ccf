"""Metrics for Prometheus: counters, gauges and histograms in its text format.

States, latencies, slips and the recording come from the published events, so that a graph shows what
subscribers received; the counters of the line come from the pipeline and the driver of the UART. The format
is version 0.0.4 of prometheus.io/docs/instrumenting/exposition_formats: base units, counters that end in
``_total``, histograms with cumulative buckets.
"""

import bisect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, starmap
from typing import Literal, get_args

from tactiled import compiled
from tactiled.daemon.serial.device import LineErrors
from tactiled.events.types import (
    BoardState,
    Event,
    RecordingEvent,
    ScanEvent,
    SlipEvent,
    StatusEvent,
    Suppressed,
)
from tactiled.pipeline import Health
from tactiled.version import __version__

# From the transfer of one frame (7 ms at 115200 baud) over FTDI buckets (16 ms) and stalls to backlogs.
_LATENCY_S = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)
# From a turn with warm caches (50 us) over cold caches to a host that has stopped working.
_LAG_S = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.1, 1.0)
_CONTACTS = get_args(Health.__annotations__["contact"])
_STATES = get_args(BoardState)

Sample = tuple[str, Mapping[str, str], float]
"""Suffix of the metric name, labels, value."""
Family = tuple[str, list[Sample]]
"""Name in `METRICS`, and samples."""


@dataclass(frozen=True)
class Metric:
    """Kind and meaning of one metric."""

    kind: Literal["counter", "gauge", "histogram"]
    meaning: str
    labels: tuple[str, ...] = ()  # besides ``board``


METRICS: Mapping[str, Metric] = {
    "info": Metric(
        "gauge",
        "1; the labels have the version of tactiled and the path of a scan.",
        ("version", "scan_path"),
    ),
    "frames_total": Metric("counter", "Frames by result: good, or why they were rejected.", ("result",)),
    "scans_total": Metric("counter", "Scans that the board took: received, missing, duplicate.", ("result",)),
    "bytes_total": Metric("counter", "Bytes received: part of a frame, or discarded.", ("result",)),
    "fits_late_total": Metric(
        "counter", "Groove fits that were not ready at the scan at which they were due."
    ),
    "board_restarts_total": Metric("counter", "Number of times that the board booted."),
    "uart_errors_total": Metric(
        "counter", "Errors that the driver of a UART counts, where there is one.", ("kind",)
    ),
    "state": Metric("gauge", "1 for the present state of the board, 0 for all others.", ("state",)),
    "valid": Metric("gauge", "1 while the tactile data are fresh, else 0."),
    "scan_age_seconds": Metric("gauge", "Age of the newest scan."),
    "scan_rate_hertz": Metric("gauge", "Scan rate that the board states."),
    "clock_sd_seconds": Metric("gauge", "Standard deviation of the times of scans; 1e9 while it is unknown."),
    "contact": Metric("gauge", "1 for the present state of the contact, 0 for all others.", ("state",)),
    "scan_latency_seconds": Metric("histogram", "Time from a scan to its handling."),
    "loop_lag_seconds": Metric("histogram", "Longest turn of the event loop in each tenth of a second."),
    "slip_onsets_total": Metric(
        "counter", "Onsets of slip, and which announcement explains them.", ("kind", "suppressed")
    ),
    "messages_refused_total": Metric(
        "counter", "Messages dropped for subscribers without keys that do not keep up."
    ),
    "recording": Metric("gauge", "1 while a recording is written, else 0."),
    "disk_free_bytes": Metric("gauge", "Free space of the disk that holds the recording."),
    "reads_unrecorded_total": Metric("counter", "Reads of the port that are in no recording."),
}
"""All metrics; the names on the page begin with ``tactiled_``."""


class Histogram:
    """Counts of values by interval, between ascending bounds and above the last of them."""

    def __init__(self, bounds: Sequence[float]) -> None:
        self._bounds = tuple(bounds)
        self._counts = [0] * (len(bounds) + 1)
        self._sum = 0.0

    def add(self, value: float) -> None:
        """Count one value."""
        self._counts[bisect.bisect_left(self._bounds, value)] += 1
        self._sum += value

    def samples(self) -> Iterator[Sample]:
        """Yield cumulative counts, sum and number of values."""
        names = [*map(_number, self._bounds), "+Inf"]
        for name, count in zip(names, accumulate(self._counts), strict=True):
            yield "_bucket", {"le": name}, count
        yield "_sum", {}, self._sum
        yield "_count", {}, sum(self._counts)


class Metrics:
    """Collect the metrics of one board; `metrics_text` formats those of all boards for a scrape.

    Parameters
    ----------
    line_errors : callable
        Returns the counters of the UART, or None where there are none.
    board : callable
        Returns the serial number of the board, empty while it is unknown.
    """

    def __init__(
        self,
        health: Callable[[], Health],
        line_errors: Callable[[], LineErrors | None],
        board: Callable[[], str],
    ) -> None:
        self._health = health
        self._board = board
        self._line_errors = line_errors
        self._latency = Histogram(_LATENCY_S)
        self._lag = Histogram(_LAG_S)
        self._status: StatusEvent | None = None
        self._recording: RecordingEvent | None = None
        self._dropped = 0
        self._slips = {(kind, by): 0 for kind in ("incipient", "gross") for by in get_args(Suppressed)}

    def count(self, event: Event, dropped: int) -> None:
        """Count a published event; `dropped` is the number that slow subscribers have lost so far."""
        self._dropped = dropped
        if isinstance(event, ScanEvent):
            self._latency.add(event.age_s)
        elif isinstance(event, SlipEvent) and event.state == "onset":
            self._slips[event.kind, event.suppressed] += 1
        elif isinstance(event, StatusEvent):
            self._status = event
            self._lag.add(event.loop_lag_s)
        elif isinstance(event, RecordingEvent):
            self._recording = event

    def families(self) -> Iterator[Family]:
        """Yield all metrics, with the serial number of the board as label ``board``."""
        board = {"board": self._board()}
        for name, samples in (*self._line(), *self._state(), *self._delivery(), *self._disk()):
            yield name, [(end, {**board, **labels}, value) for end, labels, value in samples]

    def _line(self) -> Iterator[Family]:
        health = self._health()
        yield "frames_total", _by("result", {"good": health.frames, **health.corrupt_by_reason})
        scans = {
            "received": health.scans, "missing": health.scans_missing, "duplicate": health.scans_duplicate
        }  # fmt: skip
        yield "scans_total", _by("result", scans)
        octets = {"framed": health.bytes_framed, "discarded": health.bytes_discarded}
        yield "bytes_total", _by("result", octets)
        yield "fits_late_total", _one(health.fits_late)
        yield "board_restarts_total", _one(health.restarts)
        if (errors := self._line_errors()) is not None:
            yield "uart_errors_total", _by("kind", {"framing": errors.framing, "overrun": errors.overrun})

    def _state(self) -> Iterator[Family]:
        status = self._status
        if status is None:
            return
        yield "state", _enum("state", _STATES, status.state)
        yield "valid", _one(status.valid)
        yield "scan_age_seconds", _one(status.age_s)
        yield "scan_rate_hertz", _one(status.rate_hz)
        yield "clock_sd_seconds", _one(status.clock_sd_s)
        yield "contact", _enum("state", _CONTACTS, status.contact)

    def _delivery(self) -> Iterator[Family]:
        yield "scan_latency_seconds", list(self._latency.samples())
        yield "loop_lag_seconds", list(self._lag.samples())
        slips: list[Sample] = [
            ("", {"kind": kind, "suppressed": by or "no"}, n) for (kind, by), n in self._slips.items()
        ]
        yield "slip_onsets_total", slips
        yield "messages_refused_total", _one(self._dropped)

    def _disk(self) -> Iterator[Family]:
        recording = self._recording
        if recording is None:
            return
        yield "recording", _one(recording.state == "recording")
        yield "disk_free_bytes", _one(1e6 * recording.free_mb)
        yield "reads_unrecorded_total", _one(recording.reads_dropped)


def metrics_text(boards: Iterable[Metrics]) -> str:
    """Format the metrics of all boards for one scrape, each family once."""
    labels = {"version": __version__, "scan_path": compiled.path_words()}
    merged: dict[str, list[Sample]] = {"info": [("", labels, 1)]}
    for metrics in boards:
        for name, samples in metrics.families():
            merged.setdefault(name, []).extend(samples)
    return "".join(starmap(_family, merged.items()))


def _one(value: float) -> list[Sample]:
    return [("", {}, value)]


def _by(label: str, values: Mapping[str, float]) -> list[Sample]:
    return [("", {label: name}, value) for name, value in values.items()]


def _enum(label: str, names: Sequence[str], holds: str) -> list[Sample]:
    return _by(label, {name: name == holds for name in names})


def _family(name: str, samples: Sequence[Sample]) -> str:
    metric, name = METRICS[name], f"tactiled_{name}"
    lines = [f"# HELP {name} {metric.meaning}", f"# TYPE {name} {metric.kind}"]
    for ending, labels, value in samples:
        inside = ",".join(f'{label}="{_escaped(text)}"' for label, text in labels.items())
        lines.append(f"{name}{ending}{f'{{{inside}}}' if inside else ''} {_number(value)}")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return repr(float(value)) if value != int(value) else str(int(value))


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
