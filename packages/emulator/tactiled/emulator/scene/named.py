"""Scenes by name: shipped, from a file, or a random grasp."""

import re

from tactiled import resources
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.families.holding import hold
from tactiled.errors import ConfigError

_GRASP = re.compile(r"hold-(?P<seed>\d{1,9})")


def scene_names() -> list[str]:
    """Names that `named_scene` knows."""
    return [*resources.shipped_names("config/scenes"), "hold-SEED"]


def named_scene(name: str) -> Scene:
    """Find a scene by name; `ConfigError` if there is none, or its file has faults.

    It is shipped (``demo``), a TOML file (``my/scene.toml``), or a random grasp (``hold-7``).
    """
    if resources.is_name(name) and name not in resources.shipped_names("config/scenes"):
        if grasp := _GRASP.fullmatch(name):
            return hold(int(grasp["seed"]))
        names = ", ".join(scene_names())
        raise ConfigError("--scene", [f"no scene {name!r}; there are: {names}; or give a TOML file"])
    return load_scene(name)
