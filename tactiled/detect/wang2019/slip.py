"""The published slip rule: a coif1 coefficient above 0.002 V ("wang2019").

Wang, Chen, Mei (2019) see two peaks in the wavelet coefficients of a resistor: loading to holding, then
holding to sliding. In the second peak, R1 and R3 (or R2 and R4) move in opposite directions. Online:

* A channel of a taxel in contact *crosses* when the size of its coefficient is at least `threshold_volts`.
* A crossing is the second peak under two conditions. The load was steady before the kink that the filter
  responds to (a change of load, and the settling after it, is the first peak). And over the taxels in
  contact the opposed part of the coefficients exceeds the common part. Arrays without shear channels have no
  opposed part: the load must be steady at the crossing, and no other condition applies.
* Direction: change of the summed pair responses (R1 - R3, R2 - R4) since before the kink.
* Onset: see `kink`. The detection latency is that of the filter: 0.10 to 0.17 s at level 3 and 100 Hz, or
  0.03 to 0.07 s for a strong kink, since the filter hardly responds to the first scans of a kink.
* End: contact is lost; or nothing crosses for `quiet_s` after an opposite kink that removed `relaxed_part` of
  the response, or once the response is back at its value before the slip. A stop that leaves the shear
  unchanged cannot be detected before the lift. Without shear channels a slip ends when nothing crosses for
  `quiet_s`, which on a flat plate is soon: a steady slide causes no coefficients.
* Change of direction: the end of one slip and the onset of another at the same instant, by the detector
  "wang2019-turn", whose statistic is in degrees; see `heading`. The paper slides in one direction only.
  Arrays without shear channels detect none.

The rule detects that sliding has begun, no more: `kind` is always "gross", although the kink marks the
beginning of tangential load and so precedes gross slip. `confidence` is the opposed part over the sum of
opposed and common part (0.5 without shear channels); it is no probability.

False alarms: any kink of the opposed response at a steady load is slip to this rule. Examples are a hand that
shifts sideways without slipping, a tap on one edge, a pulled cable, and a tangential load below the friction
limit; without shear channels also any local change of pressure. White noise on 36 channels, measured in a
hold at 100 Hz with the 12-bit ADC: 4 alarms in 20 h at 0.3 mV rms, 20 per minute at 0.5 mV; from 0.7 mV on
some channel always crosses, and a slip does not end before the lift.
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.contact_gate import (
    ContactParams,
    ContactTracker,
    ContactTransition,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.signal.opposed_pairs import PairResponse, mean_response
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import MAX_LEVEL, PIECE_SCANS, BankParams, SwtBank, border_scans
from tactiled.detect.wang2019.heading import HeadingTracker
from tactiled.detect.wang2019.kink import KinkFit
from tactiled.detect.wang2019.slide import ActiveSlip, MotionResponse, ScanView
from tactiled.events.types import UNKNOWN_SD_DEG, ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

DETECTOR = "wang2019"


# Voltages above 0.5 V are clear enough to analyse, the paper says. 20 N in 8 s, its slowest press, is about
# 0.1 V/s; creep in a hold is below 0.01 V/s.
PUBLISHED_CONTACT = ContactParams(contact_volts=0.5, release_volts=0.35, loading_volts_s=0.03)


class SlipParams(Params):
    """Parameters of the published rule; the defaults are for volts at any rate from 20 Hz to 1 kHz."""

    threshold_volts: float = Field(default=0.002, gt=0, description="coefficient that marks slip; 2019 paper")
    level: int = Field(
        default=0,
        ge=0,
        le=MAX_LEVEL,
        description="wavelet level; 0: level 3 at 100 Hz, the same span elsewhere",
    )
    quiet_s: float = Field(
        default=0.8, gt=0, le=60, description="time without a crossing after which a slip may end"
    )
    # A skin that stops keeps much of its shear; 15 % is well above creep (2 %) and below the relaxation of a
    # stop.
    relaxed_part: float = Field(
        default=0.15, gt=0, lt=1, description="part of the shear response that is lost when a slip ends"
    )
    # Well above the error of a direction that unequal taxels and a saturating divider cause.
    turn_deg: float = Field(
        default=30.0, ge=10, le=180, description="change of direction from which on a slip is a new one"
    )
    contact: ContactParams = PUBLISHED_CONTACT


def level_at(rate_hz: float, params: SlipParams) -> int:
    """Wavelet level at a scan rate: the one whose span in seconds is nearest to level 3 at 100 Hz."""
    return params.level or int(np.clip(round(3 + np.log2(rate_hz / 100.0)), 1, MAX_LEVEL))


class WaveletSlip:
    """Report contact and slip events by the published rule.

    Examples
    --------
    Load for 1 s, hold for 3 s, then shear along +x (R1 rises, R3 falls) from 4 s on:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.samples.block import regular_block
    >>> array, rng, time_s = load_array("wang2019-3x3"), np.random.default_rng(0), np.arange(600) / 100
    >>> shear_volts = 0.1 * np.clip(time_s - 4, 0, 1)[:, np.newaxis] * np.tile([1, 0, -1, 0], 9)
    >>> load_volts = np.clip(time_s - 1, 0, 1)[:, np.newaxis]
    >>> volts = load_volts + shear_volts + 1e-4 * rng.standard_normal((600, 36))
    >>> for event in WaveletSlip(array).process(regular_block(volts, 100.0)):
    ...     if event.topic == "slip":
    ...         print(f"{event.state} at {event.onset_s:.2f} s, detected at {event.detected_s:.2f} s")
    onset at 4.00 s, detected at 4.15 s
    """

    def __init__(self, array: Array, params: SlipParams | None = None) -> None:
        self._array = array
        self._params = params or SlipParams()
        self._pairs = PairResponse(array)
        self._has_shear = array.has_shear
        self.reset()

    def reset(self) -> None:
        """Discard everything seen; keep the parameters."""
        self._rate_hz = 0.0  # no scans yet
        self._last_time_s = 0.0
        self._slide: ActiveSlip | None = None
        self._quiet = 0  # scans since the newest crossing
        self._rest: FloatArray | None = None  # (scans, channels) before this contact's first slip

    def _start(self, rate_hz: float) -> None:
        level = level_at(rate_hz, self._params)
        self._rate_hz = rate_hz
        self._border = border_scans(level)
        # At least the filter's window: the kink of the end must have left it before the next slip.
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
        """Return the events that an item completes.

        A gap, or a new scan rate, ends a slip and a contact with events that are not valid, because their end
        was not observed. The detector then starts anew.
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
                view = ScanView(
                    float(block.time_s[scan]),
                    float(block.time_sd_s[scan]),
                    bool(block.late[scan]),
                    coefficients[scan],
                    analysed[scan],
                    crossing[scan],
                    steps[scan : scan + self._border + 1],
                    block.channel_offset_s,
                )
                slips = self._next_events(view, crosses[scan])
                events += slips
                if slips and (change := self._update_tracker(slips[-1])) is not None:
                    events.append(contact_event(block, scan, pressure, change))
            self._quiet = 0 if crosses[scan] else self._quiet + 1
            if self._tracker.state == "none":
                self._rest = None
        return events

    def _next_events(self, view: ScanView, crosses: bool) -> list[SlipEvent]:
        """Events of one scan: an onset, an end, or both for a change of direction."""
        slide = self._slide
        if slide is None:
            return self._onset(view)
        if self._tracker.state == "none":
            return [slide.ended(view.time_s, view.time_s, valid=not view.late)]
        if slips := slide.turn(view):
            return slips
        if crosses:
            slide.cross(view, is_first=self._quiet >= self._quiet_scans)
        elif self._quiet + 1 >= self._quiet_scans and slide.has_relaxed(view, self._params.relaxed_part):
            return [slide.ended(slide.trace_s, view.time_s, valid=not view.late)]
        return []

    def _update_tracker(self, slip: SlipEvent) -> ContactTransition | None:
        """Pass an onset or end on to the contact tracker."""
        if slip.state == "onset":
            return None if self._tracker.state == "sliding" else self._tracker.begin_sliding()
        self._slide = None
        return self._tracker.end_sliding() if self._tracker.state == "sliding" else None

    def _onset(self, view: ScanView) -> list[SlipEvent]:
        """Onset event if this crossing is the second peak."""
        # Slip itself may disturb the pressure. With shear channels the load only has to be steady up to the
        # kink, which is no further back than the filter's peak delay.
        within = self._kink.longest_scans if self._has_shear else 0
        if self._tracker.state == "none" or not self._tracker.was_steady(self._border + 1, within):
            return []
        if not self._has_shear:
            strongest = np.zeros((1, self._array.n_channels))
            strongest[0, np.argmax(np.where(view.crossing, np.abs(view.coefficients), -1.0))] = 1.0
            return [self._begin_slip(view, strongest, np.zeros(0, dtype=np.bool_), confidence=0.5)]
        taxels = np.zeros(self._array.n_taxels, dtype=np.bool_)
        taxels[self._array.channel_taxel[view.analysed]] = True
        taxels &= self._pairs.whole_taxels(view.analysed)
        opposed, common = self._pairs.opposed_and_common(view.coefficients, taxels)
        if not opposed > common:
            return []
        weights = self._pairs.motion_weights(taxels)
        return [self._begin_slip(view, weights, taxels, opposed / (opposed + common))]

    def _begin_slip(
        self, view: ScanView, weights: FloatArray, taxels: NDArray[np.bool_], confidence: float
    ) -> SlipEvent:
        """Onset event and the slip it begins; `weights` (axes, channels) sum the taxels' response."""
        onset = self._kink.onset(
            view.steps @ weights.T * self._quantiser.volts_per_step, weights @ view.coefficients
        )
        before_steps = view.steps[: self._kink.n_before]
        before = mean_response(weights, before_steps)
        response = MotionResponse(weights, onset.along, before, view, self._kink)
        direction_deg, direction_sd_deg = 0.0, UNKNOWN_SD_DEG
        if self._has_shear:
            moved = view.steps[-1] - before_steps.mean(axis=0)
            direction_deg = onset.direction_deg
            direction_sd_deg = self._pairs.direction_sd_deg(
                moved, taxels, onset.along, onset.direction_sd_deg
            )
        if self._tracker.state == "unknown":
            confidence /= 2  # it may equally be the stop of a slide that began unobserved
        onset_s = view.time_s + response.skew_s - onset.delay.scans / self._rate_hz
        event = SlipEvent(
            time_s=onset_s,
            state="onset",
            kind="gross",
            onset_s=onset_s,
            onset_sd_s=float(np.hypot(onset.delay.sd_scans / self._rate_hz, view.time_sd_s)),
            direction_deg=direction_deg,
            direction_sd_deg=direction_sd_deg,
            confidence=confidence,
            taxels=tuple(np.unique(self._array.channel_taxel[view.crossing]).tolist()),
            detector=DETECTOR,
            statistic=float(np.abs(view.coefficients[view.crossing]).max()),
            threshold=self._params.threshold_volts,
            valid=not view.late,
            detected_s=view.time_s,
        )
        if self._rest is None:
            self._rest = before_steps.copy()
        heading = None
        if self._has_shear:
            heading = HeadingTracker(
                self._pairs, taxels, self._rest, before, onset.along, self._params.turn_deg, self._rate_hz
            )
        self._slide = ActiveSlip(
            event, response if self._has_shear else None, heading, view.time_s, self._rate_hz
        )
        return event
