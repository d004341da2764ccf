"""Finite-element runs as data: `config/contact/fem-<mesh>-<run>.json`, readable without felupe.

Each file: ``provenance`` (surface, mesh, materials, versions, command, convergence) and ``columns`` of
numbers, one entry an increment. Forces are those on the skin, N; sides come in the order of `readout.SIDES`;
forces on a part are negative where the bonded chip is pulled (no contact sensor shows that: clamp at zero).
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Surface
from tactiled.errors import DataError
from tactiled.resources import shipped

COLUMNS = (
    "travel_x_mm",
    "travel_y_mm",
    "normal_n",
    "tangential_x_n",
    "tangential_y_n",
    *(f"half_{k}_n" for k in range(4)),
    *(f"edge_{k}_n" for k in range(4)),
    "centre_n",
    "approach_mm",  # since first touch, of a ridge where there are grooves
    "contact_mm2",
    "slipping",
    "continued_rubber",  # share of the material's points that are beyond its stable range
    "continued_rtv",
    "continued_pdms",
)


@dataclass(frozen=True, eq=False)
class ReferenceRun:
    """One run: its plate, where it came from, and `columns` by the names in `COLUMNS`, each (i,)."""

    surface: Surface
    provenance: dict[str, Any]
    columns: dict[str, FloatArray]

    def sides(self, area: str = "half") -> FloatArray:
        """Forces on the four sides (i, 4), order `readout.SIDES`; area "half" or "edge"."""
        return np.stack([self.columns[f"{area}_{k}_n"] for k in range(4)], axis=1)


def reference_path(mesh: str, run: str) -> Path:
    """Path of the file of a run."""
    return shipped("config", "contact", f"fem-{mesh}-{run}.json")


def reference_names(mesh: str) -> list[str]:
    """Runs that are shipped for a mesh, sorted."""
    head = f"fem-{mesh}-"
    return sorted(path.stem.removeprefix(head) for path in shipped("config", "contact").glob(f"{head}*.json"))


def load_reference(mesh: str, run: str) -> ReferenceRun:
    """Read a shipped run.

    Raises
    ------
    DataError
        There is no such run; names those that are.
    """
    path = reference_path(mesh, run)
    if not path.exists():
        raise DataError(f"no finite-element run {run!r} on mesh {mesh!r}; there are: {reference_names(mesh)}")
    document = json.loads(path.read_text(encoding="utf-8"))
    provenance = document["provenance"]
    columns = {name: np.array(values, dtype=np.float64) for name, values in document["columns"].items()}
    return ReferenceRun(Surface(**provenance["surface"]), provenance, columns)


def write_reference(path: Path, provenance: dict[str, Any], rows: Sequence[Sequence[float]]) -> None:
    """Write a run, six digits a number: two more than the solver's tolerance leaves."""
    lines = ",\n".join(
        f'  "{name}": {json.dumps([float(f"{row[k]:.6g}") for row in rows])}'
        for k, name in enumerate(COLUMNS)
    )
    head = json.dumps(provenance, indent=1)
    path.write_text(f'{{"provenance": {head},\n"columns": {{\n{lines}\n}}}}\n', encoding="utf-8")
