"""A detector of contact alone, for tests of `ContactTracker`."""

from tactiled.array import Array
from tactiled.detect.signal.contact_gate import (
    ContactParams,
    ContactTracker,
    contact_event,
    lost_contact_event,
)
from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock


class ContactGate:
    """Contact events from pressure alone: none, loading, holding."""

    def __init__(self, array: Array, params: ContactParams | None = None) -> None:
        self._array = array
        self._params = params or ContactParams()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._tracker: ContactTracker | None = None
        self._rate_hz = 0.0
        self._last_time_s = 0.0

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes; a gap ends a contact with an event that is not valid."""
        if isinstance(item, Gap):
            return self._forget()
        events = self._forget() if item.rate_hz != self._rate_hz else []
        if self._tracker is None:
            self._tracker = ContactTracker(self._array, self._params, item.rate_hz)
            self._rate_hz = item.rate_hz
        self._last_time_s = float(item.time_s[-1])
        self._tracker.measure(item)
        for scan in range(len(item)):
            if self._tracker.step(scan):
                events.append(contact_event(item, scan, self._tracker))
        return events

    def _forget(self) -> list[Event]:
        events: list[Event] = []
        if self._tracker is not None and self._tracker.state != "none":
            events.append(lost_contact_event(self._last_time_s, self._tracker.state))
        self.reset()
        return events
