"""Tables of contact model `periodic` that must be solved before a scene can be played in real time.

``python -m tactiled.emulator.prepare`` writes those of the shipped scenes; run it when `mechanics` changes.
"""

import sys
from collections.abc import Callable

from tactiled.array import Array, FloatArray, load_array
from tactiled.emulator.mechanics.periodic import SHIPPED, TableCollector, ship_tables, tables
from tactiled.emulator.scene.contact import explain, model_name
from tactiled.emulator.scene.description import Scene, load_scene, paper_scenes
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.errors import ConfigError

# A slide over a plate that is not shipped needs a dozen; 60 can take an hour.
_MOST_TABLES = 60
# Measured once (research/README.md, `contact`); the faster models keep up with any scene.
_SLOW = (
    "compliance takes up to 1.1 s of processor for a second of nine sliding taxels, a held object several "
    "times as long: on a slower host the board misses scans (flag overrun) and the scene stands still"
)


def missing_tables(scene: Scene, array: Array) -> list[Callable[[], FloatArray]]:
    """Functions that solve the missing tables of a scene, which are found from the onset of slip.

    Raises
    ------
    ConfigError
        No contact model can play the scene, or not in real time: the tables are too many, or unknown.
    """
    if model_name(scene) != "periodic":
        return []
    fault = ""
    if scene.held_object is not None:
        fault = "how a held object moves is up to its controller, so its tables cannot be solved beforehand"
    else:
        contact = PhysicalContact(SceneMotion(scene), array, TableCollector)
        contact.play_until(scene.duration_s)
        collectors = [model for model in contact.models if isinstance(model, TableCollector)]
        missing = {key: solve for collector in collectors for key, solve in collector.missing.items()}
        if len(missing) <= _MOST_TABLES:
            return list(missing.values())
        fault = f"{len(missing)} tables to solve, up to a minute each, and {_MOST_TABLES} is the most"
    words = (
        f"contact: periodic is not for real time here: {fault}; in simulated time periodic plays it "
        "(Simulation, bench), in real time a flat plate with contact lumped"
    )
    raise ConfigError(f"scene {scene.name}", [words])


def explain_in_real_time(scene: Scene, array: Array) -> str:
    """`explain` for a board in real time: with the tables to solve first, or the cost of a slow model.

    `ConfigError` as `missing_tables`, with what would play the scene instead.
    """
    words = explain(scene)
    if missing := missing_tables(scene, array):
        return f"{words}\n  in real time: {len(missing)} tables to solve first, up to a minute each"
    return f"{words}\n  in real time: {_SLOW if model_name(scene) == 'compliance' else 'as it is'}"


def _write_shipped() -> None:
    SHIPPED.unlink(missing_ok=True)
    grooved = [scene for name, scene in paper_scenes().items() if "-d" in name]
    for scene in [load_scene("demo"), *(s.with_changes(contact="periodic") for s in grooved)]:
        for solve in missing_tables(scene, load_array(scene.array)):
            solve()
        print(f"{scene.name}: {len(tables())} tables", file=sys.stderr)
    ship_tables()


if __name__ == "__main__":
    _write_shipped()
