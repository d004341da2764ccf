"""What a scene's contact model is said to be is what plays it, or the same refusal."""

import pytest

from tactiled.emulator.contact import explain
from tactiled.emulator.scene import load_scene
from tactiled.errors import ConfigError


@pytest.mark.parametrize("rung", ["lumped", "bristle"])
def test_a_rung_that_cannot_play_the_scene_is_refused_and_not_explained(rung: str) -> None:
    grooved = load_scene("demo").with_changes(
        contact=rung, needs=[], surface={"kind": "grooves", "period_mm": 1.2}
    )
    with pytest.raises(ConfigError, match=f"scene demo: contact: {rung} cannot play grooves"):
        explain(grooved)


def test_a_rung_that_can_is_explained() -> None:
    words = explain(load_scene("grasp").with_changes(contact="bristle"))
    assert words.startswith("contact: bristle\n  the scene says so\n  not modelled: ")
