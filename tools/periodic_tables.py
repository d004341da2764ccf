"""Tables of contact model `periodic` as data: `config/contact/periodic.npz`.

``python -m tools.periodic_tables`` solves those of the demo and of the plates of the paper; run it when
`mechanics` changes. A key is no valid file name, so that the file has an array of them.
"""

import sys

import numpy as np

from tactiled.emulator.mechanics.periodic import SHIPPED, tables
from tactiled.emulator.scene.description import load_scene, paper_scenes
from tactiled.emulator.scene.truth import Truth


def write_tables() -> None:
    """Play the scenes, and write all tables that they looked up."""
    SHIPPED.unlink(missing_ok=True)
    grooved = [scene for name, scene in paper_scenes().items() if "-d" in name]
    for scene in [load_scene("demo"), *(s.with_changes(contact="mechanics") for s in grooved)]:
        _ = Truth(scene).contact  # has played the scene to its end
        print(f"{scene.name}: {len(tables())} tables", file=sys.stderr)
    arrays = {f"table_{k}": rows for k, rows in enumerate(tables().values())}
    np.savez_compressed(SHIPPED, allow_pickle=False, keys=np.array(list(tables())), **arrays)


if __name__ == "__main__":
    write_tables()
