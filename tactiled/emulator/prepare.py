"""What must be solved before a scene can be played in real time: the tables of rung `periodic`.

``python -m tactiled.emulator.prepare`` writes those of the shipped scenes; run it when `mechanics` changes.
"""

import sys

from tactiled.array import Array, load_array
from tactiled.emulator.contact import choose_rung, make_contact
from tactiled.emulator.mechanics.tables import SHIPPED, solved_tables, write_tables
from tactiled.emulator.motion import Motion
from tactiled.emulator.physical import PhysicalContact
from tactiled.emulator.scene import Scene, load_scene, paper_scenes


def rung_of(scene: Scene) -> str:
    """Name of the contact model that plays a scene."""
    return choose_rung(scene).rung if scene.contact == "auto" else scene.contact


def prepare(scene: Scene, array: Array) -> None:
    """Play a scene once, so that all tables that it looks into are solved.

    A held object's way depends on its controller, so its tables are solved as they come.

    Raises
    ------
    ConfigError
        No contact model can play the scene.
    """
    if rung_of(scene) != "periodic" or scene.held_object is not None:
        return
    contact = make_contact(Motion(scene), array)
    assert isinstance(contact, PhysicalContact)  # what a rung plays
    contact.play_until(scene.duration_s)


def _write_shipped() -> None:
    SHIPPED.unlink(missing_ok=True)
    grooved = [scene for name, scene in paper_scenes().items() if "-d" in name]
    for scene in [load_scene("demo"), *(s.with_changes(contact="periodic") for s in grooved)]:
        prepare(scene, load_array(scene.array))
        print(f"{scene.name}: {len(solved_tables())} tables", file=sys.stderr)
    write_tables(SHIPPED, solved_tables())


if __name__ == "__main__":
    _write_shipped()
