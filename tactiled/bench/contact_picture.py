"""Picture of ``tactiled bench contact``: error against cost, and left and right over grooves."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from tactiled.bench.contact_score import AREA, replay
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.fem.reference import load_reference
from tactiled.emulator.mechanics.periodic import Periodic

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
    figure = Figure(figsize=(10, 4 + 2.2 * len(plates)), layout="constrained")
    rows = figure.subplots(1 + len(plates), 1, height_ratios=[1.6, *[1.0] * len(plates)], squeeze=False)[:, 0]
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
    axes.legend(loc="upper center")
    for axes, plate in zip(rows[1:], plates, strict=True):
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
    if plates:
        rows[1].legend(ncols=2, fontsize="small")
    figure.savefig(path, dpi=110)
