"""Explanation of the contact model of a scene, or the same refusal as for playing it."""

import pytest

from tactiled.array import load_array
from tactiled.emulator.prepare import explain_in_real_time
from tactiled.emulator.scene.contact import explain
from tactiled.emulator.scene.description import load_scene
from tactiled.errors import ConfigError


def test_explain_refuses_a_contact_model_that_cannot_play_the_scene() -> None:
    grooved = load_scene("demo").with_changes(
        contact="lumped", needs=[], surface={"kind": "grooves", "period_mm": 1.2}
    )
    with pytest.raises(ConfigError, match="scene demo: contact: lumped cannot play grooves"):
        explain(grooved)
    words = explain(load_scene("grasp"))
    assert words.startswith("contact: lumped\n  named by the scene\n  not modelled: ")


GROOVES = {"kind": "grooves", "period_mm": 1.2}


@pytest.mark.parametrize("contact", ["auto", "periodic"])
def test_a_held_object_on_grooves_is_for_simulated_time_alone(contact: str) -> None:
    held = load_scene("grasp").with_changes(
        contact=contact, needs=["groove-ripple"], tolerance=0.5, surface=GROOVES
    )
    assert explain(held).startswith("contact: periodic\n")
    with pytest.raises(
        ConfigError, match=r"up to its controller.*simulated time periodic.*real time a flat plate"
    ):
        explain_in_real_time(held, load_array(held.array))
    flat = load_scene("grasp")  # what the refusal names instead
    assert "contact: lumped" in explain_in_real_time(flat, load_array(flat.array))


def test_explain_in_real_time_names_slow_contact_models() -> None:
    shipped = load_scene("demo")
    array = load_array(shipped.array)
    assert explain_in_real_time(shipped, array) == f"{explain(shipped)}\n  in real time: as it is"
    slow = load_scene("grasp").with_changes(contact="compliance")
    assert "in real time: compliance takes up to" in explain_in_real_time(slow, array)
