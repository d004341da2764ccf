"""How the bench of faults counts, on scans written by hand, and a fault that is really played."""

import asyncio
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.daemon.fault_cases import CASES, FaultCase
from bench.daemon.faults import FaultRecovery, lost_scans, once
from bench.daemon.pty import RATE_HZ, DaemonOnPty, ReceivedMessage

PERIOD_S = 1 / RATE_HZ


def scan(place: int, count: int, error_s: float = 0.0) -> ReceivedMessage:
    return ReceivedMessage(100 + place * PERIOD_S + error_s, 0.0, {"index": count})


@given(lost=st.sets(st.integers(1, 58), max_size=9), error=st.floats(-2.5, 2.5), base=st.integers(0, 1000))
def test_lost_scans_are_found_under_any_error_of_the_instants(
    lost: set[int], error: float, base: int
) -> None:
    """One instant in three errs by up to some periods, as on a busy machine while a new clock fit settles."""
    taken_s = [100 + k * PERIOD_S for k in range(60)]
    came = [k for k in range(60) if k not in lost]
    scans = [scan(k, base + k, error * PERIOD_S * (k % 3 == 1)) for k in came]
    assert lost_scans(taken_s, scans) == [taken_s[k] for k in sorted(lost)]


def test_a_count_after_a_reboot_is_matched_by_instants() -> None:
    taken_s = [100 + k * PERIOD_S for k in range(60)]
    scans = [scan(k, k) for k in range(20)] + [scan(k, k - 10) for k in range(30, 60)]
    assert lost_scans(taken_s, scans) == taken_s[20:30]


@pytest.mark.parametrize(
    "name", ["a bit flips", "the board misses 30 scans", "its sequence jumps", "unplugged while running"]
)
def test_a_fault_on_a_pty_costs_the_scans_that_it_must(name: str, tmp_path: Path) -> None:
    (case,) = [case for case in CASES if case.name == name]

    async def play(case: FaultCase) -> tuple[FaultRecovery, list[float]]:
        async with DaemonOnPty(tmp_path) as daemon:
            await daemon.until_status("running")
            return await once(case, daemon), lost_scans(daemon.board.taken_s, daemon.scans)

    done, lost_s = asyncio.run(play(case))
    to_it, until_recovered, besides = done.lost(case, lost_s)
    assert done.counted("scans_missing") == to_it + until_recovered
    assert done.counted("scans_overrun") == case.overruns
    assert (besides, done.counted("restarts")) == (0, case.restarts)
    if case.scans_hit is not None:
        assert (to_it, until_recovered) == (case.scans_hit, 0)
    else:
        assert to_it + until_recovered == case.overruns or to_it > 50
