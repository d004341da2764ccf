"""The published procedure for grooved surfaces, online ("wang2019"); `grooves` has the equations.

Flow chart of Wang, Chen, Mei 2019: wait for slip; sample three taxels of a column for 10 s; estimate; if the
two periods disagree, sample again; else output their mean, and go on while slip lasts. Ours are:

* Windows begin `settle_s` after the scan that detected slip, so that the onset itself is not in them, and
  follow one another without overlap. They are counted in scans, so chunking does not matter.
* The signal of a taxel is one resistor, as in the paper's plots: the one (R1, say, in all three taxels) with
  the largest peak. The mean of four would do for pressure, but ripples of opposed resistors cancel in it.
* The speed is given. Without it (0) the procedure cannot answer: "no-slip", since a skin not known to move
  does not slide. A speed that changes within a window starts a new one.
* The direction is that of the slip event, unless configured. Towards the column (beyond 60 degrees from x),
  or where it is unknown, delays say nothing of the angle: "ambiguous", as for an array without a column.
* A slip that ends before any window was full is "no-slip"; late scans in the window are "stale"; no resistor
  with all but 1 % of its readings good in all three taxels is "saturated".
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect import grooves
from tactiled.detect.grooves import GrooveParams, Grooves, Motion
from tactiled.detect.quantise import Quantiser
from tactiled.events.types import Event, SlipEvent, TextureEvent
from tactiled.samples.block import Gap, ScanBlock

ESTIMATOR = "wang2019"
_MIN_WINDOW_SCANS = 8  # a spectrum of fewer has no peaks to find
_MAX_BAD_PART = 0.01  # held readings that a spectrum does not notice


class TextureParams(GrooveParams):
    """The published procedure; the defaults are the paper's."""

    window_s: float = Field(default=10.0, gt=0, le=120, description="length of a window")
    settle_s: float = Field(default=1.0, ge=0, le=60, description="from detected slip to the first window")
    column: int = Field(default=0, ge=0, description="which column, counted along x within each pad")
    speed_mm_s: float = Field(default=0.0, ge=0, description="sliding speed; 0: not known")
    speed_sd_mm_s: float = Field(default=0.0, ge=0, description="its standard deviation")
    direction_deg: float | None = Field(
        default=None,
        ge=-180,
        le=180,
        description="of the skin's motion, from +x towards +y; left out: as slip says",
    )


class PaperTexture:
    """Texture events by the published procedure.

    Parameters
    ----------
    array : Array
    params : TextureParams
    """

    def __init__(self, array: Array, params: TextureParams | None = None) -> None:
        self._array = array
        self._params = params or TextureParams()
        columns = array.columns()
        self._taxels = columns[min(self._params.column, len(columns) - 1)][:3] if columns else []
        self._resistors = _resistors(array, self._taxels)
        self._grid = Quantiser(array)
        self.reset()

    def reset(self) -> None:
        """Forget everything seen, and every speed set since; keep the parameters."""
        self._speed_mm_s = self._params.speed_mm_s
        self._speeds: list[tuple[int, float]] = []
        self._stop()

    def _stop(self) -> None:
        self._slip: SlipEvent | None = None
        self._answered = False
        self._begin_index = 0
        self._n_gathered = 0

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Speed that holds from a scan on (or from the next scan to come, if that one is past)."""
        self._speeds.append((from_index, speed_mm_s))
        self._speeds.sort(key=lambda entry: entry[0])

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Events that the item completes.

        Parameters
        ----------
        item : ScanBlock or Gap
            A gap discards the window, and waits for slip anew.
        slip : sequence of Event
            What the slip detector said of the same item; events of other topics are passed over.
        """
        if isinstance(item, Gap):
            self._stop()
            return []
        events: list[Event] = []
        done = 0
        for change in slip:
            if isinstance(change, SlipEvent):
                scan = min(int(np.searchsorted(item.time_s, change.detected_s)), len(item) - 1)
                if scan > done:
                    events += self._gather(item[done:scan])
                    done = scan
                events += self._turn(change, item, scan)
        events += self._gather(item[done:])
        return events

    def _turn(self, change: SlipEvent, block: ScanBlock, scan: int) -> list[Event]:
        """Take in that slip began or ended at a scan."""
        if change.state == "onset":
            self._stop()
            self._slip = change
            self._begin_index = int(block.index[scan]) + round(self._params.settle_s * block.rate_hz)
            return []
        events: list[Event] = []
        if self._slip is not None and not self._answered:
            time_s = float(block.time_s[scan])
            events.append(self._event(time_s, self._n_gathered / block.rate_hz, Grooves("no-slip")))
        self._stop()
        return events

    def _gather(self, block: ScanBlock) -> list[Event]:
        """Fill windows from scans between which nothing happens but, perhaps, a change of speed."""
        events: list[Event] = []
        while True:
            index = int(block.index[0])
            self._change_speed(index)
            n = len(block)
            if self._speeds:
                n = min(n, self._speeds[0][0] - index)
            if self._slip is not None and n > (wait := max(0, self._begin_index - index)):
                events += self._fill(block[wait:n])
            if n == len(block):
                return events
            block = block[n:]

    def _change_speed(self, index: int) -> None:
        while self._speeds and self._speeds[0][0] <= index:
            _, speed_mm_s = self._speeds.pop(0)
            if speed_mm_s != self._speed_mm_s:
                self._speed_mm_s, self._n_gathered = speed_mm_s, 0

    def _fill(self, block: ScanBlock) -> list[Event]:
        events: list[Event] = []
        n_window = max(_MIN_WINDOW_SCANS, round(self._params.window_s * block.rate_hz))
        done = 0
        while done < len(block):
            if self._n_gathered == 0:
                self._volts = np.empty((n_window, self._array.n_channels))
                self._good = np.empty((n_window, self._array.n_channels), dtype=np.bool_)
                self._late = False
            part = block[done : done + n_window - self._n_gathered]
            rows = slice(self._n_gathered, self._n_gathered + len(part))
            self._volts[rows] = part.volts
            # Too large to be a reading is no reading; NaN compares false.
            self._good[rows] = part.valid & (np.abs(part.volts) <= self._grid.full_scale_volts)
            self._late = self._late or bool(part.late.any())
            self._n_gathered += len(part)
            done += len(part)
            if self._n_gathered == n_window:
                found = self._estimate(block.rate_hz, block.channel_offset_s)
                events.append(self._event(float(part.time_s[-1]), n_window / block.rate_hz, found))
                self._answered, self._n_gathered = True, 0
        return events

    def _estimate(self, rate_hz: float, channel_offset_s: FloatArray) -> Grooves:
        if self._late:
            return Grooves("stale")
        if self._speed_mm_s <= 0 or self._slip is None:
            return Grooves("no-slip")
        if not self._resistors:
            return Grooves("ambiguous")
        enough = self._good.mean(axis=0) >= 1 - _MAX_BAD_PART
        resistors = [channels for channels in self._resistors if enough[channels].all()]
        if not resistors:
            return Grooves("saturated")
        signals = [self._signal(channels) for channels in resistors]
        step = self._grid.volts_per_step
        strengths = [_strength(grooves.spectrum(signal, rate_hz, step, self._params)) for signal in signals]
        best = max(range(len(signals)), key=strengths.__getitem__)
        direction_deg, direction_sd_deg = self._slip.direction_deg, self._slip.direction_sd_deg
        if self._params.direction_deg is not None:
            direction_deg, direction_sd_deg = self._params.direction_deg, 0.0
        return grooves.estimate(
            signals[best],
            rate_hz,
            step,
            self._array.y_mm[self._taxels],
            channel_offset_s[resistors[best]],
            Motion(self._speed_mm_s, self._params.speed_sd_mm_s, direction_deg, direction_sd_deg),
            self._params,
        )

    def _signal(self, channels: NDArray[np.int64]) -> FloatArray:
        """Readings (n, taxels) of one resistor of each taxel; the few bad ones are bridged by a line."""
        scans = np.arange(len(self._volts))
        columns = []
        for channel in channels:
            good = self._good[:, channel]
            columns.append(np.interp(scans, scans[good], self._volts[good, channel]))
        return np.stack(columns, axis=1)

    def _event(self, time_s: float, window_s: float, found: Grooves) -> TextureEvent:
        return TextureEvent(
            time_s=time_s,
            status=found.status,
            period_mm=found.period_mm,
            period_sd_mm=found.period_sd_mm,
            angle_deg=found.angle_deg,
            angle_sd_deg=found.angle_sd_deg,
            speed_mm_s=self._speed_mm_s,
            speed_sd_mm_s=self._params.speed_sd_mm_s if self._speed_mm_s > 0 else 0.0,
            speed_source="given" if self._speed_mm_s > 0 else "none",
            frequency_hz=found.frequency_hz,
            window_s=window_s,
            snr_db=found.snr_db,
            candidates=found.candidates,
            estimator=ESTIMATOR,
        )


def _resistors(array: Array, taxels: list[int]) -> list[NDArray[np.int64]]:
    """Channels that measure the same thing in each of the taxels: R1 of all, R2 of all, ..."""
    found: dict[tuple[str, float], list[int]] = {}
    for taxel in taxels:
        for channel in np.flatnonzero(array.channel_taxel == taxel).tolist():
            azimuth_deg = float(np.nan_to_num(array.azimuth_deg[channel]))
            found.setdefault((array.channel_kind[channel], azimuth_deg), []).append(channel)
    return [
        np.array(channels)
        for channels in found.values()
        if [int(array.channel_taxel[c]) for c in channels] == taxels
    ]


def _strength(seen: grooves.Spectrum) -> tuple[bool, float]:
    return seen.status == "ok", float((seen.amplitude_volts[seen.peak] ** 2).sum())
