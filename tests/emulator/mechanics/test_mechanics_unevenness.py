"""Friction that differs from place to place, in the field itself and in every contact model."""

import numpy as np
import pytest

from tactiled.array import FloatArray, load_array
from tactiled.emulator.mechanics.unevenness import friction_factor
from tactiled.emulator.scene.contact import make_contact
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion

WANG = load_array("wang2019-3x3")


def test_the_field_has_its_deviation_around_one_and_is_smooth() -> None:
    x, y = np.meshgrid(np.arange(0, 60, 0.07), np.arange(0, 60, 1.1))
    factor = friction_factor(0.05, np.stack([x, y], axis=-1))
    assert factor.mean() == pytest.approx(1.0, abs=0.003)
    assert factor.std() == pytest.approx(0.05, rel=0.1)
    assert np.abs(np.diff(factor, axis=1)).max() < 0.04  # over 0.07 mm
    np.testing.assert_array_equal(friction_factor(0.0, np.zeros((3, 2))), 1.0)


def test_friction_never_turns_round() -> None:
    places = np.random.default_rng(1).uniform(0, 50, (2000, 2))
    assert friction_factor(5.0, places).min() > 0


@pytest.mark.parametrize("model", ["signal", "mechanics"])
def test_taxels_that_slide_bear_other_friction_at_other_places(model: str) -> None:
    def ratios(unevenness: float) -> FloatArray:
        document = {
            "name": "test",
            "contact": model,
            "surface": {"kind": "flat", "unevenness": unevenness},
            "phases": [
                {"kind": "press", "duration_s": 0.2, "force_n": 15.0},
                {"kind": "hold", "duration_s": 0.1},
                {"kind": "slide", "duration_s": 0.6, "speed_mm_s": 5.0},
            ],
        }
        contact = make_contact(SceneMotion(Scene.model_validate(document)), WANG)
        state = contact.state(np.arange(0.5, 0.9, 0.05))
        return np.asarray(np.linalg.norm(state.tangential_n, axis=-1) / state.normal_n)

    even, uneven = ratios(0.0), ratios(0.1)
    assert even.std(axis=0).max() < 0.01
    assert (uneven.std(axis=0) > 0.01).all()
    assert 0.02 < uneven.std() / uneven.mean() < 0.2
