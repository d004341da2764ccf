"""Picture of ``./run bench contact``: error against cost, and left and right over grooves."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from bench.contact.score import AREA, replay
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.periodic import Periodic
from tools.fem.reference import load_reference

_MARKS = {"absolute-force": "o", "left-right": "s", "tangential-force": "^", "incipient-slip": "D"}
_NAMES = {
    "absolute-force": "load curve",
    "left-right": "left, right",
    "tangential-force": "friction at the knee",
    "incipient-slip": "slipping share",
}


def draw_contact(
    path: Path, scored: Mapping[str, tuple[float, Mapping[str, float]]], plates: Sequence[str]
) -> None:
    """Write the picture.

    Parameters
    ----------
    path : Path
    scored : mapping
        Rung to milliseconds a simulated second and errors by need.
    plates : sequence of str
        Groove runs of the coarse mesh.
    """
    lines = -(-len(plates) // 2)
    figure = Figure(figsize=(11, 4 + 2.2 * lines), layout="constrained")
    parts = figure.subfigures(
        1 + bool(plates), 1, height_ratios=[4, 2.2 * lines][: 1 + bool(plates)], squeeze=False
    )[:, 0]
    rows = [parts[0].subplots()]
    if plates:
        rows += list(parts[1].subplots(lines, 2, squeeze=False).ravel())
    axes = rows[0]
    for number, (need, mark) in enumerate(_MARKS.items()):
        cost = [cost_ms for cost_ms, _ in scored.values()]
        error = [100 * errors[need] for _, errors in scored.values()]
        axes.plot(cost, error, mark, color=f"C{number}", label=_NAMES[need])
    for name, (cost_ms, errors) in scored.items():
        top = 100 * max(errors[need] for need in _MARKS)
        axes.annotate(name, (cost_ms, top), textcoords="offset points", xytext=(0, 6), ha="center")
    highest = 100 * max(errors[need] for _, errors in scored.values() for need in _MARKS)
    axes.set(
        xscale="log", xlabel="ms of processor time a simulated second, 9 taxels", ylim=(0, 1.2 * highest)
    )
    axes.set(ylabel="error, %", title="Rungs against finite elements, flat plates")
    axes.margins(x=0.12)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axes, plate in zip(rows[1:], plates, strict=False):
        reference = load_reference("coarse", plate)
        travel_mm, sides = reference.columns["travel_x_mm"], reference.sides(AREA)
        own = {"compliance": replay(Compliance, reference), "periodic": replay(Periodic, reference)}
        for side, name, colour in ((0, "left", "#c0392b"), (2, "right", "#1f4e79")):
            axes.plot(travel_mm, sides[:, side], color=colour, lw=2.5, alpha=0.4, label=f"{name}, fem")
            axes.plot(
                travel_mm, own["compliance"]["side_n"][:, side], color=colour, label=f"{name}, compliance"
            )
            axes.plot(
                travel_mm, own["periodic"]["side_n"][:, side], ":", color=colour, label=f"{name}, periodic"
            )
        period, angle = plate.split("-")[1:]
        axes.set(xlabel="travel, mm", ylabel="N", title=f"Grooves {period} mm, {angle} degrees")
    for spare in rows[1 + len(plates) :]:
        spare.set_axis_off()
    if plates:
        handles = rows[1].get_legend_handles_labels()
        rows[-1].legend(*handles, loc="center", ncols=2) if len(plates) % 2 else rows[1].legend(*handles)
    figure.savefig(path, dpi=110)
