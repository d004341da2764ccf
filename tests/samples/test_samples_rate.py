"""Measurement of the scan rate."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.samples.rate_meter import RateMeter


@pytest.mark.parametrize("rate_hz", [5.0, 59.7, 100.0, 400.0])
@pytest.mark.parametrize("handover_s", [0.0, 0.016])
def test_the_rate_is_right_within_what_the_adapter_bunches(rate_hz: float, handover_s: float) -> None:
    meter = RateMeter()
    for k in range(10_000):
        taken_s = k / rate_hz
        now_s = taken_s if not handover_s else handover_s * (1 + taken_s // handover_s)
        if (found := meter.add(now_s)) is not None:
            break
    assert found == pytest.approx(rate_hz, rel=0.05 if rate_hz < 20 else 0.012)


def test_a_backlog_at_the_beginning_is_not_counted() -> None:
    meter = RateMeter()
    for _ in range(500):
        assert meter.add(10.0) is None
    found = [rate for k in range(300) if (rate := meter.add(10.0 + 0.01 * (k + 1))) is not None]
    assert found[0] == pytest.approx(100.0, rel=0.01)


@given(begin_s=st.floats(0.1, 3.0), stall_s=st.floats(0.0, 1.0))
def test_a_stall_of_the_host_does_not_change_the_rate(begin_s: float, stall_s: float) -> None:
    meter = RateMeter()
    for k in range(1000):
        taken_s = k / 100
        is_stalled = begin_s <= taken_s < begin_s + stall_s
        if (found := meter.add(begin_s + stall_s if is_stalled else taken_s)) is not None:
            break
    assert found == pytest.approx(100.0, rel=0.015)
