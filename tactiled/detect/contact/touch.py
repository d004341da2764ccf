"""One contact, from its touch to its end: its zero, its filter, its newest scan and the event of that."""

import math
from typing import Literal, NamedTuple

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.contact.filter import ContactFilter
from tactiled.detect.contact.posterior import FIVE_PERCENT, INCIPIENT_SHARE, INCIPIENT_USED
from tactiled.detect.contact.press_zero import PressZero
from tactiled.detect.contact.readings import TaxelReadings
from tactiled.detect.contact.travelling import TravellingRipple
from tactiled.events.types import GripEvent, GripState

NEEDED_UTILISATION = 0.7  # choice
"""Utilisation that `needed_load` would leave."""
_SURELY = 2.0  # choice: standard deviations by which the ratio falls where a contact is unloaded
_UNKNOWN_USED = (0.0, 0.5, 1.0)  # derived: utilisation of a contact whose beginning nobody saw
_TINY = 1e-9  # derived


class ContactScan(NamedTuple):
    """State of a contact after a scan, for those who report slips."""

    filter: ContactFilter
    shear: FloatArray  # (2, taxels): force of the object on the skin, over the total load
    # Sum of the shear along x and along y, and its moment over the mean distance of the taxels from their
    # centre; all over the total load
    ratio: tuple[float, float, float]
    rippled_s: float  # length of the window in which a ripple travels over the taxels; 0.0 where none does
    is_look: bool  # the filter took a look at this scan

    @property
    def size(self) -> float:
        """Length of the ratio: by the ellipsoid of Howe and Cutkosky (1996), compared with friction."""
        return math.hypot(*self.ratio)


class Touch:
    """One contact: its zero, and what the filter says of it."""

    def __init__(self, contact: ContactFilter, zero: PressZero, ripple: TravellingRipple) -> None:
        self._filter, self._zero, self._ripple = contact, zero, ripple
        self._offset_sd = zero.whole_sd  # of shear over load
        self._shear = np.asarray(contact.signs.over_load).reshape(2, -1)  # a view, which each scan changes
        self.scan: ContactScan | None = None
        self._verdict = contact.verdict()
        self._total = 0.0, 0.0, 0.0, _TINY

    @property
    def is_looked_at(self) -> bool:
        """True once the load was large enough to tell."""
        return self.scan is not None

    @property
    def press_is_over(self) -> bool:
        """True once the press is over, or a pull has begun in it."""
        return self._zero.is_measured or self._zero.pull_began

    def pass_gap(self, gap_s: float) -> None:
        """Take up the contact after a gap in which it went on."""
        self._zero.finish()
        self._filter.friction_memory.walk(gap_s)
        self._filter.restart()
        self._ripple.reset()

    def weigh(self, newest: FloatArray, places: FloatArray) -> None:
        """Take loads and shears (3, taxels) that are too small to tell, at places (2, taxels)."""
        x, y = newest[1].sum(), newest[2].sum()
        moment = places[0] @ newest[2] - places[1] @ newest[1]
        self._total = float(x), float(y), float(moment), max(float(newest[0].sum()), _TINY)

    def take(
        self, readings: TaxelReadings, newest: FloatArray, acceleration_m_s2: float, *, may_slip: bool
    ) -> None:
        """Take a scan, with its loads and shears (3, taxels) and the announced acceleration."""
        zero, contact = self._zero, self._filter
        signs = contact.signs
        if not zero.is_measured:
            zero.take(newest[0], newest[1:], readings.shear_sd, readings.total_sd)
            load = max(float(newest[0].sum()), _TINY)
            self._offset_sd = math.hypot(zero.whole_sd, readings.total_sd / load)
        signs.take(newest.reshape(-1), zero.parts.reshape(-1))
        rippled_s = self._ripple.take(newest)
        is_look = self.scan is None or signs.n_scans >= contact.n_look
        if is_look:
            contact.look(
                readings.shear_sd, acceleration_m_s2, has_zero=zero.is_seen, ripple_travels=rippled_s > 0
            )
        if not may_slip:
            contact.gate.close()
        if is_look:
            self._verdict = contact.verdict()
        load = max(signs.total_load, _TINY)
        self._total = signs.total_x, signs.total_y, signs.moment, load
        self.scan = ContactScan(
            filter=contact,
            shear=self._shear.copy(),
            ratio=(signs.total_x / load, signs.total_y / load, signs.moment / load),
            rippled_s=rippled_s,
            is_look=is_look,
        )

    def event(
        self, time_s: float, radius_mm: float, unit: Literal["N", "relative"], is_trusted: bool, is_late: bool
    ) -> GripEvent:
        """Return the event of the scan that was taken."""
        contact, verdict = self._filter, self._verdict
        low, median, high = verdict.utilisation
        x, y, moment, load = self._total
        is_known = contact.is_known and self.is_looked_at
        state: GripState = "unknown"
        if not is_known:  # it may hold or slide, with any shear: nothing is in use for sure, nor free
            low, median, high = _UNKNOWN_USED
            if contact.gate.is_open:
                state, low = "partial", INCIPIENT_USED
        elif contact.gate.is_gross:
            state = "gross"
        elif contact.gate.is_open:
            state = "partial"
            median, high = max(median, INCIPIENT_USED), max(high, INCIPIENT_USED)
        elif contact.signs.growth < -_SURELY * contact.growth_sd:
            state = "unloading"
        else:
            state = "partial" if verdict.slipping_share > INCIPIENT_SHARE else "sticking"
        # What is not known of the zero is more shear that may be borne.
        size = math.hypot(x, y, moment) + FIVE_PERCENT * self._offset_sd * load
        friction_low, friction, friction_high = verdict.friction
        needed_load = size / (NEEDED_UTILISATION * friction_low)
        in_50, in_100, in_300 = verdict.p_gross
        return GripEvent(
            time_s=time_s,
            utilisation=median,
            utilisation_low=low,
            utilisation_high=high,
            friction=friction,
            friction_low=friction_low,
            friction_high=friction_high,
            slipping_share=verdict.slipping_share,
            p_sliding=verdict.p_sliding,
            p_gross_50ms=in_50,
            p_gross_100ms=in_100,
            p_gross_300ms=in_300,
            load=load,
            shear_x=x,
            shear_y=y,
            torsion=moment * radius_mm + 0.0,  # never -0.0
            unit=unit,
            needed_load=needed_load if is_known else max(needed_load, load),
            state=state,
            valid=is_trusted and self.is_looked_at,
            late=is_late,
        )
