"""The soak bench finds nothing wrong with the daemon's link, and finds what is wrong where something is."""

from dataclasses import replace

import pytest

from bench.daemon.ledger import Ledger
from bench.daemon.soak import BUNCHED, soak
from bench.daemon.soak_outcome import Outcome, Stretch
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.events.types import ScanEvent
from tactiled.progress import ProgressBar


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    """Ten minutes with ten times the faults of the bench's."""
    faults = BUNCHED.model_copy(update={"reboot_per_s": 1 / 90, "unplug_per_s": 1 / 60, "stall_per_s": 0.1})
    return soak(Stretch("test", 20.0, 600.0, faults), ProgressBar("soak"))


def test_ten_minutes_of_faults_are_accounted_for(outcome: Outcome) -> None:
    assert outcome.faults == []
    assert outcome.counts.reboots > 2
    assert outcome.counts.unplugs > 4
    assert outcome.health.scans_missing > 100
    assert outcome.true_slips == 1


def test_what_does_not_add_up_is_said(outcome: Outcome) -> None:
    wrong = {
        "scans are not accounted for": replace(outcome, health=replace(outcome.health, scans_missing=0)),
        "bytes do not add up": replace(outcome, bytes_read=outcome.bytes_read + 1),
        "a scan was published twice": replace(outcome, account=replace(outcome.account, repeated=1)),
        "old news were called fresh": replace(outcome, account=replace(outcome.account, false_fresh=1)),
        "a slip was false": replace(outcome, false_slips=1),
        "reboots were not counted as such": replace(outcome, health=replace(outcome.health, restarts=0)),
    }
    for words, spoiled in wrong.items():
        assert words in spoiled.faults


def test_the_ledger_tells_lost_in_a_run_from_lost_at_its_ends() -> None:
    ledger = Ledger(10.0, 1.0)
    for k in range(20):
        boot = 1 + k // 10
        ledger.taken(ScanTruth(k, k % 10, boot, 100.0 + 0.1 * k + 5.0 * (boot - 1), 0.1 * k, sent=True))
    for index, place in enumerate([1, 2, 5, 6, 12, 13]):  # the daemon's count goes on over the boot
        count = {2: 4, 3: 5}.get(index, index + (2 if index > 3 else 0))
        time_s = 100.0 + 0.1 * place + 5.0 * (place >= 10)
        ledger.published(
            ScanEvent(time_s=time_s, index=count, volts=(), valid=(), time_sd_s=0.0, age_s=0.0, late=False)
        )
    ledger.close()
    account = ledger.account
    assert (account.taken, account.delivered, account.repeated) == (20, 6, 0)
    assert account.lost_in_runs == 2
    assert account.lost_at_restarts == 12
