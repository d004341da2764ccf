"""``tactiled view --rerun``: a recording in the rerun viewer, with a blueprint of its views."""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactiled.array import Array
from tactiled.errors import DataError
from tactiled.events.types import (
    ContactEvent,
    Event,
    ForceEvent,
    GripEvent,
    ScanEvent,
    SlipEvent,
    TextureEvent,
)
from tactiled.recording.contents import RecordedEvent
from tactiled.recording.reader import Reached, in_order, read_items

_DISC_MM = 1.5  # radius of the largest load: less than half the pitch of the 2019 array
_ARROW_MM = 1.5


def view_in_rerun(paths: Sequence[Path], save: Path | None, reached: Reached | None = None) -> int:
    """Send a recording to the rerun viewer, or save it for that; return the number of events.

    Parameters
    ----------
    paths : sequence of Path
        Parts of one recording, in any order.
    save : Path, optional
        File (.rrd) to write instead of opening the viewer.
    reached : callable, optional
        Called with the fraction that has been read.

    Raises
    ------
    DataError
        A file is no recording, or has no events.
    """
    rr: Any = importlib.import_module("rerun")
    parts = in_order(paths)
    array = parts[0][1].source.array
    stream = rr.RecordingStream("tactiled")
    if save is None:
        stream.spawn(default_blueprint=_blueprint())
    else:
        stream.save(str(save), default_blueprint=_blueprint())
    picture = _Picture(rr, stream, array)
    n_events = 0
    for number, (path, _) in enumerate(parts):
        for item in read_items(path):
            if isinstance(item, RecordedEvent):
                stream.set_time("time", timestamp=item.event.time_s + item.unix_offset_s)
                picture.draw(item.event)
                n_events += 1
        if reached is not None:
            reached((number + 1) / len(parts))
    if not n_events:
        raise DataError(f"{parts[0][0]}: has no events")
    stream.flush()
    return n_events


class _Picture:
    """Entities of rerun for the events of one board.

    Places have y downwards in rerun's two-dimensional views, so that y of the array is turned round.
    """

    def __init__(self, rr: Any, stream: Any, array: Array) -> None:
        self._rr = rr
        self._stream = stream
        self._places = np.stack([array.x_mm, -array.y_mm], axis=1)
        self._zero = array.zero
        self._load = array.normal_weights()
        self._shear_x, self._shear_y = array.shear_weights()
        self._largest_load = self._largest_shear = 1e-9

    def draw(self, event: Event) -> None:
        """Log an event at the instant that the stream is at."""
        if isinstance(event, ScanEvent):
            self._scan(event)
        elif isinstance(event, GripEvent) and event.state != "none":
            for name in ("utilisation", "utilisation_low", "utilisation_high", "p_gross_100ms"):
                self._scalar(f"friction/{name}", getattr(event, name))
        elif isinstance(event, ForceEvent) and event.calibration != "none":
            for name in ("fx_n", "fy_n", "fz_n"):
                self._scalar(f"force/{name}", getattr(event, name))
        elif isinstance(event, SlipEvent):
            words = f"{event.kind} slip {event.state}, {event.direction_deg:.0f} deg" + (
                f", suppressed: {event.suppressed}" if event.suppressed else ""
            )
            self._text(words, "WARN" if event.valid and event.state == "onset" else "INFO")
        elif isinstance(event, ContactEvent):
            self._text(f"contact {event.previous} -> {event.state}", "INFO")
        elif isinstance(event, TextureEvent):
            words = f"grooves {event.period_mm:.4f} mm, {event.angle_deg:.2f} deg"
            self._text(words if event.status == "ok" else f"no groove estimate: {event.status}", "INFO")

    def _scan(self, scan: ScanEvent) -> None:
        readings = np.where(scan.valid, np.array(scan.volts) - self._zero, 0.0)
        load = np.maximum(self._load @ readings, 0.0)
        shear = np.stack([self._shear_x @ readings, -(self._shear_y @ readings)], axis=1)
        sizes = np.linalg.norm(shear, axis=1)
        self._largest_load = max(self._largest_load, float(load.max()))
        self._largest_shear = max(self._largest_shear, float(sizes.max()))
        radii = _DISC_MM * np.sqrt(load / self._largest_load)
        self._stream.log("skin/load", self._rr.Points2D(self._places, radii=radii, colors=[86, 180, 233]))
        vectors = _ARROW_MM * shear / self._largest_shear
        arrows = self._rr.Arrows2D(origins=self._places, vectors=vectors, colors=[20, 32, 44])
        self._stream.log("skin/shear", arrows)
        self._scalar("sums/load", float(load.sum()))
        self._scalar("sums/shear", float(np.linalg.norm(shear.sum(axis=0))))

    def _scalar(self, path: str, value: float) -> None:
        self._stream.log(path, self._rr.Scalars(value))

    def _text(self, words: str, level: str) -> None:
        self._stream.log("events", self._rr.TextLog(words, level=level))


def _blueprint() -> Any:
    """Views: the skin at the left; sums, friction, force and the events at the right."""
    rrb: Any = importlib.import_module("rerun.blueprint")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial2DView(origin="/skin", name="skin (mm)"),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="/sums", name="load and shear"),
                rrb.TimeSeriesView(origin="/friction", name="friction in use, gross slip"),
                rrb.TimeSeriesView(origin="/force", name="force (N)"),
                rrb.TextLogView(origin="/events", name="events"),
            ),
        ),
        collapse_panels=True,
    )
