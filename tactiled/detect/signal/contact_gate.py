"""Contact gate with the states none, loading, holding and sliding.

A taxel is in contact when its pressure response (mean of its side channels, or of its normal channels; of
magnetic fields the size of that) exceeds a level: that of the parameters, else that of the array file, else
one above the noise of its own channels and what they swing by at rest, a small part of their range and,
where shear is not measured, 15 % of the pad's largest load of the last minutes, beyond the set that a soft
skin may have kept. A reading of one side channel alone is a fault and no contact: a press loads all four, and
shear relieves two at most.

Loading and holding are distinguished by the slope of the array's pressure response, a least-squares line over
a short window. A falling pressure is neither: the state stays and only the count of steady scans starts anew.

`Pressure` measures and is the state machine; `ContactTracker` gives it the levels of an array. Sliding
cannot be seen from pressure: the slip detector owns a tracker and tells it to `go` there and back.
"""

import math

import numpy as np
from pydantic import Field

from tactiled.array import Array
from tactiled.detect.signal.fast import Levels, Pressure
from tactiled.detect.signal.pressure import CONTACT_SDS
from tactiled.detect.signal.quantise import HeldReadings, flat
from tactiled.events.types import ContactEvent, ContactState
from tactiled.samples.block import ScanBlock
from tactiled.tomlfile import Params

# physical: part of the range. 64 of 65536 counts, 10 of 10,000 uT: drift of an unloaded sensor within minutes
# is less.
CONTACT_OF_RANGE = 1 / 1024
# prior: part of the range while the noise of a channel is not known: drift and hum of a sensor that is of use
# are less.
_EARLY_OF_RANGE = 1 / 64


class ContactParams(Params):
    """Thresholds for contact and for a steady load."""

    contact_volts: float | None = Field(
        default=None,
        gt=0,
        description="pressure response of a taxel in contact, in the unit of the array; left out, as the "
        "next two: as the array file says, else from the noise and the range of the channels",
    )
    release_volts: float | None = Field(
        default=None, gt=0, description="contact is lost when every taxel is below; lower than contact_volts"
    )
    loading_volts_s: float | None = Field(
        default=None, gt=0, description="mean pressure response rising faster than this is loading"
    )


def _levels(array: Array, params: ContactParams) -> tuple[Levels, float]:
    """Return the levels, and the least noise in the unit of the array of a channel that is not known yet."""
    own = array.contact
    early = (array.high - array.low) * _EARLY_OF_RANGE
    least_contact = (array.high - array.low) * CONTACT_OF_RANGE
    if array.unit == "count":  # whole numbers: a rest of few scans may not show that
        least_contact = max(least_contact, min(CONTACT_SDS / math.sqrt(12.0), early))
    given = (
        params.contact_volts or (own.above if own else 0.0),
        params.release_volts or (own.below if own else 0.0),
        params.loading_volts_s or (own.loading_per_s if own else 0.0),
    )
    return Levels(*given, least_contact), early / CONTACT_SDS


def levels_fault(array: Array, params: ContactParams) -> str:
    """Return why levels, given or of the array file, cannot be used together; empty if they can."""
    levels, _ = _levels(array, params)
    if not 0.0 < levels.contact <= levels.release:
        return ""
    return (
        f"contact_volts ({levels.contact:g}) must be above release_volts ({levels.release:g}); "
        f"where one is left out, it is that of array {array.name}"
    )


class ContactTracker(Pressure):
    """Contact gate of an array at a scan rate: `measure` takes a block, and `step` each of its scans."""

    def __init__(self, array: Array, params: ContactParams, rate_hz: float) -> None:
        super().__init__(array, rate_hz, *_levels(array, params))

    @property
    def hidden_below(self) -> float:
        """Part of the largest load of late, of the pad with the most, that a contact must exceed.

        0 where that is no more than the level of contact, below which nothing is told in any case.
        """
        hidden = self.of_largest * max(self.largest)
        swings = map(self.swing.level, range(self.n_taxels))
        level = min(map(self.levels.contact_at, self.taxel_noise, swings))
        return hidden if hidden > level else 0.0

    @property
    def swing_of_mean(self) -> float:
        """Level that a swing at rest of the mean pressure of the taxels does not reach."""
        return self.swing.level(self.n_taxels)

    def measure(self, block: ScanBlock) -> None:
        """Measure the pressure in each scan of a block."""
        self.take(len(block), *flat(block, self.n_channels))

    def held(self, n: int) -> HeldReadings:
        """Return the readings of the newest block, of n scans; the next one overwrites them."""
        steps, ok = np.asarray(self.steps), np.asarray(self.ok).view(np.bool_)
        shape, size = (n, self.n_channels), n * self.n_channels
        return HeldReadings(steps[:size].reshape(shape), ok[:size].reshape(shape), self.all_ok)

    def touched_in(self, scan: int) -> tuple[int, ...]:
        """Return the taxels that touch in a scan of the newest block."""
        flags = np.asarray(self.touched)[scan * self.n_taxels : (scan + 1) * self.n_taxels]
        return tuple(np.flatnonzero(flags).tolist())


def contact_event(block: ScanBlock, scan: int, tracker: ContactTracker) -> ContactEvent:
    """Make the event for a change of state at a scan of a block.

    It is not valid when the scan came late, or when the contact ends because a taxel is not read any more.
    """
    return ContactEvent(
        time_s=float(block.time_s[scan]),
        state=tracker.state,
        previous=tracker.previous,
        taxels=tracker.touched_in(scan),
        valid=not block.late[scan] and tracker.lost[scan] == 0,
    )


def lost_contact_event(time_s: float, previous: ContactState) -> ContactEvent:
    """Make the event for a contact that a gap cut off after the scan at `time_s`."""
    return ContactEvent(time_s=time_s, state="none", previous=previous, taxels=(), valid=False)
