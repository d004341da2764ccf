"""Tables of contact model `periodic` as data: `config/contact/periodic.npz`.

``python -m tools.periodic_tables`` solves those of the demo; run it when `mechanics` changes. A key is no
valid file name, so that the file has an array of them.
"""

import numpy as np

from tactiled.emulator.mechanics.periodic import SHIPPED, tables
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.truth import Truth


def write_tables() -> None:
    """Play the demo, and write all tables that it looked up."""
    SHIPPED.unlink(missing_ok=True)
    _ = Truth(load_scene("demo")).contact  # has played the scene to its end
    arrays = {f"table_{k}": rows for k, rows in enumerate(tables().values())}
    np.savez_compressed(SHIPPED, allow_pickle=False, keys=np.array(list(tables())), **arrays)


if __name__ == "__main__":
    write_tables()
