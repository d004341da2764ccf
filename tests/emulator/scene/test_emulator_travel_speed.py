"""Speed in the truth is the rate of the travel in the truth, whatever moves the skin."""

from typing import Any

import numpy as np
import pytest

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.truth import Truth

PRESS = {"kind": "press", "duration_s": 0.5, "force_n": 15.0}
SLIDE = {"kind": "slide", "duration_s": 1.5, "speed_mm_s": 3.0, "direction_deg": 40.0, "ramp_s": 0.3}


@pytest.mark.parametrize(
    "disturbance",
    [
        {"shape": "pulse", "amplitude": 2.0},
        {"shape": "ramp", "amplitude": -1.0},
        {"shape": "sine", "amplitude": 0.3, "frequency_hz": 7.0},
    ],
)
def test_speed_is_the_rate_of_travel(disturbance: dict[str, Any]) -> None:
    shaken = {"on": "travel_mm", "start_s": 0.3, "duration_s": 0.9, "direction_deg": 110.0, **disturbance}
    scene = {"name": "t", "contact": "lumped", "phases": [PRESS, SLIDE], "disturbances": [shaken]}
    truth = Truth(Scene.model_validate(scene), t0_s=5.0)
    # Off the kinks, at which a rate has two sides.
    time_s, h = np.arange(5.013, 7.0, 0.0171), 1e-6
    rate = (truth.travel_mm(time_s + h) - truth.travel_mm(time_s - h)) / (2 * h)
    np.testing.assert_allclose(truth.speed_mm_s(time_s), np.linalg.norm(rate, axis=-1), atol=1e-5)
    assert truth.speed_mm_s(np.array([5.4]))[0] > 0.5  # nothing but the disturbance moves it
