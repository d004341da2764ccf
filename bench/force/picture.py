"""Picture of ``./run bench force``: error against the duration of the calibration, and the bound."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bench.force.score import METHODS, Case, ForceScore

_COLOURS = dict(zip(METHODS, ("C0", "C1", "C2", "C3", "0.5"), strict=True))


def draw_force(path: Path, scores: Sequence[ForceScore], cases: Sequence[Case]) -> None:
    """Write the picture: one panel for normal force, one for shear; points are rigs, lines their rms."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, kind, title in zip(panels, ("normal", "shear"), ("normal force", "shear"), strict=True):
        seconds = np.array([case.seconds for case in cases])
        some = [[one for one in scores if one.case == case] for case in cases]
        for method in METHODS:
            values = [np.array([getattr(one, kind)[method] for one in group]) for group in some]
            rms = [100 * float(np.sqrt(np.mean(v**2))) for v in values]
            axes.plot(seconds, rms, "o-", ms=4, color=_COLOURS[method], label=method)
            if method == "tactiled":
                for at, v in zip(seconds, values, strict=True):
                    axes.plot(np.full(len(v), at), 100 * v, ".", ms=3, color=_COLOURS[method], alpha=0.5)
        bound = [
            100 * float(np.sqrt(np.nanmean([getattr(one, f"bound_{kind}") ** 2 for one in group])))
            for group in some
        ]
        axes.plot(seconds, bound, "k--", lw=1, label="Cramer-Rao bound of the model")
        axes.set(xscale="log", yscale="log", xlabel="calibration (s)", title=f"{title}, rms error over range")
        axes.set_xticks(seconds, [f"{s:g}" for s in seconds])
        axes.minorticks_off()
    panels[0].set_ylabel("% of range")
    panels[1].legend(fontsize=8)
    figure.savefig(path, dpi=110)
