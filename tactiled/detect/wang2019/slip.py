"""The published slip rule: a coif1 coefficient above 0.002 V, and which of two peaks it is ("wang2019").

Wang, Chen, Mei, Micromachines 2019, 10(9), 579, see two peaks in the wavelet coefficients of a resistor:
loading to holding, then holding to sliding. In the second, R1 and R3 (or R2 and R4) move in opposite
senses. Online:

* A channel of a taxel in contact *crosses* when its coefficient is `threshold_volts` or more in size.
* A crossing is the second peak when the load was steady before the kink that the filter now answers (a
  change of load, and the settling after it, is the first peak) and when, over the taxels in contact, the
  opposed part of the coefficients exceeds the common part. Arrays without shear channels have no opposed
  part: there the load must be steady now, and nothing more is asked.
* Direction: change of the summed pair responses (R1 - R3, R2 - R4) since before the kink.
* Onset: see `kink`. The delay of detection behind the onset is that of the filter: at level 3 and 100 Hz
  0.10 to 0.17 s, or 0.03 to 0.07 s for a strong kink, since it is all but blind to a kink's first scans.
* End: contact is lost; or nothing crosses for `quiet_s` after an opposite kink that took `relaxed_part` of
  the response away, or once the response is back at what it was before the slip. A stop that leaves the
  shear as it was cannot be seen before the lift. Without shear channels a slip ends when nothing crosses
  for `quiet_s`, which on a flat plate is soon: a steady slide leaves no trace.
* Turn: the end of a slip and the onset of another at one instant, by the detector "wang2019-turn", whose
  statistic is in degrees; see `heading`. The paper slides one way only. Without shear channels: none.

The rule says that sliding has begun, no more: `kind` is always "gross", though the kink belongs to the
beginning of tangential load and so comes before gross slip. `confidence` is the opposed part of opposed
plus common (0.5 where there is no shear to oppose); it is no probability.

False alarms: whatever kinks the opposed response at a steady load is slip to this rule. A hand that shifts
sideways without slipping, a tap on one edge, a cable pulled, a tangential load below the friction limit;
without shear channels also any local change of pressure. White noise, measured on 36 channels in
a hold at 100 Hz with the 12-bit ADC: 4 alarms in 20 h at 0.3 mV rms, 20 a minute at 0.5 mV; from 0.7 mV on
something always crosses, and a slip once raised does not end before the lift.
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.contact import (
    ContactParams,
    ContactTracker,
    Transition,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.signal.pairs import PairResponse, mean_response
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import MAX_LEVEL, PIECE_SCANS, BankParams, SwtBank, border_scans
from tactiled.detect.wang2019.heading import Heading
from tactiled.detect.wang2019.kink import KinkFit
from tactiled.detect.wang2019.slide import Look, MotionResponse, Slide
from tactiled.events.types import UNKNOWN_SD_DEG, ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

DETECTOR = "wang2019"


class SlipParams(Params):
    """The published rule; the defaults are for volts at any rate from 20 Hz to 1 kHz."""

    threshold_volts: float = Field(default=0.002, gt=0, description="coefficient that marks slip; 2019 paper")
    level: int = Field(
        default=0,
        ge=0,
        le=MAX_LEVEL,
        description="wavelet level; 0: level 3 at 100 Hz, the same span elsewhere",
    )
    quiet_s: float = Field(default=0.8, gt=0, le=60, description="no crossing for so long before a slip ends")
    # A skin that stops keeps much of its shear; 15 % is well above creep (2 %) and below what relaxes.
    relaxed_part: float = Field(
        default=0.15, gt=0, lt=1, description="part of the shear response that an ended slip has given back"
    )
    # Well above what unequal taxels and a saturating divider make of a direction.
    turn_deg: float = Field(
        default=30.0, ge=10, le=180, description="a slip that turns by more is a new one in its new direction"
    )
    contact: ContactParams = ContactParams()


def level_at(rate_hz: float, params: SlipParams) -> int:
    """Wavelet level in use at a scan rate: the one whose span in seconds is nearest level 3's at 100 Hz."""
    return params.level or int(np.clip(round(3 + np.log2(rate_hz / 100.0)), 1, MAX_LEVEL))


class WaveletSlip:
    """Contact and slip events by the published rule.

    Parameters
    ----------
    array : Array
    params : SlipParams
    """

    def __init__(self, array: Array, params: SlipParams | None = None) -> None:
        self._array = array
        self._params = params or SlipParams()
        self._pairs = PairResponse(array)
        self._has_shear = array.has_shear
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._rate_hz = 0.0  # nothing seen
        self._last_time_s = 0.0
        self._slide: Slide | None = None
        self._quiet = 0  # scans since the newest crossing
        self._rest: FloatArray | None = None  # readings (scans, channels) before this contact's first slip

    def _start(self, rate_hz: float) -> None:
        level = level_at(rate_hz, self._params)
        self._rate_hz = rate_hz
        self._border = border_scans(level)
        # Never less than the filter's window: the end's own kink must be out of it before the next slip.
        self._quiet_scans = max(self._border + 1, round(self._params.quiet_s * rate_hz))
        self._quantiser = Quantiser(self._array)
        self._bank = SwtBank(self._array, BankParams(levels=(level,)))
        self._tracker = ContactTracker(self._array, self._params.contact, rate_hz)
        self._kink = KinkFit(level)

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._tracker.state if self._rate_hz else "none"

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Events that the item completes.

        A gap, or a new scan rate, ends a slip and a contact with events that are not valid: nobody saw
        them end. The detector then is as new.
        """
        if isinstance(item, Gap):
            return self._forget()
        events = self._forget() if self._rate_hz not in (0.0, item.rate_hz) else []
        if not self._rate_hz:
            self._start(item.rate_hz)
        for start in range(0, len(item), PIECE_SCANS):
            events += self._process_piece(item[start : start + PIECE_SCANS])
        self._last_time_s = float(item.time_s[-1])
        return events

    def _forget(self) -> list[Event]:
        events: list[Event] = []
        if self._slide is not None:
            events.append(self._slide.ended(self._last_time_s, self._last_time_s, valid=False))
        if self.contact_state != "none":
            events.append(lost_contact_event(self._last_time_s, self.contact_state))
        self.reset()
        return events

    def _process_piece(self, block: ScanBlock) -> list[Event]:
        events: list[Event] = []
        held = self._quantiser.process(block)
        answer = self._bank.filter(held)
        pressure = self._tracker.measure(block, held)
        coefficients = answer.volts[:, 0]
        analysed = answer.usable[:, 0] & pressure.taxel_touches[:, self._array.channel_taxel]
        crossing = analysed & (np.abs(coefficients) >= self._params.threshold_volts)
        steps = self._bank.recent_steps(len(block))
        crosses = np.any(crossing, axis=1).tolist()
        for scan, values in enumerate(pressure.rows()):
            change = self._tracker.step(*values)
            if change is not None:
                events.append(contact_event(block, scan, pressure, change))
            if crosses[scan] or self._slide is not None:
                look = Look(
                    float(block.time_s[scan]),
                    float(block.time_sd_s[scan]),
                    bool(block.late[scan]),
                    coefficients[scan],
                    analysed[scan],
                    crossing[scan],
                    steps[scan : scan + self._border + 1],
                    block.channel_offset_s,
                )
                slips = self._look(look, crosses[scan])
                events += slips
                if slips and (change := self._follow(slips[-1])) is not None:
                    events.append(contact_event(block, scan, pressure, change))
            self._quiet = 0 if crosses[scan] else self._quiet + 1
            if self._tracker.state == "none":
                self._rest = None
        return events

    def _look(self, look: Look, crosses: bool) -> list[SlipEvent]:
        """What this scan brings: an onset, an end, or both for a turn."""
        slide = self._slide
        if slide is None:
            return self._onset(look)
        if self._tracker.state == "none":
            return [slide.ended(look.time_s, look.time_s, valid=not look.late)]
        if slips := slide.turn(look):
            return slips
        if crosses:
            slide.cross(look, is_first=self._quiet >= self._quiet_scans)
        elif self._quiet + 1 >= self._quiet_scans and slide.gave_back(look, self._params.relaxed_part):
            return [slide.ended(slide.trace_s, look.time_s, valid=not look.late)]
        return []

    def _follow(self, slip: SlipEvent) -> Transition | None:
        """Tell the tracker of an onset or end."""
        if slip.state == "onset":
            return None if self._tracker.state == "sliding" else self._tracker.begin_sliding()
        self._slide = None
        return self._tracker.end_sliding() if self._tracker.state == "sliding" else None

    def _onset(self, look: Look) -> list[SlipEvent]:
        """The second peak, if this crossing is that."""
        # Slip itself may disturb the pressure: with shear to tell it by, the load need only have been steady
        # up to the kink, which lies no further back than the filter's peak delay.
        within = self._kink.longest_scans if self._has_shear else 0
        if self._tracker.state == "none" or not self._tracker.was_steady(self._border + 1, within):
            return []
        if not self._has_shear:
            strongest = np.zeros((1, self._array.n_channels))
            strongest[0, np.argmax(np.where(look.crossing, np.abs(look.coefficients), -1.0))] = 1.0
            return [self._begin(look, strongest, np.zeros(0, dtype=np.bool_), confidence=0.5)]
        taxels = np.zeros(self._array.n_taxels, dtype=np.bool_)
        taxels[self._array.channel_taxel[look.analysed]] = True
        taxels &= self._pairs.whole_taxels(look.analysed)
        opposed, common = self._pairs.opposed_and_common(look.coefficients, taxels)
        if not opposed > common:
            return []
        weights = self._pairs.motion_weights(taxels)
        return [self._begin(look, weights, taxels, opposed / (opposed + common))]

    def _begin(
        self, look: Look, weights: FloatArray, taxels: NDArray[np.bool_], confidence: float
    ) -> SlipEvent:
        """Onset event, and the slide that it begins; `weights` (axes, channels) make the taxels' response."""
        onset = self._kink.onset(
            look.steps @ weights.T * self._quantiser.volts_per_step, weights @ look.coefficients
        )
        before_steps = look.steps[: self._kink.n_before]
        before = mean_response(weights, before_steps)
        response = MotionResponse(weights, onset.along, before, look, self._kink)
        direction_deg, direction_sd_deg = 0.0, UNKNOWN_SD_DEG
        if self._has_shear:
            moved = look.steps[-1] - before_steps.mean(axis=0)
            direction_deg = onset.direction_deg
            direction_sd_deg = self._pairs.direction_sd_deg(
                moved, taxels, onset.along, onset.direction_sd_deg
            )
        if self._tracker.state == "unknown":
            confidence /= 2  # it may as well be the stop of a slide that began unseen
        onset_s = look.time_s + response.skew_s - onset.delay.scans / self._rate_hz
        event = SlipEvent(
            time_s=onset_s,
            state="onset",
            kind="gross",
            onset_s=onset_s,
            onset_sd_s=float(np.hypot(onset.delay.sd_scans / self._rate_hz, look.time_sd_s)),
            direction_deg=direction_deg,
            direction_sd_deg=direction_sd_deg,
            confidence=confidence,
            taxels=tuple(np.unique(self._array.channel_taxel[look.crossing]).tolist()),
            detector=DETECTOR,
            statistic=float(np.abs(look.coefficients[look.crossing]).max()),
            threshold=self._params.threshold_volts,
            valid=not look.late,
            detected_s=look.time_s,
        )
        if self._rest is None:
            self._rest = before_steps.copy()
        heading = None
        if self._has_shear:
            heading = Heading(
                self._pairs, taxels, self._rest, before, onset.along, self._params.turn_deg, self._rate_hz
            )
        self._slide = Slide(event, response if self._has_shear else None, heading, look.time_s, self._rate_hz)
        return event
