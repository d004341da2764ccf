"""``./run bench soak``: days of board time, with faults, as fast as this machine goes.

An emulated board and the daemon's own link, session and pipeline run on a clock that jumps (`rig`). The
bench measures the errors that a service may make over months: growth of memory, frames that are not accounted
for, drift of the clock, valid statuses with old data, false slips.
"""

import gc
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from bench.daemon.accounting import ScanAccounting, ScanCounts
from bench.daemon.rig import SimulatedLink
from bench.report import Aim, BenchOptions, BenchReport, aims_table, never, rms, table
from tactiled.array import load_array
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultCounts, FaultParams
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.phases import HoldPhase, LiftPhase, PressPhase, RestPhase, SlidePhase
from tactiled.emulator.scene.truth import TrueSlip, Truth
from tactiled.events.types import ContactEvent, Event, SlipEvent
from tactiled.pipeline import Health
from tactiled.progress import ProgressBar
from tactiled.wire.layout import load_layout

_HOUR_S = 3600.0
_TENTHS = 10  # measurements of memory and clock in a run
_LATE_S = 0.1  # samples.late_after_s: evidence older than this must not make a valid slip
_STALE_FACTOR = 2.0  # a status is valid up to twice the silence that is a stall ...
_CLOCK_MARGIN_S = 0.005  # ... by estimated instants, which may err by this
_NEAR_S = 2.0  # an onset this near to a true slide belongs to it

# A cable unplugged each ten minutes, a board that resets each quarter of an hour, a flip each minute: more
# faults in a day than in years of a good line.
FAULTS = FaultParams(
    flip_per_byte=1e-5, drop_per_byte=1e-5, cut_per_frame=1e-3, duplicate_per_frame=1e-3, burst_per_s=1e-2,
    stall_per_s=1e-2, stall_s=2.0, overrun_per_s=1e-2, reboot_per_s=1 / 900, unplug_per_s=1 / 600,
    unplug_s=3.0,
)  # fmt: skip
BUNCHED = FAULTS.model_copy(update={"bunch_s": 0.016})


@dataclass(frozen=True)
class SoakConditions:
    """A length of board time under one line."""

    name: str
    rate_hz: float
    duration_s: float
    faults: FaultParams
    seed: int = 0


class ValidOnset(NamedTuple):
    """Onset of a valid slip.

    Attributes
    ----------
    is_contact_known : bool
        The contact was measured from its beginning.
    is_stale : bool
        Its evidence was processed too late.
    """

    at_s: float
    is_contact_known: bool
    is_stale: bool


@dataclass(frozen=True)
class SoakResult:
    """Everything that a soak measured.

    Attributes
    ----------
    bytes_read, took_s
        Bytes that the link got, and the duration of the run.
    rms_s, rss_mb, objects
        Error of instants, memory and the number of objects that Python holds, tenth by tenth.
    false_slips, unsure_slips : int
        Onsets away from any true slide, in a contact that was measured from its beginning, and in one
        that was not, where the end of a slide may look like an onset.
    stale_slips : int
        Onsets whose evidence was processed too late.
    """

    conditions: SoakConditions
    scans: ScanCounts
    health: Health
    done: FaultCounts
    bytes_read: int
    took_s: float
    rms_s: list[float]
    rss_mb: list[float]
    objects: list[int]
    true_slips: int
    slips_found: int
    false_slips: int
    unsure_slips: int
    stale_slips: int

    @property
    def unaccounted(self) -> int:
        """Scans that are not accounted for, and losses that were miscounted."""
        scans = self.scans
        known = scans.delivered + scans.lost_in_runs + scans.lost_at_restarts
        return abs(scans.taken - known) + abs(scans.lost_in_runs - self.health.scans_missing)

    @property
    def bytes_astray(self) -> int:
        """Bytes that are neither framed, nor discarded, nor pending, and bytes that were not counted."""
        health = self.health
        decided = health.bytes_framed + health.bytes_discarded + health.bytes_pending
        return abs(health.bytes_in - decided) + abs(health.bytes_in - self.bytes_read)


AIMS: tuple[Aim[SoakResult], ...] = (
    never("scans not accounted for", lambda soak: soak.unaccounted),
    never("bytes not accounted for", lambda soak: soak.bytes_astray),
    never("scans published twice or out of order", lambda soak: soak.scans.repeated),
    never("scans with a wrong instant", lambda soak: soak.scans.mistimed),
    never("statuses that call old scans fresh", lambda soak: soak.scans.false_fresh),
    never("false slips", lambda soak: soak.false_slips),
    never("valid slips from old scans", lambda soak: soak.stale_slips),
    never("reboots miscounted", lambda soak: abs(soak.health.restarts - soak.done.reboots)),
)


def bench_soak(progress: ProgressBar, options: BenchOptions) -> BenchReport:
    """Lost scans, false slips, and growth of memory."""
    quick = options.quick
    each = (
        SoakConditions("clean line", 100.0, 600.0 if quick else 2 * _HOUR_S, FaultParams()),
        SoakConditions("faults, 16 ms bunches", 100.0, 600.0 if quick else 12 * _HOUR_S, BUNCHED),
        SoakConditions("faults, slow board", 4.0, 8 * _HOUR_S if quick else 72 * _HOUR_S, FAULTS),
    )
    progress.begin(sum(conditions.duration_s for conditions in each))
    results = [soak(conditions, progress) for conditions in each]
    return BenchReport(
        [
            table(_scans_row(result) for result in results),
            table(_slips_row(result) for result in results),
            "unsure: false slips in a contact whose beginning was not seen.",
            aims_table(AIMS, {result.conditions.name: result for result in results}),
        ]
    )


def grasps(duration_s: float) -> Scene:
    """Scene of a hand that each ten minutes takes something, holds it, lets it slide once, puts it back."""
    cycle = [
        RestPhase(kind="rest", duration_s=20.0),
        PressPhase(kind="press", duration_s=2.0, force_n=20.0),
        HoldPhase(kind="hold", duration_s=478.0),
        SlidePhase(kind="slide", duration_s=20.0, speed_mm_s=1.0),
        HoldPhase(kind="hold", duration_s=20.0),
        LiftPhase(kind="lift", duration_s=2.0),
        RestPhase(kind="rest", duration_s=58.0),
    ]
    n = max(1, round(duration_s / sum(phase.duration_s for phase in cycle)))
    return Scene(name="grasps", phases=cycle * n)


def soak(conditions: SoakConditions, progress: ProgressBar) -> SoakResult:
    """Run one soak and look at everything that it may get wrong."""
    scene = grasps(conditions.duration_s)
    silence_s = max(0.05, 5.0 / conditions.rate_hz)
    accounting = ScanAccounting(conditions.rate_hz, _STALE_FACTOR * silence_s + _CLOCK_MARGIN_S)
    onsets: list[ValidOnset] = []
    is_known = True

    def publish(event: Event) -> None:
        nonlocal is_known
        accounting.published(event)
        if isinstance(event, ContactEvent):
            is_known = event.state != "unknown"
        elif isinstance(event, SlipEvent) and event.state == "onset" and event.valid:
            onsets.append(ValidOnset(event.onset_s, is_known, rig.now_s - event.detected_s > _LATE_S))

    rig = SimulatedLink(
        scene,
        load_layout("board-v1"),
        load_array("wang2019-3x3"),
        board=EmulatedBoardParams(rate_hz=conditions.rate_hz, drift_ppm=-40.0),
        faults=conditions.faults,
        seed=conditions.seed,
        publish=publish,
        on_scan=accounting.taken,
        tick_s=1.0,
    )
    began_s, took_s = rig.now_s, time.perf_counter()
    rms_s, rss_mb, objects = [], [], []
    for tenth in range(1, _TENTHS + 1):
        rig.run_until(began_s + conditions.duration_s * tenth / _TENTHS)
        rms_s.append(rms(accounting.errors_s))
        accounting.errors_s.clear()
        gc.collect()
        rss_mb.append(_rss_mb())
        objects.append(sys.getallocatedblocks())
        progress.advance(f"{conditions.name}, {rss_mb[-1]:.0f} MB", conditions.duration_s / _TENTHS)
    accounting.close()
    took_s = time.perf_counter() - took_s
    slips = Truth(scene, rig.port.board.scene_start_s or 0.0).slips
    near = [_slides_near(onset.at_s, slips) for onset in onsets]
    false = [onset for onset, slides in zip(onsets, near, strict=True) if not slides]
    return SoakResult(
        conditions,
        accounting.counts,
        rig.pipeline.health(),
        rig.port.counts,
        rig.bytes_read,
        took_s,
        rms_s,
        rss_mb,
        objects,
        true_slips=len(slips),
        slips_found=len(set().union(*near)),
        false_slips=sum(onset.is_contact_known for onset in false),
        unsure_slips=sum(not onset.is_contact_known for onset in false),
        stale_slips=sum(onset.is_stale for onset in onsets),
    )


def _slides_near(at_s: float, slips: Sequence[TrueSlip]) -> set[int]:
    return {k for k, slip in enumerate(slips) if slip.onset_s - _NEAR_S <= at_s <= slip.end_s + _NEAR_S}


def _rss_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def _scans_row(soak: SoakResult) -> dict[str, str]:
    conditions, scans, done = soak.conditions, soak.scans, soak.done
    faults = (
        done.frames_damaged
        + done.frames_duplicated
        + done.stalls
        + done.overruns
        + done.reboots
        + done.unplugs
    )
    return {
        "conditions": f"{conditions.name}, {conditions.rate_hz:g} Hz",
        "board time": f"{conditions.duration_s / _HOUR_S:.3g} h",
        "speed": f"{conditions.duration_s / soak.took_s:.0f} x",
        "faults done": f"{faults}",
        "scans taken": f"{scans.taken}",
        "delivered": f"{scans.delivered}",
        "of these late": f"{scans.late}",
        "missing, counted": f"{soak.health.scans_missing}",
        "lost at restarts": f"{scans.lost_at_restarts}",
        "not accounted for": f"{soak.unaccounted}",
    }


def _slips_row(soak: SoakResult) -> dict[str, str]:
    return {
        "conditions": soak.conditions.name,
        "old scans called fresh": f"{soak.scans.false_fresh}",
        "slides": f"{soak.true_slips}",
        "found": f"{soak.slips_found}",
        "false slips": f"{soak.false_slips}",
        "unsure": f"{soak.unsure_slips}",
        "from old scans": f"{soak.stale_slips}",
        "clock rms, first / last tenth": f"{1e3 * soak.rms_s[0]:.3f} / {1e3 * soak.rms_s[-1]:.3f} ms",
        "largest error": f"{1e3 * soak.scans.largest_error_s:.2f} ms",
        "memory after a tenth / at the end": f"{soak.rss_mb[0]:.1f} / {soak.rss_mb[-1]:.1f} MB",
        "objects": f"{soak.objects[-1] - soak.objects[0]:+d}",
    }
