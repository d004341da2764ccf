"""Slip detector on the summed shear response of the array ("coherent").

1. `slip.segments` filters the response of all usable taxels. `signal.stuck_channels` finds channels that do
   not follow the load; a missing, stuck or far noisier channel takes its taxel out of the response.
2. `slip.evidence` tests whether shear grows by more than noise, pressure and elastic deformation explain. If
   so, an "incipient" onset is reported: a part of the contact slips, or is about to. Its instant is when the
   shear began to grow (`slip.kink`).
3. `slip.phases` follows the slip. If the growth stops at a large shear, the slip is "gross", which is a
   second event with its own instant. If it stops at a small shear, or the shear falls back, the incipient
   slip ends.
4. `slip.gross` follows a gross slip. If it changes direction, reverses, or sticks and then grows again, it
   ends and the next slip begins at the same instant.
5. `slip.tracker` reports each slip once. After a swing of shear, a new slip must exceed that swing
   (`slip.swings`).
6. `slip.gap` compares the shear before and after a gap, to find a slip that happened inside it.

Nothing is reported without contact, or while the mean pressure is not positive. Arrays without shear channels
measure a load that moves between taxels, without a direction; one such taxel alone measures nothing.

`confidence` is the share of the opposed in the whole rise, times the agreement of the taxels on it, halved
where the beginning of the contact was not observed. It is not a probability.
"""

from collections.abc import Mapping

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.signal.contact import (
    ContactParams,
    ContactTracker,
    ContactTransition,
    PressureMeasurement,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.signal.quantise import HeldReadings, Quantiser
from tactiled.detect.signal.stuck_channels import StuckChannelDetector
from tactiled.detect.slip.alarm_rate import NOISE_PART, shear_at
from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.gap import LOOK_SCANS, PreGapReadings
from tactiled.detect.slip.scan_evidence import ScanEvidence
from tactiled.detect.slip.segments import PIECE_SCANS, TaxelSetSegment
from tactiled.detect.slip.tracker import SlipTracker
from tactiled.events.types import ContactState, Event
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

# On the 2019 array, shear over pressure (in volts) is 1.9 times tangential over normal load, and 0.3 is the
# lowest friction coefficient of dry skins. This ratio holds for all pairs of resistors around an electrode.
# Other channels have other scales, for which no size indicates gross slip.
_GROSS_OF_PAIRS = 0.45
# Tangential load moves the centre of load of a pad without shear channels by the pad's height: 1.3 mm, over
# taxels that are about 4 mm from the middle. That is 0.3 times the ratio of the loads, a sixth of what
# resistor pairs show.
_LOAD_MOVES = 1 / 6
_UNSEEN = ("corrupt", "missing")  # causes of gaps during which the board kept scanning


class CoherentParams(Params):
    """Permitted false-alarm rate, and limits of shear for the surfaces in use."""

    false_alarms_per_hour: float = Field(
        default=150.0,
        gt=0,
        le=3600,
        description="of a hand that moves unannounced; sets the growth of shear that is required",
    )
    least_shear: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="required growth of shear over pressure, both in volts; the rate is then that of "
        "noise alone; left out: follows from the rate",
    )
    gross_shear: float | None = Field(
        default=None,
        gt=0,
        le=5,
        description="shear over pressure below which no slip is gross; left out: that of the array's kind",
    )
    contact: ContactParams = ContactParams()

    @property
    def shear(self) -> float:
        """Required growth of shear over pressure."""
        return shear_at(self.false_alarms_per_hour) if self.least_shear is None else self.least_shear

    @property
    def noise_per_hour(self) -> float:
        """False alarms per hour that noise alone may cause."""
        return self.false_alarms_per_hour * (NOISE_PART if self.least_shear is None else 1.0)


SETTINGS: Mapping[str, CoherentParams] = {
    "fast": CoherentParams(false_alarms_per_hour=300.0),
    "balanced": CoherentParams(false_alarms_per_hour=150.0),
    "quiet": CoherentParams(false_alarms_per_hour=6.0),
}
"""Points on the curve of `slip.alarm_rate`.

``fast`` reports any growth of shear. ``balanced`` requires more than the first swing of a hum. ``quiet``
requires nearly all the shear of a slip on a surface of low friction.
"""


class CoherentSlip:
    """Detect contact and slip; a `Detector`.

    Parameters
    ----------
    array : Array
    params : CoherentParams

    Examples
    --------
    A press, then shear along +x by Mindlin's curve from 4.0 s, until all of the contact slips at 4.8 s:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.samples.block import regular_block
    >>> array, rng, time_s = load_array("wang2019-3x3"), np.random.default_rng(0), np.arange(600) / 100
    >>> travel = np.clip((time_s - 4) / 0.8, 0, 1)[:, np.newaxis]
    >>> shear_volts = 0.4 * (1 - (1 - travel) ** 1.5) * np.tile([1, 0, -1, 0], 9)
    >>> load_volts = np.clip(time_s - 1, 0, 1)[:, np.newaxis]
    >>> volts = load_volts + shear_volts + 1e-4 * rng.standard_normal((600, 36))
    >>> for event in CoherentSlip(array).process(regular_block(volts, 100.0)):
    ...     if event.topic == "slip":
    ...         print(f"{event.detected_s:.2f} s: {event.kind}, since {event.onset_s:.2f} s")
    4.08 s: incipient, since 4.00 s
    4.77 s: gross, since 4.73 s
    """

    def __init__(self, array: Array, params: CoherentParams | None = None) -> None:
        self._array = array
        self._params = params or CoherentParams()
        self._least_shear = self._params.shear * (1.0 if array.has_shear else _LOAD_MOVES)
        of_kind = _GROSS_OF_PAIRS if "side" in array.channel_kind else 0.0
        self._gross_shear = of_kind if self._params.gross_shear is None else self._params.gross_shear
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._rate_hz = 0.0  # nothing seen
        self._last_time_s = 0.0
        self._before: PreGapReadings | None = None  # readings before a gap
        self._stuck = StuckChannelDetector(self._array)

    def _start(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._quantiser = Quantiser(self._array)
        self._tracker = ContactTracker(self._array, self._params.contact, rate_hz)
        self._evidence = ShearEvidence(self._array, rate_hz, self._params.noise_per_hour, self._least_shear)
        self._n_seen = 0
        self._slips = SlipTracker(self._evidence, rate_hz, self._least_shear, self._gross_shear, self._before)

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._tracker.state if self._rate_hz else "none"

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes.

        A gap or a new scan rate ends slip and contact with events that are not valid, because their end was
        not observed. The detector is then reset, except that it compares the shear after a gap with that
        before.
        """
        if isinstance(item, Gap):
            before = None
            if self.contact_state != "none" and item.cause in _UNSEEN:
                before = PreGapReadings(self._last_time_s, self._evidence.newest(LOOK_SCANS), self._evidence)
            events = self._forget()
            self._before = before
            return events
        events = self._forget() if self._rate_hz not in (0.0, item.rate_hz) else []
        if not self._rate_hz:
            self._start(item.rate_hz)
        starts = range(0, len(item), PIECE_SCANS)
        for piece in [item] if len(starts) == 1 else [item[n : n + PIECE_SCANS] for n in starts]:
            events += self._process_piece(piece)
        self._last_time_s = float(item.time_s[-1])
        return events

    def _forget(self) -> list[Event]:
        events: list[Event] = [*self._slips.cut_off(self._last_time_s)] if self._rate_hz else []
        if self.contact_state != "none":
            events.append(lost_contact_event(self._last_time_s, self.contact_state))
        stuck = self._stuck  # stuck channels stay stuck over a gap
        self.reset()
        self._stuck = stuck
        return events

    def _process_piece(self, block: ScanBlock) -> list[Event]:
        held = self._quantiser.process(block)
        stuck = self._stuck.process(held.steps)
        if stuck.any():
            held = HeldReadings(held.steps, held.ok & ~stuck, False)
        pressure = self._tracker.measure(block, held, stuck)
        gate = pressure.rows()
        events: list[Event] = []
        evidence, slips = self._evidence, self._slips
        for segment in evidence.segments(held):
            if segment.jump is not None:
                slips.shift(segment.jump)
            last = len(segment.fits) - 1
            n_quiet, n_to_group = 0, evidence.n_to_group  # quiet scans that are not taken in yet
            for row in range(last + 1):
                change = self._tracker.step(*next(gate))
                state = self._tracker.state
                self._n_seen += 1
                if change is None and slips.is_quiet(segment, row, self._n_seen - 1, state):
                    n_quiet += 1
                    if n_quiet < n_to_group and row < last:
                        continue
                    self._pass_quiet(segment, row + 1, n_quiet, self._n_seen, state)
                else:
                    before = state if change is None else change.previous
                    self._pass_quiet(segment, row, n_quiet, self._n_seen - 1, before)
                    events += self._look(block, segment, row, pressure, change)
                n_quiet, n_to_group = 0, evidence.n_to_group
        return events

    def _pass_quiet(
        self, segment: TaxelSetSegment, row: int, n: int, index: int, state: ContactState
    ) -> None:
        """Take in the n quiet scans before a row of a segment, which is scan `index`."""
        if n:
            self._slips.pass_quiet(segment, row - n, n, index - n, state)
            self._evidence.learn(segment, row - n, n, disturbed=False)

    def _look(
        self,
        block: ScanBlock,
        segment: TaxelSetSegment,
        row: int,
        pressure: PressureMeasurement,
        change: ContactTransition | None,
    ) -> list[Event]:
        """Return the events of a scan in which something may happen, with those of a change of contact."""
        scan, state = segment.scans.start + row, self._tracker.state
        events: list[Event] = [contact_event(block, scan, pressure, change)] if change else []
        now = ScanEvidence(self._array, self._evidence, block, segment, row, self._n_seen - 1)
        if state == "none":
            events += self._slips.lift(now)
        else:
            events += self._slips.look(now, segment, row, is_sure=state != "unknown")
        self._evidence.learn(segment, row, disturbed=self._slips.is_active)
        if change := self._follow():
            events.append(contact_event(block, scan, pressure, change))
        return events

    def _follow(self) -> ContactTransition | None:
        """Enter or leave the contact state sliding, which only gross slip shows."""
        state, is_gross = self._tracker.state, self._slips.is_gross
        if is_gross and state not in ("sliding", "none"):
            return self._tracker.begin_sliding()
        return self._tracker.end_sliding() if state == "sliding" and not is_gross else None
