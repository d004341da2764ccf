"""Scenes by name: shipped, from a file, or of a random family."""

import re

from tactiled import resources
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.families import FAMILIES
from tactiled.errors import ConfigError

_NUMBERED = re.compile(r"(?P<family>[a-z-]+)-(?P<seed>\d{1,9})")


def scene_names() -> dict[str, list[str]]:
    """Names that `named_scene` knows, by kind."""
    return {
        "shipped": resources.shipped_names("config/scenes"),
        "family": [f"{name}-SEED" for name in FAMILIES],
    }


def named_scene(name: str) -> Scene:
    """Find a scene by name; `ConfigError` if there is none, or its file has faults.

    It is shipped (``demo``), a TOML file (``my/scene.toml``), or of a family with a seed (``stick-slip-7``).
    """
    if resources.is_name(name) and name not in resources.shipped_names("config/scenes"):
        found = _NUMBERED.fullmatch(name)
        if found and found["family"] in FAMILIES:
            return FAMILIES[found["family"]](int(found["seed"]))
        kinds = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in scene_names().items())
        raise ConfigError("--scene", [f"no scene {name!r}; there are: {kinds}; or give a TOML file"])
    return load_scene(name)
