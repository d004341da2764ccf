"""Contact and slip of arrays that do not measure shear over pressure.

The contact gate tells contact. `GrowthTracker` finds a load that moves over an array without shear channels,
or shear that grows on one without pressure, and on magnetic skins, whose field is no load: incipient slip.
`SlidingTracker` finds the sliding of an array without shear channels by its roughness and ripple: gross slip.
A slip goes on while either of the two sees it. Nothing here knows a direction.
"""

import dataclasses

import numpy as np

from tactiled.array import Array
from tactiled.detect.signal.contact_gate import ContactParams, ContactTracker
from tactiled.detect.sliding.growth import GROWS, GrowthTracker
from tactiled.detect.sliding.tracker import BEGINS, Change, SlidingTracker
from tactiled.events.types import UNKNOWN_SD_DEG, ContactEvent, ContactState, Event, SlipEvent
from tactiled.samples.block import LOSSES, Gap, ScanBlock

DETECTOR = "sliding"
LOOKS_BACK_S = 3.0  # derived: a slide is found by a window of 2 s and two hops after it began
# derived: the loads after a slide are others than before it, which looks like load that moves for as long as
# the longest growth is of.
_SETTLES_S = 2.0


class SlidingSlip:
    """Detect contact and slip; a `ContactDetector`."""

    def __init__(self, array: Array, contact: ContactParams | None = None) -> None:
        self._array, self._params = array, contact or ContactParams()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._rate_hz = 0.0  # nothing seen
        self._last_time_s = 0.0
        self._gate: ContactTracker | None = None
        self._forget()

    def _forget(self) -> None:
        """Forget contact and slip; keep what the gate knows of noise and set."""
        self._trackers: list[GrowthTracker | SlidingTracker] = []
        self._state: ContactState = "none"  # of the gate
        self._published: ContactState = "none"
        self._touching: tuple[int, ...] = ()
        self._open: dict[bool, SlipEvent] = {}  # by whether it is gross: onset of a slip that has not ended
        self._newest: SlipEvent | None = None  # newest onset that was published
        self._gross_end_s = -np.inf

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return 0.0 if self._gate is None else self._gate.hidden_below

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes; a gap or a new rate ends slip and contact, not valid."""
        if isinstance(item, Gap):
            events = self._cut_off()
            if item.cause not in LOSSES:
                self.reset()
            elif self._gate is not None:
                self._gate.interrupt(item.n_missing)
            return events
        events = []
        if item.rate_hz != self._rate_hz:
            events = self._cut_off()
            self.reset()
            self._rate_hz = item.rate_hz
        gate = self._gate = self._gate or ContactTracker(self._array, self._params, item.rate_hz)
        if not self._trackers:
            self._trackers = [GrowthTracker(self._array, item.rate_hz)]
            if not self._array.has_shear:
                self._trackers.append(SlidingTracker(self._array, item.rate_hz))
        self._last_time_s = float(item.time_s[-1])
        gate.measure(item)
        held = gate.held(len(item))
        contacts = [(row, gate.state) for row in range(len(item)) if gate.step(row)]
        found: list[tuple[int, ContactState | Change]] = [*contacts]
        for tracker in self._trackers:
            # A contact whose beginning was not seen did not begin when it was found.
            without = ("none", "unknown") if isinstance(tracker, GrowthTracker) else ("none",)
            touches = np.full(len(item), self._state not in without)
            for row, state in contacts:
                touches[row:] = state not in without
            if isinstance(tracker, SlidingTracker):
                swings = np.asarray(gate.swings)[: len(item)].astype(np.bool_)
                changes = tracker.process(held, touches, swings & ~touches)
            else:
                changes = tracker.process(held, touches)
            found += [(change.row, change) for change in changes]
        for row, what in sorted(found, key=lambda pair: pair[0]):  # stable: the contact first
            time_s, is_valid = float(item.time_s[row]), not item.late[row] and gate.lost[row] == 0
            if isinstance(what, Change):
                events += self._changed(time_s, what, is_valid)
            else:
                self._state = what
                self._touching = gate.touched_in(row)
                if what == "none":
                    events += self._changed(time_s, Change(row, False, 0.0, 0, is_gross=False), is_valid)
            slides = True in self._open and self._state != "none"
            events += self._publish(time_s, "sliding" if slides else self._state, is_valid)
        return events

    def _changed(self, time_s: float, change: Change, is_valid: bool) -> list[Event]:
        if change.is_onset:
            is_settling = time_s - self._gross_end_s < _SETTLES_S
            if not change.is_gross and not self._array.has_shear and (is_settling or self._state == "none"):
                return []
            slides = True in self._open
            onset = self._open[change.is_gross] = self._onset(time_s, change, is_valid)
            if slides:
                return []
            self._newest = onset
            return [onset]
        if self._open.pop(change.is_gross, None) is None:
            return []
        if change.is_gross:  # load that still moves belongs to the slide: slip and contact end together
            self._open, self._gross_end_s = {}, time_s
        return [] if self._open else self._ended(time_s, is_valid)

    def _onset(self, time_s: float, change: Change, is_valid: bool) -> SlipEvent:
        before_s, statistic = change.scans_before / self._rate_hz, change.statistic
        return SlipEvent(
            time_s=time_s - before_s,
            state="onset",
            kind="gross" if change.is_gross else "incipient",
            onset_s=time_s - before_s,
            onset_sd_s=before_s / 2,
            direction_deg=0.0,
            direction_sd_deg=UNKNOWN_SD_DEG,
            confidence=float(1 / (1 + np.exp(-statistic))) if change.is_gross else 1 - 1 / statistic,
            taxels=self._touching or tuple(range(self._array.n_taxels)),
            detector=DETECTOR,
            statistic=statistic,
            threshold=BEGINS if change.is_gross else GROWS,
            valid=is_valid,
            detected_s=time_s,
        )

    def _ended(self, time_s: float, is_valid: bool) -> list[Event]:
        newest, self._newest = self._newest, None
        if newest is None:
            return []
        return [dataclasses.replace(newest, state="end", time_s=time_s, detected_s=time_s, valid=is_valid)]

    def _publish(self, time_s: float, state: ContactState, is_valid: bool) -> list[Event]:
        if state == self._published:
            return []
        before, self._published = self._published, state
        return [
            ContactEvent(time_s=time_s, state=state, previous=before, taxels=self._touching, valid=is_valid)
        ]

    def _cut_off(self) -> list[Event]:
        """End slip and contact after the last scan, not valid, and forget them."""
        self._touching = ()
        events = self._ended(self._last_time_s, False)
        events += self._publish(self._last_time_s, "none", False)
        self._forget()
        return events
