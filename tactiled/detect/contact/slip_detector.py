"""Contact and slip events from the contact filter, as a detector of the suite."""

from collections.abc import Mapping

from tactiled.array import Array, FloatArray
from tactiled.detect.contact.gate import SlipThresholds
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.learnt import Learnt
from tactiled.detect.contact.slips import PosteriorSlips, ScanInstant
from tactiled.detect.signal.contact_gate import (
    ContactTracker,
    ContactTransition,
    contact_event,
    lost_contact_event,
)
from tactiled.events.types import ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock

SETTINGS: Mapping[str, SlipThresholds] = {
    "fast": SlipThresholds(incipient=0.7, gross=0.35),
    "balanced": SlipThresholds(incipient=0.9, gross=0.5),
    "quiet": SlipThresholds(incipient=0.98, gross=0.65),
}
"""Probabilities from which incipient and gross slip are reported, by setting (docs/grip.md)."""


class GripSlip:
    """Detect contact and slip by the contact filter; publish its grip events where these are published.

    An array without shear or without load channels has contact events only.

    Examples
    --------
    A press, then shear along +x by Mindlin's curve from 4.0 s. Loads are equal, so that only the size of the
    shear tells of friction:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.samples.block import regular_block
    >>> array, rng, time_s = load_array("wang2019-3x3"), np.random.default_rng(0), np.arange(600) / 100
    >>> travel = np.clip((time_s - 4) / 0.8, 0, 1)[:, np.newaxis]
    >>> shear_volts = 0.4 * (1 - (1 - travel) ** 1.5) * np.tile([1, 0, -1, 0], 9)
    >>> load_volts = np.clip(time_s - 1, 0, 1)[:, np.newaxis]
    >>> volts = load_volts + shear_volts + 1e-4 * rng.standard_normal((600, 36))
    >>> for event in GripSlip(array).process(regular_block(volts, 100.0)):
    ...     if event.topic == "slip" and event.state == "onset":
    ...         print(f"{event.detected_s:.2f} s: {event.kind}, since {event.onset_s:.2f} s")
    4.17 s: incipient, since 4.09 s
    """

    def __init__(self, array: Array, params: GripParams | None = None, learnt: Learnt | None = None) -> None:
        self._params = params or GripParams()
        self._grip = GripDetector(array, self._params, learnt)
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._grip.reset()
        self._begin()

    def _begin(self) -> None:
        """Forget everything seen, beside what the contact filter has forgotten by itself."""
        self._slips: PosteriorSlips | None = None
        self._signs: object = None  # of the contact whose slips these are
        self._rate_hz = 0.0
        self._last_s = 0.0

    def state_friction(self, value: float, log_sd: float) -> None:
        """Take friction from outside: see `GripDetector.state_friction`."""
        self._grip.state_friction(value, log_sd)

    def change_object(self) -> None:
        """Forget friction: see `GripDetector.change_object`."""
        self._grip.change_object()

    def announce_motion(self, time_s: FloatArray, acceleration_m_s2: FloatArray) -> None:
        """Take the hand's own motion: see `GripDetector.announce_motion`."""
        self._grip.announce_motion(time_s, acceleration_m_s2)

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._grip.contact_state

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return self._grip.hidden_below

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes.

        A gap or a new scan rate ends slip and contact with events that are not valid, because their end was
        not observed. A slip inside a gap is reported where the contact goes on after it.
        """
        if isinstance(item, Gap):
            return self._interrupt(item)
        events = self._forget() if self._rate_hz not in (0.0, item.rate_hz) else []
        self._rate_hz = item.rate_hz
        for row, message in enumerate(self._grip.scans(item)):
            tracker, pressure = self._grip.tracker, self._grip.pressure
            assert tracker is not None
            assert pressure is not None
            if self._grip.change:
                events.append(contact_event(item, row, pressure, self._grip.change))
            is_valid = self._grip.keeps_enough and not bool(item.late[row])
            at = ScanInstant(float(item.time_s[row]), float(item.time_sd_s[row]), is_valid)
            events += self._slip(at)
            if change := self._follow(tracker):
                events.append(contact_event(item, row, pressure, change))
            if message is not None and self._params.publish:
                events.append(message)
        self._last_s = float(item.time_s[-1])
        return events

    def _slip(self, at: ScanInstant) -> list[SlipEvent]:
        """Return the slip events of a scan."""
        scan = None if self.contact_state == "none" else self._grip.contact
        slips = self._slips
        if scan is not None:
            if slips is None or scan.filter.signs is not self._signs:
                self._slips = slips = PosteriorSlips(scan.filter.gate, self._rate_hz)
                self._signs = scan.filter.signs
            return slips.step(scan, at)
        # Readings that are lost look like a contact that is lost.
        is_valid = at.is_valid and self._grip.is_trusted
        return [slips.end(at.time_s, valid=is_valid)] if slips is not None and slips.open else []

    def _follow(self, tracker: ContactTracker) -> ContactTransition | None:
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

    def _interrupt(self, gap: Gap) -> list[Event]:
        """Cut off slip and contact; the contact filter keeps what it knows until the scan after the gap."""
        events = self._cut_off()
        lost = self._grip.pass_gap(gap)
        return events + (lost if self._params.publish else [])

    def _forget(self) -> list[Event]:
        events = self._cut_off()
        lost = self._grip.forget()
        self._begin()
        return events + (lost if self._params.publish else [])

    def _cut_off(self) -> list[Event]:
        events: list[Event] = []
        if self._slips is not None and self._slips.open:
            events.append(self._slips.end(self._last_s, valid=False))
        if self.contact_state != "none":
            events.append(lost_contact_event(self._last_s, self.contact_state))
        return events
