"""The stepper: any instants, any order, any chunking, the same bits, bounded memory."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.stepper import GridInterpolator

STEP_S = 0.01
ALL = np.arange(3)


class Walk:
    """A source with memory, which counts how often it was begun anew."""

    def __init__(self) -> None:
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1
        self.rng = np.random.default_rng(3)
        self.place = np.zeros(3)

    def advance(self, time_s: FloatArray) -> FloatArray:
        walk = self.place + np.cumsum(self.rng.normal(size=(len(time_s), 3)), axis=0)
        self.place = walk[-1]
        return np.asarray(walk)


TRUE = Walk()
TRUE.reset()
PATH = TRUE.advance(np.arange(20_000) * np.float64(STEP_S))


@given(st.lists(st.floats(0, 120), min_size=1, max_size=40), st.sampled_from([1, 7, 64]))
@settings(max_examples=20, deadline=None)
def test_any_order_and_chunking_gives_the_same_bits(times: list[float], block: int) -> None:
    columns = np.array([2, 0])
    time_s = np.repeat(np.array(times)[:, None], 2, axis=1) + np.array([0.0, 0.0007])
    whole = GridInterpolator(Walk(), step_s=STEP_S, block=block).at(time_s, columns)
    one = GridInterpolator(Walk(), step_s=STEP_S, block=block)
    np.testing.assert_array_equal(np.concatenate([one.at(row[None], columns) for row in time_s]), whole)
    np.testing.assert_array_equal(one.at(time_s, columns), whole)


@given(st.floats(0, 100))
@settings(max_examples=40, deadline=None)
def test_rows_between_grid_points_are_interpolated_linearly(time_s: float) -> None:
    stepper = GridInterpolator(Walk(), step_s=STEP_S, block=16)
    grid = STEP_S * np.arange(len(PATH))
    expected = [np.interp(time_s, grid, PATH[:, k]) for k in range(3)]
    np.testing.assert_allclose(stepper.at(np.array([[time_s]]), ALL)[0], expected, rtol=1e-7, atol=1e-7)


def test_rows_before_time_0_are_those_of_time_0() -> None:
    rows = GridInterpolator(Walk(), step_s=STEP_S, block=64).at(np.array([[-5.0], [0.0]]), ALL)
    np.testing.assert_array_equal(rows[0], rows[1])


def test_memory_is_bounded_and_the_far_past_is_computed_again() -> None:
    source = Walk()
    stepper = GridInterpolator(source, step_s=STEP_S, block=64)
    early = stepper.at(np.array([[0.5]]), ALL)
    stepper.at(np.arange(0, 150, 1.0)[:, None], ALL)
    held = sum(block.size for block in stepper._blocks.values())  # noqa: SLF001  the bound on memory
    assert held <= 3 * 4200
    assert source.resets == 1
    np.testing.assert_array_equal(stepper.at(np.array([[0.5]]), ALL), early)
    assert source.resets == 2


@pytest.mark.parametrize("block", [1, 12])
def test_no_more_blocks_are_computed_than_needed(block: int) -> None:
    stepper = GridInterpolator(Walk(), step_s=STEP_S, block=block)
    for time_s in (0.2, 0.5, 3.0):
        stepper.at(np.array([[time_s]]), ALL)
        assert time_s <= stepper.made_s <= time_s + 2 * block * STEP_S
