"""Picture of ``./run bench texture``: where answers are to be had, table 2, error against time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.texture.curve import PRESETS, Slide, points
from bench.texture.grid import MIN_PERIODS, Trial, summary
from bench.texture.paper import Answered

_COLOURS = {"quick": "#e07b00", "balanced": "#1f4e79", "fine": "#1a7f37"}
_MARKS = "osD^v"


def draw_texture(
    path: Path, trials: Sequence[Trial], plates: Sequence[Answered], slides: Sequence[Slide]
) -> None:
    """Write the picture.

    Parameters
    ----------
    trials : sequence of Trial
        Of the joint estimator.
    """
    figure = Figure(figsize=(12, 13), layout="constrained")
    rows = figure.subplots(3, 2)
    for axes, is_known in zip(rows[0], (True, False), strict=True):
        _draw_threshold(axes, trials, is_known)
    _draw_plates(rows[1, 0], plates, 0, "period: error (um)", 1e3)
    _draw_plates(rows[1, 1], plates, 1, "angle: error (deg)", 1.0)
    _draw_curve(rows[2, 0], slides, "period_mm", "period: error (um)", 1e3)
    _draw_curve(rows[2, 1], slides, "angle_deg", "angle: error (deg)", 1.0)
    figure.suptitle("Grooves by the joint estimator")
    figure.savefig(path, dpi=110)


def _draw_threshold(axes: Axes, trials: Sequence[Trial], is_known: bool) -> None:
    """Part of windows answered, as colour; error over bound, as numbers."""
    mine = [t for t in trials if t.is_speed_known == is_known and t.periods >= MIN_PERIODS]
    windows, snrs = sorted({t.window_s for t in mine}), sorted({t.snr_db for t in mine})
    part = np.full((len(windows), len(snrs)), np.nan)
    for i, window_s in enumerate(windows):
        for j, snr_db in enumerate(snrs):
            found = summary([t for t in mine if (t.window_s, t.snr_db) == (window_s, snr_db)])
            part[i, j] = found.ok / found.trials if found.trials else np.nan
            if found.ok > found.wrong:
                words = f"{found.angle:.2f}\n{found.period:.2f}" + "!" * (found.wrong > 0)
                axes.text(j, i, words, ha="center", va="center", fontsize=8)
    image = axes.imshow(part, origin="lower", aspect="auto", cmap="RdYlGn", vmin=0, vmax=1, alpha=0.7)
    is_answered = np.nan_to_num(part) >= 0.9
    for i, j in zip(*np.nonzero(is_answered[:, 1:] != is_answered[:, :-1]), strict=True):
        axes.plot([j + 0.5, j + 0.5], [i - 0.5, i + 0.5], color="black", lw=2)
    for i, j in zip(*np.nonzero(is_answered[1:] != is_answered[:-1]), strict=True):
        axes.plot([j - 0.5, j + 0.5], [i + 0.5, i + 0.5], color="black", lw=2)
    axes.set_xticks(range(len(snrs)), [f"{snr_db:g}" for snr_db in snrs])
    axes.set_yticks(range(len(windows)), [f"{window_s:g}" for window_s in windows])
    axes.set(xlabel="dB a channel", ylabel="window (s)")
    known = "known" if is_known else "unknown"
    axes.set_title(
        f"speed {known}: part answered (line: 9 of 10);\nerror over bound of angle, period", fontsize=10
    )
    axes.figure.colorbar(image, ax=axes)


def _draw_plates(axes: Axes, plates: Sequence[Answered], which: int, label: str, unit: float) -> None:
    names = list(dict.fromkeys(a.plate for a in plates))
    for mark, method in zip(_MARKS, dict.fromkeys(a.method for a in plates), strict=False):
        errors = [a.errors()[which] * unit for a in plates if a.method == method]
        places = [names.index(a.plate) for a in plates if a.method == method]
        axes.plot(places, errors, mark, label=method, ms=7)
    axes.set_xticks(range(len(names)), [f"{p:g} mm\n{a}°" for p, a in names], fontsize=8)
    axes.set(yscale="log", ylabel=label)
    axes.set_title("plates of the paper, with physics", fontsize=10)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8)


def _draw_curve(axes: Axes, slides: Sequence[Slide], what: str, label: str, unit: float) -> None:
    curve = points(slides)
    for preset in PRESETS:
        mine = [p for p in curve if p.preset == preset]
        times_s = [p.time_s for p in mine]
        bound = [unit * getattr(p, what.replace("_", "_bound_")) for p in mine]
        axes.plot(times_s, bound, "--", color=_COLOURS[preset], lw=1, alpha=0.6)
        said = [(p.time_s, unit * getattr(p, what)) for p in mine if p.answered]
        axes.plot(*np.array(said).reshape(-1, 2).T, "o-", color=_COLOURS[preset], ms=4, label=preset)
    axes.plot([], [], "--", color="#777777", label="bound")
    axes.set(xscale="log", yscale="log", xlabel="time since the onset of slip (s)", ylabel=label)
    axes.set_title("error against time, 20 dB, 1.5 mm/s", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
