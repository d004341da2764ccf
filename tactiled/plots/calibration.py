"""Picture of a calibration: reference, differences in the folds, and stated intervals."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tactiled.array import FloatArray
from tactiled.force.calibration import AXES
from tactiled.plots import save

_Z90 = 1.645


def draw_calibration(
    path: Path,
    time_s: FloatArray,
    reference: FloatArray,
    left_out: FloatArray,
    sd: FloatArray,
    used: list[int],
    name: str,
) -> None:
    """Write a picture: on the left the reference (n, 6) and the model, on the right their difference.

    `left_out` (n, 6) is reference minus model where a segment was left out of the fit, `sd` (n, 3) what is
    stated, `used` the columns that the reference has.
    """
    axes_used = [axis for axis in range(3) if axis in used]
    figure = Figure(figsize=(11, 2.4 * len(axes_used) + 0.6), layout="constrained")
    grid = figure.subplots(len(axes_used), 2, squeeze=False, width_ratios=(1.6, 1.0))
    figure.suptitle(f"calibration {name}: each segment is predicted by a fit to the others")
    for (left, right), axis in zip(grid, axes_used, strict=True):
        model = reference[:, axis] - left_out[:, axis]
        left.plot(time_s, reference[:, axis], color="0.6", lw=2.5, label="reference")
        left.plot(time_s, model, color="C0", lw=0.8, label="model")
        left.set_ylabel(f"{AXES[axis]} (N)")
        left.legend(loc="upper right", fontsize=8)
        order = np.argsort(reference[:, axis])
        force = reference[order, axis]
        right.plot(force, 1e3 * left_out[order, axis], ".", ms=2, color="C0")
        # Intervals depend on more than the force: their median over neighbouring forces is drawn.
        width = max(len(force) // 40, 1)
        parts = np.array_split(np.arange(len(force)), max(len(force) // width, 1))
        middle = np.array([force[p].mean() for p in parts])
        band = 1e3 * _Z90 * np.array([np.median(sd[order][p, axis]) for p in parts])
        right.fill_between(middle, -band, band, color="C1", alpha=0.25, label="stated 90 % interval")
        right.set_xlabel(f"{AXES[axis]} of the reference (N)")
        right.set_ylabel("difference (mN)")
        right.legend(loc="upper right", fontsize=8)
    grid[-1][0].set_xlabel("time (s)")
    save(figure, path)
