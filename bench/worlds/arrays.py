"""Square arrays of taxels, each with a load and two shears, and the places of their taxels."""

import functools
from typing import Any, Literal

import numpy as np

from tactiled.array import Array, ArrayFile, FloatArray, Grid, TaxelChannel, build

_CHANNELS = {
    "xyz": [TaxelChannel(name=f"F{kind}", kind=kind) for kind in ("shear_x", "shear_y", "normal")],
    "sides": [
        TaxelChannel(name=f"R{k + 1}", kind="side", azimuth_deg=(180.0 + 90 * k) % 360) for k in range(4)
    ],
}


@functools.cache
def square_array(kind: Literal["xyz", "sides"], side: int, pitch_mm: float, **fields: Any) -> Array:
    """Array of channels for two shears and a load, or for four sides; `fields` are those of its file."""
    places_mm = [pitch_mm * (k - (side - 1) / 2) for k in range(side)]
    grid = Grid(x_mm=places_mm, y_mm=places_mm)
    name = f"{kind}-{side}x{side}"
    return build(ArrayFile(name=name, grids=[grid], taxel_channels=_CHANNELS[kind], **fields))


def places_mm(side: int, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return x and y (taxels,) of a square of taxels about its middle."""
    line = pitch_mm * (np.arange(side) - (side - 1) / 2)
    x, y = np.meshgrid(line, line)
    return x.ravel(), y.ravel()
