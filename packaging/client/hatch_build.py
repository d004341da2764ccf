"""Puts the modules of the client, which lie in the checkout above this folder, into the wheel."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ClientModules(BuildHookInterface[Any]):
    """Include `modules` of pyproject.toml; an editable install has the checkout itself on its path."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the files to a build of the given kind."""
        if version != "editable":
            checkout = Path(self.root).parents[1]
            build_data["force_include"] |= {str(checkout / name): name for name in self.config["modules"]}
