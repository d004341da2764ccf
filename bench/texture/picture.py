"""Picture of ``./run bench texture``: where windows are answered, table 2, error against time."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.report import grouped, rms
from bench.texture.tables import TrialSet, by_plate, standing_answers, windows_of
from bench.texture.trials import MIN_PERIODS, QUANTITIES, Quantity, Trial

_COLOURS = {"quick": "#e07b00", "balanced": "#1f4e79", "fine": "#1a7f37"}
_LABELS: dict[Quantity, tuple[str, float]] = {
    "period": ("period: error (um)", 1e3),
    "angle": ("angle: error (deg)", 1.0),
}


def draw_texture(path: Path, trials: Mapping[str, Sequence[Trial]]) -> None:
    """Write the picture from the trials by part of the bench."""
    figure = Figure(figsize=(12, 13), layout="constrained")
    rows = figure.subplots(3, 2)
    for axes, is_known in zip(rows[0], (True, False), strict=True):
        _draw_threshold(axes, trials["grid"], is_known)
    for column, quantity in enumerate(QUANTITIES):
        _draw_plates(rows[1, column], trials["plates"], quantity)
        _draw_curve(rows[2, column], trials["slides"], quantity)
    figure.suptitle("Grooves by the joint estimator")
    figure.savefig(path, dpi=110)


def _draw_threshold(axes: Axes, trials: Sequence[Trial], is_known: bool) -> None:
    """Draw the part of windows answered as colour, error over bound as numbers."""
    mine = [t for t in trials if t.is_speed_known == is_known and t.periods >= MIN_PERIODS]
    windows, snrs = sorted({t.window_s for t in mine}), sorted({t.snr_db for t in mine})
    part = np.full((len(windows), len(snrs)), np.nan)
    for (window_s, snr_db), some in grouped(mine, lambda t: (t.window_s, t.snr_db)).items():
        i, j, found = windows.index(window_s), snrs.index(snr_db), TrialSet(some)
        part[i, j] = len(found.ok) / len(found.all)
        if found.right:
            words = f"{found.over_bound('angle'):.2f}\n{found.over_bound('period'):.2f}"
            axes.text(j, i, words + "!" * (found.n_wrong > 0), ha="center", va="center", fontsize=8)
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
    title = f"speed {known}: part answered (line: 9 of 10);\nerror over bound of angle, period"
    axes.set_title(title, fontsize=10)
    axes.figure.colorbar(image, ax=axes)


def _draw_plates(axes: Axes, trials: Sequence[Trial], quantity: Quantity) -> None:
    label, unit = _LABELS[quantity]
    plates = by_plate(windows_of(trials))
    for mark, method in zip("osD", next(iter(plates.values())), strict=False):
        errors = [unit * methods[method].error(quantity) for methods in plates.values()]
        axes.plot(range(len(plates)), errors, mark, label=method, ms=7)
    axes.set_xticks(range(len(plates)), [f"{mm:g} mm\n{deg}°" for mm, deg in plates], fontsize=8)
    axes.set(yscale="log", ylabel=label)
    axes.set_title("plates of the paper, with physics", fontsize=10)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8)


def _draw_curve(axes: Axes, trials: Sequence[Trial], quantity: Quantity) -> None:
    label, unit = _LABELS[quantity]
    for preset, times in standing_answers(trials).items():
        bound = [unit * rms([t.of(quantity).bound for t in found.all]) for found in times.values()]
        axes.plot(list(times), bound, "--", color=_COLOURS[preset], lw=1, alpha=0.6)
        errors = [unit * found.error(quantity) for found in times.values()]  # NaN before the first answer
        axes.plot(list(times), errors, "o-", color=_COLOURS[preset], ms=4, label=preset)
    axes.plot([], [], "--", color="#777777", label="bound")
    axes.set(xscale="log", yscale="log", xlabel="time since the onset of slip (s)", ylabel=label)
    axes.set_title("error against time, 20 dB, 1.5 mm/s", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
