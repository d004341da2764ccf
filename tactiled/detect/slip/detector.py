"""Early slip detector that decides on the response of the whole array ("coherent").

* Evidence (`slip.evidence`): shear of the array as a whole grows beyond noise, pressure and elastic play.
  That is "incipient": some part of the contact slips, or is about to. The instant is the kink's, when shear
  began to grow (`slip.kink`); no signal shows when a tenth of the contact slips, since friction is not known.
* Channels (`slip.stuck_channels`, `slip.segments`): what is missing, stuck or far noisier than most takes its taxel
  out, and events name the taxels that are left.
* Course (`slip.phases`): the growth stops while shear is large, and all slips: "gross", an event of its own
  with its own instant. Or it stops below, or goes back: the end of an incipient slip.
* A gross slip that turns back, turns, or sticks and grows again ends, and another begins at the same instant.
* While a slip goes on it is not said again; what came and went of late must grow beyond that to be said
  (`slip.swings`).
* A slip that lies wholly in a gap shows by the shear after it (`slip.gap`).

Nothing is said of an array out of contact, or while its mean pressure is not positive. Arrays without shear
channels see a load that moves between taxels; they tell no direction. One such taxel alone sees nothing.

`confidence` is the opposed part of opposed plus common rise, times the taxels' agreement on it, halved where
the contact's beginning was not seen; it is no probability.
"""

from collections.abc import Mapping

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.signal.contact import (
    ContactParams,
    ContactTracker,
    ContactTransition,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.signal.quantise import HeldReadings, Quantiser
from tactiled.detect.slip.alarm_rate import NOISE_PART, shear_at
from tactiled.detect.slip.evidence import ShearEvidence
from tactiled.detect.slip.gap import LOOK_SCANS, PreGapReadings
from tactiled.detect.slip.scan_evidence import ScanEvidence
from tactiled.detect.slip.stuck_channels import StuckChannelDetector
from tactiled.detect.slip.tracker import SlipTracker
from tactiled.events.types import ContactState, Event
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

# On the 2019 array shear over pressure is 1.9 times friction over load; 0.3 is the least friction of dry
# skins. Pairs of resistors around an electrode all work so; shear channels have any scale, and pads that feel
# shear as a load that moves have the scale of their thickness: there no size tells gross slip.
_GROSS_OF_PAIRS = 0.45
# Friction moves the load of a pad without shear channels by its height over the taxels' distance from the
# middle, 1.3 mm over some 4 mm: that is 0.3 times friction over load, a sixth of what pairs show.
_LOAD_MOVES = 1 / 6
_UNSEEN = ("corrupt", "missing")  # gaps in which the board went on as before
_PIECE_SCANS = 256  # filtered at once: bounds the memory of long blocks


class CoherentParams(Params):
    """Permitted false-alarm rate, and limits of shear for the surfaces in use."""

    false_alarms_per_hour: float = Field(
        default=150.0,
        gt=0,
        le=3600,
        description="of a hand that moves and does not say so: the growth of shear that counts follows",
    )
    least_shear: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="growth of shear over pressure, both in volts, that counts; the rate then is of "
        "noise alone; left out: as the rate has it",
    )
    gross_shear: float | None = Field(
        default=None,
        gt=0,
        le=5,
        description="shear over pressure below which nothing is gross; left out: as the array's kind has it",
    )
    contact: ContactParams = ContactParams()

    @property
    def shear(self) -> float:
        """Growth of shear over pressure that counts."""
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
"""Points on the curve of `slip.alarm_rate`: ``fast`` says any growth of shear, ``balanced`` what is more than the
first swing of a hum, ``quiet`` nearly all that a weak slip has."""


class CoherentSlip:
    """Detect contact and slip; a `Detector`.

    Parameters
    ----------
    array : Array
    params : CoherentParams
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
        self._story = SlipTracker(self._evidence, rate_hz, self._least_shear, self._gross_shear, self._before)

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._tracker.state if self._rate_hz else "none"

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes.

        A gap, or a new scan rate, ends a slip and a contact with events that are not valid: nobody saw
        them end. The detector then is as new, but compares the shear after a gap with that before.
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
        starts = range(0, len(item), _PIECE_SCANS)
        for piece in [item] if len(starts) == 1 else [item[n : n + _PIECE_SCANS] for n in starts]:
            events += self._process_piece(piece)
        self._last_time_s = float(item.time_s[-1])
        return events

    def _forget(self) -> list[Event]:
        events: list[Event] = [*self._story.cut_off(self._last_time_s)] if self._rate_hz else []
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
            held = HeldReadings(held.steps, held.ok & ~stuck)
        pressure = self._tracker.measure(block, held, stuck)
        gate = pressure.rows()
        events: list[Event] = []
        for stretch in self._evidence.stretches(held):
            self._story.shift(stretch.jump)
            for row in range(stretch.scans.stop - stretch.scans.start):
                scan = stretch.scans.start + row
                if change := self._tracker.step(*next(gate)):
                    events.append(contact_event(block, scan, pressure, change))
                now = ScanEvidence(self._array, self._evidence, block, stretch, row, self._n_seen)
                if (state := self._tracker.state) == "none":
                    slips = self._story.lift(now)
                else:
                    slips = self._story.look(now, stretch, row, is_sure=state != "unknown")
                self._evidence.learn(stretch, row, disturbed=self._story.happens)
                events += slips
                if change := self._follow():
                    events.append(contact_event(block, scan, pressure, change))
                self._n_seen += 1
        return events

    def _follow(self) -> ContactTransition | None:
        """Enter or leave the contact state sliding, which only gross slip shows."""
        state, is_gross = self._tracker.state, self._story.is_gross
        if is_gross and state not in ("sliding", "none"):
            return self._tracker.begin_sliding()
        return self._tracker.end_sliding() if state == "sliding" and not is_gross else None
