"""Slip detector for arrays that do not measure shear over pressure: the events of two detectors as one.

A first detector reports contact, and slip as far as the array shows shear over pressure. On arrays without
shear channels, `SlidingTracker` beside it finds sliding by its roughness and ripple. A slip goes on while
either of the two sees it: ridges that move the centre of load end a slip for the first detector, and not for
the second. On arrays without pressure, and on magnetic skins, whose field is no load, `GrowthTracker` finds
slips, and those of the first detector are left out. Nothing here knows a direction.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.base import ContactDetector
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.sliding.growth import GROWS, GrowthTracker
from tactiled.detect.sliding.tracker import BEGINS, Change, SlidingTracker
from tactiled.events.types import UNKNOWN_SD_DEG, ContactEvent, ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock

DETECTOR = "sliding"
LOOKS_BACK_S = 3.0  # derived: a slide is found by a window of 2 s and two hops after it began
# derived: the loads after a slide are others than before it, which looks like load that moves for as long as
# the longest growth is of.
_SETTLES_S = 2.0
_NOT_TOUCHING: tuple[ContactState, ...] = ("none",)
_NOT_BEGUN: tuple[ContactState, ...] = ("none", "unknown")
_STATES_THAT_SLIDE = ("unknown", "loading", "holding", "sliding")


class SlidingSlip:
    """Detect contact and slip; a `Detector`. `first` reports contact, and slip by shear."""

    def __init__(self, array: Array, first: ContactDetector) -> None:
        self._array = array
        self._first = first
        self._grows = array.has_shear
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._first.reset()
        self._last_time_s = 0.0
        self._forget()

    def _forget(self) -> None:
        self._rate_hz = 0.0  # nothing seen
        self._state: ContactState = "none"  # of the first detector
        self._published: ContactState = "none"
        self._touching: tuple[int, ...] = ()
        self._of_first: SlipEvent | None = None  # newest onset of a slip that has not ended
        self._own: dict[int, SlipEvent] = {}  # by tracker: onset of a slip that has not ended
        self._newest: SlipEvent | None = None  # newest onset that was published
        self._gross_end_s = -np.inf

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return self._first.hidden_below

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes; a gap ends slip and contact as not valid."""
        if isinstance(item, Gap):
            self._first.process(item)
            return self._cut_off()
        events: list[Event] = []
        before = self._first.process(item)
        if item.rate_hz != self._rate_hz:
            if self._rate_hz:  # the first detector ended its slip and contact at the last scan
                before = [event for event in before if event.evidence_s > self._last_time_s]
                events += self._cut_off()
            self._rate_hz = item.rate_hz
            self._quantiser = Quantiser(self._array)
            self._trackers: list[GrowthTracker | SlidingTracker] = [GrowthTracker(self._array, item.rate_hz)]
            if not self._grows:
                self._trackers.append(SlidingTracker(self._array, item.rate_hz))
        self._last_time_s = float(item.time_s[-1])
        at = [(_row(item, event), event) for event in before]
        held = self._quantiser.process(item)
        both: list[tuple[int, Event | tuple[int, Change]]] = [*at]
        for which, tracker in enumerate(self._trackers):
            # A contact whose beginning was not seen did not begin when it was found.
            without = _NOT_BEGUN if isinstance(tracker, GrowthTracker) else _NOT_TOUCHING
            touches = self._touches(item, at, without)
            both += [(change.row, (which, change)) for change in tracker.process(held, touches)]
        for row, found in sorted(both, key=lambda pair: pair[0]):  # stable: the first detector first
            if isinstance(found, tuple):
                events += self._changed(item, *found)
            elif isinstance(found, SlipEvent):
                events += self._first_slips(found)
            elif isinstance(found, ContactEvent):
                is_only_first = self._grows and found.state == "sliding"
                self._state = "holding" if is_only_first else found.state
                self._touching = found.taxels
            events += self._contact(item, row)
        return events

    def _touches(
        self, block: ScanBlock, at: list[tuple[int, Event]], without: tuple[ContactState, ...]
    ) -> NDArray[np.bool_]:
        """Return the scans (n,) in contact: in a state that is none of some."""
        touches = np.full(len(block), self._state not in without)
        for row, event in at:
            if isinstance(event, ContactEvent):
                touches[row:] = event.state not in without
        return touches

    def _changed(self, block: ScanBlock, which: int, change: Change) -> list[Event]:
        time_s, valid = float(block.time_s[change.row]), not bool(block.late[change.row])
        if change.is_onset:
            before = [*self._own.values(), *([self._of_first] if self._of_first is not None else [])]
            is_settling = time_s - self._gross_end_s < _SETTLES_S
            if not change.is_gross and not self._grows and (is_settling or self._state == "none"):
                return []
            onset = self._own[which] = self._onset(time_s, change, valid=valid)
            if any(slip.kind == "gross" or onset.kind == slip.kind for slip in before):
                return []
            self._newest = onset
            return [onset]
        own = self._own.pop(which, None)
        if own is None:
            return []
        if own.kind == "gross":  # load that still moves belongs to the slide: slip and contact end together
            self._own, self._gross_end_s = {}, time_s
        return [] if self._own or self._of_first is not None else self._ended(time_s, valid=valid)

    def _first_slips(self, event: SlipEvent) -> list[Event]:
        self._of_first = event if event.state == "onset" and not self._grows else None
        if self._own or self._grows:
            return []
        self._newest = event if event.state == "onset" else None
        return [event]

    def _ended(self, time_s: float, *, valid: bool) -> list[Event]:
        newest, self._newest = self._newest, None
        if newest is None:
            return []
        return [dataclasses.replace(newest, state="end", time_s=time_s, detected_s=time_s, valid=valid)]

    def _onset(self, time_s: float, change: Change, *, valid: bool) -> SlipEvent:
        before_s = change.scans_before / self._rate_hz
        return SlipEvent(
            time_s=time_s - before_s,
            state="onset",
            kind="gross" if change.is_gross else "incipient",
            onset_s=time_s - before_s,
            onset_sd_s=before_s / 2,
            direction_deg=0.0,
            direction_sd_deg=UNKNOWN_SD_DEG,
            confidence=float(1 / (1 + np.exp(-change.statistic)))
            if change.is_gross
            else 1 - 1 / change.statistic,
            taxels=self._touching or tuple(range(self._array.n_taxels)),
            detector=DETECTOR,
            statistic=change.statistic,
            threshold=BEGINS if change.is_gross else GROWS,
            valid=valid,
            detected_s=time_s,
        )

    def _contact(self, block: ScanBlock, row: int) -> list[Event]:
        """Return the change of the published contact, which slides while sliding is seen."""
        is_gross = any(slip.kind == "gross" for slip in self._own.values())
        slides = is_gross and self._state in _STATES_THAT_SLIDE
        state: ContactState = "sliding" if slides else self._state
        return self._publish(float(block.time_s[row]), state, self._touching, valid=not bool(block.late[row]))

    def _publish(
        self, time_s: float, state: ContactState, taxels: tuple[int, ...], *, valid: bool
    ) -> list[Event]:
        if state == self._published:
            return []
        before, self._published = self._published, state
        return [ContactEvent(time_s=time_s, state=state, previous=before, taxels=taxels, valid=valid)]

    def _cut_off(self) -> list[Event]:
        """End slip and contact after the last scan, not valid, and forget them."""
        events = self._ended(self._last_time_s, valid=False)
        events += self._publish(self._last_time_s, "none", (), valid=False)
        self._forget()
        return events


def _row(block: ScanBlock, event: Event) -> int:
    """Scan of a block at which an event was reported."""
    return min(int(np.searchsorted(block.time_s, event.evidence_s)), len(block) - 1)
