"""The line: transfer time, bunches, stalls; every fault counted."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.emulator.line.cable import Arrival, CableModel
from tactiled.emulator.line.faults import FaultCounts, FaultParams, FaultPlan

FRAME = bytes(range(1, 86))
BYTE_S = 10 / 115200


def line(**params: object) -> CableModel:
    return CableModel(115200, FaultParams.model_validate(params), 3, FaultCounts())


def sent(params: dict[str, object], n: int = 400) -> tuple[list[Arrival], FaultCounts]:
    counts = FaultCounts()
    made = CableModel(115200, FaultParams.model_validate(params), 3, counts)
    for k in range(n):
        made.send(0.01 * k, FRAME)
    return made.arrivals(math.inf), counts


def test_a_frame_arrives_whole_with_its_last_bit() -> None:
    made = line()
    made.send(5.0, FRAME)
    assert made.next_arrival_s() == pytest.approx(5.0 + 85 * BYTE_S)
    assert made.arrivals(5.0 + 84.9 * BYTE_S) == []
    assert [a.data for a in made.arrivals(5.0 + 85.1 * BYTE_S)] == [FRAME]
    assert made.next_arrival_s() == math.inf


def test_frames_queue_on_a_busy_line() -> None:
    made = line()
    made.send(5.0, FRAME)
    made.send(5.001, FRAME)
    arrived = [a.arrival_s for a in made.arrivals(6.0)]
    assert arrived == pytest.approx([5.0 + 85 * BYTE_S, 5.0 + 170 * BYTE_S])


def test_a_bunching_adapter_delivers_at_multiples_of_its_timer() -> None:
    made = line(bunch_s=0.016, adapter_ppm=1000.0)
    for k in range(300):
        made.send(0.01 * k, FRAME)
    arrived = made.arrivals(math.inf)
    ticks = np.array([a.arrival_s for a in arrived]) / (0.016 / 1.001)
    np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-6)
    assert np.all(np.diff(np.rint(ticks)) == 1)
    assert b"".join(a.data for a in arrived) == FRAME * 300
    # Each byte within one tick of its last bit.
    done_s = (np.arange(300)[:, None] * 0.01 + np.arange(1, 86) * BYTE_S).ravel()
    waited = np.repeat([a.arrival_s for a in arrived], [len(a.data) for a in arrived]) - done_s
    assert waited.min() >= -1e-9
    assert waited.max() < 0.016


def test_after_a_stall_all_bytes_arrive_at_once() -> None:
    made = line()
    for k in range(20):
        made.send(0.01 * k, FRAME)
    before = made.arrivals(0.1)
    made.stall(0.6)
    assert made.arrivals(0.5999) == []
    assert made.next_arrival_s() == 0.6
    (burst,) = made.arrivals(0.6)
    assert b"".join(a.data for a in before) + burst.data == FRAME * 20
    made.send(0.7, FRAME)
    assert made.next_arrival_s() == pytest.approx(0.7 + 85 * BYTE_S)


@pytest.mark.parametrize(
    ("params", "rates"),
    [
        ({"flip_per_byte": 0.01}, {"bytes_flipped": 0.01 * 85}),
        ({"drop_per_byte": 0.01}, {"bytes_dropped": 0.01 * 85}),
        ({"cut_per_frame": 0.2}, {"frames_cut": 0.2}),
        ({"duplicate_per_frame": 0.2}, {"frames_duplicated": 0.2}),
        (
            {"flip_per_byte": 0.01, "drop_per_byte": 0.01, "cut_per_frame": 0.2, "duplicate_per_frame": 0.2},
            {"frames_duplicated": 0.2},
        ),
    ],
)
def test_faults_come_at_their_rates_and_add_up(params: dict[str, object], rates: dict[str, float]) -> None:
    arrived, counts = sent(params)
    for name, rate in rates.items():
        expected = 400 * rate
        assert abs(getattr(counts, name) - expected) < 5 * math.sqrt(expected)
    assert counts.frames_in == 400 + counts.frames_duplicated
    assert counts.bytes_in == 85 * counts.frames_in
    arrived_bytes = sum(len(a.data) for a in arrived)
    assert counts.bytes_in == counts.bytes_cut + counts.bytes_dropped + arrived_bytes


def test_flips_change_one_bit_each() -> None:
    arrived, counts = sent({"flip_per_byte": 0.05})
    got = np.frombuffer(b"".join(a.data for a in arrived), np.uint8)
    changed = np.bitwise_count(got ^ np.frombuffer(FRAME * 400, np.uint8))
    assert set(changed.tolist()) == {0, 1}
    assert int(changed.sum()) == counts.bytes_flipped
    assert int(changed.reshape(400, 85).any(axis=1).sum()) == counts.frames_damaged


def test_armed_faults_change_the_next_frame_only() -> None:
    counts = FaultCounts()
    made = CableModel(115200, FaultParams(burst_bytes=100), 3, counts)
    arrived: list[bytes] = []
    for kind in (None, "flip", None, "drop", None, "cut", None, "duplicate", None, "burst", None, None):
        if kind is not None:
            made.arm(kind)
        made.send(len(arrived) * 1.0, FRAME)
        arrived.append(b"".join(a.data for a in made.arrivals(math.inf)))
    whole = [data == FRAME for data in arrived]
    assert whole == [True, False, True, False, True, False, True, False, True, False, False, True]
    assert (counts.bytes_flipped, counts.bytes_dropped, counts.frames_cut) == (1, 1, 1)
    assert arrived[7] == FRAME + FRAME
    assert (counts.bursts, counts.bytes_noise, counts.frames_damaged) == (1, 100, 5)
    noise = np.frombuffer(arrived[9] + arrived[10], np.uint8) != np.frombuffer(FRAME + FRAME, np.uint8)
    assert noise.tolist() == [True] * 100 + [False] * 70
    assert arrived[5] == FRAME[: len(arrived[5])]
    assert len(arrived[5]) <= 82


@given(st.lists(st.floats(0.0001, 0.1), min_size=1, max_size=40), st.booleans())
@settings(max_examples=30, deadline=None)
def test_any_polling_gives_the_same_bytes_at_the_same_instants(steps: list[float], bunched: bool) -> None:
    params = {"bunch_s": 0.016 if bunched else 0.0, "flip_per_byte": 0.01, "duplicate_per_frame": 0.1}

    def run(polls: list[float]) -> list[Arrival]:
        made, out, k = line(**params), [], 0
        for now_s in polls:
            while 0.01 * k <= now_s:
                made.send(0.01 * k, FRAME)
                k += 1
            out += made.arrivals(now_s)
        return out

    polls = np.cumsum(steps).tolist()
    assert run(polls) == run([polls[-1]])


def test_planned_faults_are_in_order_at_their_rate_and_reproducible() -> None:
    params = FaultParams.model_validate(
        {"stall_per_s": 0.5, "reboot_per_s": 0.1, "at": [{"kind": "unplug", "at_s": 33.0}]}
    )

    def run(seed: int, chosen: FaultParams = params) -> list[tuple[float, str]]:
        plan = FaultPlan(chosen, seed, power_up_s=100.0)
        out: list[tuple[float, str]] = []
        while plan.next_s() < 1100.0:
            at_s = plan.next_s()
            out.append((at_s, plan.pop()))
        return out

    faults = run(1)
    assert faults == sorted(faults) == run(1)
    assert faults != run(2)
    assert (133.0, "unplug") in faults
    for kind, rate in (("stall", 0.5), ("reboot", 0.1)):
        n = sum(k == kind for _, k in faults)
        assert abs(n - 1000 * rate) < 5 * math.sqrt(1000 * rate)
    only = [f for f in faults if f[1] == "reboot"]
    assert run(1, FaultParams(reboot_per_s=0.1)) == only  # one kind does not move another
    assert FaultPlan(FaultParams(), 1, 0.0).next_s() == math.inf
