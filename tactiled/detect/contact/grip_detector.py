"""Contact, slip and grip events from scans: contact gate, zero of shear, contact filter."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.contact.announced import AnnouncedMotion
from tactiled.detect.contact.fast import (
    ContactFilter,
    FrictionMemory,
    Memory,
    Posterior,
    Signs,
    SlipHysteresis,
)
from tactiled.detect.contact.filter import scans_of_look
from tactiled.detect.contact.friction import FRICTION, FRICTION_LOG_SD, prior_log_sd
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.contact.learnt import Learnt, shipped_learnt
from tactiled.detect.contact.press_zero import PressZero
from tactiled.detect.contact.slips import PosteriorSlips
from tactiled.detect.contact.travelling import TravellingRipple
from tactiled.detect.signal.contact_gate import (
    ContactParams,
    ContactTracker,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.signal.fast import Readings
from tactiled.detect.signal.front_end import AVERAGED_S
from tactiled.events.types import ContactState, Event, GripEvent
from tactiled.samples.block import LOSSES, Gap, ScanBlock
from tactiled.tomlfile import Params

# The filter looks at a contact from where the mean load of the taxels exceeds both, until that has fallen to
# half of it: of a lighter one, the ratio of shear and load is that of noise and drift.
_CONTACT_NOISES = 10.0  # choice: standard deviations of the mean load's noise
_CONTACT_RANGE = 0.005  # physical: of full scale: drift of a sensor at rest stays below it for minutes
_LONGEST_GAP_S = 2.0  # prior: beyond, what is held is held anew
# prior: of the load, by taxel: a contact goes on over a gap where loads changed by less. A hand that takes
# hold anew seldom meets the same loads; one that grips more firmly seldom doubles them within a gap.
_SAME_LOADS = 0.5
# prior: noise of a taxel's shear over its load where a log begins in contact, until the noise is measured:
# that of the noisiest usual sensors. With less, any change of the shares would be that of a slide.
_UNKNOWN_NOISE = 0.03
# prior: standard deviation of the logarithm of friction by which the model errs although friction is known:
# taxels are unequal, and pressure, speed and age count. Log friction widens by as much when the pad loses a
# taxel, whose part of the load is not seen. Coverage in `bench grip` is the same from 0.05 to 0.3.
_MODEL_SD = 0.1

_CONTACT_OF_SLIP: Mapping[str, ContactState] = {"": "holding", "incipient": "shearing", "gross": "sliding"}


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
    friction_log_sd: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="standard deviation of its logarithm; 0.1: known to 10 %. Left out: 0.6, or 1 where "
        "`friction` is left out, too, and shear has channels in counts without `shear_per_friction`",
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
    motion : AnnouncedMotion
        The hand's own motion, for the scans that are processed from now on.

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
    4.23 s: incipient slip since 4.10 s
    4.60 s: partial, utilisation 0.6
    """

    def __init__(self, array: Array, params: GripParams | None = None, learnt: Learnt | None = None) -> None:
        self._array = array
        self._params = params or GripParams()
        self.can_tell = array.measures_ratio
        self._learnt = (learnt or shipped_learnt()) if self.can_tell else None
        x, y = array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()
        # A pad that turns about its centre bears mu P times the mean distance of its loads.
        self._radius_mm = float(np.sqrt(x**2 + y**2).mean()) or 1.0
        self._places = np.stack([x, y]) / self._radius_mm
        self._least_load = _CONTACT_RANGE * array.full_scale
        self._stated: tuple[float, float] | None = None  # friction from outside, and the sd of its logarithm
        self.reset()

    def reset(self) -> None:
        """Forget everything seen and announced; keep the parameters, and friction that was stated."""
        self.motion = AnnouncedMotion()
        self._begin()

    def _begin(self) -> None:
        """Forget everything seen."""
        self._rate_hz = self._last_s = 0.0
        self.tracker: ContactTracker | None = None
        self._readings: Readings | None = None  # from the first scan on
        self._n_baseline = 0
        self._is_friction_due = False  # the next contact begins with the prior anew
        self._is_held = False  # the newest scan is of a contact
        self._press_is_over = False  # or a pull has begun in it
        self._may_go_on = False  # after a gap in the contact, until the next scan tells
        self._is_after_gap = True  # or after nothing: a contact of the next scan was not seen to begin
        self._loads_before_gap: FloatArray = np.zeros(1)
        self._is_told = False  # the newest message has a contact
        self._owes_end = False  # a gap ended the messages of a contact; the next scan says that it ended
        self.acceleration_m_s2 = math.nan
        """Announced acceleration of the hand minus that of gravity, against the object's pull, at the newest
        scan; NaN where none is announced."""

    def _make(self, rate_hz: float) -> None:
        """Make all that depends on the scan rate."""
        array, params = self._array, self._params
        self._rate_hz = rate_hz
        self.tracker = ContactTracker(array, params.contact, rate_hz)
        if self._learnt is None:
            return
        x, y = self._places.tolist()
        step = self.tracker.volts_per_step
        self._readings = Readings(array, rate_hz, step)
        self._newest = self._readings.recent[-1]  # views, which each scan changes
        self._reading = self._newest.reshape(-1)
        self._ripple = TravellingRipple(array, rate_hz, self.tracker.rest.least_step, step)
        self._slips = PosteriorSlips(rate_hz)
        look_s = scans_of_look(rate_hz) / rate_hz
        friction, log_sd = self._prior()
        self._filter = ContactFilter(
            Signs(x, y, look_s, array.shear_per_friction),
            self._learnt,
            Memory(self._learnt.base_odds),
            FrictionMemory(friction / array.shear_per_friction, log_sd),
            Posterior(look_s),
            SlipHysteresis(params.incipient_p, params.gross_p, look_s),
            rate_hz,
            self._radius_mm,
            "N" if array.unit == "N" else "relative",
        )

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
        self._is_friction_due = self._is_held or self._may_go_on
        if self._readings is not None and not self._is_friction_due:
            self._expect_friction()

    def _expect_friction(self) -> None:
        median, log_sd = self._prior()
        self._filter.friction_memory.expect(median / self._array.shear_per_friction, log_sd)

    def _prior(self) -> tuple[float, float]:
        if self._stated is not None:
            return self._stated
        median = self._params.friction or FRICTION * self._array.shear_per_friction
        log_sd = prior_log_sd(self._array) if self._params.friction is None else FRICTION_LOG_SD
        return median, self._params.friction_log_sd or log_sd

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return 0.0 if self.tracker is None else self.tracker.hidden_below

    @property
    def contact(self) -> ContactFilter | None:
        """Filter of the present contact; None without one, or where its load is too small to tell."""
        return self._filter if self._is_held and self._filter.is_begun else None

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes.

        A gap or a new scan rate ends slip and contact with events that are not valid, because their end was
        not observed. A slip inside a gap is reported where the contact goes on after it.
        """
        if isinstance(item, Gap):
            return self._pass_gap(item)
        events = self._forget() if item.rate_hz != self._rate_hz else []
        for row, message in enumerate(self.scans(item)):
            if self._changed:
                assert self.tracker is not None
                events.append(contact_event(item, row, self.tracker))
            if self._readings is not None and self._slips.kind != self._filter.hysteresis.kind:
                events += self._follow_slip(item, row, self._readings)
            if message is not None:
                events.append(message)
        return events

    def _follow_slip(self, block: ScanBlock, row: int, readings: Readings) -> list[Event]:
        """Return the events of a slip at a scan, and those of the contact states that it makes."""
        tracker, slips = self.tracker, self._slips
        assert tracker is not None
        touches, events = tracker.state != "none", list[Event]()
        # A slip that ends with the readings of a taxel was not seen to end.
        is_valid = readings.keeps_enough and not readings.is_lost and not bool(block.late[row])
        if touches and (contact := self.contact) is not None:
            events += slips.step(contact, self._last_s, float(block.time_sd_s[row]), valid=is_valid)
        elif slips.open is not None:  # readings that are lost look like a contact that is lost
            events.append(slips.end(self._filter, self._last_s, valid=is_valid and readings.is_read))
        if touches:
            tracker.go(_CONTACT_OF_SLIP[slips.kind])
            contact_change = contact_event(block, row, tracker)
            events.append(replace(contact_change, valid=contact_change.valid and not readings.is_lost))
        return events

    def scans(self, block: ScanBlock) -> Iterator[GripEvent | None]:
        """Yield the event of each scan of a block, None without contact; `contact` is then that of the scan.

        All blocks have one scan rate.
        """
        if self.tracker is None:
            self._make(block.rate_hz)
        tracker, readings = self.tracker, self._readings
        assert tracker is not None
        tracker.measure(block)
        if readings is not None:
            readings.follow(tracker, block.channel_offset_s)
        times_s, are_late = block.time_s.tolist(), block.late.tolist()
        for scan, (time_s, is_late) in enumerate(zip(times_s, are_late, strict=True)):
            self._changed = tracker.step(scan)
            step_s, self._last_s = time_s - self._last_s, time_s
            if readings is None:
                yield None
                continue
            touches = tracker.state != "none"
            in_contact = self._may_go_on or self.contact is not None
            readings.take(scan, in_contact, self._is_held and self._press_is_over)
            self._step(readings, step_s, tracker.swing_of_mean, touches=touches)
            yield self._told(readings.is_read and not is_late, is_late, touches=touches)

    def _step(self, readings: Readings, step_s: float, swing: float, *, touches: bool) -> None:
        """Take the newest scan, `step_s` after the one before; `swing` and `touches` by the contact gate."""
        self.acceleration_m_s2 = self.motion.at(self._last_s)
        contact, load = self._filter, readings.load
        is_seen, self._is_after_gap = not self._is_after_gap, False
        if readings.is_lost:
            contact.friction_memory.widen(_MODEL_SD)
            contact.hysteresis.settle()
        least = max(_CONTACT_NOISES * readings.load_sd, self._least_load, swing)
        if self._may_go_on:
            self._may_go_on = False
            contact.friction_memory.walk(min(max(step_s, 0.0), _LONGEST_GAP_S))
            if load > least and self._went_on(step_s):
                self._is_held = True
            else:
                self._end_contact(readings)
        elif self._is_held and (load < least / 2 if contact.is_begun else load <= least and not touches):
            self._end_contact(readings)
        if not self._is_held:
            if load <= least and not touches:
                self._n_baseline += 1
                readings.rest(1.0 / min(self._n_baseline, max(1.0, AVERAGED_S * self._rate_hz)))
                return
            self._begin_contact(least, is_seen=is_seen)
        if load > least or contact.is_begun:
            self._take(readings, touches=touches)
        else:
            loads, x, y = self._newest
            moment = self._places[0] @ y - self._places[1] @ x
            contact.weigh(float(x.sum()), float(y.sum()), float(moment), float(loads.sum()))

    def _take(self, readings: Readings, *, touches: bool) -> None:
        """Take the newest scan of a contact whose load is large enough to tell."""
        zero, contact, noise = self._zero, self._filter, readings.shear_sd
        if readings.floor.n == 0 and not zero.is_seen:
            noise = max(noise, _UNKNOWN_NOISE * readings.load)
        if not zero.is_measured:
            newest = self._newest
            zero.take(newest[0], newest[1:], readings.shear_sd, readings.total_sd)
            self._zero_parts = zero.parts.reshape(-1)
            self._press_is_over = zero.is_measured or zero.pull_began
            contact.zero_sd = math.hypot(zero.whole_sd, readings.total_sd / max(float(newest[0].sum()), 1e-9))
        contact.take(
            self._last_s,
            self._reading,
            self._zero_parts,
            noise,
            self.acceleration_m_s2,
            zero.is_seen,
            self._ripple.take(self._reading),
            touches,
        )

    def _told(self, is_trusted: bool, is_late: bool, *, touches: bool) -> GripEvent | None:
        """Return the message of the newest scan: of the contact, or that it ended."""
        if not self._params.publish:
            return None
        ends = self._is_told or self._owes_end
        self._is_told, self._owes_end = touches, False
        if touches:
            return self._filter.event(self._last_s, is_trusted, is_late)
        return GripEvent(time_s=self._last_s, valid=is_trusted) if ends else None

    def _begin_contact(self, least: float, *, is_seen: bool) -> None:
        self._is_held, self._press_is_over = True, False
        self._zero = PressZero(self._array, self._rate_hz, least, is_seen=is_seen)
        self._zero_parts = self._zero.parts.reshape(-1)
        self._filter.begin(is_seen=is_seen)
        self._filter.zero_sd = self._zero.whole_sd
        self._ripple.reset()

    def _end_contact(self, readings: Readings) -> None:
        self._is_held = False
        self._filter.hysteresis.close()
        readings.relief.reset()
        if self._is_friction_due:
            self._is_friction_due = False
            self._expect_friction()
        else:
            self._filter.friction_memory.end_contact()

    def _went_on(self, gap_s: float) -> bool:
        """Return whether the contact went on in a gap, by the loads before and after it."""
        before, after = self._loads_before_gap, self._newest[0]
        most = _SAME_LOADS * max(float(before.sum()), float(after.sum()))
        if not 0.0 < gap_s <= _LONGEST_GAP_S or float(np.abs(after - before).sum()) >= most:
            return False
        # What the press did while nobody looked is not known.
        self._zero.is_measured = self._press_is_over = True
        self._filter.restart()
        self._ripple.reset()
        return True

    def _pass_gap(self, gap: Gap) -> list[Event]:
        """Return the ends of what a gap interrupts; keep what is known until the scan after it.

        Where the board kept scanning, friction, baseline and noise floor are kept. The scan after the gap
        tells whether the contact went on.
        """
        if gap.cause not in LOSSES or self.tracker is None:
            return self._forget()
        self._owes_end = self._owes_end or self._is_told
        events = self._cut_off()
        self.tracker.interrupt(gap.n_missing)
        if self._readings is None:
            return events
        if self.contact is not None:
            self._may_go_on, self._is_held = True, False
            self._loads_before_gap = self._newest[0].copy()
        elif self._is_held:  # its load was too small to tell: there is nothing to go on with
            self._end_contact(self._readings)
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
        if self._readings is not None and self._slips.open is not None:
            events.append(self._slips.end(self._filter, self._last_s, valid=False))
        if self.tracker is not None and self.tracker.state != "none":
            events.append(lost_contact_event(self._last_s, self.tracker.state))
        if self._is_told:
            events.append(GripEvent(time_s=self._last_s, valid=False))
        self._is_told = False
        return events
