"""Slip events of all settings on one case.

To compare another detector, add a line to `OTHERS`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from bench.slip.cases import Case
from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.contact.grip_detector import GripParams
from tactiled.detect.contact.slip_detector import SETTINGS
from tactiled.detect.contact.slips_by_threshold import SlipsByThreshold
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.events.types import SlipEvent

OTHERS: Mapping[str, Callable[[Array], Detector]] = {
    "wang2019": lambda array: build_suite(
        array, DetectParams(setting="wang2019"), topics=("slip", "contact")
    ),
}
"""Detectors beside the contact filter."""

NAMES = (*SETTINGS, *OTHERS)


@dataclass(frozen=True, eq=False)
class CaseEvents:
    """Slip events of one case, by setting or name of another detector."""

    case: Case
    by_name: Mapping[str, Sequence[SlipEvent]]


def run_case(case: Case) -> CaseEvents:
    """Run all detectors over a case."""
    slips = SlipsByThreshold(case.array, GripParams(), SETTINGS.values())
    slips.process(case.block)
    found: dict[str, Sequence[SlipEvent]] = {name: slips.found[at] for name, at in SETTINGS.items()}
    for name, build in OTHERS.items():
        found[name] = [e for e in build(case.array).process(case.block) if isinstance(e, SlipEvent)]
    return CaseEvents(case, found)
