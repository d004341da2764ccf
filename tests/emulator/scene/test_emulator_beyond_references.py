"""Loads that no reference has: a number, and a flag in the truth."""

import json
from typing import Any

import numpy as np
import pytest

from tactiled.emulator.mechanics.base import PRESSED_REFERENCE_N, SHEARED_REFERENCE_N
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.truth import Truth
from tactiled.resources import shipped

HOLD = {"kind": "hold", "duration_s": 0.5}
SLIDE = {"kind": "slide", "duration_s": 1.0, "speed_mm_s": 1.0}


def truth(force_n: float, *phases: dict[str, Any], **rest: Any) -> Truth:
    press = {"kind": "press", "duration_s": 1.0, "force_n": force_n}
    scene = {"name": "t", "contact": "lumped", "touching": [4], "phases": [press, *phases], **rest}
    return Truth(Scene.model_validate(scene))


def test_load_limits_are_those_of_the_references_without_continued_materials() -> None:
    pressed: list[float] = []
    sheared: list[float] = []
    for path in shipped("config", "contact").glob("fem-*.json"):
        columns = {k: np.array(v) for k, v in json.loads(path.read_text())["columns"].items()}
        assert not any(columns[name].any() for name in columns if name.startswith("continued_"))
        slides = columns["slipping"].max() == 1.0
        (sheared if slides else pressed).append(columns["normal_n"].max())
    assert max(pressed) == pytest.approx(PRESSED_REFERENCE_N, abs=0.01)
    assert max(sheared) == pytest.approx(SHEARED_REFERENCE_N, abs=0.01)


def test_more_load_than_in_any_reference_is_flagged_at_its_instant() -> None:
    assert truth(2.4, SLIDE).warnings == {}
    assert truth(3.9, HOLD).warnings == {}
    pressed = truth(8.0, HOLD).warnings
    (words,) = pressed
    assert "more than in any finite-element reference" in words
    assert pressed[words] == pytest.approx(PRESSED_REFERENCE_N / 8.0, abs=0.01)
    assert truth(3.5, SLIDE).warnings == {words: pytest.approx(1.0, abs=0.03)}
