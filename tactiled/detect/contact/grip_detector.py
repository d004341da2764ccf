"""Contact, slip and grip events from scans: contact gate, zero of shear, contact filter."""

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.contact.announced import AnnouncedMotion
from tactiled.detect.contact.filter import ROW_NAMES, ContactFilter
from tactiled.detect.contact.gate import SETTINGS
from tactiled.detect.contact.learnt import Learnt, learnt_from, shipped_trees
from tactiled.detect.contact.press_zero import PressZero
from tactiled.detect.contact.readings import TaxelReadings
from tactiled.detect.contact.slips import PosteriorSlips, ScanInstant
from tactiled.detect.contact.touch import ContactScan, Touch
from tactiled.detect.contact.travelling import TravellingRipple
from tactiled.detect.signal.contact_gate import (
    ContactParams,
    ContactTracker,
    ContactTransition,
    PressureMeasurement,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.signal.quantise import Quantiser
from tactiled.events.types import ContactState, Event, GripEvent, SlipEvent
from tactiled.samples.block import LOSSES, Gap, ScanBlock
from tactiled.tomlfile import Params

# The filter looks at a contact from where the mean load of the taxels exceeds both, until that has fallen to
# half of it: of a lighter one, the ratio of shear and load is that of noise and drift.
_CONTACT_NOISES = 10.0  # choice: standard deviations of the mean load's noise
_CONTACT_RANGE = 0.005  # physical: of full scale: drift of a sensor at rest stays below it for minutes
_FRICTION = 0.6  # physical: of rubber on objects, the median: between 0.2 (wet, oily) and 2 (clean glass)
_BASELINE_S = 1.0  # choice: averaging time of the readings without contact
_LONGEST_GAP_S = 2.0  # prior: beyond, what is held is held anew
# prior: of the load, by taxel: a contact goes on over a gap where loads changed by less. A hand that takes
# hold anew seldom meets the same loads; one that grips more firmly seldom doubles them within a gap.
_SAME_LOADS = 0.5
# tuned: standard deviation of the logarithm of friction by which the model errs although friction is known:
# taxels are unequal, and pressure, speed and age count. Coverage is the same from 0.05 to 0.3; errors grow
# with it.
_MODEL_SD = 0.1
# prior: by which log friction widens when the pad loses a taxel: its part of the load is not seen
_DROPPED_SD = 0.1


class GripParams(Params):
    """Prior of the contact filter, probabilities at which slips are reported, switch of the grip messages."""

    publish: bool = Field(default=True, description="a grip message for each scan in contact")
    friction: float | None = Field(
        default=None,
        ge=0.01,
        le=100,
        description="median of friction before any contact, in shear reading over load; left out: 0.6 times "
        "`shear_per_friction` of the array",
    )
    # Skin-like rubber on objects spans 0.2 to 2 (log sd 0.5); gains of uncalibrated shear add 0.3.
    friction_log_sd: float = Field(
        default=0.6, gt=0, le=1, description="standard deviation of its logarithm; 0.1: known to 10 %"
    )
    incipient_p: float = Field(
        default=SETTINGS["balanced"].incipient,
        gt=0,
        lt=1,
        description="probability of incipient slip from which slip events report it",
    )
    gross_p: float = Field(
        default=SETTINGS["balanced"].gross,
        gt=0,
        lt=1,
        description="probability of gross slip from which slip events report it",
    )
    contact: ContactParams = ContactParams()


class GripDetector:
    """Detect contact and slip, and compute for each scan how close the contact is to slipping.

    The contact is that of the contact gate: a grip event for each of its scans, of state unknown and not
    valid while the load is too small to tell. An array without shear or without load channels has contact
    events only.

    Attributes
    ----------
    tracker : ContactTracker or None
        State of the contact; None before the first scan.
    pressure : PressureMeasurement or None
        Of the newest block.
    change : ContactTransition or None
        Of the contact by the pressure of the newest scan.

    Examples
    --------
    A press, then shear along +x by Mindlin's curve from 4.0 s, until all of the contact slips at 4.8 s. Loads
    are equal, so that only the size of the shear tells of friction:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.samples.block import regular_block
    >>> array, rng, time_s = load_array("wang2019-3x3"), np.random.default_rng(0), np.arange(600) / 100
    >>> travel = np.clip((time_s - 4) / 0.8, 0, 1)[:, np.newaxis]
    >>> shear_volts = 0.4 * (1 - (1 - travel) ** 1.5) * np.tile([1, 0, -1, 0], 9)
    >>> load_volts = np.clip(time_s - 1, 0, 1)[:, np.newaxis]
    >>> volts = load_volts + shear_volts + 1e-4 * rng.standard_normal((600, 36))
    >>> for event in GripDetector(array).process(regular_block(volts, 100.0)):
    ...     if event.topic == "slip" and event.state == "onset":
    ...         print(f"{event.detected_s:.2f} s: {event.kind} slip since {event.onset_s:.2f} s")
    ...     if event.topic == "grip" and f"{event.time_s:.2f}" in ("3.90", "4.60"):
    ...         print(f"{event.time_s:.2f} s: {event.state}, utilisation {event.utilisation:.1f}")
    3.90 s: sticking, utilisation 0.1
    4.17 s: incipient slip since 4.09 s
    4.60 s: partial, utilisation 0.5
    """

    def __init__(self, array: Array, params: GripParams | None = None, learnt: Learnt | None = None) -> None:
        self._array = array
        self._params = params or GripParams()
        self._unit: Literal["N", "relative"] = "N" if array.unit == "N" else "relative"
        self.can_tell = array.measures_ratio
        self._learnt = (learnt or learnt_from(shipped_trees())) if self.can_tell else None
        if self._learnt is not None:
            self._learnt.check(ROW_NAMES)
        x, y = array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()
        # A pad that turns about its centre bears mu P times the mean distance of its loads.
        self._radius_mm = float(np.hypot(x, y).mean()) or 1.0
        self._stated: tuple[float, float] | None = None  # friction from outside, and the sd of its logarithm
        self._motion = AnnouncedMotion()
        self._places = np.stack([x, y]) / self._radius_mm
        self._least_load = _CONTACT_RANGE * array.full_scale
        self.reset()

    def reset(self) -> None:
        """Forget everything seen and announced; keep the parameters, and friction that was stated."""
        self._motion.reset()
        self._begin()

    def _begin(self) -> None:
        """Forget everything seen."""
        self._quantiser = Quantiser(self._array)
        self._is_friction_due = False  # the next contact begins with the prior anew
        self._n_baseline = 0
        self._rate_hz = 0.0
        self._readings: TaxelReadings | None = None  # from the first scan on
        self._touch: Touch | None = None
        self._before_gap: Touch | None = None  # contact that a gap interrupted
        self._is_after_gap = True  # or after nothing: a contact of the next scan was not seen to begin
        self._loads_before_gap: FloatArray = np.zeros(1)
        self._last_s = 0.0
        self._is_told = False  # the newest message has a contact
        self._is_cut_off = False  # a gap ended the messages of a contact
        self._slips: PosteriorSlips | None = None
        self._signs_of_slips: object = None  # which are those of another contact where they are not its signs
        self.tracker: ContactTracker | None = None
        self.pressure: PressureMeasurement | None = None
        self.change: ContactTransition | None = None
        self.is_trusted = True
        """False where the newest scan came late or could not be read."""
        self.acceleration_m_s2 = math.nan
        """Announced acceleration of the hand along the pull, gravity's part included, at the newest scan; NaN
        where none is announced."""

    def announce_motion(self, time_s: FloatArray, acceleration_m_s2: FloatArray) -> None:
        """Take the hand's own motion, for the scans that are processed from now on.

        Parameters
        ----------
        time_s : (n,) float64
            Instants in the clock of the scans, never decreasing; see `AnnouncedMotion.announce`.
        acceleration_m_s2 : (n,) float64
            Along the pull, gravity's part included: 9.81 for a hand at rest.
        """
        self._motion.announce(time_s, acceleration_m_s2)

    def state_friction(self, value: float, log_sd: float) -> None:
        """Take friction from outside, from the next contact on; one that goes on keeps what it has shown.

        Parameters
        ----------
        value : float
            In shear reading over load, as in the events.
        log_sd : float
            Standard deviation of its logarithm. That of the filter itself is added: see `_MODEL_SD`.
        """
        self._stated = value, math.hypot(log_sd, _MODEL_SD)
        self._renew_friction()

    def change_object(self) -> None:
        """Forget friction, stated or learnt: from the next contact on, another object is held."""
        self._stated = None
        self._renew_friction()

    def _renew_friction(self) -> None:
        if self._readings is None:
            return
        if self._touch is None and self._before_gap is None:
            self._expect_friction()
        else:
            self._is_friction_due = True

    def _expect_friction(self) -> None:
        median, log_sd = self._prior()
        self._filter.friction_memory.expect(median / self._array.shear_per_friction, log_sd)

    def _prior(self) -> tuple[float, float]:
        if self._stated is not None:
            return self._stated
        median = self._params.friction or _FRICTION * self._array.shear_per_friction
        return median, self._params.friction_log_sd

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes.

        A gap or a new scan rate ends slip and contact with events that are not valid, because their end was
        not observed. A slip inside a gap is reported where the contact goes on after it.
        """
        if isinstance(item, Gap):
            return self._pass_gap(item)
        events = self._forget() if item.rate_hz != self._rate_hz else []
        for row, message in enumerate(self.scans(item)):
            tracker, pressure = self.tracker, self.pressure
            assert tracker is not None
            assert pressure is not None
            if self.change:
                events.append(contact_event(item, row, pressure, self.change))
            is_valid = self.keeps_enough and not bool(item.late[row])
            events += self._slip(ScanInstant(self._last_s, float(item.time_sd_s[row]), is_valid))
            if change := self._follow_slip(tracker):
                events.append(contact_event(item, row, pressure, change))
            if message is not None and self._params.publish:
                events.append(message)
        return events

    def _slip(self, at: ScanInstant) -> list[SlipEvent]:
        """Return the slip events of the newest scan."""
        scan = None if self.contact_state == "none" else self.contact
        slips = self._slips
        if scan is not None:
            if slips is None or scan.filter.signs is not self._signs_of_slips:
                self._slips = slips = PosteriorSlips(scan.filter.gate, self._rate_hz)
                self._signs_of_slips = scan.filter.signs
            return slips.step(scan, at)
        # Readings that are lost look like a contact that is lost.
        is_valid = at.is_valid and self.is_trusted
        return [slips.end(at.time_s, valid=is_valid)] if slips is not None and slips.open else []

    def _follow_slip(self, tracker: ContactTracker) -> ContactTransition | None:
        """Enter or leave the contact states that slips make."""
        state = tracker.state
        if state == "none":
            return None
        slip = None if self._slips is None else self._slips.open
        if slip is None:
            return tracker.end_sliding() if state in ("shearing", "sliding") else None
        if slip.kind == "gross":
            return None if state == "sliding" else tracker.begin_sliding()
        return None if state == "shearing" else tracker.begin_shearing()

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return "none" if self.tracker is None else self.tracker.state

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return 0.0 if self.tracker is None else self.tracker.hidden_below

    @property
    def contact(self) -> ContactScan | None:
        """Newest scan of the present contact; None without one, or where its load is too small to tell."""
        return None if self._touch is None else self._touch.scan

    @property
    def keeps_enough(self) -> bool:
        """True where so many taxels can be read that what is said of the contact is valid."""
        return self._readings is None or self._readings.keeps_enough

    def scans(self, block: ScanBlock) -> Iterator[GripEvent | None]:
        """Yield the event of each scan of a block, None without contact; `contact` is then that of the scan.

        All blocks have one scan rate.
        """
        if self.tracker is None:
            self._rate_hz = block.rate_hz
            self.tracker = ContactTracker(self._array, self._params.contact, block.rate_hz)
            self._readings = self._make(block.rate_hz) if self.can_tell else None
        tracker, readings = self.tracker, self._readings
        held = self._quantiser.process(block)
        self.pressure = tracker.measure(block, held)
        if readings is not None:
            readings.begin_block(held, block.channel_offset_s)
        for scan, (time_s, is_late, pressed) in enumerate(
            zip(block.time_s.tolist(), block.late.tolist(), self.pressure.rows(), strict=True)
        ):
            self.change = tracker.step(*pressed)
            before_s, self._last_s = self._last_s, time_s
            if readings is None:
                yield None
                continue
            in_contact = self.contact is not None or self._before_gap is not None
            press_is_over = self._touch is not None and self._touch.press_is_over
            readings.take(scan, in_contact, press_is_over)
            self.is_trusted = readings.is_read and not is_late
            self._step(readings, time_s - before_s, touches=tracker.state != "none")
            yield self._told(is_late, touches=tracker.state != "none")

    def _make(self, rate_hz: float) -> TaxelReadings:
        """Make all that depends on the scan rate."""
        assert self._learnt is not None  # what the array measures is enough to tell
        self._ripple = TravellingRipple(self._array, rate_hz)
        x, y = self._places
        self._filter = ContactFilter(
            x,
            y,
            rate_hz,
            self._array.shear_per_friction,
            *self._prior(),
            self._params.incipient_p,
            self._params.gross_p,
            self._learnt,
        )
        return TaxelReadings(self._array, rate_hz)

    def _pass_gap(self, gap: Gap) -> list[Event]:
        """Return the ends of what a gap interrupts; keep what is known until the scan after it.

        Where the board kept scanning, friction, baseline and noise floor are kept. The scan after the gap
        tells whether the contact went on.
        """
        if gap.cause not in LOSSES or self.tracker is None:
            return self._forget()
        self._is_cut_off = self._is_told
        events = self._cut_off()
        self.tracker.interrupt(gap.n_missing)
        if self._readings is None:
            return events
        if self.contact is not None:
            self._before_gap = self._touch
            self._loads_before_gap = self._readings.recent[-1, 0].copy()
            self._touch = None
        elif self._touch is not None:  # its load was too small to tell: there is nothing to go on with
            self._end_touch(self._readings)
        self._is_after_gap = True
        self._readings.interrupt()
        return events

    def _forget(self) -> list[Event]:
        """Forget everything seen; return the ends of what is cut off."""
        events = self._cut_off()
        self._begin()
        return events

    def _cut_off(self) -> list[Event]:
        """Return the ends of slip, contact and grip events, not valid: nobody saw them."""
        events: list[Event] = []
        if self._slips is not None and self._slips.open:
            events.append(self._slips.end(self._last_s, valid=False))
        if self.contact_state != "none":
            events.append(lost_contact_event(self._last_s, self.contact_state))
        if self._is_told and self._params.publish:
            events.append(_no_contact(self._last_s, valid=False))
        self._is_told = False
        return events

    def _step(self, readings: TaxelReadings, step_s: float, *, touches: bool) -> None:
        """Take the newest scan, `step_s` after the one before; `touches` by the contact gate."""
        self.acceleration_m_s2 = self._motion.at(self._last_s)
        is_seen, self._is_after_gap = not self._is_after_gap, False
        if readings.is_lost:
            self._filter.friction_memory.widen(_DROPPED_SD)
            self._filter.gate.settle()
        load = readings.load
        least = max(_CONTACT_NOISES * readings.load_sd, self._least_load)
        if self._before_gap is not None:
            loads = readings.recent[-1, 0]
            self._touch = self._resume(self._before_gap, loads, load > least, step_s)
            self._before_gap = None
            if self._touch is None:
                self._end_touch(readings)
        elif self._touch is not None:
            is_over = load < least / 2 if self._touch.is_looked_at else load <= least and not touches
            if is_over:
                self._end_touch(readings)
        if self._touch is None:
            if load <= least and not touches:
                self._n_baseline += 1
                readings.rest(1.0 / min(self._n_baseline, max(1.0, _BASELINE_S * self._rate_hz)))
                return
            self._touch = self._begin_touch(least, is_seen=is_seen)
        if load > least or self._touch.is_looked_at:
            self._touch.take(readings, readings.recent[-1], self.acceleration_m_s2, may_slip=touches)
        else:
            self._touch.weigh(readings.recent[-1], self._places)

    def _told(self, is_late: bool, *, touches: bool) -> GripEvent | None:
        """Return the message of the newest scan: of the contact, or that it ended."""
        assert self._readings is not None
        ends = self._is_told or self._is_cut_off
        self._is_told, self._is_cut_off = touches, False
        if touches:
            assert self._touch is not None
            return self._touch.event(self._last_s, self._radius_mm, self._unit, self.is_trusted, is_late)
        return _no_contact(self._last_s, valid=self.is_trusted) if ends else None

    def _begin_touch(self, least: float, *, is_seen: bool) -> Touch:
        zero = PressZero(
            self._array.n_taxels,
            self._rate_hz,
            self._array.shear_per_friction,
            least,
            is_seen=is_seen,
            in_counts=self._array.unit == "count",
        )
        self._filter.begin(is_seen=is_seen)
        self._ripple.reset()
        return Touch(self._filter, zero, self._ripple)

    def _resume(self, touch: Touch, load: FloatArray, touches: bool, gap_s: float) -> Touch | None:
        """Return the contact if it went on in a gap, by the loads (taxels,) after it; None if it ended."""
        before = self._loads_before_gap
        changed = float(np.abs(load - before).sum())
        most = _SAME_LOADS * max(float(before.sum()), float(load.sum()))
        if touches and 0.0 < gap_s <= _LONGEST_GAP_S and changed < most:
            touch.pass_gap(gap_s)
            return touch
        self._filter.friction_memory.walk(min(max(gap_s, 0.0), _LONGEST_GAP_S))
        return None

    def _end_touch(self, readings: TaxelReadings) -> None:
        self._touch = None
        readings.release()
        if self._is_friction_due:
            self._is_friction_due = False
            self._expect_friction()
        else:
            self._filter.end()


def _no_contact(time_s: float, *, valid: bool) -> GripEvent:
    return GripEvent(time_s=time_s, valid=valid)
