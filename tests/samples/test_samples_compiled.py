"""What each scan runs through on its way to an instant: the same bits compiled as in plain Python."""

import os
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled import compiled
from tactiled.samples import bucket, clock, envelope, unwrap

pytestmark = pytest.mark.skipif(
    bool(compiled.reason_plain) and "TACTILED_CI" not in os.environ,
    reason=f"no compiled path: {compiled.path_words()}",
)
counters = st.tuples(st.integers(0, 3), st.integers(0, 2**16 - 1), st.booleans(), st.floats(-0.3, 12.0))


def compiled_of(plain: ModuleType) -> ModuleType:
    found = compiled.compiled_module(plain.__name__)
    assert found is not None
    return found


@given(
    st.integers(0, 2**32 - 1),
    st.lists(counters, min_size=1, max_size=40),
    st.sampled_from([1e-6, 1e-3]),
    st.booleans(),
)
def test_counters_of_scans(
    tick0: int, scans: list[tuple[int, int, bool, float]], tick_s: float, has_ticks: bool
) -> None:
    both = [
        one.ScanCounter(16, 32 if has_ticks else None, tick_s if has_ticks else None)
        for one in (unwrap, compiled_of(unwrap))
    ]
    arrival_s, sequence, ticks = 7.0, 65_530, tick0
    for advance, anywhere, forgets, wait_s in scans:
        sequence = (sequence + advance) % 2**16 if advance else anywhere
        ticks = (ticks + round((advance or wait_s) * 0.01 / tick_s)) % 2**32
        arrival_s += wait_s if wait_s > 1.0 else 0.01
        found = []
        for one in both:
            if forgets and not advance:
                one.forget_sequence()
            one.age_s = max(wait_s, 0.0)
            runs_on = has_ticks and one.runs_on(ticks, arrival_s)
            step = one.step(sequence, ticks if has_ticks else None, arrival_s, 100.0)
            found.append((tuple(step), one.board_s, runs_on))
        assert found[0] == found[1]


@given(seed=st.integers(0, 2**32), bunch_s=st.sampled_from([0.0, 0.004, 0.016]), pings=st.booleans())
@settings(max_examples=25, deadline=None)
def test_instants_of_a_line_with_delays_stalls_and_steps(seed: int, bunch_s: float, pings: bool) -> None:
    rng = np.random.default_rng(seed)
    plain, fast = (clock.ClockFit(clock.ClockParams(window_buckets=12), 0.003) for _ in range(2))
    parts = (
        (bucket.Bucket, envelope.lines_through),
        (
            compiled_of(bucket).Bucket,
            compiled_of(envelope).lines_through,
        ),
    )
    at_s = np.arange(600) / 37.0
    arrivals_s = 50.0 + at_s * (1 + rng.normal(0, 1e-4)) + rng.exponential(5e-4, len(at_s))
    stalled = rng.random(len(at_s)) < 0.01
    arrivals_s = np.maximum.accumulate(arrivals_s + np.where(stalled, rng.exponential(0.3, len(at_s)), 0.0))
    arrivals_s[300:] += rng.choice([0.0, 0.0, -0.1])
    # Ticks that go back or forth, for one scan or from one on.
    glitches = rng.random(len(at_s)) < rng.choice([0.0, 0.02])
    board_s = at_s + np.where(glitches, rng.normal(0.0, 0.3, len(at_s)), 0.0)
    board_s[rng.integers(1, 5) :] += rng.choice([0.0, -0.05])
    if bunch_s:
        arrivals_s = np.ceil(arrivals_s / bunch_s) * bunch_s
    before_s = 0.0
    for tick_s, arrival_s in zip(board_s.tolist(), arrivals_s.tolist(), strict=True):
        found = []
        for fit, (bucket_type, through) in zip((plain, fast), parts, strict=True):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(clock, "Bucket", bucket_type)
                patch.setattr(clock, "lines_through", through)
                fit.add(tick_s, arrival_s, arrival_s - before_s, whole=bunch_s == 0)
                if pings and round(37 * tick_s) % 20 == 0:
                    fit.answered(tick_s, arrival_s - 0.004, arrival_s - 0.001)
                found.append((*fit.time_of(tick_s), fit.drift_ppm))
        assert found[0] == found[1]
        before_s = arrival_s
