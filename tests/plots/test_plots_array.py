"""Pictures of arrays: every shipped one is drawn, with each channel and sign in its place."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Wedge
from matplotlib.text import Annotation

from tactiled.array import Array, ArrayFile, build, load_array
from tactiled.plots import array_map
from tactiled.resources import shipped_names


def drawn(monkeypatch: pytest.MonkeyPatch, path: Path, array: Array) -> Axes:
    """Axis of the picture that is written."""
    axes: list[Axes] = []
    real = Figure.add_axes

    def add(self: Figure, *args: Any, **kwargs: Any) -> Axes:
        axes.append(real(self, *args, **kwargs))
        return axes[-1]

    monkeypatch.setattr(Figure, "add_axes", add)
    array_map.draw_array(path, array, ["slip: from shear, " * 20])
    return axes[0]


def test_every_shipped_array_is_drawn(tmp_path: Path) -> None:
    for name in shipped_names("config/arrays"):
        array_map.draw_array(tmp_path / f"{name}.png", load_array(name), ["contact: not measured"])
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_names_of_channels_are_compared_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Once for each channel, the picture of 4096 taxels took minutes for its colours."""
    array, names = load_array("xyz-counts-4x4"), []
    of_channel = array_map._own_name  # noqa: SLF001  counted

    def own_name(array: Array, channel: int) -> str:
        names.append(of_channel(array, channel))
        return names[-1]

    monkeypatch.setattr(array_map, "_own_name", own_name)
    array_map.draw_array(tmp_path / "a.png", array, ["contact: not measured"])
    assert len(names) <= 2 * array.n_channels


def test_arrows_point_where_motion_raises_the_reading(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = ArrayFile.model_validate(
        {
            "name": "one",
            "taxels": [{"x_mm": 3.0, "y_mm": 1.0, "axes_deg": 90.0}],
            "taxel_channels": [
                {"name": "X", "kind": "shear_x", "sign": -1},
                {"name": "Y", "kind": "shear_y"},
                {"name": "L", "kind": "side", "azimuth_deg": 0.0},
                {"name": "Z", "kind": "normal", "sign": -1},
            ],
        }
    )
    axis = drawn(monkeypatch, tmp_path / "one.png", build(file))
    arrows = [text for text in axis.texts if isinstance(text, Annotation)]
    ways = [np.subtract(arrow.xy, (3.0, 1.0)) for arrow in arrows]
    assert [np.round(way / np.hypot(*way), 6).tolist() for way in ways] == [[0.0, -1.0], [-1.0, 0.0]]
    (wedge,) = (patch for patch in axis.patches if isinstance(patch, Wedge))
    assert (wedge.theta1, wedge.theta2) == (55.0, 125.0)  # the side at 0 degrees, turned with its pad
    labels = [text.get_text() for text in axis.texts]
    assert "\N{MINUS SIGN}3" in labels
    assert {"0", "1", "2"} <= set(labels)


def test_taxels_at_unknown_places_do_not_lie_on_each_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    axis = drawn(monkeypatch, tmp_path / "skin.svg", load_array("magnetometers-5"))
    places = [text.get_position() for text in axis.texts if text.get_fontweight() == "bold"]
    assert len(set(places)) == 5
    assert "unknown" in axis.get_xlabel()
