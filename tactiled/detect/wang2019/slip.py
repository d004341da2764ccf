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
* End: contact is lost; or nothing crosses for `_QUIET_S` after an opposite kink that removed `_RELAXED_PART`
  of the response, or once the response is back at its value before the slip. A stop that leaves the shear
  unchanged cannot be detected before the lift. Without shear channels a slip ends when nothing crosses for
  `_QUIET_S`, which on a flat plate is soon: a steady slide causes no coefficients.
* The paper slides in one direction only: where a slide turns, no new slip is reported.

The rule detects that sliding has begun, no more: `kind` is always "gross", although the kink marks the
beginning of tangential load and so precedes gross slip. `confidence` is the opposed part over the sum of
opposed and common part (0.5 without shear channels); it is no probability.

False alarms: any kink of the opposed response at a steady load is slip to this rule. Examples are a hand that
shifts sideways without slipping, a tap on one edge, a pulled cable, and a tangential load below the friction
limit; without shear channels also any local change of pressure. White noise on 36 channels, measured in a
hold at 100 Hz with the 12-bit ADC: 4 alarms in 20 h at 0.3 mV rms, 20 per minute at 0.5 mV; from 0.7 mV on
some channel always crosses, and a slip does not end before the lift.
"""

import dataclasses
from typing import NamedTuple

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
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.wavelet import MAX_LEVEL, SwtBank, border_scans
from tactiled.detect.wang2019.kink import KinkFit
from tactiled.detect.wang2019.opposed_pairs import PairResponse, mean_response
from tactiled.events.types import UNKNOWN_SD_DEG, ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

DETECTOR = "wang2019"
_PIECE_SCANS = 1024  # choice: most scans filtered at once: bounds the memory of long blocks
_QUIET_S = 0.8  # choice: time without a crossing after which a slip may end
# prior: part of the shear response that is lost when a slip ends. A skin that stops keeps much of its shear;
# 15 % is well above creep (2 %) and below the relaxation of a stop.
_RELAXED_PART = 0.15

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
    contact: ContactParams = PUBLISHED_CONTACT


def level_at(rate_hz: float, params: SlipParams) -> int:
    """Wavelet level at a scan rate: the one whose span in seconds is nearest to level 3 at 100 Hz."""
    return params.level or int(np.clip(round(3 + np.log2(rate_hz / 100.0)), 1, MAX_LEVEL))


class ScanView(NamedTuple):
    """Inputs of the rule in one scan."""

    time_s: float
    time_sd_s: float
    late: bool
    coefficients: FloatArray  # (channels,)
    analysed: NDArray[np.bool_]  # (channels,): usable, and on a taxel in contact
    crossing: NDArray[np.bool_]  # (channels,)
    steps: FloatArray  # (taps, channels): the readings that the coefficients are computed from
    channel_offset_s: FloatArray  # (channels,): delay of each channel's sample after `time_s`


class MotionResponse:
    """Summed pair response along the direction of a slip, relative to that before the slip.

    Parameters
    ----------
    weights : (axes, channels) float64
        From readings to the response of each axis; on a grid, so that sums are exact.
    along : (axes,) float64
        Unit vector of the slip.
    before : (axes,) float64
        Response before the slip, in grid steps.

    Attributes
    ----------
    skew_s : float
        Weighted mean of the delay from the beginning of the scan to the samples of its channels.
    """

    def __init__(
        self, weights: FloatArray, along: FloatArray, before: FloatArray, view: ScanView, kink: KinkFit
    ) -> None:
        self._weights, self._along, self._before = weights, along, before
        self._n_before = kink.n_before
        self.kink_delay_scans = kink.middle_scans
        sizes = np.abs(along @ weights)
        # A direction without channels, such as x on an array with shear along y only, has no weights.
        self.skew_s = float(np.average(view.channel_offset_s, weights=sizes)) if sizes.any() else 0.0

    def now(self, view: ScanView) -> float:
        """Response of the newest scan, in grid steps."""
        return self._above(self._weights @ view.steps[-1])

    def before_kink(self, view: ScanView) -> float:
        """Response before any kink that the filter responds to now."""
        return self._above(mean_response(self._weights, view.steps[: self._n_before]))

    def opposes_motion(self, view: ScanView) -> bool:
        """True where the response kinks against the motion."""
        return bool(self._along @ (self._weights @ view.coefficients) < 0)

    def _above(self, response: FloatArray) -> float:
        return float((response - self._before) @ self._along)


class ActiveSlip:
    """Track one slip from its onset to its end.

    Parameters
    ----------
    response : MotionResponse or None
        None for an array without shear channels, whose slips end with their last crossing.
    now_s : float
        Instant of the scan in which the slip was detected.

    Attributes
    ----------
    trace_s : float
        Instant of the end, if the slip proves to have ended.
    """

    def __init__(
        self, onset: SlipEvent, response: MotionResponse | None, now_s: float, rate_hz: float
    ) -> None:
        self._onset = onset
        self._response = response
        self._rate_hz = rate_hz
        self.trace_s = now_s
        self._before_kinks = 0.0  # largest response before the opposite kinks of this burst of crossings
        self._kinking_back = False

    def cross(self, view: ScanView, *, is_first: bool) -> None:
        """Process a crossing, the first of a burst or a later one."""
        if self._response is None:
            self.trace_s = view.time_s
            return
        if is_first:
            self._before_kinks, self._kinking_back = 0.0, False
        opposes_motion = self._response.opposes_motion(view)
        if opposes_motion:
            self._before_kinks = max(self._before_kinks, self._response.before_kink(view))
            if not self._kinking_back:
                delay_s = self._response.kink_delay_scans / self._rate_hz
                self.trace_s = view.time_s + self._response.skew_s - delay_s
        self._kinking_back = opposes_motion

    def has_relaxed(self, view: ScanView) -> bool:
        """True where the response has lost `_RELAXED_PART` of its value before the opposite kink, or all.

        False while the response is falling: that fall belongs to a kink that the filter has not responded to
        yet.
        """
        if self._response is None:
            return True
        left = (1 - _RELAXED_PART) * self._before_kinks
        now, before = self._response.now(view), self._response.before_kink(view)
        return now < left and (before < left or before - now < _RELAXED_PART / 2 * self._before_kinks)

    def ended(self, ended_s: float, detected_s: float, *, valid: bool) -> SlipEvent:
        """Event for the end, with the other fields of the onset's event."""
        return dataclasses.replace(
            self._onset, state="end", time_s=ended_s, detected_s=detected_s, valid=valid
        )


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

    def _start(self, rate_hz: float) -> None:
        level = level_at(rate_hz, self._params)
        self._rate_hz = rate_hz
        self._border = border_scans(level)
        # At least the filter's window: the kink of the end must have left it before the next slip.
        self._quiet_scans = max(self._border + 1, round(_QUIET_S * rate_hz))
        self._quantiser = Quantiser(self._array)
        self._bank = SwtBank(self._array, level)
        self._tracker = ContactTracker(self._array, self._params.contact, rate_hz)
        self._kink = KinkFit(level)

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._tracker.state if self._rate_hz else "none"

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return self._tracker.hidden_below if self._rate_hz else 0.0

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
        for start in range(0, len(item), _PIECE_SCANS):
            events += self._process_piece(item[start : start + _PIECE_SCANS])
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
        coefficients, usable = self._bank.filter(held)
        pressure = self._tracker.measure(block, held)
        analysed = usable & pressure.taxel_touches[:, self._array.channel_taxel]
        crossing = analysed & (np.abs(coefficients) >= self._params.threshold_volts)
        steps = self._bank.steps
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
        return events

    def _next_events(self, view: ScanView, crosses: bool) -> list[SlipEvent]:
        """Onset or end in one scan, if there is any."""
        slide = self._slide
        if slide is None:
            return self._onset(view)
        if self._tracker.state == "none":
            return [slide.ended(view.time_s, view.time_s, valid=not view.late)]
        if crosses:
            slide.cross(view, is_first=self._quiet >= self._quiet_scans)
        elif self._quiet + 1 >= self._quiet_scans and slide.has_relaxed(view):
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
        self._slide = ActiveSlip(event, response if self._has_shear else None, view.time_s, self._rate_hz)
        return event
