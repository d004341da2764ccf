"""Runs of finite elements with friction and finite strain: `config/contact/fem-<mesh>-<run>.json`.

They were made once (research/README.md names the commit that has the program): a taxel is pressed on a plate,
and in all runs but `load` slid over it. Each file has ``provenance`` (surface, mesh, materials, versions,
convergence) and ``columns``, one entry an increment:

``travel_x_mm, travel_y_mm`` place over the plate; ``approach_mm`` since first touch, of a ridge over grooves
``normal_n, tangential_x_n, tangential_y_n`` force on the skin
``half_0_n`` to ``half_3_n``, ``edge_0_n`` to ``edge_3_n``: force on the sides of the chip -x, -y, +x, +y
``centre_n`` force under its middle; ``contact_mm2``; ``slipping``, the share of the contact
``continued_rubber, continued_rtv, continued_pdms`` share of a material beyond its stable range

Forces on a part are negative where the bonded chip is pulled (no contact sensor shows that: clamp at zero).
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactiled.array import FloatArray
from tactiled.emulator.mechanics.base import Surface
from tactiled.errors import DataError
from tactiled.resources import shipped


@dataclass(frozen=True, eq=False)
class ReferenceRun:
    """One run: its plate, where it came from, and the columns above, each (i,)."""

    surface: Surface
    provenance: dict[str, Any]
    columns: dict[str, FloatArray]

    def sides(self, area: str = "half") -> FloatArray:
        """Forces on the four sides (i, 4), order as above; area "half" or "edge"."""
        return np.stack([self.columns[f"{area}_{k}_n"] for k in range(4)], axis=1)


def reference_names(mesh: str) -> list[str]:
    """Runs that are shipped for a mesh, sorted."""
    head = f"fem-{mesh}-"
    return sorted(path.stem.removeprefix(head) for path in shipped("config", "contact").glob(f"{head}*.json"))


def load_reference(mesh: str, run: str) -> ReferenceRun:
    """Read a shipped run; raise DataError, which names those that are there, where there is no such run."""
    path = shipped("config", "contact", f"fem-{mesh}-{run}.json")
    if not path.exists():
        raise DataError(f"no finite-element run {run!r} on mesh {mesh!r}; there are: {reference_names(mesh)}")
    document = json.loads(path.read_text(encoding="utf-8"))
    provenance = document["provenance"]
    columns = {name: np.array(values, dtype=np.float64) for name, values in document["columns"].items()}
    return ReferenceRun(Surface(**provenance["surface"]), provenance, columns)
