"""Tracker of the slips of one contact: scans to slip events.

While no slip is active, evidence of growing shear begins one. An active slip is followed through its phases;
a gross slip whose shear fell back is followed until shear reverses or rests. Each slip is reported once:
evidence counts from the scan where the last slip ended, and shear must exceed that of recent swings
(`slip.swings`). Two slips in quick succession are separated only if the skin springs back in between;
otherwise no signal shows the stop.
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.slip import slip_events
from tactiled.detect.slip.evidence import ShearEvidence, ShearGrowth
from tactiled.detect.slip.friction_limit import FrictionLimitTest
from tactiled.detect.slip.gap import LOOK_SCANS, PreGapReadings, moved_in_gap
from tactiled.detect.slip.gross import SlipDecision
from tactiled.detect.slip.history import ResponseHistory
from tactiled.detect.slip.kink import KinkEstimate
from tactiled.detect.slip.phases import SlipPhaseTracker
from tactiled.detect.slip.response import PRESSURE, motion, unit
from tactiled.detect.slip.scan_evidence import ScanEvidence, SlipDescription
from tactiled.detect.slip.segments import TaxelSetSegment
from tactiled.detect.slip.swings import OUTGROWS_S, ShakeTracker, SwingHistory, extent
from tactiled.events.types import ContactState, SlipEvent

_SWING_S = 2.0  # a whole swing of 0.5 Hz


class _TrackedSlip(NamedTuple):
    """Slip with its newest onset event, its phase tracker and the statistic that raised it."""

    event: SlipEvent
    phases: SlipPhaseTracker
    statistic: float


class SlipTracker:
    """Track the slips of one contact.

    Parameters
    ----------
    evidence : ShearEvidence
    rate_hz : float
    least_shear, gross_shear : float
        Least shear over pressure that counts as slip, and that of gross slip.
    before : PreGapReadings or None
        Readings before a gap in which the contact continued.
    """

    def __init__(
        self,
        evidence: ShearEvidence,
        rate_hz: float,
        least_shear: float,
        gross_shear: float,
        before: PreGapReadings | None = None,
    ) -> None:
        self._evidence = evidence
        self._rate_hz = rate_hz
        self._least_shear, self._gross_shear = least_shear, gross_shear
        self._before = before
        self._slip: _TrackedSlip | None = None
        self._recoil: _TrackedSlip | None = None  # an ended slip whose shear may be reversing
        self._reported_until = 0  # scans up to this one were reported, or had no contact
        self._swings = SwingHistory(rate_hz)
        self._shake: ShakeTracker | None = None  # sustained shaking, reported as one slip
        self._unreported: ShakeTracker | None = None  # swings that are not reported
        self._history = ResponseHistory(rate_hz, evidence.longest)

    @property
    def is_gross(self) -> bool:
        """True while the whole contact slips."""
        return self._slip is not None and self._slip.event.kind == "gross"

    def shift(self, jump: FloatArray) -> None:
        """Correct all kept responses for a change of the taxel set, by which the response jumps by (7,)."""
        for slip in (self._slip, self._recoil):
            if slip is not None:
                slip.phases.shift(jump, self._evidence.taxels)
        self._history.shift(jump)

    def cut_off(self, time_s: float) -> list[SlipEvent]:
        """Return the end of an active slip cut off by a gap, marked as not valid."""
        if self._slip is None:
            return []
        return [slip_events.ended(self._slip.event, time_s, time_s, valid=False)]

    def is_quiet(self, segment: TaxelSetSegment, row: int, index: int, state: ContactState) -> bool:
        """Return True where `lift` or `look` would do no more with scan `index` than `pass_quiet` does."""
        if self._slip is not None:
            return False
        if state == "none":
            return True
        if self._recoil is not None or self._shake is not None or self._unreported is not None:
            return False
        is_after_gap = self._before is not None and index == LOOK_SCANS - 1
        return not is_after_gap and not segment.any_fits[row]

    def pass_quiet(
        self, segment: TaxelSetSegment, row: int, n: int, first_index: int, state: ContactState
    ) -> None:
        """Process n scans that are quiet, from a row of the segment on, in one state of the contact."""
        if state != "none":
            self._history.take(segment.newest(row, n))
            return
        self._reported_until = first_index + n - 1
        self._recoil = self._shake = self._unreported = None
        self._history.forget()

    def lift(self, now: ScanEvidence) -> list[SlipEvent]:
        """Process a scan without contact; an active slip ends."""
        self._reported_until = now.index
        self._recoil = self._shake = self._unreported = None
        self._history.forget()
        return [] if self._slip is None else [self._end(now, now.time_s)]

    def look(
        self, now: ScanEvidence, segment: TaxelSetSegment, row: int, *, is_sure: bool
    ) -> list[SlipEvent]:
        """Process a scan in contact; `is_sure` is True if the beginning of the contact was observed.

        With a mean pressure of zero or less there is no load: the scan is kept but not evaluated.
        """
        self._history.take(now.seen[-1:])
        if self._before is not None and now.index == LOOK_SCANS - 1 and self._slip is None:
            return self._look_back(self._before, now)
        if now.seen[-1, PRESSURE] <= 0:
            return []  # no load, or no valid taxel: shear over pressure is undefined in this scan
        if self._shake is not None:
            return self._follow_shake(self._shake, now)
        if (slip := self._slip or self._recoil) is not None:
            noise = self._evidence.noise(slip.phases.along)
            decision = slip.phases.step(now.index, now.seen, now.steps, noise)
            if decision is None:
                return []
            return self._apply_recoil(decision, now) if slip is self._recoil else self._apply(decision, now)
        if self._is_outgrown(now):
            return self._begin_outgrown(now, self._evidence.threshold)
        since, pressure = now.index - self._reported_until, float(now.seen[-1, PRESSURE])
        growth = self._evidence.growth(segment, row, since, 0.0)
        if growth is None:
            return []
        least = self._swings.least(now.index)
        if least > 0 and self._evidence.growth(segment, row, since, least * pressure) is None:
            self._swings.go_on(now.index)
            if self._unreported is None:
                self._unreported = self._swinging(now, least)
            return []
        return [self._onset(growth, now, is_sure)]

    def _swinging(self, now: ScanEvidence, least: float) -> ShakeTracker:
        """Make the tracker of swings that are not reported, as large as shear before the newest of them."""
        # A swing is measured from end to end; its amplitude about the middle is half of that.
        before = now.seen[: len(now.seen) - (now.index - self._reported_until)]
        of_late = before[-round(_SWING_S * self._rate_hz) :]
        sizes = [extent(motion(row)) / max(float(row[PRESSURE]), 1.0) for row in of_late]
        largest = max([least / 2, *sizes])
        return ShakeTracker(
            now.index, now.shear, largest, self._rate_hz, self._least_shear, is_known=bool(sizes)
        )

    def _is_outgrown(self, now: ScanEvidence) -> bool:
        """Return True if shear exceeds the unreported swings; as noise they would hide it."""
        if self._unreported is None:
            return False
        noise = self._evidence.noise(unit(now.shear)) / float(now.seen[-1, PRESSURE])
        if self._unreported.rests(now.index, now.shear, noise):
            self._unreported = None
            return False
        return self._unreported.is_outgrown(now.index, now.shear)

    def _look_back(self, before: PreGapReadings, now: ScanEvidence) -> list[SlipEvent]:
        """Return the onset of a slip inside a gap, found `LOOK_SCANS` scans after the gap."""
        first_s = now.time_s - (LOOK_SCANS - 1) / self._rate_hz
        moved = moved_in_gap(before, now.steps[-LOOK_SCANS:], first_s, self._evidence, self._least_shear)
        if moved is None:
            return []
        half = moved.gap_s * self._rate_hz / 2
        kink, description = (
            KinkEstimate(LOOK_SCANS - 1 + half, half),
            now.describe_change(moved.along, moved.change).with_half_confidence(),
        )
        return [
            self._begin(now, moved.along, kink, description, moved.size / (2 * half), moved.statistic, before)
        ]

    @property
    def is_active(self) -> bool:
        """True while a slip is active or recoiling, so that the noise floor is frozen."""
        return self._slip is not None or self._recoil is not None

    def _onset(self, growth: ShearGrowth, now: ScanEvidence, is_sure: bool) -> SlipEvent:
        size = float(np.sqrt((growth.rise**2).sum()))
        along = growth.rise / size
        known, noise = now.index - self._reported_until, self._evidence.noise(along)
        kink = self._history.began(now.seen, growth.scans, known, along, noise)
        growth = now.without_skew(growth, kink.delay_scans)
        along = unit(growth.rise)
        description = now.describe_change(along, growth.change)
        description = description if is_sure else description.with_half_confidence()
        return self._begin(now, along, kink, description, size / growth.scans, growth.statistic)

    def _begin(
        self,
        now: ScanEvidence,
        along: FloatArray,
        kink: KinkEstimate,
        description: SlipDescription,
        slope: float,
        statistic: float,
        before: PreGapReadings | None = None,
    ) -> SlipEvent:
        """Begin a slip and return its onset; `before` is set if a gap hid it."""
        onset_s = now.time_s + now.skew_s(along) - kink.delay_scans / self._rate_hz
        event = slip_events.onset(now, onset_s, kink, description, self._evidence, statistic)
        start = self._history.at(now.seen, kink.delay_scans)
        limit = now.limit(kink.delay_scans)
        if before is not None:
            start, limit = (
                self._evidence.weights @ before.readings,
                FrictionLimitTest.unobserved(len(before.readings)),
            )
        phases = SlipPhaseTracker(
            along,
            start,
            self._evidence.even,
            now.index,
            kink,
            slope,
            self._rate_hz,
            least=self._least_shear,
            gross=self._gross_shear,
            limit=limit,
        )
        phases.look_back(now.steps)
        self._slip = _TrackedSlip(event, phases, statistic)
        self._unreported = None
        self._swings.begin(now.index)
        return event

    def _apply(self, decision: SlipDecision, now: ScanEvidence) -> list[SlipEvent]:
        """Return the events of a decision on the active slip."""
        assert self._slip is not None
        along = self._slip.phases.along
        since = now.index - decision.at_index
        at_s = now.time_s + now.skew_s(along) - since / self._rate_hz
        if decision.outcome == "gross":
            return [self._become_gross(decision, now, at_s)]
        slip, was_gross = self._slip, self._slip.event.kind == "gross"
        excursion = slip.phases.excursion(now.seen[-1])
        if self._swings.are_many:
            self._shake = ShakeTracker(now.index, now.shear, excursion, self._rate_hz, self._least_shear)
            return []
        if decision.outcome == "back":
            self._recoil = slip
        if decision.outcome == "back" and not was_gross:
            self._swings.record_swing(excursion, now.index)
        events = [self._end(now, at_s)]
        self._reported_until = int(decision.at_index)
        if decision.outcome in ("again", "turned"):
            # Friction points along the motion: in a gross slip that goes on, all of the response does.
            goes_on = was_gross and decision.outcome == "turned"
            towards = unit(now.shear) if goes_on else now.along(since)
            events += self._resume(decision, now, towards, slip.statistic)
        return events

    def _follow_shake(self, shake: ShakeTracker, now: ScanEvidence) -> list[SlipEvent]:
        """Process a scan during sustained shaking."""
        assert self._slip is not None
        shear, slip = now.shear, self._slip
        noise = self._evidence.noise(slip.phases.along) / float(now.seen[-1, PRESSURE])
        is_outgrown = shake.is_outgrown(now.index, shear)
        if not is_outgrown and not shake.rests(now.index, shear, noise):
            return []
        since = OUTGROWS_S * self._rate_hz if is_outgrown else now.index - shake.rests_since
        self._shake = None
        self._reported_until = int(now.index - since)
        self._swings.record_swing(shake.largest, now.index)
        events = [self._end(now, now.time_s - since / self._rate_hz)]
        return events + self._begin_outgrown(now, slip.statistic) if is_outgrown else events

    def _begin_outgrown(self, now: ScanEvidence, statistic: float) -> list[SlipEvent]:
        """Return the onset of a slip that exceeds the swings before it."""
        since = OUTGROWS_S * self._rate_hz
        decision = SlipDecision("again", now.index - since, since / 2)
        return self._resume(decision, now, now.along(since), statistic)

    def _apply_recoil(self, decision: SlipDecision, now: ScanEvidence) -> list[SlipEvent]:
        """Return the events of a decision on a slip whose shear fell back."""
        assert self._recoil is not None
        recoil, self._recoil = self._recoil, None
        was_gross = recoil.event.kind == "gross"
        self._reported_until = int(decision.at_index)
        if decision.outcome == "rests":
            if not was_gross:  # a swing goes from one end to the other
                self._swings.record_swing(recoil.phases.swing(now.seen[-1]), now.index)
            return []
        return self._resume(decision, now, now.along(now.index - decision.at_index), recoil.statistic)

    def _resume(
        self, decision: SlipDecision, now: ScanEvidence, along: FloatArray, statistic: float
    ) -> list[SlipEvent]:
        """Return the onset of a slip that directly follows another."""
        since = now.index - decision.at_index
        size = float(np.sqrt((motion(now.seen[-1] - now.seen[now.ago(since)]) ** 2).sum()))
        if not along.any() or size == 0:
            return []
        description = now.describe_change(along, now.changed(since))
        kink = KinkEstimate(since, max(decision.sd_scans, 1.0))
        return [self._begin(now, along, kink, description, size / max(since, 1.0), statistic)]

    def _become_gross(self, decision: SlipDecision, now: ScanEvidence, gross_s: float) -> SlipEvent:
        assert self._slip is not None
        event = slip_events.gross(self._slip.event, now, gross_s, decision.sd_scans)
        self._slip = self._slip._replace(event=event)
        return event

    def _end(self, now: ScanEvidence, ended_s: float) -> SlipEvent:
        assert self._slip is not None
        event = self._slip.event
        self._slip = None
        return slip_events.ended(event, ended_s, now.time_s, valid=not now.is_late)
