"""Slip reports of each setting in two recordings without slip, and the friction that the contacts showed.

Nothing slips as a whole in either recording: every report of gross slip is false. An incipient slip may be
true, since a tenth of the contact area may well slip in an object that stays in the hand. A controller acts
on both, so that the proposed setting is the one that reports earliest among those with no more reports of
both kinds than the user accepts.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import Array
from tactiled.detect.contact.friction import prior_log_sd
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.signal.contact_gate import ContactParams, ContactTracker
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.detect.tuning import StartZero, TunedSuite, relative_to
from tactiled.errors import DataError
from tactiled.events.types import Event, GripEvent, SlipEvent
from tactiled.samples.block import Gap, ScanBlock

N_STAGES = 3  # progress steps: hold, motion, the end of the motion
# Log friction of one object differs from contact to contact by 15 % (dry rubber on one surface): a prior.
_CONTACT_SD = 0.15
_KNOWN = 0.95  # of the spread before any contact: friction that is known no better is not proposed
_FIVE_PERCENT = 1.645  # standard deviations from the median to the quantile of 95 %

# A firm hold of an array in volts, whose noise is that of work. Other units: as the detectors find it.
_HELD_V = ContactParams(contact_volts=0.5, release_volts=0.35, loading_volts_s=0.03)
# A shorter contact shows less than the model needs: 0.6 s for its zero, then a second to settle.
_LEAST_S = 4.0
_LEVEL = 0.95  # of the intervals of a rate, as in trials of reliability

Report = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Recording:
    """Scans of a held object."""

    name: str  # name in the report: a file name, or "quiet hold"
    array: Array
    items: tuple[ScanBlock | Gap, ...]

    @property
    def seconds(self) -> float:
        """Duration of all blocks."""
        return sum(len(block) / block.rate_hz for block in self._blocks())

    def contact_s(self) -> float:
        """Return the time in contact of some taxel (s); raise `DataError` where it is too little."""
        held_s = sum(float(touching(one, self.array).sum()) / one.rate_hz for one in self._blocks())
        if held_s < _LEAST_S:
            nothing = f"no contact (no taxel above {contact_level(self.array)})"
            found = f"{held_s:.1f} s of contact" if held_s else nothing
            zero = f"; touch nothing in its first {self.array.zero_first_s:g} s, which give the zero"
            raise DataError(
                f"{self.name}: {found} in {self.seconds:.1f} s, at least {_LEAST_S:g} s are needed: grip an "
                "object and hold it for the whole recording" + zero * bool(self.array.zero_first_s)
            )
        return held_s

    def _blocks(self) -> list[ScanBlock]:
        """Return the blocks relative to the zero of the array."""
        start = StartZero(self.array.zero_first_s)
        items = [part for item in self.items for part in start.process(item)]
        zero = start.zero if self.array.zero_first_s else self.array.zero
        return [part for item in items if isinstance(part := relative_to(zero, item), ScanBlock)]


def contact_level(array: Array) -> str:
    """Return words for the level above which a taxel counts as touched."""
    if array.unit == "V":
        return f"{_HELD_V.contact_volts:g} V"
    return f"the contact level of the array, which is in {array.unit} and follows from its noise"


def contact_gate(array: Array, rate_hz: float) -> ContactTracker:
    """Return a gate of contact whose levels in volts are those of a firm hold."""
    return ContactTracker(array, _HELD_V if array.unit == "V" else ContactParams(), rate_hz)


def touching(block: ScanBlock, array: Array) -> NDArray[np.bool_]:
    """Flags (n,) of scans in which some taxel is above the contact threshold."""
    gate = contact_gate(array, block.rate_hz)
    gate.measure(block)
    touches: NDArray[np.bool_] = np.asarray(gate.touches)[: len(block)] != 0
    return touches


def rate_interval(count: int, hours: float) -> tuple[float, float]:
    """95 % interval of the rate per hour after `count` reports in `hours`.

    No report in T hours bounds the rate by 3 / T at 95 % (the rule of three: exp(-3) = 0.05). Seconds of
    motion can never prove one report an hour.

    Garwood's exact limits (Biometrika 28, 1936); with no report the whole 5 % lies above: 3 / hours.
    """
    if count == 0:
        return 0.0, float(-np.log(1 - _LEVEL) / hours)
    side = (1 - _LEVEL) / 2
    low, high = special.gammaincinv(count, side), special.chdtri(2 * count + 2, side) / 2
    return float(low / hours), float(high / hours)


class ReportCount(NamedTuple):
    """Slips that a setting reports in a recording; one that becomes gross counts as gross."""

    incipient: int
    gross: int

    @property
    def total(self) -> int:
        """Number of all slips."""
        return self.incipient + self.gross


class Friction(NamedTuple):
    """Friction before a contact, as ``[detect.grip]`` takes it: median, and sd of its logarithm."""

    median: float
    log_sd: float


class SettingReports(NamedTuple):
    """Reports of one setting in the hold and in the motion."""

    quiet: ReportCount
    motion: ReportCount


@dataclass(frozen=True, eq=False)
class Study:
    """Results of `study`."""

    accepted_per_hour: float
    quiet: Recording
    motion: Recording
    # hold_s, motion_s: time in contact
    hold_s: float
    motion_s: float
    settings: Mapping[str, SettingReports]
    proposed: str
    is_accepted: bool  # False where even the proposed setting reports more than is accepted
    # Friction after both recordings; None where it is known no better than before them
    friction: Friction | None

    def interval(self, count: int) -> tuple[float, float]:
        """95 % interval of a rate per hour, of which `count` were reported in the motion."""
        return rate_interval(count, self.motion_s / 3600)


def study(quiet: Recording, motion: Recording, accepted_per_hour: float, report: Report) -> Study:
    """Evaluate two recordings of one array in which nothing slips as a whole.

    `DataError` where there is too little contact in one of them.
    """
    hold_s, motion_s = quiet.contact_s(), motion.contact_s()
    reports = _Reports(quiet.array)
    report("counting reports in the hold")
    in_hold = reports.of(quiet)
    report("counting reports in the motion")
    in_motion = reports.of(motion)
    settings = {name: SettingReports(in_hold[name], in_motion[name]) for name in SETTINGS}
    accepted = [
        name
        for name, found in settings.items()
        if found.motion.total <= accepted_per_hour * motion_s / 3600
        and found.quiet.total <= accepted_per_hour * hold_s / 3600
    ]
    return Study(
        accepted_per_hour=accepted_per_hour,
        quiet=quiet,
        motion=motion,
        hold_s=hold_s,
        motion_s=motion_s,
        settings=settings,
        proposed=accepted[0] if accepted else list(SETTINGS)[-1],
        is_accepted=bool(accepted),
        friction=reports.friction(),
    )


class _Reports:
    """Slip reports of all settings, and the friction that contacts showed where most was borne."""

    def __init__(self, array: Array) -> None:
        self._array = array
        x, y = array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()
        self._radius_mm = float(np.hypot(x, y).mean()) or 1.0
        self._largest = 0.0  # ratio, with the moment
        self._friction: GripEvent | None = None  # at the largest ratio

    def of(self, recording: Recording) -> dict[str, ReportCount]:
        """Count the slips that each setting reports; short gaps are bridged as in the pipeline."""
        counts = {}
        for name in SETTINGS:
            build = partial(build_suite, topics=("slip", "grip"))
            suite = TunedSuite(self._array, DetectParams(setting=name), build)
            events = [event for item in recording.items for event in suite.process(item)]
            counts[name] = _count(events)
            if not self._array.measures_ratio:  # slips come from what sliding shows, whatever the setting is
                return dict.fromkeys(SETTINGS, counts[name])
        for event in events:
            if isinstance(event, GripEvent) and event.valid and event.state not in ("none", "unknown"):
                moment = event.torsion / self._radius_mm
                ratio = math.hypot(event.shear_x, event.shear_y, moment) / event.load
                if ratio > self._largest:
                    self._largest, self._friction = ratio, event
        return counts

    def friction(self) -> Friction | None:
        """Return the friction that contacts showed, if it is known better than before them."""
        if self._friction is None:
            return None
        spread = math.log(self._friction.friction_high / self._friction.friction_low)
        log_sd = math.hypot(spread / (2 * _FIVE_PERCENT), _CONTACT_SD)
        is_known = log_sd < _KNOWN * prior_log_sd(self._array)
        return Friction(self._friction.friction, log_sd) if is_known else None


def _count(events: Iterable[Event]) -> ReportCount:
    """Count the slips that begin; one that becomes gross is one slip."""
    incipient = gross = 0
    before: SlipEvent | None = None  # onset of the slip that goes on
    for event in events:
        if not isinstance(event, SlipEvent):
            continue
        if event.state == "onset" and event.valid:
            became_gross = before is not None and before.kind == "incipient" and event.kind == "gross"
            incipient += (event.kind == "incipient") - became_gross
            gross += event.kind == "gross"
        before = event if event.state == "onset" and event.valid else None
    return ReportCount(incipient, gross)
