"""What must be solved before a scene can be played in real time: the tables of rung `periodic`.

``python -m tactiled.emulator.prepare`` writes those of the shipped scenes; run it when `mechanics` changes.
"""

import sys
from collections.abc import Callable

from tactiled.array import Array, FloatArray, load_array
from tactiled.emulator.mechanics.base import Rung, Surface
from tactiled.emulator.mechanics.period import SHIPPED, is_solved, solved_tables, write_tables
from tactiled.emulator.mechanics.periodic import STEP_S, Foresight
from tactiled.emulator.scene.contact import choose_rung, explain
from tactiled.emulator.scene.description import Scene, load_scene, paper_scenes
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.errors import ConfigError

Progress = Callable[[int, int], None]
# A slide over a plate of one's own takes a dozen; beyond this nobody waits for the board to come up.
_MOST_TABLES = 60
_INSTEAD = (
    "in simulated time periodic plays it (Simulation, bench), in real time a flat plate with contact lumped"
)
# `compliance` takes about as long as it plays (`./run bench contact`); the faster rungs need no such word.
_SLOW = (
    "compliance takes up to 1.1 s of processor for a second of nine sliding taxels, a held object several "
    "times as long: on a slower host the board misses scans (flag overrun) and the scene stands still"
)


def rung_of(scene: Scene) -> str:
    """Name of the contact model that plays a scene."""
    return choose_rung(scene).rung if scene.contact == "auto" else scene.contact


def prepare(scene: Scene, array: Array, progress: Progress | None = None) -> None:
    """Solve all tables that a scene looks into.

    Parameters
    ----------
    scene : Scene
    array : Array
    progress : callable
        Told, before each table that is solved, how many are and how many there will be.

    Raises
    ------
    ConfigError
        No contact model can play the scene, or not in real time: too many tables, or nobody knows which.
    """
    missing = _missing(scene, array)
    for done, solve in enumerate(missing):
        if progress is not None:
            progress(done, len(missing))
        solve()


def explain_in_real_time(scene: Scene, array: Array) -> str:
    """`explain` for a board that plays the scene as it goes: what is solved before, or what comes late.

    Raises
    ------
    ConfigError
        As `prepare`, with what would play the scene instead.
    """
    words = explain(scene)
    rung = rung_of(scene)
    if missing := _missing(scene, array):
        return f"{words}\n  in real time: {len(missing)} tables to solve first, up to a minute each"
    return f"{words}\n  in real time: {_SLOW if rung == 'compliance' else 'as it is'}"


def check_real_time(scene: Scene) -> None:
    """Refuse at once what `prepare` would refuse for any plate.

    Raises
    ------
    ConfigError
        The tables of the scene cannot be known beforehand.
    """
    if rung_of(scene) == "periodic" and scene.held_object is not None:
        fault = "how a held object moves is up to its controller, so its tables cannot be solved beforehand"
        raise ConfigError(
            f"scene {scene.name}", [f"contact: periodic is not for real time here: {fault}; {_INSTEAD}"]
        )


def _missing(scene: Scene, array: Array) -> list[Callable[[], FloatArray]]:
    """What solves the tables that nobody has solved; `ConfigError` where real time cannot wait for them."""
    if rung_of(scene) != "periodic":
        return []
    check_real_time(scene)
    where = f"scene {scene.name}"
    missing = [solve for key, solve in _wanted(scene, array).items() if not is_solved(key)]
    if len(missing) > _MOST_TABLES:
        fault = f"{len(missing)} tables to solve, up to a minute each, and {_MOST_TABLES} is the most"
        raise ConfigError(where, [f"contact: periodic is not for real time here: {fault}; {_INSTEAD}"])
    return missing


def _wanted(scene: Scene, array: Array) -> dict[str, Callable[[], FloatArray]]:
    """Tables of a scene that nobody moves, found by its onsets alone."""
    rungs: list[Foresight] = []

    def build(surface: Surface, azimuth_deg: FloatArray, n_taxels: int) -> Rung:
        rungs.append(Foresight(surface, azimuth_deg, n_taxels, readout=scene.readout))
        return rungs[-1]

    PhysicalContact(SceneMotion(scene), array, build, STEP_S, "periodic").play_until(scene.duration_s)
    return {key: solve for rung in rungs for key, solve in rung.wanted.items()}


def _write_shipped() -> None:
    SHIPPED.unlink(missing_ok=True)
    grooved = [scene for name, scene in paper_scenes().items() if "-d" in name]
    for scene in [load_scene("demo"), *(s.with_changes(contact="periodic") for s in grooved)]:
        prepare(scene, load_array(scene.array))
        print(f"{scene.name}: {len(solved_tables())} tables", file=sys.stderr)
    write_tables(SHIPPED, solved_tables())


if __name__ == "__main__":
    _write_shipped()
