"""Metrics for Prometheus: counters, gauges and histograms in its text format.

They are computed from the published events, so that a graph shows what subscribers received. The format
is version 0.0.4 of prometheus.io/docs/instrumenting/exposition_formats: base units, counters that end in
``_total``, histograms with cumulative buckets.
"""

import bisect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import accumulate
from typing import Literal, get_args

from tactiled import compiled
from tactiled.daemon.serial.device import LineErrors
from tactiled.events.types import (
    BoardState,
    Event,
    RecordingEvent,
    ScanEvent,
    Sent,
    SlipEvent,
    StatusEvent,
    Suppressed,
)
from tactiled.pipeline import Health
from tactiled.version import __version__

# From the transfer of one frame (7 ms at 115200 baud) over FTDI buckets (16 ms) and stalls to backlogs.
_LATENCY_S = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)
# From a frame with warm caches (50 us) over cold caches to a host that has stopped working.
_HANDLING_S = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.1, 1.0)
_CONTACTS = get_args(Health.__annotations__["contact"])
_STATES = get_args(BoardState)

Kind = Literal["counter", "gauge", "histogram"]
Sample = tuple[str, Mapping[str, str], float]
"""Suffix of the metric name, labels, value."""
Family = tuple[str, Kind, str, list[Sample]]
"""Name without prefix, kind, description, samples."""


class Histogram:
    """Counts of values by interval; made cumulative by `samples`.

    Parameters
    ----------
    bounds : sequence of float
        Upper bounds in ascending order; a further interval above the last is added.
    """

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
        self._handling = Histogram(_HANDLING_S)
        self._lag = Histogram(_HANDLING_S)
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

    def handled(self, duration_s: float) -> None:
        """Count the handling time of a read of the port, from its arrival to its last message."""
        self._handling.add(duration_s)

    def families(self) -> Iterator[Family]:
        """Yield all metrics, with the serial number of the board as label ``board``."""
        board = {"board": self._board()}
        for name, kind, words, samples in (
            *self._line(), *self._state(), *self._delivery(), *self._disk()
        ):  # fmt: skip
            yield name, kind, words, [(end, {**board, **labels}, value) for end, labels, value in samples]

    def _line(self) -> Iterator[Family]:
        health = self._health()
        frames = {"good": health.frames, **health.corrupt_by_reason}
        what = "Frames by result: good, or why they were rejected."
        yield "frames_total", "counter", what, _by("result", frames)
        scans = {
            "received": health.scans, "missing": health.scans_missing, "duplicate": health.scans_duplicate
        }  # fmt: skip
        yield "scans_total", "counter", "Scans the board took, by what became of them.", _by("result", scans)
        became = {"framed": health.bytes_framed, "discarded": health.bytes_discarded}
        yield "bytes_total", "counter", "Bytes received, by what became of them.", _by("result", became)
        what = "Groove fits that were not ready at the scan at which they were due."
        yield "fits_late_total", "counter", what, _one(health.fits_late)
        yield "board_restarts_total", "counter", "How often the board booted.", _one(health.restarts)
        if (errors := self._line_errors()) is not None:
            counts = {"framing": errors.framing, "overrun": errors.overrun}
            yield "uart_errors_total", "counter", "Errors that the UART's driver counts.", _by("kind", counts)

    def _state(self) -> Iterator[Family]:
        status = self._status
        if status is None:
            return
        yield "state", "gauge", "1 for the state that holds.", _enum("state", _STATES, status.state)
        yield "valid", "gauge", "1 while the tactile data are fresh.", _one(status.valid)
        yield "scan_age_seconds", "gauge", "Age of the newest scan.", _one(status.age_s)
        yield "scan_rate_hertz", "gauge", "Scan rate, as the board says.", _one(status.rate_hz)
        yield "clock_sd_seconds", "gauge", "Sigma of scan instants; 1e9: unknown.", _one(status.clock_sd_s)
        yield (
            "clock_drift_ratio",
            "gauge",
            "Board clock slow relative to the host clock, as a ratio.",
            _one(1e-6 * status.clock_rate_ppm),
        )
        yield "contact", "gauge", "1 for the state that holds.", _enum("state", _CONTACTS, status.contact)
        yield "slipping", "gauge", "Whether slip has begun and not ended.", _one(status.slipping)
        yield (
            "inhibited_seconds",
            "gauge",
            "Remaining time for which slips are marked as not valid.",
            _one(status.inhibited_s),
        )
        yield "connects_total", "counter", "How often the port was opened.", _one(status.connects)
        yield "uptime_seconds", "gauge", "Since the daemon started.", _one(status.uptime_s)

    def _delivery(self) -> Iterator[Family]:
        what = "From a scan's instant to its handling."
        yield "scan_latency_seconds", "histogram", what, list(self._latency.samples())
        what = "Longest turn of the event loop in each tenth of a second."
        yield "loop_lag_seconds", "histogram", what, list(self._lag.samples())
        what = "From bytes in hand to messages sent."
        yield "handling_seconds", "histogram", what, list(self._handling.samples())
        slips: list[Sample] = [
            ("", {"kind": kind, "suppressed": by or "no"}, n) for (kind, by), n in self._slips.items()
        ]
        yield "slip_onsets_total", "counter", "Onsets of slip, and which announcement explains them.", slips
        if self._status is not None:
            sent = {field.name: getattr(self._status.sent, field.name) for field in fields(Sent)}
            yield "messages_total", "counter", "Messages of this board by topic.", _by("topic", sent)
        what = "Messages dropped for subscribers without keys that do not keep up."
        yield "messages_refused_total", "counter", what, _one(self._dropped)

    def _disk(self) -> Iterator[Family]:
        recording = self._recording
        if recording is None:
            return
        yield (
            "recording",
            "gauge",
            "Whether a recording is being written.",
            _one(recording.state == "recording"),
        )
        yield "recorded_bytes", "gauge", "Size of the recording.", _one(recording.bytes_written)
        yield "disk_free_bytes", "gauge", "Free disk space at the recording.", _one(1e6 * recording.free_mb)
        yield "reads_unrecorded_total", "counter", "Reads that are in no file.", _one(recording.reads_dropped)
        yield "reads_waiting", "gauge", "Items that wait for the disk.", _one(recording.reads_waiting)


def metrics_text(boards: Iterable[Metrics]) -> str:
    """Format the metrics of all boards for one scrape, each family once."""
    labels = {"version": __version__, "scan_path": compiled.path_words()}
    version: Family = ("info", "gauge", "Version of tactiled, and the path of a scan.", [("", labels, 1)])
    merged: dict[str, Family] = {"info": version}
    for metrics in boards:
        for family in metrics.families():
            merged.setdefault(family[0], (*family[:3], []))[3].extend(family[3])
    return "".join(_family(*family) for family in merged.values())


def _one(value: float) -> list[Sample]:
    return [("", {}, value)]


def _by(label: str, values: Mapping[str, float]) -> list[Sample]:
    return [("", {label: name}, value) for name, value in values.items()]


def _enum(label: str, names: Sequence[str], holds: str) -> list[Sample]:
    return _by(label, {name: name == holds for name in names})


def _family(name: str, kind: Kind, words: str, samples: Sequence[Sample]) -> str:
    name = f"tactiled_{name}"
    lines = [f"# HELP {name} {words}", f"# TYPE {name} {kind}"]
    for ending, labels, value in samples:
        inside = ",".join(f'{label}="{_escaped(text)}"' for label, text in labels.items())
        lines.append(f"{name}{ending}{f'{{{inside}}}' if inside else ''} {_number(value)}")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return repr(float(value)) if value != int(value) else str(int(value))


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
