"""Grip events from scans: contact gate, zero, contact model, one event for each scan in contact."""

import itertools
import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.grip.announced import AnnouncedMotion
from tactiled.detect.grip.compiled_model import AnyContactModel, contact_model
from tactiled.detect.grip.friction import FrictionPosterior
from tactiled.detect.grip.model import INCIPIENT_SHARE, NEEDED_UTILISATION, STEP_S, Grip
from tactiled.detect.grip.observe import (
    level_for,
    noise_gain,
)
from tactiled.detect.grip.press import PressZero
from tactiled.detect.grip.readings import AnyTaxelReadings, ScanReading, taxel_readings
from tactiled.detect.signal.contact import ContactParams
from tactiled.events.types import Event, GripEvent, GripState
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

# A contact begins where the mean load of the taxels exceeds both, and ends at half of it.
_CONTACT_NOISES = 10.0  # standard deviations of the mean load's noise
_CONTACT_RANGE = 0.005  # of full scale: drift of a sensor at rest stays below it for minutes
_FRICTION = 0.6  # of rubber on objects, the median: between 0.2 (wet, oily) and 2 (clean glass)
_BASELINE_S = 1.0  # averaging time of the readings without contact
_SCANNED = ("corrupt", "missing")  # causes of gaps during which the board kept scanning
_LONGEST_GAP_S = 2.0  # beyond, what is held is held anew
# Of the load, by taxel: a contact goes on over a gap where loads changed by less. A hand that takes hold anew
# seldom meets the same loads; one that grips more firmly seldom doubles them within a gap.
_SAME_LOADS = 0.5
# During the press, when the load is small: noise of shear over load below which it is followed, and standard
# deviations by which it must exceed what is not known of it before the shares of the taxels are looked at.
_CLEAR, _NOISES = 0.02, 4.0
_FIVE_PERCENT = 1.645  # standard deviations from the median to the quantile of 95 %
_UNKNOWN_USED = (0.0, 0.5, 1.0)  # utilisation of a contact whose beginning nobody saw
# Standard deviation of the logarithm of friction by which the model errs although friction is known: taxels
# are unequal, and pressure, speed and age count. Coverage is the same from 0.05 to 0.3; errors grow with it.
_MODEL_SD = 0.1
_DROPPED_SD = 0.1  # by which log friction widens when the pad loses a taxel: a ninth of the load is not seen


class GripParams(Params):
    """Prior of the contact model, probabilities at which slips are reported, switch of the grip messages."""

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
        default=0.9, gt=0, lt=1, description="probability of incipient slip from which slip events report it"
    )
    gross_p: float = Field(
        default=0.25, gt=0, lt=1, description="probability of gross slip from which slip events report it"
    )
    contact: ContactParams = ContactParams()


class ContactScan(NamedTuple):
    """State of a contact after a scan, for those who report slips.

    Attributes
    ----------
    model : ContactModel
    grip : Grip
    shear : (2, taxels) float64
        Force of the object on the skin, over the total load.
    """

    model: AnyContactModel
    grip: Grip
    shear: FloatArray


class GripDetector:
    """Compute how close a contact is to slipping, for each scan.

    An array without shear or without load channels cannot tell, and gets no events.

    Parameters
    ----------
    array : Array
    params : GripParams

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
    >>> grips = GripDetector(array).process(regular_block(volts, 100.0))
    >>> for grip in (grip for grip in grips if f"{grip.time_s:.2f}" in ("3.90", "4.20", "4.60")):
    ...     print(f"{grip.time_s:.2f} s: {grip.state}, utilisation {grip.utilisation:.1f}")
    3.90 s: sticking, utilisation 0.0
    4.20 s: partial, utilisation 0.2
    4.60 s: partial, utilisation 0.4
    """

    def __init__(self, array: Array, params: GripParams | None = None) -> None:
        self._array = array
        self._params = params or GripParams()
        self._unit: Literal["N", "relative"] = "N" if array.unit == "N" else "relative"
        self.can_tell = bool(np.any(array.normal_weights() != 0)) and array.has_shear
        """True where the array has load and shear channels."""
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
        self._friction = self._prior()
        self._is_friction_due = False  # the next contact begins with the prior anew
        self._n_baseline = 0
        self._rate_hz = 0.0
        self._readings: AnyTaxelReadings | None = None  # from the first scan on
        self._touch: _Touch | None = None
        self._before_gap: _Touch | None = None  # contact that a gap interrupted
        self._is_after_gap = True  # or after nothing: a contact of the next scan was not seen to begin
        self._loads_before_gap: FloatArray = np.zeros(1)
        self._last_s = 0.0
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
            Standard deviation of its logarithm. That of the model itself is added: see `_MODEL_SD`.
        """
        self._stated = value, math.hypot(log_sd, _MODEL_SD)
        self._renew_friction()

    def change_object(self) -> None:
        """Forget friction, stated or learnt: from the next contact on, another object is held."""
        self._stated = None
        self._renew_friction()

    def _renew_friction(self) -> None:
        if self._touch is None and self._before_gap is None:
            self._friction = self._prior()
        else:
            self._is_friction_due = True

    def _prior(self) -> FrictionPosterior:
        if self._stated is not None:
            return FrictionPosterior(*self._stated)
        median = self._params.friction or _FRICTION * self._array.shear_per_friction
        return FrictionPosterior(median, self._params.friction_log_sd)

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return an event for each scan in contact, and one of state none when the contact ends."""
        if isinstance(item, Gap):
            return self.pass_gap(item)
        events = self.lose_contact() if item.rate_hz != self._rate_hz else []
        events += [event for event in self.scans(item) if event is not None]
        return events

    @property
    def contact(self) -> ContactScan | None:
        """Newest scan of the present contact; None without one."""
        touch = self._touch
        if touch is None or touch.grip is None:
            return None
        return ContactScan(touch.model, touch.grip, touch.model.shear)

    @property
    def keeps_enough(self) -> bool:
        """True where so many taxels can be read that what is said of the contact is valid."""
        return self._readings is None or self._readings.keeps_enough

    def scans(self, block: ScanBlock) -> Iterator[GripEvent | None]:
        """Yield the event of each scan of a block, None without contact; `contact` is then that of the scan.

        A block of another scan rate follows a `lose_contact`.
        """
        if not self.can_tell:
            yield from itertools.repeat(None, len(block))
            return
        readings = self._readings
        if readings is None:
            self._rate_hz = block.rate_hz
            self._readings = readings = taxel_readings(self._array, block.rate_hz)
        readings.begin(block)
        for scan, (time_s, is_late) in enumerate(
            zip(block.time_s.tolist(), block.late.tolist(), strict=True)
        ):
            in_contact = self._touch is not None or self._before_gap is not None
            is_pressed = self._touch is not None and self._touch.is_pressed
            reading = readings.take(scan, in_contact=in_contact, is_pressed=is_pressed)
            self.is_trusted = reading.is_read and not is_late
            yield self._step(readings, reading, time_s, is_late)

    def pass_gap(self, gap: Gap) -> list[Event]:
        """Return the end of a contact that a gap interrupts, and predict over the gap.

        Where the board kept scanning, friction, baseline and noise floor are kept. The scan after the gap
        tells whether the contact went on.
        """
        if gap.cause not in _SCANNED or self._readings is None:
            return self.lose_contact()
        events: list[Event] = [] if self._touch is None else [_no_contact(self._last_s, valid=False)]
        if self._touch is not None:
            self._before_gap, self._touch = self._touch, None
            self._loads_before_gap = self._readings.history[-1, 0].copy()
        self._is_after_gap = True
        self._readings.interrupt()
        return events

    def lose_contact(self) -> list[Event]:
        """Forget everything seen; return the end of a contact that is cut off."""
        events: list[Event] = [] if self._touch is None else [_no_contact(self._last_s, valid=False)]
        self._begin()
        return events

    def _step(
        self,
        readings: AnyTaxelReadings,
        reading: ScanReading,
        time_s: float,
        is_late: bool,
    ) -> GripEvent | None:
        """Take the newest scan of the readings."""
        before_s, self._last_s = self._last_s, time_s
        self.acceleration_m_s2 = self._motion.at(time_s)
        is_seen, self._is_after_gap = not self._is_after_gap, False
        if reading.is_lost:
            self._friction.spread(_DROPPED_SD)
        load = reading.load
        least = max(_CONTACT_NOISES * reading.load_sd, self._least_load)
        if self._before_gap is not None:
            loads = readings.history[-1, 0]
            self._touch = self._resume(self._before_gap, loads, load > least, time_s - before_s)
            self._before_gap = None
            if self._touch is None:
                self._end_touch(readings)
                if load <= least:  # the contact that was cut off is known to have ended
                    return _no_contact(time_s, valid=self.is_trusted)
        if self._touch is None:
            if load <= least:
                self._n_baseline += 1
                readings.rest(1.0 / min(self._n_baseline, max(1.0, _BASELINE_S * self._rate_hz)))
                return None
            x, y = self._places
            model = contact_model(x, y, self._friction, readings.history, 1.0 / self._rate_hz)
            per_friction = self._array.shear_per_friction
            zero = PressZero(self._array.n_taxels, self._rate_hz, per_friction, least, is_seen=is_seen)
            self._touch = _Touch(model, zero, self._rate_hz)
        elif load < least / 2:
            self._end_touch(readings)
            return _no_contact(time_s, valid=self.is_trusted)
        if reading.is_switched:
            self._touch.model.loosen(readings.switched)
        self._touch.take(reading, readings.history)
        return self._touch.event(time_s, self._radius_mm, self._unit, self.is_trusted, is_late)

    def _resume(self, touch: "_Touch", load: FloatArray, touches: bool, gap_s: float) -> "_Touch | None":
        """Return the contact if it went on in a gap, by the loads (taxels,) after it; None if it ended."""
        before = self._loads_before_gap
        changed = float(np.abs(load - before).sum())
        most = _SAME_LOADS * max(float(before.sum()), float(load.sum()))
        if touches and 0.0 < gap_s <= _LONGEST_GAP_S and changed < most:
            touch.pass_gap(gap_s)
            return touch
        self._friction.walk(min(max(gap_s, 0.0), _LONGEST_GAP_S))
        return None

    def _end_touch(self, readings: AnyTaxelReadings) -> None:
        self._touch = None
        readings.release()
        if self._is_friction_due:
            self._friction, self._is_friction_due = self._prior(), False
        else:
            self._friction.end_contact()


class _Touch:
    """One contact: its zero and its model."""

    def __init__(self, model: AnyContactModel, zero: PressZero, rate_hz: float) -> None:
        self.model = model
        self._zero = zero
        self._step_s = 1.0 / rate_hz
        self._since_s = self._step_s  # the scan before
        self._n_look = max(1, round(STEP_S * rate_hz))
        self._n = 0
        self._level = 0
        self._offset_sd = 0.0  # of shear over load
        self._load = 0.0
        self.grip: Grip | None = None
        self._is_known = (
            False  # a slide told how much of the limit is in use, though nobody saw the beginning
        )

    @property
    def is_pressed(self) -> bool:
        """True once the press is over, or a pull has begun in it."""
        return self._zero.is_measured or self._zero.is_left

    def pass_gap(self, gap_s: float) -> None:
        """Predict over a gap in which the contact went on."""
        self._zero.is_measured = True
        self._since_s = gap_s
        self.model.skip(gap_s)

    def take(self, reading: ScanReading, history: FloatArray) -> None:
        """Take a scan, with loads and shears (n, 3, taxels) up to it."""
        self._n += 1
        zero, model, n_taxels = self._zero, self.model, history.shape[2]
        self._load = max(reading.load * n_taxels, 1e-9)
        noise_sd = reading.total_sd / self._load
        self._offset_sd = zero.whole_sd
        is_clear = True
        if not zero.is_measured:
            zero.take(history[-1, 0], history[-1, 1:], reading.shear_sd, reading.total_sd)
            model.parts[:] = zero.parts
            self._level = level_for(reading.shear_sd * n_taxels / self._load, 1.0 / self._step_s)
            self._offset_sd = math.hypot(zero.whole_sd, noise_sd)
            is_clear = self.is_pressed or noise_sd < _CLEAR
        if not is_clear:
            model.measure(self._load)
            return
        model.follow(self._load, noise_sd, self._since_s, self._offset_sd)
        self._since_s = self._step_s
        shows = self.is_pressed or model.trend.size > _NOISES * self._offset_sd
        if self._n % self._n_look == 0 and shows:
            noise_sd = reading.shear_sd * noise_gain(self._level)
            look_sd = math.hypot(noise_sd, zero.taxel_sd * self._load / n_taxels)
            model.look(self._level, look_sd, self._n_look * self._step_s)

    def event(
        self, time_s: float, radius_mm: float, unit: Literal["N", "relative"], is_trusted: bool, is_late: bool
    ) -> GripEvent:
        """Return the event of the scan that was taken."""
        self.grip = grip = self.model.grip()
        state: GripState = "sticking"
        if grip.is_gross:
            state = "gross"
        elif grip.is_unloading:
            state = "unloading"
        elif grip.slipping_share > INCIPIENT_SHARE:
            state = "partial"
        # What is not known of the zero widens the interval of the utilisation.
        offset = _FIVE_PERCENT * self._offset_sd
        x, y, moment = total = self.model.total
        size = math.hypot(*total) + offset * self._load
        low, median, high = grip.utilisation
        self._is_known = self._is_known or self._zero.is_seen or grip.is_gross
        if not self._is_known:  # it may hold or slide, with any shear: nothing is in use for sure, nor free
            state = "unknown"
            low, median, high = _UNKNOWN_USED
        friction, p_gross = grip.friction, grip.p_gross
        needed_load = size / (NEEDED_UTILISATION * friction[0])
        more = offset / friction[1]
        return GripEvent(
            time_s=time_s,
            utilisation=median,
            utilisation_low=max(0.0, median - math.hypot(median - low, more)),
            utilisation_high=min(1.0, median + math.hypot(high - median, more)),
            friction=friction[1],
            friction_low=friction[0],
            friction_high=friction[2],
            slipping_share=grip.slipping_share,
            p_sliding=min(grip.p_sliding, 1.0),
            p_gross_50ms=p_gross[0],
            p_gross_100ms=p_gross[1],
            p_gross_300ms=p_gross[2],
            load=self._load,
            shear_x=x,
            shear_y=y,
            torsion=moment * radius_mm + 0.0,  # never -0.0
            unit=unit,
            needed_load=needed_load if self._is_known else max(needed_load, self._load),
            state=state,
            valid=is_trusted,
            late=is_late,
        )


def _no_contact(time_s: float, *, valid: bool) -> GripEvent:
    return GripEvent(time_s=time_s, valid=valid)
