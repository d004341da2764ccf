"""Puts the modules of the client into wheel and sdist: from the checkout above, or from the sdist itself."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ClientModules(BuildHookInterface[Any]):
    """Include `modules` of pyproject.toml; an editable install has the checkout itself on its path."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the files to a build of the given kind."""
        if version != "editable":
            root = Path(self.root)
            source = root if (root / "tactiled").is_dir() else root.parents[1]
            build_data["force_include"] |= {str(source / name): name for name in self.config["modules"]}
