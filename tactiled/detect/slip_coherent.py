"""Slip as early as the signal allows: one decision of the whole array ("coherent").

* Evidence (`slip_evidence`): shear of the array as a whole grows beyond noise, pressure and elastic play.
  That is "incipient": some part of the contact slips, or is about to. The instant is the kink's, when shear
  began to grow (`slip_kink`); no signal shows when a tenth of the contact slips, since friction is not known.
* Course (`slip_course`): the growth stops while shear is large, and all slips: "gross", an event of its own
  with its own instant. Or it stops below, or goes back: the end of an incipient slip.
* A gross slip that turns back, turns, or sticks and grows again ends, and another begins at the same instant.
* While a slip goes on it is not said again; what came and went of late must grow beyond that to be said.

Nothing is said of an array out of contact. Arrays without shear channels see a load that moves between
taxels; they tell no direction. One such taxel alone sees nothing.

`confidence` is the opposed part of opposed plus common rise, times the taxels' agreement on it, halved where
the contact's beginning was not seen; it is no probability.

A controller that knows better says so with `announce`. What falls into its time is reported, not valid.
"""

import dataclasses
import math
from collections import deque
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.contact import (
    ContactParams,
    ContactTracker,
    Transition,
    contact_event,
    lost_contact_event,
)
from tactiled.detect.quantise import Quantiser
from tactiled.detect.slip_course import Course, Verdict
from tactiled.detect.slip_evidence import Evidence, Growth, Stretch
from tactiled.detect.slip_filters import N_BASELINE
from tactiled.detect.slip_kink import Kink, find_kink
from tactiled.detect.slip_response import PRESSURE, motion
from tactiled.detect.slip_witness import Testimony, Witness
from tactiled.events.types import ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

DETECTOR = "coherent"
_PIECE_SCANS = 256  # filtered at once: bounds the memory of long blocks
_KEPT_ANNOUNCED = 8
# Shear that came and went is no news for a while: a hum or a shaking arm is said once, not at each swing.
_NEWS = 1.2
_FORGET_S = 1.0
_BEGUN = 0.004  # shear over pressure at which a load has begun to grow: friction of 0.2 % of the load


class CoherentParams(Params):
    """How sure a slip must be, and of how much shear."""

    false_alarms_per_hour: float = Field(
        default=1.0, gt=0, le=3600, description="that noise alone may raise; the threshold follows"
    )
    least_shear: float = Field(
        default=0.1, gt=0, le=1, description="growth of shear over pressure, both in volts, that counts"
    )
    # On the 2019 array shear over pressure is 1.9 times friction over load; 0.3 is the least friction of
    # dry skins.
    gross_shear: float = Field(
        default=0.45, gt=0, le=5, description="shear over pressure below which nothing is gross"
    )
    # Half of the paper's "clear enough": the mean of four resistors is clear enough at 10 mV of noise each.
    contact: ContactParams = ContactParams(contact_volts=0.25, release_volts=0.15)


SETTINGS: Mapping[str, CoherentParams] = {
    "fast": CoherentParams(false_alarms_per_hour=6.0, least_shear=0.02),
    "balanced": CoherentParams(false_alarms_per_hour=1.0, least_shear=0.1),
    "quiet": CoherentParams(false_alarms_per_hour=0.1, least_shear=0.25),
}
"""``fast`` takes all growing shear for slip, ``quiet`` waits until a tenth slips on any likely friction."""

Announcement = Literal["inhibit", "load-change"]
SlipKind = Literal["incipient", "gross"]


class _Announced(NamedTuple):
    kind: Announcement
    from_index: int
    duration_s: float


class _Slip(NamedTuple):
    """The slip that goes on: its newest onset event, its course, and the evidence that raised it."""

    event: SlipEvent
    course: Course
    statistic: float


class CoherentSlip:
    """Contact and slip events; a `Detector`.

    Parameters
    ----------
    array : Array
    params : CoherentParams
    """

    def __init__(self, array: Array, params: CoherentParams | None = None) -> None:
        self._array = array
        self._params = params or CoherentParams()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen and announced; keep the parameters."""
        self._announced: deque[_Announced] = deque(maxlen=_KEPT_ANNOUNCED)
        self._forget_signal()

    def _forget_signal(self) -> None:
        self._rate_hz = 0.0  # nothing seen
        self._last_time_s = 0.0
        self._slip: _Slip | None = None

    def _start(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._quantiser = Quantiser(self._array)
        self._tracker = ContactTracker(self._array, self._params.contact, rate_hz)
        self._evidence = Evidence(
            self._array, rate_hz, self._params.false_alarms_per_hour, self._params.least_shear
        )
        self._n_seen = 0
        self._told = 0  # what was until this scan is told, or was no contact
        self._came_and_went = (0.0, 0)  # shear over pressure, and when

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._tracker.state if self._rate_hz else "none"

    def announce(self, kind: Announcement, from_index: int, duration_s: float) -> None:
        """Something that its maker knows of: what slips meanwhile is reported as not valid.

        Parameters
        ----------
        kind : {"inhibit", "load-change"}
            The hand itself moves: nothing is valid. Or a load is taken up or set down: shear grows for a
            reason, so incipient slip is not valid; gross slip is.
        from_index : int
            First scan that it holds for, in the count of the blocks.
        duration_s : float
        """
        self._announced.append(_Announced(kind, from_index, duration_s))

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Events that the item completes.

        A gap, or a new scan rate, ends a slip and a contact with events that are not valid: nobody saw
        them end. The detector then is as new, but for what is announced.
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
        if self._slip is not None:
            events.append(_ended(self._slip.event, self._last_time_s, self._last_time_s, valid=False))
        if self.contact_state != "none":
            events.append(lost_contact_event(self._last_time_s, self.contact_state))
        self._forget_signal()
        return events

    def _process_piece(self, block: ScanBlock) -> list[Event]:
        held = self._quantiser.process(block)
        pressure = self._tracker.measure(block, held)
        gate = pressure.rows()
        events: list[Event] = []
        for stretch in self._evidence.stretches(held):
            if self._slip is not None:
                self._slip.course.shift(stretch.jump)
            for row in range(stretch.scans.stop - stretch.scans.start):
                scan = stretch.scans.start + row
                if change := self._tracker.step(*next(gate)):
                    events.append(contact_event(block, scan, pressure, change))
                now = Witness(self._array, self._evidence, block, stretch, row, self._n_seen)
                events += self._look(now, stretch, row)
                if change := self._follow():
                    events.append(contact_event(block, scan, pressure, change))
                self._n_seen += 1
        return events

    def _follow(self) -> Transition | None:
        """Sliding is known by slip alone."""
        is_gross = self._slip is not None and self._slip.course.is_gross
        if is_gross and self._tracker.state not in ("sliding", "none"):
            return self._tracker.begin_sliding()
        return self._tracker.end_sliding() if self._tracker.state == "sliding" and not is_gross else None

    def _look(self, now: Witness, stretch: Stretch, row: int) -> list[SlipEvent]:
        """What a scan brings."""
        events: list[SlipEvent] = []
        happens = True
        if self._tracker.state == "none":
            self._told = now.index
            happens = False
            if self._slip is not None:
                events = [self._end(now, now.time_s)]
        elif self._slip is not None:
            course = self._slip.course
            verdict = course.step(now.index, now.seen, self._evidence.noise(course.along))
            events = self._conclude(verdict, now) if verdict else []
        else:
            least = self._shaken(now.index) * float(now.seen[-1, PRESSURE])
            growth = self._evidence.growth(stretch, row, now.index - self._told, least)
            happens = growth is not None
            events = [self._onset(growth, now)] if growth else []
        self._evidence.learn(stretch.details[row], happens)
        return events

    def _shaken(self, index: int) -> float:
        """Shear over pressure that came and went of late."""
        size, at = self._came_and_went
        return size * math.pow(2.0, -(index - at) / (_FORGET_S * self._rate_hz))

    def _onset(self, growth: Growth, now: Witness) -> SlipEvent:
        size = float(np.sqrt((growth.rise**2).sum()))
        along = growth.rise / size
        n = min(growth.scans + max(N_BASELINE, growth.scans), now.index - self._told, len(now.seen))
        course = motion(now.seen[-n:]) @ along
        least = _BEGUN * float(now.seen[-1, PRESSURE])
        kink = find_kink(course, 2 * growth.scans, self._evidence.noise(along), least)
        said = now.testify(along, growth.change)
        return self._begin(now, along, kink, said, size / growth.scans, growth.statistic)

    def _begin(
        self,
        now: Witness,
        along: FloatArray,
        kink: Kink,
        said: Testimony,
        slope: float,
        statistic: float,
    ) -> SlipEvent:
        onset_s = now.time_s + now.skew_s(along) - kink.delay_scans / self._rate_hz
        event = SlipEvent(
            time_s=onset_s,
            state="onset",
            kind="incipient",
            onset_s=onset_s,
            onset_sd_s=float(np.hypot(kink.sd_scans / self._rate_hz, now.time_sd_s)),
            direction_deg=said.direction_deg,
            direction_sd_deg=said.direction_sd_deg,
            confidence=said.confidence / (2 if self._tracker.state == "unknown" else 1),
            taxels=said.taxels,
            detector=DETECTOR,
            statistic=statistic,
            threshold=self._evidence.threshold,
            valid=self._is_valid("incipient", onset_s, now),
            detected_s=now.time_s,
        )
        before = now.seen[now.ago(kink.delay_scans)]
        course = Course(
            along,
            before,
            self._evidence.even,
            now.index,
            kink.delay_scans,
            slope,
            self._rate_hz,
            least=self._params.least_shear,
            gross=self._params.gross_shear,
        )
        self._slip = _Slip(event, course, statistic)
        return event

    def _conclude(self, verdict: Verdict, now: Witness) -> list[SlipEvent]:
        """Events of what became of the slip."""
        assert self._slip is not None
        along, statistic = self._slip.course.along, self._slip.statistic
        since = now.index - verdict.index
        at_s = now.time_s + now.skew_s(along) - since / self._rate_hz
        if verdict.fate == "gross":
            return [self._deepen(verdict, now, at_s)]
        was_gross = self._slip.event.kind == "gross"
        if verdict.fate == "back" and not was_gross:
            size = _NEWS * self._slip.course.excursion(now.seen[-1])
            self._came_and_went = (max(size, self._shaken(now.index)), now.index)
        events = [self._end(now, at_s)]
        self._told = int(verdict.index)
        towards = now.along(since)
        if (was_gross or verdict.fate == "turned") and towards.any():
            # Friction points along the motion: in a slip that goes on, all of the response does.
            if was_gross and verdict.fate == "turned":
                towards = motion(now.seen[-1]) / np.sqrt((motion(now.seen[-1]) ** 2).sum())
            size = float(np.sqrt((motion(now.seen[-1] - now.seen[now.ago(since)]) ** 2).sum()))
            kink = Kink(since, max(verdict.sd_scans, 1.0))
            said = now.testify(towards, now.changed(since))
            events.append(self._begin(now, towards, kink, said, size / max(since, 1.0), statistic))
        return events

    def _deepen(self, verdict: Verdict, now: Witness, gross_s: float) -> SlipEvent:
        assert self._slip is not None
        event = dataclasses.replace(
            self._slip.event,
            kind="gross",
            time_s=gross_s,
            onset_s=gross_s,
            onset_sd_s=float(np.hypot(verdict.sd_scans / self._rate_hz, now.time_sd_s)),
            valid=self._is_valid("gross", gross_s, now),
            detected_s=now.time_s,
        )
        self._slip = self._slip._replace(event=event)
        return event

    def _is_valid(self, kind: SlipKind, onset_s: float, now: Witness) -> bool:
        """Whether nobody has announced it, and it does not come late."""
        return not now.is_late and not any(
            (a.kind == "inhibit" or kind == "incipient")
            and now.block_index >= a.from_index
            and now.block_index - (now.time_s - onset_s) * self._rate_hz
            <= a.from_index + a.duration_s * self._rate_hz
            for a in self._announced
        )

    def _end(self, now: Witness, ended_s: float) -> SlipEvent:
        assert self._slip is not None
        event = self._slip.event
        self._slip = None
        return _ended(event, ended_s, now.time_s, valid=event.valid and not now.is_late)


def _ended(event: SlipEvent, ended_s: float, detected_s: float, *, valid: bool) -> SlipEvent:
    """Event for the end; it repeats what the onset's event said."""
    return dataclasses.replace(event, state="end", time_s=ended_s, detected_s=detected_s, valid=valid)
