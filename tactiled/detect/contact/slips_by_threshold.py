"""Slip events of several pairs of probabilities on one posterior, to compare settings at the price of one."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from tactiled.array import Array
from tactiled.detect.contact.gate import SlipHysteresis
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.learnt import Learnt
from tactiled.detect.contact.slips import PosteriorSlips, ScanInstant
from tactiled.detect.contact.touch import ContactScan
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock


class SlipThresholds(NamedTuple):
    """Probabilities from which incipient and gross slip are reported."""

    incipient: float
    gross: float


class SlipsByThreshold:
    """Collect the slip events that `GripSlip` has with each pair of probabilities; a `Detector`.

    Parameters
    ----------
    params : GripParams
        Of the contact filter; its probabilities are not used.

    Attributes
    ----------
    found : mapping of SlipThresholds to list of SlipEvent
        Events since the last `reset`.
    """

    def __init__(
        self,
        array: Array,
        params: GripParams,
        thresholds: Iterable[SlipThresholds],
        learnt: Learnt | None = None,
    ) -> None:
        self._thresholds = tuple(thresholds)
        self._grip = GripDetector(array, params, learnt)
        self.reset()

    def reset(self) -> None:
        """Forget everything seen and found."""
        self.found: Mapping[SlipThresholds, list[SlipEvent]] = {at: [] for at in self._thresholds}
        self._last = ScanInstant(0.0, 0.0, is_valid=False)
        self._rate_hz = 0.0
        self._grip.reset()
        self._slips: dict[SlipThresholds, PosteriorSlips] = {}
        self._signs: object = None  # of the contact whose slips these are

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Take the item; return nothing, since events of different thresholds are no stream."""
        if isinstance(item, Gap):
            self._end(self._last._replace(is_valid=False))
            self._grip.pass_gap(item)
            for slips in self._slips.values():
                slips.gate.close()
            return []
        if item.rate_hz != self._rate_hz:
            self._end(self._last._replace(is_valid=False))
            self._grip.lose_contact()
        self._rate_hz = item.rate_hz
        for row, _ in enumerate(self._grip.scans(item)):
            is_valid = self._grip.keeps_enough and not bool(item.late[row])
            self._last = ScanInstant(float(item.time_s[row]), float(item.time_sd_s[row]), is_valid)
            scan = self._grip.contact if self._grip.contact_state != "none" else None
            if scan is None:
                self._end(self._last)
            else:
                self.take(scan, self._last)
        return []

    def take(self, scan: ContactScan, at: ScanInstant) -> None:
        """Take a scan in contact."""
        contact = scan.filter
        if contact.signs is not self._signs:
            self._signs = contact.signs
            self._slips = {
                key: PosteriorSlips(SlipHysteresis(*key, contact.look_s), self._rate_hz)
                for key in self._thresholds
            }
        for key, slips in self._slips.items():
            if scan.is_look:
                slips.gate.look(contact.p_incipient, contact.p_sliding, contact.signs.ratio, contact.ratio_sd)
            self.found[key].extend(slips.step(scan, at))

    def _end(self, at: ScanInstant) -> None:
        for key, slips in self._slips.items():
            if slips.open is not None:
                self.found[key].append(slips.end(at.time_s, valid=at.is_valid))
