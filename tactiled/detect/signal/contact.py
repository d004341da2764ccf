"""Contact gate with the states none, loading, holding and sliding.

Wang, Chen, Mei 2019 call voltages above 0.5 V clear enough to analyse: a taxel whose pressure response
(mean of its four resistors, or its normal channel) exceeds that is in contact. A reading of one resistor
alone is a fault and no contact: a press loads all four, and shear relieves two at most. Loading and
holding are distinguished by the slope of the array's pressure response, a least-squares line over a short
window. A falling pressure is neither: the state stays and only the count of steady scans starts anew.

`ContactTracker` is the state machine. `ContactGate` makes a detector of it. Sliding cannot be seen from
pressure: the slip detector owns a tracker and calls `begin_sliding` and `end_sliding` (see `wang2019.slip`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.quantise import HeldReadings, Quantiser
from tactiled.events.types import ContactEvent, ContactState, Event
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

# A side is clipped to this multiple of the mean of the other sides of its taxel. With two sides fully
# relieved and their load on the third, the multiple would be three.
_ONE_SIDE = 5.0
_LEAST_SIDES = 3  # of two readings that differ, the wrong one cannot be identified


class ContactParams(Params):
    """Thresholds for contact and for a steady load."""

    contact_volts: float = Field(
        default=0.5, gt=0, description="pressure response of a taxel in contact; 0.5 V in the 2019 paper"
    )
    release_volts: float = Field(
        default=0.35, gt=0, description="contact is lost when every taxel is below; lower than contact_volts"
    )
    # 20 N in 8 s, the paper's slowest press, is about 0.1 V/s; creep in a hold is below 0.01 V/s.
    loading_volts_s: float = Field(
        default=0.03, gt=0, description="mean pressure response rising faster than this is loading"
    )
    slope_window_s: float = Field(default=0.3, gt=0, le=1, description="window of the slope's line fit")
    settle_s: float = Field(default=0.2, ge=0, le=10, description="steady for so long before it is a hold")


@dataclass(frozen=True, eq=False)
class PressureMeasurement:
    """Measurements of the contact gate for n scans.

    Attributes
    ----------
    taxel_touches : (n, taxels) bool
    touches, released : (n,) bool
        Some taxel above `contact_volts`; every taxel below `release_volts`.
    slope_volts_s : (n,) float64
        Slope of the pressure response, for each taxel in contact.
    """

    taxel_touches: NDArray[np.bool_]
    touches: NDArray[np.bool_]
    released: NDArray[np.bool_]
    slope_volts_s: FloatArray

    def rows(self) -> Iterator[tuple[bool, bool, float]]:
        """Iterate over the arguments of `ContactTracker.step`, scan by scan."""
        return zip(self.touches.tolist(), self.released.tolist(), self.slope_volts_s.tolist(), strict=True)


class ContactTransition(NamedTuple):
    """Change of the contact's state."""

    previous: ContactState
    state: ContactState


class ContactTracker:
    """State machine of the contact, one scan at a time.

    Parameters
    ----------
    array : Array
    params : ContactParams
    rate_hz : float

    Attributes
    ----------
    state : str
    """

    def __init__(self, array: Array, params: ContactParams, rate_hz: float) -> None:
        self._params = params
        self._grid = Quantiser(array)
        weights = array.normal_weights()
        self._signs = np.sign(weights).T.copy()  # (channels, taxels): whole, so that sums are exact
        self._sign = self._signs.sum(axis=1)  # a channel is of one taxel
        self._counted = np.abs(self._signs)
        # Taxels may have different numbers of pressure channels: a common denominator keeps weights whole.
        counts = np.maximum(self._counted.sum(axis=0), 1).astype(np.int64)
        self._denominator = float(np.lcm.reduce(counts))
        self._total_weights = np.rint(weights.sum(axis=0) * self._denominator)
        own = [np.flatnonzero(column) for column in self._counted.T]
        most = max(1, *map(len, own))
        self._own = np.array([np.resize(row, most) for row in own])  # (taxels, channels of one)
        n = max(3, round(params.slope_window_s * rate_hz))
        # Least-squares slope of n even samples: sum (k - mean) v / sum (k - mean)^2, here with whole weights.
        self._line = 2.0 * np.arange(n) - (n - 1)
        self._slope_scale = (
            self._grid.volts_per_step / self._denominator * rate_hz * 2 / float(self._line @ self._line)
        )
        self._settle_scans = max(1, round(params.settle_s * rate_hz))
        self.state: ContactState = "none"
        self._is_first = True
        self._totals: FloatArray | None = None
        self._steady = 0
        self._steady_before = 0  # length of the steady stretch before this unsteady one
        self._unsteady = 0

    def measure(
        self, block: ScanBlock, held: HeldReadings, stuck: NDArray[np.bool_] | None = None
    ) -> PressureMeasurement:
        """Measure the pressure in each scan of a block.

        A saturated reading still means "pressed": contact uses every finite reading except those known to
        be `stuck` (n, channels). The slope uses held readings, since a channel that drops out is no change
        of load.
        """
        if held.ok.all():
            steps, readings = held.steps, self._counted.sum(axis=0)
        else:
            counts = ~np.isnan(block.volts) if stuck is None else ~(np.isnan(block.volts) | stuck)
            steps = np.where(counts, self._grid.round(block.volts), 0.0)
            readings = counts.astype(np.float64) @ self._counted
        pressure = self._sums(steps, readings) * self._grid.volts_per_step / np.maximum(readings, 1.0)
        taxel_touches = pressure > self._params.contact_volts
        n_touching = taxel_touches.sum(axis=1)
        return PressureMeasurement(
            taxel_touches=taxel_touches,
            touches=n_touching > 0,
            released=(pressure < self._params.release_volts).all(axis=1),
            slope_volts_s=self._slope(held.steps) / np.maximum(n_touching, 1),
        )

    def _sums(self, steps: FloatArray, readings: FloatArray) -> FloatArray:
        """Sum the steps of each taxel (n, taxels); whole numbers except where one side was clipped."""
        sums = steps @ self._signs
        largest = (steps * self._sign)[:, self._own].max(axis=2)
        rest = sums - largest
        bounded = rest + np.minimum(largest, _ONE_SIDE / np.maximum(readings - 1, 1.0) * rest)
        return np.where(readings >= _LEAST_SIDES, bounded, sums)

    def _slope(self, steps: FloatArray) -> FloatArray:
        totals = steps @ self._total_weights
        before = self._totals if self._totals is not None else np.full(len(self._line) - 1, totals[0])
        seen = np.concatenate([before, totals])
        self._totals = seen[len(totals) :].copy()
        slope: FloatArray = np.correlate(seen, self._line, "valid") * self._slope_scale
        return slope

    def step(self, touches: bool, released: bool, slope_volts_s: float) -> ContactTransition | None:
        """Process one scan and return the change of state, if any."""
        self._follow_load(slope_volts_s)
        is_first, self._is_first = self._is_first, False
        if self.state == "none":
            if touches and is_first:
                return self._go("unknown")
            self._steady = self._steady_before = 0  # a steady signal before the touch is no hold
            return self._go("loading") if touches else None
        if released:
            return self._go("none")
        if self.state == "loading" and self._steady >= self._settle_scans:
            return self._go("holding")
        if self.state == "holding" and slope_volts_s > self._params.loading_volts_s:
            return self._go("loading")
        return None

    def _follow_load(self, slope_volts_s: float) -> None:
        if abs(slope_volts_s) <= self._params.loading_volts_s:
            self._steady += 1
            return
        if self._steady >= self._settle_scans:
            self._steady_before, self._unsteady = self._steady, 0
        self._steady = 0
        self._unsteady += 1

    def was_steady(self, for_scans: int, within_scans: int) -> bool:
        """Return True if the load was steady for `for_scans` scans, ending at most `within_scans` ago."""
        if self._steady >= for_scans:
            return True
        since_lost = self._unsteady + self._steady
        return self._steady_before >= for_scans and since_lost <= within_scans

    def begin_sliding(self) -> ContactTransition:
        """Enter the state sliding; called by the slip detector."""
        return self._go("sliding")

    def end_sliding(self) -> ContactTransition:
        """Return to the state holding; called by the slip detector."""
        return self._go("holding")

    def _go(self, state: ContactState) -> ContactTransition:
        transition = ContactTransition(self.state, state)
        self.state = state
        return transition


def contact_event(
    block: ScanBlock, scan: int, pressure: PressureMeasurement, change: ContactTransition
) -> ContactEvent:
    """Make the event for a change of state at a scan of a block; not valid when the scan came late."""
    return ContactEvent(
        time_s=float(block.time_s[scan]),
        state=change.state,
        previous=change.previous,
        taxels=tuple(np.flatnonzero(pressure.taxel_touches[scan]).tolist()),
        valid=not block.late[scan],
    )


def lost_contact_event(time_s: float, previous: ContactState) -> ContactEvent:
    """Make the event for a contact that a gap cut off after the scan at `time_s`."""
    return ContactEvent(time_s=time_s, state="none", previous=previous, taxels=(), valid=False)


class ContactGate:
    """Contact events from pressure alone: none, loading, holding.

    Parameters
    ----------
    array : Array
    params : ContactParams
    """

    def __init__(self, array: Array, params: ContactParams | None = None) -> None:
        self._array = array
        self._params = params or ContactParams()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._quantiser = Quantiser(self._array)
        self._tracker: ContactTracker | None = None
        self._rate_hz = 0.0
        self._last_time_s = 0.0

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes; a gap ends a contact with an event that is not valid."""
        if isinstance(item, Gap):
            return self._forget()
        events = self._forget() if item.rate_hz != self._rate_hz else []
        if self._tracker is None:
            self._tracker = ContactTracker(self._array, self._params, item.rate_hz)
            self._rate_hz = item.rate_hz
        self._last_time_s = float(item.time_s[-1])
        pressure = self._tracker.measure(item, self._quantiser.process(item))
        for scan, values in enumerate(pressure.rows()):
            if change := self._tracker.step(*values):
                events.append(contact_event(item, scan, pressure, change))
        return events

    def _forget(self) -> list[Event]:
        events: list[Event] = []
        if self._tracker is not None and self._tracker.state != "none":
            events.append(lost_contact_event(self._last_time_s, self._tracker.state))
        self.reset()
        return events
