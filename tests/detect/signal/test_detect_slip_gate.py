"""Scans of settled slips, each with its speed, whatever the chunking."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.detect.signal.slip_gate import SlidingScans, SlipEnd, SlipGate, SlipStart
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import ScanBlock, regular_block

N, RATE_HZ = 200, 100.0
BLOCK = regular_block(np.arange(N)[:, np.newaxis] * np.ones(36), RATE_HZ)


def slip(state: str, scan: int) -> SlipEvent:
    time_s = float(BLOCK.time_s[scan])
    return SlipEvent(
        time_s=time_s, state=state, kind="gross", onset_s=time_s, onset_sd_s=0.01,  # type: ignore[arg-type]
        direction_deg=0.0, direction_sd_deg=1.0, confidence=1.0, taxels=(), detector="grip",
        statistic=1.0, threshold=0.0, valid=True, detected_s=time_s,
    )  # fmt: skip


def passed(
    cuts: list[int], slips: list[tuple[str, int]], speeds: list[tuple[int, float]]
) -> list[tuple[str, int, float]]:
    """What a gate that settles for 0.1 s passes on: starts, ends, and each scan with its speed."""
    gate = SlipGate(0.1, 1.0)
    for from_index, speed in speeds:
        gate.set_speed(speed, from_index)
    out: list[tuple[str, int, float]] = []
    edges = [0, *sorted(set(cuts)), N]
    for begin, end in itertools.pairwise(edges):
        if begin == end:
            continue
        part: ScanBlock = BLOCK[begin:end]
        events: list[Event] = [slip(state, scan) for state, scan in slips if begin <= scan < end]
        for piece in gate.pass_through(part, events):
            if isinstance(piece, SlidingScans):
                rows = zip(piece.block.index.tolist(), piece.speeds_mm_s.tolist(), strict=True)
                out += [("scan", index, speed) for index, speed in rows]
            elif isinstance(piece, SlipStart):
                out.append(("start", piece.index, 0.0))
            else:
                assert isinstance(piece, SlipEnd)
                out.append(("end", round(piece.time_s * RATE_HZ), 0.0))
    return out


def test_scans_are_passed_from_settling_to_the_end_of_the_slip() -> None:
    found = passed([], [("onset", 20), ("end", 150)], [])
    assert found == [("start", 20, 0.0), *(("scan", i, 1.0) for i in range(30, 150)), ("end", 150, 0.0)]


def test_a_new_onset_begins_to_settle_again() -> None:
    """Incipient, then gross: the scans before the second onset are passed on, then 0.1 s are not."""
    found = passed([], [("onset", 20), ("onset", 60)], [])
    scans = [index for kind, index, _ in found if kind == "scan"]
    assert scans == [*range(30, 60), *range(70, 200)]


def test_a_speed_holds_from_its_scan_on() -> None:
    found = passed([], [("onset", 0)], [(100, -3.0), (50, 2.0)])
    speeds = {index: speed for kind, index, speed in found if kind == "scan"}
    assert [speeds[i] for i in (49, 50, 99, 100, 199)] == [1.0, 2.0, 2.0, -3.0, -3.0]


@given(
    st.lists(st.integers(1, N - 1), max_size=8),
    st.lists(st.tuples(st.integers(0, N - 1), st.floats(-5, 5)), max_size=3, unique_by=lambda s: s[0]),
    st.lists(st.integers(0, N - 1), max_size=4, unique=True),
)
def test_any_chunking_passes_the_same(
    cuts: list[int], speeds: list[tuple[int, float]], changes: list[int]
) -> None:
    slips = [("onset" if n % 2 == 0 else "end", scan) for n, scan in enumerate(sorted(changes))]
    assert passed(cuts, slips, speeds) == passed([], slips, speeds)


def test_after_close_nothing_is_passed_until_the_next_onset() -> None:
    gate = SlipGate(0.0, 1.0)
    assert len(list(gate.pass_through(BLOCK[:50], [slip("onset", 10)]))) == 2
    gate.close()
    assert list(gate.pass_through(BLOCK[50:100], [])) == []
    assert gate.speed_mm_s == pytest.approx(1.0)


def test_scans_before_the_detection_have_the_speed_of_their_time() -> None:
    gate = SlipGate(0.1, 1.0, looks_back_s=1.005)
    gate.set_speed(2.0, 100)
    late = replace(slip("onset", 160), onset_s=float(BLOCK.time_s[20]))
    assert not list(gate.pass_through(BLOCK[:150], []))
    parts = [part for part in gate.pass_through(BLOCK[150:], [late]) if isinstance(part, SlidingScans)]
    speeds = {i: v for p in parts if p.are_past for i, v in zip(p.block.index, p.speeds_mm_s, strict=True)}
    assert speeds == {i: 1.0 if i < 100 else 2.0 for i in range(60, 160)}
