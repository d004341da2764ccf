"""The soak bench finds nothing wrong with the daemon's link, and finds what is wrong where something is."""

from dataclasses import replace

import pytest

from bench.daemon.accounting import ScanAccounting
from bench.daemon.soak import AIMS, BUNCHED, SoakConditions, SoakResult, soak
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.events.types import ScanEvent
from tactiled.progress import ProgressBar


@pytest.fixture(scope="module")
def result() -> SoakResult:
    """Ten minutes with ten times the faults of the bench's."""
    faults = BUNCHED.model_copy(update={"reboot_per_s": 1 / 90, "unplug_per_s": 1 / 60, "stall_per_s": 0.1})
    return soak(SoakConditions("test", 20.0, 600.0, faults), ProgressBar("soak"))


def missed(result: SoakResult) -> set[str]:
    return {aim.name for aim in AIMS if aim.measure(result).verdict != "met"}


def test_ten_minutes_of_faults_are_accounted_for(result: SoakResult) -> None:
    assert missed(result) == set()
    assert result.done.reboots > 2
    assert result.done.unplugs > 4
    assert result.health.scans_missing > 100
    assert result.true_slips == 1


def test_every_defect_misses_its_aim(result: SoakResult) -> None:
    wrong = {
        "scans not accounted for": replace(result, health=replace(result.health, scans_missing=0)),
        "bytes not accounted for": replace(result, bytes_read=result.bytes_read + 1),
        "scans published twice or out of order": replace(result, scans=replace(result.scans, repeated=1)),
        "scans with a wrong instant": replace(result, scans=replace(result.scans, mistimed=1)),
        "statuses that call old scans fresh": replace(result, scans=replace(result.scans, false_fresh=1)),
        "false slips": replace(result, false_slips=1),
        "valid slips from old scans": replace(result, stale_slips=1),
        "reboots miscounted": replace(result, health=replace(result.health, restarts=0)),
    }
    assert set(wrong) == {aim.name for aim in AIMS}
    for name, spoiled in wrong.items():
        assert name in missed(spoiled)


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
