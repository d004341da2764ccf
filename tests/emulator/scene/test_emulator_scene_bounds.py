"""No accepted scene makes anything but numbers: each value has bounds, and at them volts are finite."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import load_array
from tactiled.emulator.board.electronics import ElectronicsParams
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene import phases
from tactiled.emulator.scene.description import Scene
from tactiled.tomlfile import Params

WANG = load_array("wang2019-3x3")
PARTS = (ElectronicsParams, phases.FlatPlate, phases.GroovedPlate, phases.Disturbance, phases.HeldObject)


def extremes(part: type[Params]) -> dict[str, list[float]]:
    """Least and largest accepted value of each float."""
    found = {}
    for name, field in part.model_fields.items():
        if field.annotation is not float:
            continue
        limits: dict[str, float] = {}
        for limit in field.metadata:
            limits |= {key: getattr(limit, key) for key in ("ge", "gt", "le", "lt") if hasattr(limit, key)}
        low = limits["ge"] if "ge" in limits else limits["gt"] + 1e-300 + 1e-12 * abs(limits["gt"])
        high = limits["le"] if "le" in limits else limits["lt"] * (1 - 1e-12)
        found[name] = [low, high]
    return found


@pytest.mark.parametrize("part", PARTS)
def test_every_number_is_bounded_on_both_sides(part: type[Params]) -> None:
    assert extremes(part)


def at_extremes(part: type[Params]) -> st.SearchStrategy[dict[str, Any]]:
    choices: dict[str, st.SearchStrategy[Any]] = {n: st.sampled_from(v) for n, v in extremes(part).items()}
    return st.fixed_dictionaries({}, optional=choices)


@given(
    at_extremes(ElectronicsParams),
    at_extremes(phases.FlatPlate),
    st.sampled_from(["signal", "mechanics"]),
    st.sampled_from([1e-300, 1e-6, 5.0, 2000.0]),
    st.sampled_from([1e-300, 1.0, 1000.0]),
    st.sampled_from([-10.0, 0.0, 10.0]),
)
@settings(max_examples=60, deadline=None)
def test_volts_are_finite_at_the_extremes_of_all_parameters(
    electronics: dict[str, float],
    plate: dict[str, float],
    contact: str,
    force_n: float,
    speed_mm_s: float,
    gradient: float,
) -> None:
    press = {"kind": "press", "duration_s": 0.2, "force_n": force_n}
    slide = {"kind": "slide", "duration_s": 0.2, "speed_mm_s": speed_mm_s}
    scene = Scene.model_validate(
        {
            "name": "extreme",
            "contact": contact,
            "electronics": electronics,
            "surface": {"kind": "flat", **plate},
            "phases": [press, slide, {"kind": "lift", "duration_s": 0.1}],
            "load_gradient_per_mm": (gradient if contact == "mechanics" else 0.0, 0.0),
        }
    )
    sensor = Sensor(scene, WANG, adc_bits=12, adc_reference_v=3.0)
    volts = sensor.volts(np.repeat(np.linspace(0, 0.5, 11)[:, None], WANG.n_channels, axis=1))
    assert np.isfinite(volts).all()


@pytest.mark.parametrize(
    "change",
    [
        {"load_gradient_per_mm": [1e308, 0.0]},
        {"electronics": {"rubber_ohm_n": 1e-320}},
        {"surface": {"kind": "grooves", "period_mm": 1.0, "ripple": 1e308}},
    ],
)
def test_parameters_that_gave_nan_are_refused(change: dict[str, Any]) -> None:
    press = {"kind": "press", "duration_s": 1.0, "force_n": 5.0}
    with pytest.raises(ValueError, match=r"(less|greater) than or equal"):
        Scene.model_validate({"name": "t", "phases": [press], **change})
