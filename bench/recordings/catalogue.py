"""Sources of the catalogue: where they are, what is asked of them, and their array files."""

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from tactiled import tomlfile
from tactiled.array import Array, ArrayFile, build

Question = Literal[
    "period", "slip", "gross slip", "p of sliding", "force", "poses", "contact", "touch", "loss"
]
_FILE = Path(__file__).with_name("catalogue.toml")


@dataclass(frozen=True)
class Source:
    """One source."""

    name: str
    # address, commit, licence: repository, its version, and the licence that it states
    address: str
    commit: str
    files: list[str]  # folders that are read
    licence: str
    sensor: str
    labels: str
    asked: dict[Question, str]  # questions, and the simple rule that stands beside the daemon in each
    chosen: str  # constants of the daemon that were chosen on this source; empty for none
    array_file: dict[str, Any]  # array file, as a user writes it
    # Squared growths of load that moves from which an onset is told: each object is judged with the one that
    # is best on the others. Without any, all are judged with the one that ships.
    growths: list[float] = field(default_factory=list)

    @property
    def folder(self) -> str:
        """Name of the folder of its checkout."""
        return self.address.rsplit("/", 1)[-1]

    @property
    def array(self) -> Array:
        """The array of its logs."""
        return build(tomlfile.parse(self.array_file, ArrayFile, f"catalogue, {self.name}"))

    def is_in(self, data: Path) -> bool:
        """Return True where a folder has its files."""
        return all((data / self.folder / files).is_dir() for files in self.files)


def how_to_get(wanted: Iterable[Source]) -> list[str]:
    """Return commands that make the checkouts of sources, in the folder of the data."""
    files: dict[tuple[str, str, str], list[str]] = {}
    for source in wanted:
        files.setdefault((source.address, source.folder, source.commit), []).extend(source.files)
    return [
        f"git clone --filter=blob:none --no-checkout {address} && "
        f"git -C {folder} checkout {commit} -- {' '.join(dict.fromkeys(own))}"
        for (address, folder, commit), own in files.items()
    ]


def sources() -> list[Source]:
    """Read the catalogue."""
    found = []
    for table in tomllib.loads(_FILE.read_text())["source"]:
        chosen, array = table.pop("set"), table.pop("array")
        found.append(Source(**table, chosen=chosen, array_file=array))
    return found
