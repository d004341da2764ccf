"""Creep follows the load that the rubber bears: disturbances and a controller's grip too."""

from typing import Any

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.control import move_grip
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.loading import CreepLag

WANG = load_array("wang2019-3x3")
PRESS = {"kind": "press", "duration_s": 0.5, "force_n": 10.0}
HOLD = {"kind": "hold", "duration_s": 3.0}


def sensor(**rest: Any) -> Sensor:
    scene = Scene.model_validate({"name": "t", "phases": [PRESS, HOLD], **rest})
    return Sensor(scene, WANG, adc_bits=12, adc_reference_v=3.0)


@pytest.mark.parametrize("tau", [0.2, 20.0])
def test_the_creep_lag_solves_its_equation(tau: float) -> None:
    coarse = np.interp(np.arange(0, 2.5, 0.01), [0, 0.5, 1.2, 1.4, 2.0], [0, 9, 9, 0, 4])
    fine = np.interp(np.arange(0, 2.5, 1e-4), np.arange(0, 2.5, 0.01), coarse)
    stepped = np.zeros_like(fine)
    for k in range(len(fine) - 1):  # trapezoidal rule
        mean = (fine[k] + fine[k + 1]) / 2
        stepped[k + 1] = mean + (stepped[k] - mean) * np.exp(-1e-4 / tau)
    np.testing.assert_allclose(CreepLag(0.01, tau).feed(coarse), stepped[::100], atol=1e-5)


@pytest.mark.parametrize("contact", ["signal", "mechanics"])
def test_a_disturbance_of_the_load_enters_creep(contact: str) -> None:
    extra = {"on": "load_n", "shape": "pulse", "amplitude": 8.0, "start_s": 1.0, "duration_s": 1.0}
    model = sensor(contact=contact, disturbances=[extra], electronics={"creep_time_s": 0.05}).contact
    time_s = np.full((1, 36), 1.5)
    # The pulse is 4 - 4 cos(w t); a first-order lag leaves 1 / (1 + (w tau)^2) of a cosine at its crest.
    lagged_n = 14.0 + 4.0 / (1 + (2 * np.pi * 0.05) ** 2)
    assert model.forces(time_s)[1][0, 0] == pytest.approx(lagged_n, rel=1e-4)


def test_a_controllers_grip_enters_creep() -> None:
    load = {"kind": "load", "duration_s": 3.0, "tangential_n": 0.0}
    held = {"contact": "mechanics", "held_object": {}, "phases": [PRESS, load]}

    def conductance(**electronics: float) -> dict[float, float]:
        worn = sensor(**held, electronics={"dead_zone_n": 0.0, "noise_v": 0.0, **electronics})
        at = {}
        for time_s in np.arange(0.0, 3.0, 0.01).round(2):
            if time_s in (1.0, 2.0):
                move_grip(worn.contact, 30.0 if time_s == 1.0 else 15.0)
            volts = worn.volts(np.full((1, 36), time_s))[0, 0]
            at[float(time_s)] = volts / (3.3 - volts)
        return at

    plain = conductance(creep_per_n=0.0)
    crept = conductance(creep_per_n=0.01, creep_time_s=0.05)
    for time_s, load_n in ((0.9, 10.0), (1.9, 30.0), (2.9, 15.0)):
        assert crept[time_s] / plain[time_s] == pytest.approx(1 + 0.01 * load_n, rel=1e-3)
