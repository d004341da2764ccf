"""The program's own front end (zero, noise, contact) before the learnt filter."""

from bench.learnt.filter import ContactFilter, Learnt
from tactiled.array import Array
from tactiled.detect.grip.detector import GripDetector, GripParams
from tactiled.detect.grip.readings import AnyTaxelReadings, ScanReading
from tactiled.events.types import GripEvent

_FRICTION = 0.6  # of rubber on objects, as in `GripParams`
INCIPIENT_P, GROSS_P = 0.9, 0.5


class LearntDetector(GripDetector):
    """`GripDetector` that gives the loads and shears of its contacts to the learnt filter, too.

    Parameters
    ----------
    array : Array
    rate_hz : float
    learnt : Learnt

    Attributes
    ----------
    filter : ContactFilter
    in_contact : bool
    """

    def __init__(self, array: Array, rate_hz: float, learnt: Learnt) -> None:
        super().__init__(array, GripParams())
        x, y = self._places
        self.filter = ContactFilter(
            x,
            y,
            rate_hz,
            array.shear_per_friction,
            _FRICTION * array.shear_per_friction,
            GripParams().friction_log_sd,
            INCIPIENT_P,
            GROSS_P,
            learnt,
        )
        self._filtered: object = None  # the contact that the filter follows
        self.in_contact = False

    def _step(
        self, readings: AnyTaxelReadings, reading: ScanReading, time_s: float, is_late: bool
    ) -> GripEvent | None:
        event = super()._step(readings, reading, time_s, is_late)
        touch = self._touch
        if touch is not self._filtered:
            if self._filtered is not None:
                self.filter.end()
            if touch is not None:
                self.filter.begin(is_seen=event is not None and event.state != "unknown")
            self._filtered = touch
        self.in_contact = touch is not None
        if touch is not None:
            signs = self.filter.signs
            signs.take(readings.history[-1].reshape(-1), touch.model.parts.reshape(-1))
            if signs.n_scans >= self.filter.n_look:
                self.filter.look(reading.shear_sd)
        return event
