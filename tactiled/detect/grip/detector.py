"""Grip events from scans: contact gate, zero, contact model, one event for each scan in contact."""

import itertools
import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.grip.friction import FrictionPosterior
from tactiled.detect.grip.jumps import JumpGate
from tactiled.detect.grip.model import INCIPIENT_SHARE, NEEDED_UTILISATION, STEP_S, ContactModel, Grip
from tactiled.detect.grip.observe import (
    FLOOR_LEVELS,
    NoiseFloor,
    Responses,
    approximation_taps,
    history_scans,
    level_for,
    noise_gain,
)
from tactiled.detect.grip.press import PressZero
from tactiled.detect.grip.relief import RelievedSides
from tactiled.detect.signal.contact import ContactParams
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.stuck_channels import StuckChannelDetector
from tactiled.detect.signal.wavelet import BankParams, SwtBank
from tactiled.events.types import Event, GripEvent, GripState
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

# A contact begins where the mean load of the taxels exceeds both, and ends at half of it.
_CONTACT_NOISES = 10.0  # standard deviations of the mean load's noise
_CONTACT_RANGE = 0.005  # of full scale: drift of a sensor at rest stays below it for minutes
_FRICTION = 0.6  # of rubber on objects, the median: between 0.2 (wet, oily) and 2 (clean glass)
_BASELINE_S = 1.0  # averaging time of the readings without contact
_HOLD_S = (
    0.05  # for which the last good reading stands in; a channel that is bad for longer takes its taxel out
)
_LEAST_KEPT = 0.75  # of the taxels; with fewer, the messages are not valid
_SCANNED = ("corrupt", "missing")  # causes of gaps during which the board kept scanning
_LONGEST_GAP_S = 2.0  # beyond, what is held is held anew
# Of the load, by taxel: a contact goes on over a gap where loads changed by less. A hand that takes hold anew
# seldom meets the same loads; one that grips more firmly seldom doubles them within a gap.
_SAME_LOADS = 0.5
# During the press, when the load is small: noise of shear over load below which it is followed, and standard
# deviations by which it must exceed what is not known of it before the shares of the taxels are looked at.
_CLEAR, _NOISES = 0.02, 4.0
_FIVE_PERCENT = 1.645  # standard deviations from the median to the quantile of 95 %
_DROPPED_SD = 0.1  # by which log friction widens when the pad loses a taxel: a ninth of the load is not seen


class GripParams(Params):
    """Switch of the grip messages, and prior of the contact model."""

    enabled: bool = Field(
        default=False, description="a grip message for each scan in contact; costs about 0.7 ms of a core"
    )
    friction: float | None = Field(
        default=None,
        gt=0,
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

    model: ContactModel
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
        self._responses = Responses(array)
        self._relieved = RelievedSides(array)
        self._unit: Literal["N", "relative"] = "N" if array.unit == "N" else "relative"
        self.can_tell = self._responses.senses_load and self._responses.senses_shear
        """True where the array has load and shear channels."""
        x, y = array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()
        # A pad that turns about its centre bears mu P times the mean distance of its loads.
        self._radius_mm = float(np.hypot(x, y).mean()) or 1.0
        self._places = np.stack([x, y]) / self._radius_mm
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._quantiser = Quantiser(self._array)
        self._bank = SwtBank(self._array, BankParams(levels=tuple(range(1, FLOOR_LEVELS + 1))))
        self._floor = NoiseFloor(self._array.n_channels, self._quantiser.volts_per_step)
        median = self._params.friction or _FRICTION * self._array.shear_per_friction
        self._friction = FrictionPosterior(median, self._params.friction_log_sd)
        self._baseline = np.zeros(self._array.n_channels)
        self._n_baseline = 0
        self._rate_hz = 0.0
        self._history = np.zeros((1, 3, self._array.n_taxels))
        self._remainders = np.zeros(1)
        self._previous: FloatArray | None = None  # readings (2, channels) of the scans before
        self._relieved.reset()
        self._touch: _Touch | None = None
        self._before_gap: _Touch | None = None  # contact that a gap interrupted
        self._is_after_gap = True  # or after nothing: a contact of the next scan was not seen to begin
        self._stuck = StuckChannelDetector(self._array)
        self._jumps = JumpGate(self._responses.taxel_channels)
        self._last_s = 0.0
        self._bad_scans = np.zeros(self._array.n_channels, dtype=np.int64)
        self._dropped = np.zeros(self._array.n_taxels, dtype=np.bool_)
        self._was_bad = False  # a channel now, or a taxel that is out
        self._n_hold = 1
        self.is_trusted = True
        """False where the newest scan came late or could not be read."""

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
        return ContactScan(touch.model, touch.grip, touch.shear)

    @property
    def keeps_enough(self) -> bool:
        """True where so many taxels can be read that what is said of the contact is valid."""
        return int(np.count_nonzero(self._dropped)) <= (1 - _LEAST_KEPT) * len(self._dropped)

    def scans(self, block: ScanBlock) -> Iterator[GripEvent | None]:
        """Yield the event of each scan of a block, None without contact; `contact` is then that of the scan.

        A block of another scan rate follows a `lose_contact`.
        """
        if not self.can_tell:
            yield from itertools.repeat(None, len(block))
            return
        if not self._rate_hz:
            self._rate_hz = block.rate_hz
            self._history = np.zeros((history_scans(block.rate_hz), 3, self._array.n_taxels))
            self._remainders = np.zeros(history_scans(block.rate_hz))
            self._n_hold = max(1, round(_HOLD_S * block.rate_hz))
        held = self._quantiser.process(block)
        ok = held.ok & ~self._stuck.process(held.steps)
        details = self._bank.process(block)
        usable = np.all(details.usable, axis=1)
        late: list[bool] = block.late.tolist()
        readings = held.steps * self._quantiser.volts_per_step
        together, remainder = self._at_one_instant(readings, block)
        for scan, volts in enumerate(readings):
            if (jumped := self._jumping(volts)) is not None:
                ok[scan] &= ~jumped
                together[scan, jumped] = self._jumps.accepted[jumped]
            self.is_trusted = is_trusted = self._take_out(ok[scan]) and not late[scan]
            out = self._responses.taxel_channels[self._dropped].any(axis=0) if self._was_bad else False
            rows = details.volts[scan] if (usable[scan] | out).all() else None
            left = None if remainder is None else remainder[scan]
            time_s = float(block.time_s[scan])
            yield self._step(volts, together[scan], left, rows, time_s, is_trusted, late[scan])

    def _jumping(self, volts: FloatArray) -> NDArray[np.bool_] | None:
        """Return the channels (channels,) that jump, or None; a press moves taxels one after the other."""
        touch = self._touch
        if touch is None or not touch.is_pressed:
            self._jumps.skip(volts)
            return None
        return self._jumps.take(volts, touch.loads, self._floor.sd())

    def _at_one_instant(self, readings: FloatArray, block: ScanBlock) -> tuple[FloatArray, FloatArray | None]:
        """Return readings (n, channels) interpolated to the beginning of their scan, and the remainders.

        A board reads its channels one after the other. While shear grows, the taxels that are read last have
        grown the most, by several times what partial slip changes of their shares. Linear interpolation
        leaves half of the second derivative times the times to both readings (Abramowitz and Stegun, 25.2.3).
        That is None where all channels are read at once.
        """
        if not block.channel_offset_s.any():
            return readings, None
        n = len(readings)
        seen = np.empty((n + 2, readings.shape[1]))
        seen[:2] = readings[0] if self._previous is None else self._previous
        seen[2:] = readings
        self._previous = seen[-2:].copy()
        back = np.clip(block.channel_offset_s * block.rate_hz, 0.0, 1.0)
        change = np.diff(seen, axis=0)
        together = readings - back * change[1:]
        return np.asarray(together), np.asarray(0.5 * back * (1.0 - back) * np.diff(change, axis=0))

    def pass_gap(self, gap: Gap) -> list[Event]:
        """Return the end of a contact that a gap interrupts, and predict over the gap.

        Where the board kept scanning, friction, baseline and noise floor are kept. The scan after the gap
        tells whether the contact went on.
        """
        if gap.cause not in _SCANNED or not self._rate_hz:
            return self.lose_contact()
        events: list[Event] = [] if self._touch is None else [_no_contact(self._last_s, valid=False)]
        self._before_gap, self._touch = self._touch or self._before_gap, None
        self._is_after_gap = True
        self._bank.reset()
        self._previous = None
        return events

    def lose_contact(self) -> list[Event]:
        """Forget everything seen; return the end of a contact that is cut off."""
        events: list[Event] = [] if self._touch is None else [_no_contact(self._last_s, valid=False)]
        self.reset()
        return events

    def _take_out(self, ok: NDArray[np.bool_]) -> bool:
        """Take out taxels with a channel that is bad for long; return True if the rest can be read.

        A taxel stays out until the contact ends, because its zero and its share are no longer known.
        """
        if not self._was_bad and ok.all():
            return True
        self._bad_scans = np.where(ok, 0, self._bad_scans + 1)
        bad = self._responses.taxel_channels @ (self._bad_scans > self._n_hold)
        dropped = bad | self._dropped if self._touch is not None else bad
        if self._touch is not None and np.any(dropped & ~self._dropped):
            self._friction.spread(_DROPPED_SD)
        self._dropped = dropped
        self._was_bad = bool(dropped.any() or self._bad_scans.any())
        waits = self._responses.taxel_channels[~dropped] @ ~ok
        return not bool(np.any(waits)) and self.keeps_enough

    def _step(
        self,
        volts: FloatArray,
        together: FloatArray,
        remainder: FloatArray | None,
        details: FloatArray | None,
        time_s: float,
        is_trusted: bool,
        is_late: bool,
    ) -> GripEvent | None:
        """Take a scan (channels,) as it was read and at one instant.

        The remainder (channels,) of the interpolation is None where there is none, details (levels, channels)
        where they still see a gap.
        """
        before_s, self._last_s = self._last_s, time_s
        if details is not None:
            self._floor.take(volts, details, self._rate_hz)
        pressed = together - self._baseline
        response = self._responses.of(pressed)
        was_relieved = self._relieved.relieved
        if self._touch is not None or self._before_gap is not None:
            self._relieved.correct(response, pressed)
        response[:, self._dropped] = 0.0
        is_seen, self._is_after_gap = not self._is_after_gap, False
        if is_seen:
            self._history[:-1] = self._history[1:]
            self._history[-1] = response
        else:
            self._history[:], self._remainders[:] = response, 0.0  # no window straddles a gap
        channel_sd = self._floor.sd()
        shear_sd, total_sd, load_sd = self._responses.noise(channel_sd)
        if remainder is not None:
            self._remainders[:-1] = self._remainders[1:]
            self._remainders[-1] = (self._responses.of(remainder)[1:] ** 2).mean()
            shear_sd = math.sqrt(shear_sd**2 + self._remainders.max())
        load = float(response[0].mean())
        least = max(_CONTACT_NOISES * load_sd, _CONTACT_RANGE * self._array.full_scale)
        if self._before_gap is not None:
            self._touch = self._resume(self._before_gap, response[0], load > least, time_s - before_s)
            self._before_gap = None
        if self._touch is None:
            if load <= least:
                self._follow_baseline(volts)
                return None
            model = ContactModel(self._places[0], self._places[1], self._friction)
            n_taxels, per_friction = self._array.n_taxels, self._array.shear_per_friction
            zero = PressZero(n_taxels, self._rate_hz, per_friction, is_seen=is_seen)
            self._touch = _Touch(model, zero, self._rate_hz)
        elif load < least / 2:
            self._end_touch()
            return _no_contact(time_s, valid=is_trusted)
        if self._relieved.relieved is not was_relieved:
            switched = (self._relieved.relieved != was_relieved).any(axis=0)
            if switched.any():
                self._touch.model.loosen(switched)
        self._touch.take(self._history, shear_sd, total_sd)
        return self._touch.event(time_s, self._radius_mm, self._unit, is_trusted, is_late)

    def _resume(self, touch: "_Touch", load: FloatArray, touches: bool, gap_s: float) -> "_Touch | None":
        """Return the contact if it went on in a gap, by the loads (taxels,) after it; else end it."""
        before = touch.loads
        changed = float(np.abs(load - before).sum())
        most = _SAME_LOADS * max(float(before.sum()), float(load.sum()))
        if touches and 0.0 < gap_s <= _LONGEST_GAP_S and changed < most:
            touch.pass_gap(gap_s)
            return touch
        self._friction.walk(min(max(gap_s, 0.0), _LONGEST_GAP_S))
        self._end_touch()
        return None

    def _end_touch(self) -> None:
        self._touch = None
        self._relieved.reset()
        self._friction.end_contact()

    def _follow_baseline(self, volts: FloatArray) -> None:
        self._n_baseline += 1
        part = 1.0 / min(self._n_baseline, max(1.0, _BASELINE_S * self._rate_hz))
        self._baseline += part * (volts - self._baseline)


class _Touch:
    """One contact: its zero and its model."""

    def __init__(self, model: ContactModel, zero: PressZero, rate_hz: float) -> None:
        self.model = model
        self._zero = zero
        self._step_s = 1.0 / rate_hz
        self._since_s = self._step_s  # the scan before
        self._n_look = max(1, round(STEP_S * rate_hz))
        self._n = 0
        self._level = 0
        self._total = np.zeros(3)
        self._offset_sd = 0.0  # of shear over load
        self._load = 0.0
        self.loads: FloatArray = np.zeros(1)
        """Loads (taxels,) of the newest scan."""
        self.grip: Grip | None = None
        self.shear: FloatArray = np.zeros((2, 1))
        """Shear (2, taxels) over the total load."""

    @property
    def is_pressed(self) -> bool:
        """True once the press is over."""
        return self._zero.is_measured

    def pass_gap(self, gap_s: float) -> None:
        """Predict over a gap in which the contact went on."""
        self._zero.is_measured = True
        self._since_s = gap_s
        self.model.skip(gap_s)

    def take(self, history: FloatArray, shear_sd: float, total_sd: float) -> None:
        """Take loads and shears (n, 3, taxels) of the newest scans, with the noise of the last one."""
        self._n += 1
        zero = self._zero
        load, shear = history[-1, 0], history[-1, 1:]
        self.loads = load.copy()
        self._load = max(float(load.sum()), 1e-9)
        self._offset_sd = zero.whole_sd
        noise_sd = total_sd / self._load
        is_clear = True
        if not zero.is_measured:
            zero.take(load, shear, shear_sd, total_sd)
            self._level = level_for(shear_sd * len(load) / self._load, 1.0 / self._step_s)
            self._offset_sd = math.hypot(zero.whole_sd, noise_sd)
            is_clear = zero.is_measured or noise_sd < _CLEAR
        borne = shear - zero.parts * load
        self._total, self.shear = self.model.total(borne), borne / self._load
        if not is_clear:
            return
        self.model.follow(self._total / self._load, noise_sd, self._since_s, self._offset_sd)
        self._since_s = self._step_s
        shows = zero.is_measured or self.model.trend.size > _NOISES * self._offset_sd
        if self._n % self._n_look == 0 and shows:
            kernel = approximation_taps(self._level)
            smooth = np.tensordot(kernel[::-1], history[-len(kernel) :], axes=1)
            look_sd = math.hypot(shear_sd * noise_gain(self._level), zero.taxel_sd * self._load / len(load))
            step_s = self._n_look * self._step_s
            self.model.look(smooth[0], smooth[1:] - zero.parts * smooth[0], look_sd, step_s)

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
        size = math.sqrt(float(self._total @ self._total)) + offset * self._load
        utilisation, friction, p_gross = (
            grip.utilisation.tolist(),
            grip.friction.tolist(),
            grip.p_gross.tolist(),
        )
        low, median, high = utilisation
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
            p_gross_50ms=p_gross[0],
            p_gross_100ms=p_gross[1],
            p_gross_300ms=p_gross[2],
            load=self._load,
            shear_x=float(self._total[0]),
            shear_y=float(self._total[1]),
            torsion=float(self._total[2]) * radius_mm,
            unit=unit,
            needed_load=size / (NEEDED_UTILISATION * friction[0]),
            state=state,
            valid=is_trusted,
            late=is_late,
        )


def _no_contact(time_s: float, *, valid: bool) -> GripEvent:
    return GripEvent(time_s=time_s, valid=valid)
