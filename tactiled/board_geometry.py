"""Description of an array for viewers: places of taxels, and weights from channels to load and shear."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from tactiled import resources
from tactiled.array import Array, load_array
from tactiled.errors import TactiledError

_DESCRIBING = ("array_id", "channels", "taxels", "x_mm", "y_mm", "channel_names")  # an array, in a message
_CHANNEL_NAME = re.compile(r"t(\d+)\.")


def geometry_of(info: Mapping[str, Any], override: Array | None = None) -> dict[str, Any]:
    """Return what a viewer must know to draw readings of a board.

    Parameters
    ----------
    info : mapping
        Message of the topic `info`. Its `array_id` names an array that ships with tactiled; of another array
        only places and taxels are known, so that no shear can be drawn.
    override : Array, optional
        Array from a file of the user, used where it has as many channels as the board.

    Returns
    -------
    dict
        Among others `pressure`, `shear_x`, `shear_y`: for each taxel a list of ``[channel, weight]``; and
        `words` on what is not known, empty where everything is.
    """
    n_channels = int(info.get("channels", 0))
    array = override if override is not None and override.n_channels == n_channels else None
    if array is None:
        array = _shipped(str(info.get("array_id", "")), n_channels)
    return _from_info(info) if array is None else _from_array(array)


def same_array(info: Mapping[str, Any], other: Mapping[str, Any] | None) -> bool:
    """Return True where two messages of the topic `info` describe one array, with the same geometry."""
    return other is not None and all(info.get(name) == other.get(name) for name in _DESCRIBING)


def _shipped(array_id: str, n_channels: int) -> Array | None:
    if array_id not in resources.shipped_names("config/arrays"):
        return None
    try:
        array = load_array(array_id)
    except TactiledError:
        return None
    return array if array.n_channels == n_channels else None


def _from_array(array: Array) -> dict[str, Any]:
    shear_x, shear_y = array.shear_weights()
    return {
        "array": array.name,
        "x_mm": array.x_mm.tolist(),
        "y_mm": array.y_mm.tolist(),
        "has_places": array.has_places,
        "has_shear": array.has_shear,
        "taxel_of_channel": array.channel_taxel.tolist(),
        "names": list(array.channel_name),
        "unit": array.unit,
        "low": array.low,
        "high": array.high,
        "pressure": _sparse(array.normal_weights()),
        "shear_x": _sparse(shear_x),
        "shear_y": _sparse(shear_y),
        "words": "",
    }


def _from_info(info: Mapping[str, Any]) -> dict[str, Any]:
    """Describe an array of which only the message is known: pressure is the mean of a taxel's channels."""
    names = [str(name) for name in info.get("channel_names", ())]
    n_taxels = max(1, int(info.get("taxels", 1)))
    found = [_CHANNEL_NAME.match(name) for name in names]
    taxel_of_channel = [min(int(match[1]), n_taxels - 1) if match else 0 for match in found]
    channels_of: list[list[int]] = [[] for _ in range(n_taxels)]
    for channel, taxel in enumerate(taxel_of_channel):
        channels_of[taxel].append(channel)
    x_mm, y_mm = list(info.get("x_mm", ())), list(info.get("y_mm", ()))
    return {
        "array": str(info.get("array_id", "")),
        "x_mm": x_mm,
        "y_mm": y_mm,
        "has_places": len(set(zip(x_mm, y_mm, strict=False))) == n_taxels,
        "has_shear": False,
        "taxel_of_channel": taxel_of_channel,
        "names": names,
        "unit": "V",
        "low": -8.0,
        "high": 8.0,
        "pressure": [[[channel, 1 / len(own)] for channel in own] for own in channels_of],
        "shear_x": [[] for _ in range(n_taxels)],
        "shear_y": [[] for _ in range(n_taxels)],
        "words": f"array {info.get('array_id')!r} does not ship with tactiled: give --array FILE for shear",
    }


def _sparse(weights: np.ndarray[Any, np.dtype[np.float64]]) -> list[list[list[float]]]:
    """Weights that are not zero, as ``[channel, weight]`` for each taxel."""
    return [[[int(c), float(row[c])] for c in np.flatnonzero(row)] for row in weights]
