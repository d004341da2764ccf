"""Picture of an array: places of its taxels, what each channel measures with which sign, and what follows."""

import textwrap
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Wedge

from tactiled.array import Array, FloatArray
from tactiled.plots import save
from tactiled.plots.palette import CHANNELS, NEUTRAL

_ALONE_MM = 4.0  # distance of taxels assumed for the size of the marks where there is only one
_MOST_NUMBERED = 64  # taxels whose channels are all numbered; more would overlap
_LINE = 124  # characters of the text below the map
_WIDTH_IN, _MAP_IN = 10.0, 6.0
_MARGIN = 0.85  # around the taxels, in their distance


def draw_array(path: Path, array: Array, lines: Sequence[str]) -> None:
    """Write a picture of an array, with lines of text below the map: what the array can measure."""
    x_mm, y_mm = _places(array)
    pitch_mm = _pitch_mm(x_mm, y_mm)
    shape = (np.ptp(y_mm) + 2 * _MARGIN * pitch_mm) / (np.ptp(x_mm) + 2 * _MARGIN * pitch_mm)
    text = "\n".join(line for each in lines for line in textwrap.wrap(each, _LINE, subsequent_indent="    "))
    text_in = 0.19 * (text.count("\n") + 1) + 0.2
    map_in = float(np.clip(_MAP_IN * shape, 2.0, 9.0))
    height_in = map_in + text_in + 1.1
    figure = Figure(figsize=(_WIDTH_IN, height_in))
    axis = figure.add_axes(
        (0.7 / _WIDTH_IN, (text_in + 0.6) / height_in, _MAP_IN / _WIDTH_IN, map_in / height_in)
    )
    # Of a circle's radius, as large as three digits beside a mark allow.
    across_mm = np.ptp(x_mm) + 2 * _MARGIN * pitch_mm
    letters_pt = float(
        np.clip(0.38 * 0.38 * pitch_mm * 72 * min(_MAP_IN, map_in / shape) / across_mm, 3.0, 9.0)
    )
    for taxel in range(array.n_taxels):
        place = float(x_mm[taxel]), float(y_mm[taxel])
        _draw_taxel(axis, array, taxel, place, 0.38 * pitch_mm, letters_pt)
    _draw_pads(axis, array, x_mm, y_mm, pitch_mm)
    axis.set(
        xlim=(x_mm.min() - _MARGIN * pitch_mm, x_mm.max() + _MARGIN * pitch_mm),
        ylim=(y_mm.min() - _MARGIN * pitch_mm, y_mm.max() + _MARGIN * pitch_mm),
    )
    axis.set_aspect("equal")
    if array.has_places:
        axis.set(xlabel="x (mm)", ylabel="y (mm)")
    else:
        axis.set(xticks=[], yticks=[], xlabel="places unknown: taxels in the order of the channels")
    title = array.in_words().split(", no shear")[0]
    figure.text(0.3 / _WIDTH_IN, 1 - 0.3 / height_in, title, fontsize=10.5)
    figure.legend(
        handles=_legend(array), loc="upper left",
        bbox_to_anchor=((_MAP_IN + 0.9) / _WIDTH_IN, 1 - 0.4 / height_in),
        fontsize=9, frameon=False, title="channels of a taxel", alignment="left",
    )  # fmt: skip
    figure.text(0.3 / _WIDTH_IN, 0.12 / height_in, text, fontsize=8.5, family="monospace", va="bottom")
    save(figure, path)


def _places(array: Array) -> tuple[FloatArray, FloatArray]:
    """Places of the taxels; a square of rows where they are unknown."""
    if array.has_places:
        return array.x_mm, array.y_mm
    n_columns = int(np.ceil(np.sqrt(array.n_taxels)))
    row, column = np.divmod(np.arange(array.n_taxels), n_columns)
    return column * _ALONE_MM, -row * _ALONE_MM


def _pitch_mm(x_mm: FloatArray, y_mm: FloatArray) -> float:
    """Smallest distance of two taxels."""
    apart_mm = np.hypot(x_mm[:, None] - x_mm, y_mm[:, None] - y_mm)
    apart_mm = apart_mm[apart_mm > 0]
    return float(apart_mm.min()) if apart_mm.size else _ALONE_MM


def _draw_taxel(
    axis: Axes, array: Array, taxel: int, place: tuple[float, float], radius_mm: float, letters_pt: float
) -> None:
    channels = np.flatnonzero(array.channel_taxel == taxel)
    axis.add_patch(Circle(place, radius_mm, fc="white", ec=NEUTRAL, lw=0.8, zorder=2))
    for channel in channels.tolist():
        color = _colors(array)[channel]
        kind, sign = array.channel_kind[channel], array.sign[channel]
        azimuth_deg = float(array.azimuth_deg[channel])
        if kind == "normal":
            axis.add_patch(Circle(place, 0.45 * radius_mm, fc=color, alpha=0.35, lw=0, zorder=3))
            label_at = (place[0], place[1] - 0.72 * radius_mm)
        elif kind == "side":
            axis.add_patch(
                Wedge(
                    place, radius_mm, azimuth_deg - 35, azimuth_deg + 35, width=0.4 * radius_mm,
                    fc=color, alpha=0.6, lw=0, zorder=3,
                )
            )  # fmt: skip
            label_at = _beside(place, azimuth_deg, 0.8 * radius_mm)
        else:
            way_deg = azimuth_deg if sign > 0 else azimuth_deg + 180.0
            axis.annotate(
                "", _beside(place, way_deg, 1.25 * radius_mm), _beside(place, way_deg, 0.5 * radius_mm),
                zorder=4,
                arrowprops={"arrowstyle": "-|>", "color": color, "lw": 1.3, "shrinkA": 0, "shrinkB": 0},
            )  # fmt: skip
            label_at = _beside(place, way_deg + 22, 0.95 * radius_mm)
        if array.n_taxels <= _MOST_NUMBERED:
            falls = "\N{MINUS SIGN}" if sign < 0 and kind in ("normal", "side") else ""
            axis.text(*label_at, f"{falls}{channel}", fontsize=letters_pt, ha="center", va="center", zorder=5)
    axis.text(
        *place, str(taxel), fontsize=letters_pt + 1.5, weight="bold", ha="center", va="center", zorder=6
    )


def _beside(place: tuple[float, float], angle_deg: float, distance_mm: float) -> tuple[float, float]:
    angle = np.radians(angle_deg)
    return place[0] + distance_mm * float(np.cos(angle)), place[1] + distance_mm * float(np.sin(angle))


def _draw_pads(axis: Axes, array: Array, x_mm: FloatArray, y_mm: FloatArray, pitch_mm: float) -> None:
    """Frame each pad where there are several."""
    pads = sorted(set(array.pad.tolist()))
    if len(pads) < 2:
        return
    for pad in pads:
        mine = array.pad == pad
        left, low = x_mm[mine].min() - 0.62 * pitch_mm, y_mm[mine].min() - 0.62 * pitch_mm
        right, high = x_mm[mine].max() + 0.62 * pitch_mm, y_mm[mine].max() + 0.62 * pitch_mm
        axis.plot([left, right, right, left, left], [low, low, high, high, low], ":", color=NEUTRAL, lw=1)
        axis.text(left, high, f" pad {pad}", fontsize=8, va="bottom", color=NEUTRAL)


def _own_name(array: Array, channel: int) -> str:
    return array.channel_name[channel].split(".", 1)[-1]


@lru_cache(maxsize=1)
def _colors(array: Array) -> list[str]:
    """Return the colour of each channel: one for each name."""
    names = [_own_name(array, channel) for channel in range(array.n_channels)]
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return [CHANNELS[number[name] % len(CHANNELS)] for name in names]


def _legend(array: Array) -> list[Line2D]:
    """Return one entry for each name of channels, and for the numbers."""
    entries: dict[str, Line2D] = {}
    for channel in range(array.n_channels):
        name = _own_name(array, channel)
        if name in entries:
            continue
        kind, sign = array.channel_kind[channel], array.sign[channel]
        rises = "rises" if sign > 0 else "falls"
        words = {
            "normal": f"{name}: pressure, {rises} with load",
            "side": f"{name}: side at {array.azimuth_deg[channel]:g}\N{DEGREE SIGN}, {rises} with load",
        }.get(kind, f"{name}: shear, rises with motion\nof the skin along the arrow")
        marker = "o" if kind == "normal" else "s" if kind == "side" else ">"
        entries[name] = Line2D([], [], ls="", marker=marker, color=_colors(array)[channel], label=words)
    numbers = "bold: taxel"
    if array.n_taxels <= _MOST_NUMBERED:
        numbers += "\nsmall: channel, in wire order;\nwith \N{MINUS SIGN}: the reading falls with load"
    return [*entries.values(), Line2D([], [], ls="", label=numbers)]
