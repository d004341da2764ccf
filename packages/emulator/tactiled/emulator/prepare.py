"""Tables of contact model `periodic` that must be solved before a scene can be played in real time.

``python -m tactiled.emulator.prepare`` writes those of the shipped scenes; run it when `mechanics` changes.
"""

import sys
from collections.abc import Callable

from tactiled.array import Array, FloatArray, load_array
from tactiled.emulator.mechanics.base import Surface, TaxelModel
from tactiled.emulator.mechanics.period import SHIPPED, is_solved, ship_tables, solved_tables
from tactiled.emulator.mechanics.periodic import STEP_S, TableCollector
from tactiled.emulator.scene.contact import explain, model_name
from tactiled.emulator.scene.description import Scene, load_scene, paper_scenes
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.errors import ConfigError

Progress = Callable[[int, int], None]
# A slide over a plate that is not shipped needs a dozen; 60 can take an hour.
_MOST_TABLES = 60
_INSTEAD = (
    "in simulated time periodic plays it (Simulation, bench), in real time a flat plate with contact lumped"
)
# Measured once (research/README.md, `contact`); the faster models keep up with any scene.
_SLOW = (
    "compliance takes up to 1.1 s of processor for a second of nine sliding taxels, a held object several "
    "times as long: on a slower host the board misses scans (flag overrun) and the scene stands still"
)


def prepare(scene: Scene, array: Array, progress: Progress | None = None) -> None:
    """Solve all tables that a scene needs.

    Parameters
    ----------
    progress : callable
        Called before each table that is solved, with the number of tables done and their total.

    Raises
    ------
    ConfigError
        No contact model can play the scene, or not in real time: the tables are too many, or unknown.
    """
    missing = _missing(scene, array)
    for done, solve in enumerate(missing):
        if progress is not None:
            progress(done, len(missing))
        solve()


def explain_in_real_time(scene: Scene, array: Array) -> str:
    """`explain` for a board in real time: with the tables to solve first, or the cost of a slow model.

    Raises
    ------
    ConfigError
        As `prepare`, with what would play the scene instead.
    """
    words = explain(scene)
    if missing := _missing(scene, array):
        return f"{words}\n  in real time: {len(missing)} tables to solve first, up to a minute each"
    return f"{words}\n  in real time: {_SLOW if model_name(scene) == 'compliance' else 'as it is'}"


def check_real_time(scene: Scene) -> None:
    """Refuse a scene that `prepare` would refuse on any plate.

    Raises
    ------
    ConfigError
        The tables of the scene cannot be known beforehand.
    """
    if model_name(scene) == "periodic" and scene.held_object is not None:
        raise _not_in_real_time(
            scene,
            "how a held object moves is up to its controller, so its tables cannot be solved beforehand",
        )


def _missing(scene: Scene, array: Array) -> list[Callable[[], FloatArray]]:
    """Functions that solve the missing tables; `ConfigError` where real time cannot wait for them."""
    if model_name(scene) != "periodic":
        return []
    check_real_time(scene)
    missing = [solve for key, solve in _needed(scene, array).items() if not is_solved(key)]
    if len(missing) > _MOST_TABLES:
        raise _not_in_real_time(
            scene, f"{len(missing)} tables to solve, up to a minute each, and {_MOST_TABLES} is the most"
        )
    return missing


def _not_in_real_time(scene: Scene, fault: str) -> ConfigError:
    words = f"contact: periodic is not for real time here: {fault}; {_INSTEAD}"
    return ConfigError(f"scene {scene.name}", [words])


def _needed(scene: Scene, array: Array) -> dict[str, Callable[[], FloatArray]]:
    """Tables of a scene without controller, found from the onset of slip alone."""
    collectors: list[TableCollector] = []

    def build(surface: Surface, azimuth_deg: FloatArray, n_taxels: int) -> TaxelModel:
        collectors.append(TableCollector(surface, azimuth_deg, n_taxels, readout=scene.readout))
        return collectors[-1]

    PhysicalContact(SceneMotion(scene), array, build, STEP_S, "periodic").play_until(scene.duration_s)
    return {key: solve for collector in collectors for key, solve in collector.needed.items()}


def _write_shipped() -> None:
    SHIPPED.unlink(missing_ok=True)
    grooved = [scene for name, scene in paper_scenes().items() if "-d" in name]
    for scene in [load_scene("demo"), *(s.with_changes(contact="periodic") for s in grooved)]:
        prepare(scene, load_array(scene.array))
        print(f"{scene.name}: {len(solved_tables())} tables", file=sys.stderr)
    ship_tables()


if __name__ == "__main__":
    _write_shipped()
