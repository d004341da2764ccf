"""Ten minutes of board time with very many faults: nothing is lost, called fresh or invented."""

from scan_accounting import ScanAccounting
from simulated_link import SimulatedLink, grasps

from tactiled.array import load_array
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.scene.truth import Truth
from tactiled.events.types import ContactEvent, Event, ScanEvent, SlipEvent
from tactiled.wire.layout import load_layout

RATE_HZ = 20.0
DURATION_S = 600.0
# A cable unplugged each minute, a board that resets each 90 s: more faults than in years of a good line.
FAULTS = FaultParams(
    flip_per_byte=1e-5, drop_per_byte=1e-5, cut_per_frame=1e-3, duplicate_per_frame=1e-3, burst_per_s=1e-2,
    stall_per_s=0.1, stall_s=2.0, overrun_per_s=1e-2, reboot_per_s=1 / 90, unplug_per_s=1 / 60,
    unplug_s=3.0, bunch_s=0.016,
)  # fmt: skip
LATE_S = 0.1  # samples.late_after_s: older evidence must not make a valid slip
OLDEST_VALID_S = 2 * 5 / RATE_HZ + 0.005  # twice the silence that is a stall, by instants that may err
NEAR_S = 2.0  # an onset this near to a true slide belongs to it


def test_ten_minutes_of_faults() -> None:
    scene = grasps(DURATION_S)
    accounting = ScanAccounting(RATE_HZ, OLDEST_VALID_S)
    onsets: list[tuple[float, bool]] = []  # valid ones: instant; whether the contact was seen to begin
    stale = []
    is_known = True

    def publish(event: Event) -> None:
        nonlocal is_known
        accounting.published(event)
        if isinstance(event, ContactEvent):
            is_known = event.state != "unknown"
        elif isinstance(event, SlipEvent) and event.state == "onset" and event.valid:
            onsets.append((event.onset_s, is_known))
            stale.append(link.now_s - event.detected_s > LATE_S)

    link = SimulatedLink(
        scene,
        load_layout("board-v1"),
        load_array("wang2019-3x3"),
        board=EmulatedBoardParams(rate_hz=RATE_HZ, drift_ppm=-40.0),
        faults=FAULTS,
        publish=publish,
        on_scan=accounting.taken,
        tick_s=1.0,
    )
    link.run_until(link.now_s + DURATION_S)
    accounting.close()
    scans, health, done = accounting.counts, link.pipeline.health(), link.port.counts
    assert (done.reboots > 2, done.unplugs > 4, health.scans_missing > 100) == (True, True, True)

    assert scans.taken == scans.delivered + scans.lost_in_runs + scans.lost_at_restarts
    assert scans.lost_in_runs == health.scans_missing
    assert health.bytes_in == link.bytes_read
    assert health.bytes_in == health.bytes_framed + health.bytes_discarded + health.bytes_pending
    assert (scans.repeated, scans.mistimed, scans.false_fresh) == (0, 0, 0)
    assert health.restarts == done.reboots

    (slide,) = Truth(scene, link.port.board.scene_start_s or 0.0).slips
    is_near = [slide.onset_s - NEAR_S <= at_s <= slide.end_s + NEAR_S for at_s, _ in onsets]
    assert any(is_near)
    # Where nobody saw the contact begin, the end of a slide may look like an onset.
    assert all(near or not known for near, (_, known) in zip(is_near, onsets, strict=True))
    assert not any(stale)


def test_losses_within_a_run_and_at_its_ends_are_counted_separately() -> None:
    accounting = ScanAccounting(10.0, 1.0)
    for k in range(20):
        boot = 1 + k // 10
        accounting.taken(ScanTruth(k, k % 10, boot, 100.0 + 0.1 * k + 5.0 * (boot - 1), 0.1 * k, sent=True))
    for index, place in enumerate([1, 2, 5, 6, 12, 13]):  # the daemon's count goes on over the boot
        count = {2: 4, 3: 5}.get(index, index + (2 if index > 3 else 0))
        time_s = 100.0 + 0.1 * place + 5.0 * (place >= 10)
        accounting.published(
            ScanEvent(time_s=time_s, index=count, volts=(), valid=(), time_sd_s=0.0, age_s=0.0, late=False)
        )
    accounting.close()
    counts = accounting.counts
    assert (counts.taken, counts.delivered, counts.repeated) == (20, 6, 0)
    assert counts.lost_in_runs == 2
    assert counts.lost_at_restarts == 12
