"""The guide asks for what is lacking, and is content with a person's presses."""

import numpy as np
import pytest

from tactiled.array import Array, load_array
from tactiled.calibrate.guide import GOOD, Guide
from tactiled.emulator.rig.motion import Motion
from tactiled.emulator.rig.session import draw_rig

ARRAY = load_array("wang2019-3x3")
MOTIONS: tuple[Motion, ...] = ("walk", "tip")


def guided(motion: Motion, seconds: float, array: Array = ARRAY) -> Guide:
    rig, rng = draw_rig(ARRAY, 2)
    readings = rig.run(motion, seconds, rng).readings
    guide = Guide(array)
    for start in range(0, len(readings), 100):
        guide.add(readings[start : start + 100])
    return guide


def test_nothing_touched_asks_for_a_press() -> None:
    guide = Guide(ARRAY)
    guide.add(1e-3 * np.random.default_rng(0).standard_normal((100, 36)))
    assert "press" in guide.advice().motion
    assert guide.advice().worst > GOOD


def test_flat_presses_ask_for_shear_or_single_taxels() -> None:
    advice = guided("flat", 60.0).advice()
    assert "sideways" in advice.motion or "finger tip" in advice.motion
    assert min(advice.sd["shear x"], advice.sd["shear y"]) > GOOD


def test_presses_everywhere_and_on_single_taxels_are_enough() -> None:
    early, late = guided("walk", 20.0).advice(), with_tips(lost=None).advice()
    assert late.motion == ""
    assert early.motion
    assert late.worst < early.worst


@pytest.mark.parametrize("taxel", [0, 8])
def test_a_taxel_that_was_left_out_is_named(taxel: int) -> None:
    assert f"taxel {taxel} at" in with_tips(lost=taxel).advice().motion


def with_tips(lost: int | None) -> Guide:
    """Guide after presses that wander, and presses on single taxels."""
    rig, rng = draw_rig(ARRAY, 2)
    guide = Guide(ARRAY)
    for motion in MOTIONS:
        readings = rig.run(motion, 60.0, rng).readings.copy()
        if lost is not None:
            readings[:, 4 * lost : 4 * lost + 4] = 0.0
        for start in range(0, len(readings), 100):
            guide.add(readings[start : start + 100])
    return guide
