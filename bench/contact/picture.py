"""Picture of ``./run bench contact``: error against cost, and left and right over grooves."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.contact.score import AREA, NEEDS, ModelScore, replay
from tools.fem.reference import load_reference

_MARKS = {"absolute-force": "o", "left-right": "s", "tangential-force": "^", "incipient-slip": "D"}


def draw_contact(path: Path, scores: Mapping[str, ModelScore], plates: Sequence[str]) -> None:
    """Write the picture; `plates` are groove runs of the coarse mesh."""
    lines = -(-len(plates) // 2)
    figure = Figure(figsize=(11, 4 + 2.4 * lines), layout="constrained")
    grid = figure.add_gridspec(1 + lines, 2, height_ratios=[4, *[2.4] * lines])
    _draw_costs(figure.add_subplot(grid[0, :]), scores)
    for k, plate in enumerate(plates):
        axes = figure.add_subplot(grid[1 + k // 2, k % 2])
        _draw_plate(axes, plate)
        if k == 0:
            axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def _draw_costs(axes: Axes, scores: Mapping[str, ModelScore]) -> None:
    for need, mark in _MARKS.items():
        cost = [score.cost_ms for score in scores.values()]
        axes.plot(cost, [100 * score.flat[need] for score in scores.values()], mark, label=NEEDS[need])
    highest = {score.name: 100 * max(score.flat[need] for need in _MARKS) for score in scores.values()}
    for name, top in highest.items():
        place = (scores[name].cost_ms, top)
        axes.annotate(name, place, textcoords="offset points", xytext=(0, 6), ha="center")
    axes.set(xscale="log", xlabel="processor time of a simulated second of nine taxels (ms)")
    axes.set(ylim=(0, 1.2 * max(highest.values())), ylabel="error (%)")
    axes.set_title("Contact models against finite elements, flat plates")
    axes.margins(x=0.12)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _draw_plate(axes: Axes, plate: str) -> None:
    reference = load_reference("coarse", plate)
    travel_mm, true_n = reference.columns["travel_x_mm"], reference.sides(AREA)
    own_n = replay("compliance", reference)["side_n"]
    for side, name, colour in ((0, "left", "#c0392b"), (2, "right", "#1f4e79")):
        axes.plot(
            travel_mm, true_n[:, side], color=colour, lw=2.5, alpha=0.4, label=f"{name}, finite elements"
        )
        axes.plot(travel_mm, own_n[:, side], color=colour, label=f"{name}, compliance")
    period, angle = plate.split("-")[1:]
    axes.set(xlabel="travel (mm)", ylabel="force (N)", title=f"grooves of {period} mm at {angle} degrees")
