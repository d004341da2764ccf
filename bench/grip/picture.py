"""Picture of ``./run bench grip``: reliability, utilisation told over true, and one slip."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.grip.score import GripRecord, forecast
from tactiled.detect.grip.model import HORIZONS_S


def draw_grip(path: Path, told: Sequence[GripRecord]) -> None:
    """Write the picture."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(2, 2)
    _draw_reliability(axes[0, 0], told)
    _draw_margins(axes[0, 1], told)
    slips = [t for t in told if t.world.slips and len(t.time_s) and t.time_s[0] < t.first_gross_s - 1.5]
    for axis, hand in zip(axes[1], ("ease", "pull"), strict=True):
        chosen = [t for t in slips if t.world.hand == hand]
        if chosen:
            _draw_slip(axis, chosen[0])
    figure.savefig(path, dpi=110)


def _draw_reliability(axes: Axes, told: Sequence[GripRecord]) -> None:
    for k, horizon_s in enumerate(HORIZONS_S):
        found = forecast(told, k)
        known = found.time_s > 0.2
        axes.plot(found.said[known], found.seen[known], "o-", label=f"{1000 * horizon_s:.0f} ms")
    axes.plot([0, 1], [0, 1], "k:", lw=1)
    axes.set(xlabel="probability of gross slip, told", ylabel="share that slipped", xlim=(0, 1), ylim=(0, 1))
    axes.set_title("Calibration")
    axes.legend(fontsize=8)


def _draw_margins(axes: Axes, told: Sequence[GripRecord]) -> None:
    picks = [t for t in told if len(t.time_s)]
    true = np.concatenate([t.utilisation[:: max(1, round(t.world.rate_hz / 5))] for t in picks])
    said = np.concatenate([t.quantiles[:: max(1, round(t.world.rate_hz / 5)), 1] for t in picks])
    axes.plot(true, said, ".", ms=2, alpha=0.4)
    axes.plot([0, 1], [0, 1], "k:", lw=1)
    axes.set(xlabel="utilisation, true", ylabel="median told", xlim=(0, 1), ylim=(0, 1))
    axes.set_title("Utilisation, five scans of each second")


def _draw_slip(axes: Axes, told: GripRecord) -> None:
    world = told.world
    axes.fill_between(
        told.time_s, told.quantiles[:, 0], told.quantiles[:, 2], alpha=0.3, label="5 to 95 % told"
    )
    axes.plot(told.time_s, told.quantiles[:, 1], lw=1, label="median told")
    axes.plot(told.time_s, told.utilisation, "k", lw=1, label="true")
    axes.plot(told.time_s, told.p_gross[:, 2], "r", lw=1, label="p_gross_300ms")
    axes.axvline(told.first_gross_s, color="k", ls=":", lw=1)
    axes.set(xlim=(told.first_gross_s - 2.5, told.first_gross_s + 0.7), ylim=(0, 1.02), xlabel="time (s)")
    axes.set_title(f"{world.hand}, {world.law}, {world.noise_mv:.1f} mV of noise (seed {world.seed})")
    axes.legend(fontsize=8, loc="upper left")
