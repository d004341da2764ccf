"""``./run bench soak``: days of board time, with faults, as fast as this machine goes.

An emulated board and the daemon's own link, session and pipeline on a clock that jumps (`rig`). Everything
that a service may get wrong over months is looked for: memory that grows, frames that nobody accounts for,
a clock that drifts, statuses that call old news fresh, slips that never were.
"""

import gc
import resource
import sys
import time
from pathlib import Path

import numpy as np

from bench.daemon.ledger import Ledger
from bench.daemon.rig import Rig
from bench.daemon.soak_outcome import Onset, Outcome, Stretch
from tactiled.array import load_array
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.phases import HoldPhase, LiftPhase, PressPhase, RestPhase, SlidePhase
from tactiled.emulator.scene.truth import Truth
from tactiled.events.types import ContactEvent, Event, SlipEvent
from tactiled.plain_table import table
from tactiled.progress import ProgressBar
from tactiled.wire.layout import load_layout

HOUR_S = 3600.0
_TENTHS = 10  # looks at memory and clock
_LATE_S = 0.1  # samples.late_after_s: evidence older than this must not make a valid slip
_STALE_FACTOR = 2.0  # as the status has it: valid up to twice the silence that is a stall ...
_CLOCK_MARGIN_S = 0.005  # ... by estimated instants, which may err by this

# A cable that is twitched each ten minutes, a board that resets each quarter of an hour, a flip each minute:
# a day of it is worse than years of a good line.
FAULTS = FaultParams(
    flip_per_byte=1e-5, drop_per_byte=1e-5, cut_per_frame=1e-3, duplicate_per_frame=1e-3, burst_per_s=1e-2,
    stall_per_s=1e-2, stall_s=2.0, overrun_per_s=1e-2, reboot_per_s=1 / 900, unplug_per_s=1 / 600,
    unplug_s=3.0,
)  # fmt: skip
BUNCHED = FAULTS.model_copy(update={"bunch_s": 0.016})


def grasps(duration_s: float) -> Scene:
    """A hand that takes something each ten minutes, holds it, lets it slide once, and puts it back."""
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


def soak(stretch: Stretch, progress: ProgressBar) -> Outcome:
    """Run a stretch and look at everything that it may get wrong."""
    array, layout = load_array("wang2019-3x3"), load_layout("board-v1")
    silence_s = max(0.05, 5.0 / stretch.rate_hz)
    ledger = Ledger(stretch.rate_hz, _STALE_FACTOR * silence_s + _CLOCK_MARGIN_S)
    onsets: list[Onset] = []
    is_known = True

    def publish(event: Event) -> None:
        nonlocal is_known
        ledger.published(event)
        if isinstance(event, ContactEvent):
            is_known = event.state != "unknown"
        elif isinstance(event, SlipEvent) and event.state == "onset" and event.valid:
            onsets.append(Onset(event.onset_s, is_known, rig.now_s - event.detected_s > _LATE_S))

    scene = grasps(stretch.duration_s)
    rig = Rig(
        scene,
        layout,
        array,
        board=EmulatedBoardParams(rate_hz=stretch.rate_hz, drift_ppm=-40.0),
        faults=stretch.faults,
        seed=stretch.seed,
        publish=publish,
        on_scan=ledger.taken,
        tick_s=1.0,
    )
    began_s, took_s = rig.now_s, time.perf_counter()
    outcome = Outcome(stretch, ledger.account, rig.pipeline.health(), rig.port.counts)
    for tenth in range(1, _TENTHS + 1):
        rig.run_until(began_s + stretch.duration_s * tenth / _TENTHS)
        outcome.rms_s.append(float(np.sqrt(np.mean(np.square(ledger.errors_s)))))
        ledger.errors_s.clear()
        gc.collect()
        outcome.rss_mb.append(_rss_mb())
        outcome.blocks.append(sys.getallocatedblocks())
        progress.advance(f"{stretch.name}, {outcome.rss_mb[-1]:.0f} MB", stretch.duration_s / _TENTHS)
    ledger.close()
    outcome.took_s = time.perf_counter() - took_s
    outcome.health = rig.pipeline.health()
    outcome.bytes_read = rig.bytes_read
    outcome.score(Truth(scene, rig.port.board.scene_start_s or 0.0), onsets)
    return outcome


def bench_soak(progress: ProgressBar, *, quick: bool) -> str:
    """Tables of what was lost, what was false, and what grew."""
    stretches = [
        Stretch("clean line", 100.0, 600.0 if quick else 2 * HOUR_S, FaultParams()),
        Stretch("faults, 16 ms bunches", 100.0, 600.0 if quick else 12 * HOUR_S, BUNCHED),
        Stretch("faults, slow board", 4.0, 8 * HOUR_S if quick else 72 * HOUR_S, FAULTS),
    ]
    progress.begin(sum(stretch.duration_s for stretch in stretches))
    outcomes = [soak(stretch, progress) for stretch in stretches]
    lost = table(
        ["stretch", "board time", "speed", "faults done", "scans taken", "delivered", "of these late",
         "missing, counted", "at restarts", "not accounted for"],
        [_lost(outcome) for outcome in outcomes],
    )  # fmt: skip
    false = table(
        ["stretch", "false fresh", "slides", "found", "false slips", "unsure", "stale",
         "clock rms, first / last tenth", "largest error", "memory after a tenth / at the end", "objects"],
        [_false(outcome) for outcome in outcomes],
    )  # fmt: skip
    wrong = [f"{outcome.stretch.name}: {fault}" for outcome in outcomes for fault in outcome.faults]
    return f"{lost}\n\n{false}\n\n{'wrong: ' + '; '.join(wrong) if wrong else 'Nothing wrong was found.'}"


def _lost(outcome: Outcome) -> list[str]:
    account, stretch, counts = outcome.account, outcome.stretch, outcome.counts
    done = (
        counts.frames_damaged + counts.frames_duplicated + counts.stalls + counts.overruns
        + counts.reboots + counts.unplugs
    )  # fmt: skip
    return [
        f"{stretch.name}, {stretch.rate_hz:g} Hz",
        f"{stretch.duration_s / 3600:.3g} h",
        f"{stretch.duration_s / outcome.took_s:.0f} x",
        str(done),
        str(account.taken),
        str(account.delivered),
        str(account.late),
        str(outcome.health.scans_missing),
        str(account.lost_at_restarts),
        str(outcome.unaccounted),
    ]


def _false(outcome: Outcome) -> list[str]:
    return [
        outcome.stretch.name,
        str(outcome.account.false_fresh),
        str(outcome.true_slips),
        str(outcome.slips_found),
        str(outcome.false_slips),
        str(outcome.unsure_slips),
        str(outcome.stale_slips),
        f"{1e3 * outcome.rms_s[0]:.3f} / {1e3 * outcome.rms_s[-1]:.3f} ms",
        f"{1e3 * outcome.account.largest_error_s:.2f} ms",
        f"{outcome.rss_mb[0]:.1f} / {outcome.rss_mb[-1]:.1f} MB",
        f"{outcome.blocks[-1] - outcome.blocks[0]:+d}",
    ]


def _rss_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6
