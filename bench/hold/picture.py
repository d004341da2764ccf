"""Picture of ``./run bench hold``: drops over grip of all ways of holding, and three grasps."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.hold.batch import RATE_HZ
from bench.hold.bench import REPORTED_FROM, Arm, dropped, margin_episodes, over_least
from bench.hold.play import Episodes
from bench.hold.result import GraspResult
from tactiled.client.grip_controller import TARGET
from tactiled.emulator.scene.families.holding import hold

_SHOWN = ("jerks", "filling", "easing")
_KINDS = {
    "margin": ("margin, by target", "o-"),
    "oracle": ("oracle, by true utilisation", "*-"),
    "slip events": ("tightened at each slip event", "s-"),
    "slip events, eased": ("the same, eased between", "D"),
    "newtons": ("one grip for all objects", "^-"),
    "times the least": ("times the least (known to nobody)", "x:"),
}


def draw_hold(path: Path, found: Mapping[Arm, Sequence[GraspResult]]) -> None:
    """Write the picture."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(2, 2)
    _draw_trade(axes[0, 0], found)
    seeds = range(REPORTED_FROM, REPORTED_FROM + 40)
    shown = [next(s for s in seeds if hold(s).description == event) for event in _SHOWN]
    episodes = margin_episodes(shown)
    for e, axis in enumerate(axes.ravel()[1:]):
        _draw_grasp(axis, episodes, e)
    figure.savefig(path, dpi=110)


def _draw_trade(axes: Axes, found: Mapping[Arm, Sequence[GraspResult]]) -> None:
    for kind, (label, style) in _KINDS.items():
        some = [(arm, results) for arm, results in found.items() if arm.kind == kind]
        if not some:
            continue
        grip = [over_least(results) for _, results in some]
        axes.plot(grip, [100 * dropped(results) for _, results in some], style, label=label, ms=5)
        for (arm, results), x in zip(some, grip, strict=True):
            if np.isfinite(x):
                axes.annotate(
                    f"{arm.number:g}",
                    (x, 100 * dropped(results)),
                    xytext=(3, 3),
                    textcoords="offset points",
                    fontsize=7,
                )
    axes.axvline(1.4, color="k", ls=":", lw=1)
    axes.axhline(0.5, color="k", ls=":", lw=1)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set(
        xlabel="mean grip over the least that holds", ylabel="dropped (%)", xlim=(1, 7), ylim=(-0.1, 110)
    )
    axes.set_title("Drops over grip (dotted: the aims)")
    axes.legend(fontsize=8)


def _draw_grasp(axes: Axes, episodes: Episodes, e: int) -> None:
    time_s = np.arange(len(episodes.grip_n)) / RATE_HZ
    axes.plot(time_s, episodes.least_n[:, e], "k", lw=1, label="least that holds")
    axes.plot(time_s, episodes.grip_n[:, e], lw=1.5, label=f"grip, target {TARGET:g}")
    axes.plot(time_s, episodes.place_mm[:, e], "r", lw=1, label="slid (mm)")
    axes.set(xlabel="time (s)", ylabel="N", ylim=(0, 1.2 * float(episodes.grip_n[:, e].max())))
    axes.set_title(f"{episodes.scenes[e].name}: {episodes.scenes[e].description}")
    axes.legend(fontsize=8, loc="lower right")
