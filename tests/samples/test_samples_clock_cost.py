"""The clock fit costs the same for a scan at any rate: operations are counted, not timed."""

import itertools
import math
from typing import Any

import pytest

from tactiled.samples import clock, envelope
from tactiled.samples.bucket import SLOTS, Bucket
from tactiled.samples.clock import ClockFit, ClockParams

RATES_HZ = (1.0, 10.0, 100.0, 1000.0, 5000.0, 20_000.0)
WINDOW = 120
DURATION_S = {1.0: 130.0, 10.0: 125.0, 100.0: 20.0, 1000.0: 6.0, 5000.0: 2.5, 20_000.0: 2.1}


class Counted(float):
    """A float that counts what is done with it and with what comes of it: sorts and sums in C included."""

    n = 0

    def __hash__(self) -> int:
        return float.__hash__(self)


def _counting(name: str) -> Any:
    plain = getattr(float, name)

    def counted(self: Counted, *others: Any) -> Any:
        Counted.n += 1
        value = plain(self, *others)
        return Counted(value) if type(value) is float else value

    return counted


OPERATIONS = (
    "add", "radd", "sub", "rsub", "mul", "rmul", "truediv", "rtruediv", "floordiv", "mod", "pow", "rpow",
    "neg", "abs", "floor", "lt", "le", "gt", "ge", "eq",
)  # fmt: skip
for _name in OPERATIONS:
    setattr(Counted, f"__{_name}__", _counting(f"__{_name}__"))


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the plain modules: what is compiled takes floats as numbers of C, which nobody counts."""
    monkeypatch.setattr(clock, "Bucket", Bucket)
    monkeypatch.setattr(clock, "lines_through", envelope.lines_through)


def costs(rate_hz: float, bunch_s: float) -> tuple[list[int], int]:
    """Operations of each scan, and the most arrivals that were ever kept."""
    fit = ClockFit(ClockParams(window_buckets=WINDOW), 0.0)
    found, kept, last_s = [], 0, -math.inf
    for k in range(int(DURATION_S[rate_hz] * rate_hz)):
        board_s = k / rate_hz
        arrival_s = 100.0 + board_s * 1.00005 + 1e-4 * (k * 0.618 % 1.0)
        if bunch_s:
            arrival_s = math.ceil(arrival_s / bunch_s) * bunch_s
        waited_s = bunch_s or arrival_s - last_s
        Counted.n = 0
        fit.add(Counted(board_s), Counted(arrival_s), Counted(waited_s), whole=not bunch_s)
        fit.time_of(Counted(board_s))
        found.append(Counted.n)
        kept = max(kept, len(fit._bucket._kept))  # noqa: SLF001  the bound on memory
        last_s = arrival_s
    return found, kept


@pytest.mark.parametrize("bunch_s", [0.0, 0.016])
def test_the_cost_of_a_scan_does_not_grow_with_the_rate(bunch_s: float) -> None:
    """Until a line is fitted, on the way, and when a bucket closes."""
    mean, first, worst, kept = {}, {}, {}, {}
    for rate_hz in RATES_HZ:
        found, kept[rate_hz] = costs(rate_hz, bunch_s)
        mean[rate_hz] = sum(found) / len(found)
        unfitted = found[: int(2 * rate_hz)] or found[:2]  # two buckets, in which there is no line
        first[rate_hz] = sum(unfitted) / len(unfitted)
        worst[rate_hz] = max(found)
    assert max(kept.values()) <= SLOTS
    # A line is fitted once a bucket, so that slower boards spread the same fit over fewer scans.
    for slower, faster in itertools.pairwise(RATES_HZ):
        assert mean[faster] <= 1.2 * mean[slower], mean
    assert max(first.values()) <= 3000, first
    assert first[20_000.0] <= first[1000.0] <= first[100.0], first
    assert max(worst.values()) <= 80_000, worst  # a full window of buckets is fitted: 1 ms of a core
    assert worst[20_000.0] <= 1.5 * worst[1000.0], worst
