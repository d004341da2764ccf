"""The published slip rule: a coif1 coefficient above 0.002 V.

Wang, Chen, Mei (2019) see two peaks in the wavelet coefficients of a resistor: loading to holding, then
holding to sliding. In the second peak, R1 and R3 (or R2 and R4) move in opposite directions. Online:

* A channel of a taxel in contact *crosses* when the size of its coefficient is at least 0.002 V.
* A crossing is the second peak under two conditions. The load was steady before the kink that the filter
  responds to (a change of load, and the settling after it, is the first peak). And over the taxels in
  contact the opposed part of the coefficients exceeds the common part. Arrays without shear channels have no
  opposed part, and no slips.
* Direction: change of the summed pair responses (R1 - R3, R2 - R4) since before the kink.
* Onset: the paper states no instant. A kink is seen at the latest when its coefficient peaks; the onset is
  half of that time before the crossing.
* End: contact is lost; or nothing crosses for `_QUIET_S` after an opposite kink that removed `_RELAXED_PART`
  of the response, or once the response is back at its value before the slip. A stop that leaves the shear
  unchanged cannot be detected before the lift.
* The paper slides in one direction only: where a slide turns, no new slip is reported.

The rule detects that sliding has begun, no more: `kind` is always "gross", although the kink marks the
beginning of tangential load and so precedes gross slip. `confidence` is the opposed part over the sum of
opposed and common part; it is no probability.

False alarms: any kink of the opposed response at a steady load is slip to this rule. Examples are a hand that
shifts sideways without slipping, a tap on one edge, a pulled cable, and a tangential load below the friction
limit. White noise on 36 channels, measured in a hold at 100 Hz with the 12-bit ADC: 4 alarms in 20 h at
0.3 mV rms, 20 per minute at 0.5 mV; from 0.7 mV on some channel always crosses, and a slip does not end
before the lift.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.contact_gate import (
    ContactParams,
    ContactTracker,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.signal.pressure import SETTLE_S
from tactiled.detect.signal.wavelet import border_scans, taps
from tactiled.events.types import UNKNOWN_SD_DEG, ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.wang2019.bank import SwtBank, kink_response

DETECTOR = "wang2019"
_THRESHOLD_V = 0.002  # of the paper
# Voltages above 0.5 V are clear enough to analyse, the paper says. 20 N in 8 s, its slowest press, is about
# 0.1 V/s; creep in a hold is below 0.01 V/s.
PUBLISHED_CONTACT = ContactParams(contact_volts=0.5, release_volts=0.35, loading_volts_s=0.03)
_MAX_LEVEL = 6  # choice: sums of its filter stay exact (`detect/signal/wavelet.py`)
_PIECE_SCANS = 1024  # choice: most scans filtered at once: bounds the memory of long blocks
_QUIET_S = 0.8  # choice: time without a crossing after which a slip may end
# prior: part of the shear response that is lost when a slip ends. A skin that stops keeps much of its shear;
# 15 % is well above creep (2 %) and below the relaxation of a stop.
_RELAXED_PART = 0.15
# derived: weights are multiples of 2^-20, so that sums of weighted readings (whole steps within 2^23, some
# hundreds of channels) stay below 2^53 and exact. It costs a millionth of a response.
_WEIGHT_SCALE = 2.0**20
# prior: standard deviation of a direction. Resistors that are 5 % unequal turn that of one taxel by so much.
_DIRECTION_SD_DEG = 3.0


def level_at(rate_hz: float) -> int:
    """Wavelet level at a scan rate: the one whose span in seconds is nearest to level 3 at 100 Hz."""
    return int(np.clip(round(3 + np.log2(rate_hz / 100.0)), 1, _MAX_LEVEL))


class ScanView(NamedTuple):
    """Inputs of the rule in one scan."""

    time_s: float
    late: bool
    coefficients: FloatArray  # (channels,)
    analysed: NDArray[np.bool_]  # (channels,): usable, and on a taxel in contact
    crossing: NDArray[np.bool_]  # (channels,)
    steps: FloatArray  # (taps, channels): the readings that the coefficients are computed from


class LoadSteadiness:
    """Count for how many scans the load of a contact has been steady, and was before it moved."""

    def __init__(self, settle_scans: int) -> None:
        self._settle_scans = settle_scans
        self.begin()

    def begin(self) -> None:
        """Begin with a touch: a steady signal before it is no hold."""
        self._now = self._before = self._moving = 0

    def follow(self, is_steady: bool) -> None:
        """Take a scan."""
        if is_steady:
            self._now += 1
            return
        if self._now >= self._settle_scans:
            self._before, self._moving = self._now, 0
        self._now = 0
        self._moving += 1

    def was_steady(self, for_scans: int, within_scans: int) -> bool:
        """Return True if the load was steady for `for_scans` scans, ending at most `within_scans` ago."""
        if self._now >= for_scans:
            return True
        return self._before >= for_scans and self._moving + self._now <= within_scans


class ActiveSlip:
    """Track one slip from its onset to its end, by the pair response along its direction.

    `weights` (2, channels) lead from readings to the response, `along` (2,) is the unit vector of the slip,
    `n_before` scans at the beginning of the filter's window precede any kink that it responds to. `ended_s`
    is the instant of the end, if the slip proves to have ended.
    """

    def __init__(
        self, onset: SlipEvent, weights: FloatArray, along: FloatArray, n_before: int, view: ScanView
    ) -> None:
        self._onset, self._weights, self._along, self._n_before = onset, weights, along, n_before
        self._start = mean_response(weights, view.steps[:n_before])
        self.ended_s = view.time_s
        self._before_kinks = 0.0  # largest response before the opposite kinks of this burst of crossings
        self._kinking_back = False

    def _above_start(self, steps: FloatArray) -> float:
        return float((mean_response(self._weights, steps) - self._start) @ self._along)

    def cross(self, view: ScanView, *, is_first: bool) -> None:
        """Process a crossing, the first of a burst or a later one."""
        if is_first:
            self._before_kinks, self._kinking_back = 0.0, False
        kinks_back = bool(self._along @ (self._weights @ view.coefficients) < 0)
        if kinks_back:
            self._before_kinks = max(self._before_kinks, self._above_start(view.steps[: self._n_before]))
            if not self._kinking_back:  # as long before its crossing as the kink of the onset
                self.ended_s = view.time_s - (self._onset.detected_s - self._onset.onset_s)
        self._kinking_back = kinks_back

    def has_relaxed(self, view: ScanView) -> bool:
        """True where the response has lost `_RELAXED_PART` of its value before the opposite kink, or all.

        False while the response is falling: that fall belongs to a kink that the filter has not responded to
        yet.
        """
        left = (1 - _RELAXED_PART) * self._before_kinks
        now, before = map(self._above_start, (view.steps[-1:], view.steps[: self._n_before]))
        return now < left and (before < left or before - now < _RELAXED_PART / 2 * self._before_kinks)

    def end(self, at_s: float, detected_s: float, *, valid: bool) -> SlipEvent:
        """Event for the end, with the other fields of the onset's event."""
        return dataclasses.replace(self._onset, state="end", time_s=at_s, detected_s=detected_s, valid=valid)


def mean_response(weights: FloatArray, steps: FloatArray) -> FloatArray:
    """Mean response (axes,) over some scans of readings: sums of whole numbers, exact in any order."""
    return np.asarray(weights @ steps.sum(axis=0) / len(steps))


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
    onset at 4.07 s, detected at 4.15 s
    """

    def __init__(self, array: Array) -> None:
        self._array = array
        # (2, taxels, channels)
        self._weights = np.rint(array.shear_weights() * _WEIGHT_SCALE) / _WEIGHT_SCALE
        self._sizes = np.abs(self._weights).sum(axis=2)  # (2, taxels)
        self._common = array.normal_weights()  # (taxels, channels)
        # A taxel with one resistor of a pair missing would take pressure for shear.
        self._needs = (self._weights != 0).any(axis=0).astype(np.float64)
        self.reset()

    def reset(self) -> None:
        """Discard everything seen."""
        self._rate_hz = 0.0  # no scans yet
        self._last_time_s = 0.0
        self._slide: ActiveSlip | None = None
        self._quiet = 0  # scans since the newest crossing

    def _start(self, rate_hz: float) -> None:
        level = level_at(rate_hz)
        self._rate_hz = rate_hz
        self._border = border_scans(level)
        # At least the filter's window: the kink of the end must have left it before the next slip.
        self._quiet_scans = max(self._border + 1, round(_QUIET_S * rate_hz))
        self._longest = int(np.argmax(kink_response(level)))  # scans from a kink to its peak
        self._n_before = max(2, len(taps(level)) // 4)
        self._bank = SwtBank(self._array, level)
        self._tracker = ContactTracker(self._array, PUBLISHED_CONTACT, rate_hz)
        self._load = LoadSteadiness(max(1, round(SETTLE_S * rate_hz)))

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._tracker.state if self._rate_hz else "none"

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: the levels are given."""
        return 0.0

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
            events.append(self._slide.end(self._last_time_s, self._last_time_s, valid=False))
        if self.contact_state != "none":
            events.append(lost_contact_event(self._last_time_s, self.contact_state))
        self.reset()
        return events

    def _process_piece(self, block: ScanBlock) -> list[Event]:
        events: list[Event] = []
        n, tracker = len(block), self._tracker
        tracker.measure(block)
        coefficients, usable = self._bank.filter(tracker.held(n))
        touched = np.asarray(tracker.touched).reshape(-1, self._array.n_taxels)[:n] != 0
        analysed = usable & touched[:, self._array.channel_taxel]
        crossing = analysed & (np.abs(coefficients) >= _THRESHOLD_V)
        steps = self._bank.steps
        crosses = np.any(crossing, axis=1).tolist()
        slope = np.asarray(tracker.slope)[:n]
        steady, is_read = np.abs(slope) <= np.asarray(tracker.loading)[:n], ~np.isnan(slope)
        for scan in range(n):
            if is_read[scan]:
                self._load.follow(bool(steady[scan]))
            was_none = tracker.state == "none"
            changes = tracker.step(scan)
            if was_none and tracker.state != "unknown":
                self._load.begin()
            if changes:
                events.append(contact_event(block, scan, tracker))
            if crosses[scan] or self._slide is not None:
                view = ScanView(
                    float(block.time_s[scan]),
                    bool(block.late[scan]),
                    coefficients[scan],
                    analysed[scan],
                    crossing[scan],
                    steps[scan : scan + self._border + 1],
                )
                if (slip := self._change(view, crosses[scan])) is not None:
                    events.append(slip)
                    if self._update_tracker(slip):
                        events.append(contact_event(block, scan, tracker))
            self._quiet = 0 if crosses[scan] else self._quiet + 1
        return events

    def _change(self, view: ScanView, crosses: bool) -> SlipEvent | None:
        """Onset or end in one scan, if there is any."""
        slide = self._slide
        if slide is None:
            return self._onset(view)
        if self._tracker.state == "none":
            return slide.end(view.time_s, view.time_s, valid=not view.late)
        if crosses:
            slide.cross(view, is_first=self._quiet >= self._quiet_scans)
        elif self._quiet + 1 >= self._quiet_scans and slide.has_relaxed(view):
            return slide.end(slide.ended_s, view.time_s, valid=not view.late)
        return None

    def _update_tracker(self, slip: SlipEvent) -> bool:
        """Pass an onset or end on to the contact tracker; return whether its state changes."""
        begins, slides = slip.state == "onset", self._tracker.state == "sliding"
        if not begins:
            self._slide = None
        if begins != slides:
            self._tracker.go("sliding" if begins else "holding")
        return begins != slides

    def _onset(self, view: ScanView) -> SlipEvent | None:
        """Onset event if this crossing is the second peak."""
        # Slip itself may disturb the pressure: the load only has to be steady up to the kink, which is no
        # further back than the filter's peak delay.
        if self._tracker.state == "none" or not self._load.was_steady(self._border + 1, self._longest):
            return None
        taxels = np.zeros(self._array.n_taxels, dtype=np.bool_)
        taxels[self._array.channel_taxel[view.analysed]] = True
        taxels &= (self._needs @ ~view.analysed) == 0
        responses = (self._weights @ view.coefficients)[:, taxels].sum(axis=1)
        opposed = float(np.hypot(*(responses / np.maximum(self._sizes[:, taxels].sum(axis=1), 1e-12))))
        common = abs(float((self._common @ view.coefficients)[taxels].sum() / max(int(taxels.sum()), 1)))
        if not opposed > common:
            return None
        confidence = opposed / (opposed + common)
        if self._tracker.state == "unknown":
            confidence /= 2  # it may equally be the stop of a slide that began unobserved
        weights = np.asarray(self._weights[:, taxels].sum(axis=1))
        moved = mean_response(weights, view.steps[-1:]) - mean_response(weights, view.steps[: self._n_before])
        size = float(np.hypot(*moved))
        along = moved / size if size else np.array([1.0, 0.0])
        onset_s = view.time_s - 0.5 * self._longest / self._rate_hz
        event = SlipEvent(
            time_s=onset_s,
            state="onset",
            kind="gross",
            onset_s=onset_s,
            onset_sd_s=float(self._longest / np.sqrt(12) / self._rate_hz),
            direction_deg=float(np.degrees(np.arctan2(moved[1], moved[0]))),
            direction_sd_deg=_DIRECTION_SD_DEG if size else UNKNOWN_SD_DEG,
            confidence=confidence,
            taxels=tuple(np.unique(self._array.channel_taxel[view.crossing]).tolist()),
            detector=DETECTOR,
            statistic=float(np.abs(view.coefficients[view.crossing]).max()),
            threshold=_THRESHOLD_V,
            valid=not view.late,
            detected_s=view.time_s,
        )
        self._slide = ActiveSlip(event, weights, along, self._n_before, view)
        return event
