"""Run-time settings of the detectors: zero, speed, friction, motion, thresholds, suppression of slips.

`TunedSuite` replaces a suite. Without any command its events are those of the suite, bit for bit. Its
settings survive gaps and replugs; `reset()` restores the configuration. Every change takes effect at a scan
boundary. A change of the zero or of thresholds is a `Gap` to the detectors, so that no window holds scans
from before and after it. Replaying the same calls between the same blocks gives the same events.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled import tomlfile
from tactiled.array import Array, FloatArray
from tactiled.detect.base import in_order
from tactiled.detect.signal.contact_gate import CONTACT_OF_RANGE
from tactiled.detect.signal.fast import StuckChannels
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.suite import DetectParams, Suite, build_suite
from tactiled.errors import ConfigError
from tactiled.events.types import ContactEvent, Event, GripEvent, SlipEvent, Suppressed
from tactiled.force.estimator import ForceSource
from tactiled.samples.block import Gap, ScanBlock

TARE_S = 0.5  # choice: averaged for a new zero: 50 scans at 100 Hz take white noise down to a seventh
_LEAST_VALID = 0.9  # choice: part of a channel's readings in a tare; both halves then have some
_LEAST_TARE_SCANS = 10  # choice: below 20 Hz, half a second holds too few scans for a mean
# derived: means of both halves may differ by this part of the contact level: 10 mV of 0.25 V on the 2019
# array, which is well above creep of 0.01 V/s in a quarter of a second and what is left of 5 mV rms of noise
# (1.4 mV), and well below what a touch brings in the time.
_STILL_OF_CONTACT = 1 / 25
_NO_MODEL = (
    "no detector of this configuration takes friction or motion: that needs an array with shear and load, "
    "the topic grip or slip, and a setting other than wang2019"
)


class StartZero:
    """Hold back the first scans until their median is known as the zero.

    Parameters
    ----------
    first_s : float
        Duration of the data that gives the zero; 0 passes every item on at once.

    Attributes
    ----------
    zero : (channels,) float64 or None
        Median of the valid readings, NaN for a channel without any; None until it is known.
    known_s : float
        Instant of the scan that completed it. Nothing is reported of earlier scans before this one.
    """

    def __init__(self, first_s: float) -> None:
        self._first_s = first_s
        self._held: list[ScanBlock | Gap] = []
        self._n_wanted = 0  # scans that are still missing
        self.zero: FloatArray | None = None
        self.known_s = -np.inf

    def process(self, item: ScanBlock | Gap) -> list[ScanBlock | Gap]:
        """Return the items that may go on; nothing while the zero is not known."""
        if self._first_s == 0 or self.zero is not None:
            return [item]
        if not self._held:  # the zero is that of the first readings
            if isinstance(item, Gap):  # what came before, with another zero, ends here
                return [item]
            is_read = item.valid.any(axis=1)
            if not is_read.any():
                return []
            item = item[int(is_read.argmax()) :]
            self._n_wanted = max(1, round(self._first_s * item.rate_hz))
        self._held.append(item)
        self._n_wanted -= 0 if isinstance(item, Gap) else len(item)
        if self._n_wanted > 0:
            return []
        blocks = [held for held in self._held if isinstance(held, ScanBlock)]
        n_wanted = sum(map(len, blocks)) + self._n_wanted
        valid = np.concatenate([block.valid for block in blocks])[:n_wanted]
        readings = np.where(valid, np.concatenate([block.volts for block in blocks])[:n_wanted], np.nan)
        seen = valid.any(axis=0)
        self.zero = np.full(readings.shape[1], np.nan)
        self.zero[seen] = np.nanmedian(readings[:, seen], axis=0)
        self.known_s = float(np.concatenate([block.time_s for block in blocks])[n_wanted - 1])
        held, self._held = self._held, []
        return held


def relative_to(zero: FloatArray | None, item: ScanBlock | Gap) -> ScanBlock | Gap:
    """Return the item relative to a zero (channels,); channels whose zero is NaN become invalid."""
    if isinstance(item, Gap) or zero is None or not zero.any():
        return item
    return replace(item, volts=item.volts - zero, valid=item.valid & np.isfinite(zero))


@dataclass(frozen=True)
class _Interval:
    """Time that a client announced: the newest one, since a slip is found soon after its onset."""

    from_s: float = np.inf
    until_s: float = -np.inf

    def announced(self, now_s: float, duration_s: float) -> "_Interval":
        """Return an interval that starts now; while this one is running, its end is replaced."""
        if duration_s == 0 and self.left_s(now_s) == 0:
            return self  # nothing to end
        return _Interval(self.from_s if self.left_s(now_s) > 0 else now_s, now_s + duration_s)

    def left_s(self, now_s: float) -> float:
        """Return the remaining time."""
        return max(0.0, self.until_s - now_s)

    def covers(self, *times_s: float) -> bool:
        """Return True if one of the instants is within the interval."""
        return any(self.from_s <= time_s <= self.until_s for time_s in times_s)


class TunedSuite:
    """Suite of detectors with run-time settings.

    Each command returns the reason why it was refused (empty if it was not) and the resulting events.

    Parameters
    ----------
    build : callable
        Makes the suite.
    force : ForceSource, optional
        Adds force events.
    """

    def __init__(
        self,
        array: Array,
        params: DetectParams,
        build: Callable[[Array, DetectParams], Suite] = build_suite,
        force: ForceSource | None = None,
    ) -> None:
        self._array = array
        self._configured = params
        self._build = build
        self._force = force
        self.reset()

    def reset(self) -> None:
        """Forget everything seen and every setting."""
        self.params = self._configured
        """Parameters in use."""
        self.baseline_volts: FloatArray | None = None
        """Zero (channels,) of the last tare; None before any tare, while the array's own is subtracted."""
        self._start = StartZero(self._array.zero_first_s)
        self.speed_mm_s: float | None = None
        """Speed last set; None while that of the configuration is used."""
        self.friction: tuple[float, float] | None = None
        """Friction last stated, and the sd of its logarithm; None while that of the configuration is used."""
        self.next_index = 0
        """Index of the first scan that a command given now applies to."""
        self._suite = self._build(self._array, self.params)
        if self._force is not None:
            self._force.reset()
            self._quantiser = Quantiser(self._array)
            self._stuck = StuckChannels(self._array, self._quantiser.volts_per_step)
        self._recent: deque[tuple[FloatArray, NDArray[np.bool_]]] = deque()  # readings and validity
        self._inhibited = self._load_changes = _Interval()
        self._in_contact = False
        self._slip_is_published = False  # an onset of this slip was published as valid
        self._slip_suppressed: Suppressed = ""

    @property
    def zero_known_s(self) -> float:
        """Instant of the scan at which a zero from the first scans was known."""
        return self._start.known_s

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return self._suite.hidden_below

    @property
    def zero(self) -> FloatArray | None:
        """Zero (channels,) in use, NaN for a channel without one; None while the first scans are not in."""
        if self.baseline_volts is not None:
            return self.baseline_volts
        return self._start.zero if self._array.zero_first_s else self._array.zero

    @property
    def zero_warning(self) -> str:
        """Channels that are left out because the first scans have no zero for them; empty for none."""
        zero = self._start.zero
        if self.baseline_volts is not None or zero is None or np.isfinite(zero).all():
            return ""
        return (
            f"channels {np.flatnonzero(np.isnan(zero)).tolist()} had no valid reading in the first "
            f"{self._array.zero_first_s:g} s, which give the zero, and are left out: repair them, then "
            "tare with nothing in contact"
        )

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes; mark slips in announced intervals as suppressed."""
        if isinstance(item, Gap):
            self._recent.clear()
        else:
            n_wanted = max(_LEAST_TARE_SCANS, round(TARE_S * item.rate_hz))
            if self._recent.maxlen != n_wanted:
                self._recent = deque(self._recent, n_wanted)
            self._recent.extend(zip(item.volts, item.valid, strict=True))
            self.next_index = int(item.index[-1]) + 1
        parts = [relative_to(self.zero, part) for part in self._start.process(item)]
        events = self._mark_suppressed([event for part in parts for event in self._suite.process(part)])
        if self._force is None:
            return events
        forces = [event for part in parts for event in self._force.process(self._without_stuck(part))]
        return in_order(events, forces)

    def _without_stuck(self, item: ScanBlock | Gap) -> ScanBlock | Gap:
        """Return the item without the readings of stuck channels, which say nothing: not even saturation."""
        if isinstance(item, Gap):
            return item
        steps, stuck = self._quantiser.process(item).steps, np.empty(item.valid.shape, dtype=np.bool_)
        if not self._stuck.take(len(item), 0, steps.reshape(-1), stuck.reshape(-1).view(np.uint8)):
            return item
        stuck &= item.valid
        return replace(item, volts=np.where(stuck, np.nan, item.volts), valid=item.valid & ~stuck)

    def tare(self, *, force: bool) -> tuple[str, list[Event]]:
        """Take the mean of the last `TARE_S` as zero; refused under load unless forced."""
        if self._in_contact and not force:
            return "something is in contact: lift the finger first, or force it if you know better", []
        n_wanted = self._recent.maxlen or _LEAST_TARE_SCANS
        if len(self._recent) < n_wanted:
            n = len(self._recent)
            return f"only {n} scans since the last gap, {n_wanted} are needed: ask again", []
        volts, valid = (np.array(part) for part in zip(*self._recent, strict=True))
        channels = np.flatnonzero(valid.mean(axis=0) < _LEAST_VALID).tolist()
        if channels:
            return f"too few valid readings of channels {channels}: repair them first", []
        volts = np.where(valid, volts, np.nan)
        half = n_wanted // 2
        drift = float(np.abs(np.nanmean(volts[-half:], axis=0) - np.nanmean(volts[:half], axis=0)).max())
        array = self._array
        level, range_ = array.contact, array.high - array.low
        still = range_ * CONTACT_OF_RANGE if level is None else level.above * _STILL_OF_CONTACT
        if drift > still and not force:
            return f"readings still move by {drift:.2g} {array.unit}: wait until they are steady", []
        events = self._insert_gap()
        self.baseline_volts = np.nanmean(volts, axis=0)
        if self._force is not None:
            self._force.tared()
        return "", events

    def forget_zero(self) -> None:
        """Discard the zero, as for another board; a gap always precedes the block that follows."""
        self.baseline_volts = None
        self._start = StartZero(self._array.zero_first_s)
        if self._force is not None:
            self._force.reset()

    def set_speed(self, speed_mm_s: float) -> None:
        """Set the sliding speed from the next scan on."""
        if speed_mm_s != self.speed_mm_s:
            self.speed_mm_s = speed_mm_s
            self._pass_speed()

    def state_friction(self, value: float, log_sd: float) -> str:
        """Take friction, in shear reading over load, from the next contact on."""
        if self._suite.grip is None:
            return _NO_MODEL
        self.friction = value, log_sd
        self._suite.grip.state_friction(value, log_sd)
        return ""

    def change_object(self) -> str:
        """Forget friction, stated or learnt, from the next contact on."""
        self.friction = None
        if self._suite.grip is None:
            return _NO_MODEL
        self._suite.grip.change_object()
        return ""

    def announce_motion(self, time_s: FloatArray, acceleration_m_s2: FloatArray) -> str:
        """Take accelerations (n,) of the hand minus gravity's, against the object's pull, by instant (n,).

        They apply to scans that are processed from now on: see `AnnouncedMotion`.
        """
        if self._suite.grip is None:
            return _NO_MODEL
        self._suite.grip.motion.announce(time_s, acceleration_m_s2)
        return ""

    def acceleration_m_s2(self, now_s: float) -> float:
        """Return the acceleration that is announced for now; NaN for none."""
        return math.nan if self._suite.grip is None else self._suite.grip.motion.at(now_s)

    def expect_late_fit(self, due_index: int) -> None:
        """Treat the fit that is due at a scan as not ready, as it was in the live run."""
        if self._suite.texture is not None:
            self._suite.texture.expect_late_fit(due_index)

    def take_late_fits(self) -> list[int]:
        """Return the due scans of the fits that were not ready since the last call."""
        return self._suite.texture.take_late_fits() if self._suite.texture is not None else []

    def inhibit(self, now_s: float, duration_s: float) -> None:
        """Suppress slips for `duration_s` from now on; 0 ends the interval now."""
        self._inhibited = self._inhibited.announced(now_s, duration_s)

    def inhibited_s(self, now_s: float) -> float:
        """Return the remaining time for which slips are suppressed."""
        return self._inhibited.left_s(now_s)

    def expect_load_change(self, now_s: float, duration_s: float) -> None:
        """Suppress incipient slips, not gross ones, during an expected change of load; 0 ends it."""
        self._load_changes = self._load_changes.announced(now_s, duration_s)

    def set_thresholds(self, values: Mapping[str, Any]) -> tuple[str, list[Event]]:
        """Change parameters of the detectors by dotted name, as in ``grip.incipient_p``."""
        document = self.params.model_dump(exclude_none=True)
        for name, value in values.items():
            place = document
            if name.split(".")[0] not in ("grip", "texture"):
                return f"{name}: names begin with grip or texture", []
            *tables, key = name.split(".")
            for table in tables:
                place = place.setdefault(table, {})
                if not isinstance(place, dict):
                    return f"{name}: {table} is no table of parameters", []
            place[key] = value
        try:
            params = tomlfile.parse(document, DetectParams, "")
            params.check_array(self._array, "")
        except ConfigError as error:
            return "; ".join(error.faults), []
        # Speed and friction are those of the newest command, whether it named them or set their parameters.
        if "texture.speed_mm_s" in values:
            self.set_speed(params.texture.speed_mm_s)
        is_restated = self.friction is not None and "grip.friction" in values
        if params == self.params and not is_restated:
            return "", []
        events = self._insert_gap()
        self.params = params
        if is_restated:
            self.friction = None
        before, self._suite = self._suite.grip, self._build(self._array, params)
        if before is not None and self._suite.grip is not None:
            self._suite.grip.motion = before.motion
        self._pass_speed()
        if self._suite.grip is not None and self.friction is not None:
            self._suite.grip.state_friction(*self.friction)
        return "", events

    def _pass_speed(self) -> None:
        if self.speed_mm_s is not None and self._suite.texture is not None:
            self._suite.texture.set_speed(self.speed_mm_s, self.next_index)

    def _insert_gap(self) -> list[Event]:
        """Pass a gap to the detectors, so that no window spans the change."""
        self._recent.clear()
        gap = Gap(0, "command", self.next_index)
        return self._mark_suppressed(self._suite.process(gap)) if self.next_index else []

    def _mark_suppressed(self, events: list[Event]) -> list[Event]:
        out: list[Event] = []
        for event in events:
            if isinstance(event, ContactEvent):
                self._in_contact = event.state != "none"
            elif isinstance(event, SlipEvent):
                is_lone_end = event.state == "end" and not self._slip_is_published
                if (reason := self._suppressed(event)) or is_lone_end:
                    event = replace(event, valid=False, suppressed=reason)
            elif isinstance(event, GripEvent) and self._inhibited.covers(event.time_s):
                event = replace(event, valid=False, suppressed="inhibit")
            out.append(event)
        return out

    def _suppressed(self, slip: SlipEvent) -> Suppressed:
        """Return the reason to suppress an event, or an empty string.

        Every published onset that is valid is followed by a published end, and no valid end comes alone.
        """
        reason: Suppressed = ""
        if slip.state == "end":
            reason = "" if self._slip_is_published else self._slip_suppressed
            self._slip_is_published, self._slip_suppressed = False, ""
            return reason
        if self._inhibited.covers(slip.onset_s, slip.detected_s):
            reason = "inhibit"
        elif slip.kind == "incipient" and self._load_changes.covers(slip.onset_s, slip.detected_s):
            reason = "load-change"
        self._slip_is_published |= slip.valid and not reason
        self._slip_suppressed = reason or self._slip_suppressed
        return reason
