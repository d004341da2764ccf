"""Slip events of all settings on one case.

To compare another detector, add a line to `OTHERS`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.slip.cases import Case
from tactiled.array import Array, FloatArray
from tactiled.detect.base import Detector
from tactiled.detect.contact.grip_detector import ContactScan, GripParams
from tactiled.detect.contact.posterior import INCIPIENT_USED
from tactiled.detect.contact.slip_detector import SETTINGS
from tactiled.detect.contact.slips import ScanInstant
from tactiled.detect.contact.slips_by_threshold import SlipsByThreshold, SlipThresholds
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import SlipEvent
from tactiled.samples.block import Gap, ScanBlock

OTHERS: Mapping[str, Callable[[Array], Detector]] = {
    "wang2019": lambda array: build_suite(
        array, DetectParams(setting="wang2019"), topics=("slip", "contact")
    ),
}
"""Detectors beside the contact filter."""

NAMES = (*SETTINGS, *OTHERS)
INCIPIENT_PS = (0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)
GROSS_PS = (0.05, 0.1, 0.25, 0.35, 0.5, 0.7, 0.9)
_OTHER_GROSS_P, _OTHER_INCIPIENT_P = 0.5, 0.9  # while the other probability is varied
_SURE_GROWTH = 3.0  # standard deviations of the growth
N_BINS = 10


@dataclass(frozen=True, eq=False)
class Reliability:
    """Time of contact by the probability told: (bins,) float64 each, in seconds.

    Attributes
    ----------
    time_s, said_s, seen_s : (N_BINS,) float64
        Time; time multiplied by the probability told; time in which it was so.
    """

    time_s: FloatArray = field(default_factory=lambda: np.zeros(N_BINS))
    said_s: FloatArray = field(default_factory=lambda: np.zeros(N_BINS))
    seen_s: FloatArray = field(default_factory=lambda: np.zeros(N_BINS))

    def take(self, p: float, is_true: bool, step_s: float) -> None:
        """Count a scan."""
        k = min(int(p * N_BINS), N_BINS - 1)
        self.time_s[k] += step_s
        self.said_s[k] += step_s * p
        self.seen_s[k] += step_s * is_true

    def __add__(self, other: "Reliability") -> "Reliability":
        return Reliability(self.time_s + other.time_s, self.said_s + other.said_s, self.seen_s + other.seen_s)


@dataclass(frozen=True, eq=False)
class CaseEvents:
    """Slip events of one case.

    Attributes
    ----------
    by_name : mapping of str to sequence of SlipEvent
        By setting, or name of another detector.
    by_threshold : mapping of SlipThresholds to sequence of SlipEvent
        Of the contact filter.
    partial : Reliability
        Probability that a tenth of the area slips, where shear over load certainly grows beyond what was
        borne before: a contact that rests has slipped, and does not slip.
    """

    case: Case
    by_name: Mapping[str, Sequence[SlipEvent]]
    by_threshold: Mapping[SlipThresholds, Sequence[SlipEvent]]
    partial: Reliability


def incipient_curve_at(p: float) -> SlipThresholds:
    """Return a point of the curve over the probability of incipient slip."""
    return SlipThresholds(p, _OTHER_GROSS_P)


def gross_curve_at(p: float) -> SlipThresholds:
    """Return a point of the curve over the probability of gross slip."""
    return SlipThresholds(_OTHER_INCIPIENT_P, p)


def all_thresholds() -> list[SlipThresholds]:
    """Return the thresholds of the settings and of both curves."""
    curves = [*map(incipient_curve_at, INCIPIENT_PS), *map(gross_curve_at, GROSS_PS)]
    return list(dict.fromkeys([*SETTINGS.values(), *curves]))


def run_case(case: Case) -> CaseEvents:
    """Run all detectors over a case."""
    slips = _CountedSlips(case, all_thresholds())
    slips.process(case.block)
    by_name = {name: slips.found[at] for name, at in SETTINGS.items()}
    return CaseEvents(case, by_name | _of_others(case.array, [case.block]), slips.found, slips.reliability)


def run_stream(array: Array, stream: Sequence[ScanBlock | Gap]) -> dict[str, Sequence[SlipEvent]]:
    """Return the events of all detectors on blocks and gaps, by name; short gaps are bridged as in use."""
    slips = SlipsByThreshold(array, GripParams(), SETTINGS.values())
    bridged = GapBridge(slips)
    for item in stream:
        bridged.process(item)
    return {name: slips.found[at] for name, at in SETTINGS.items()} | _of_others(array, stream)


def _of_others(array: Array, stream: Sequence[ScanBlock | Gap]) -> dict[str, Sequence[SlipEvent]]:
    found: dict[str, Sequence[SlipEvent]] = {}
    for name, build in OTHERS.items():
        detector = build(array)
        events = [event for item in stream for event in detector.process(item)]
        found[name] = [event for event in events if isinstance(event, SlipEvent)]
    return found


class _CountedSlips(SlipsByThreshold):
    """Slip events at each pair of thresholds, and the reliability of the probability of incipient slip."""

    def __init__(self, case: Case, thresholds: Sequence[SlipThresholds]) -> None:
        super().__init__(case.array, GripParams(), thresholds)
        self._case = case
        self.reliability = Reliability()

    def take(self, scan: ContactScan, at: ScanInstant) -> None:
        super().take(scan, at)
        signs = scan.filter.signs
        if signs.ratio >= signs.largest and signs.growth > _SURE_GROWTH * scan.filter.growth_sd:
            is_partial = self._case.utilisation_at(at.time_s) >= INCIPIENT_USED
            step_s = 1.0 / self._case.block.rate_hz
            self.reliability.take(min(scan.verdict.p_incipient, 1.0), is_partial, step_s)
