"""Scenes of the slip bench: instants of a slip."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.slip.scenes import GRID_S, PlayedScene, at_speed, play, shear_begins_s
from tactiled.emulator.scene.phases import FlatPlate
from tactiled.emulator.scene.truth import TrueSlip


@pytest.fixture(scope="module")
def slide() -> PlayedScene:
    return play(at_speed(1.0), 1)


def test_instants_of_a_slip_are_in_order(slide: PlayedScene) -> None:
    slip = slide.slip
    assert slip is not None
    assert 0.0 < slip.shear_s < slip.incipient_s < slip.gross_s < slip.end_s
    still = slide.volts[int(slip.shear_s * 100) - 20 : int(slip.shear_s * 100) - 1]
    assert np.ptp(still, axis=0).max() < 1e-3  # nothing moves before the shear but creep


@given(st.floats(0.5, 3.0), st.sampled_from([1, 2, 3]))
def test_growth_of_a_load_begins_at_the_end_of_its_rest(swells_for_s: float, power: int) -> None:
    time_s = np.arange(0.0, 6.0, GRID_S)
    shear_n = np.where(time_s < 1.0, time_s, 1.0)  # it has come and stays
    shear_n += 5.0 * (np.maximum(time_s - 3.0, 0.0) / swells_for_s) ** power
    slip = TrueSlip(5.9, np.inf, 0.0, FlatPlate(friction=0.5), shear_s=0.0)
    begins_s = shear_begins_s(slip, time_s, shear_n, np.full(len(time_s), 10.0))
    before_n, grown_n = np.interp([begins_s - 0.1, begins_s], time_s, shear_n)
    assert grown_n - before_n <= 0.002 * 10.0 + 1e-9  # not yet growth
    assert begins_s >= 3.0 - GRID_S
