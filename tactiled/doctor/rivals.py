"""Pairs of gratings that look alike to an array, from its geometry alone.

Two plane waves look alike where their phases differ by the same at every taxel, whole turns n aside. That
depends on the difference dk of their wave vectors alone: over all dk, what is left is least where ``dk . r``
fits ``2 pi n`` best, which is a straight least-squares fit for each set of whole numbers n. So the rivals of
a wave are a list: dk, and how far the phases then differ, rms over taxels.

Where the motion is known, frequency ties the component of k along it, and dk lies across.
"""

from dataclasses import dataclass

import numpy as np

from tactiled.array import Array, FloatArray

_STEP_TURNS = 0.25  # over the array, from one dk to the next: no set of whole numbers is stepped over
_LIKELY = 0.9  # resultant of the phases on that grid where a fit may leave little
_SAME_PER_MM = 1e-6  # rad: two fits that are one


@dataclass(frozen=True, eq=False)
class Rivals:
    """Differences of wave vectors that the array hardly sees; each stands for its opposite too.

    Attributes
    ----------
    per_mm : (n, 2) float64
        dk, radians a millimetre; the first is the least.
    apart_rad : (n,) float64
        By which phases differ, rms over taxels.
    """

    per_mm: FloatArray
    apart_rad: FloatArray


def rivals(array: Array, finest_mm: float, alike_rad: float, across_deg: float | None = None) -> Rivals:
    """All dk between waves of a period or more whose phases differ by no more than `alike_rad`.

    Parameters
    ----------
    array : Array
    finest_mm : float
        Waves of that period differ by 4 pi / `finest_mm` at most.
    alike_rad : float
    across_deg : float, optional
        The motion is known, and this is the direction across it; left out: nothing is known of it.
    """
    places = np.stack([array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()], axis=1)
    reach = 4 * np.pi / finest_mm
    across = np.radians(0.0 if across_deg is None else across_deg)
    axes = np.array([[np.cos(across), np.sin(across)], [-np.sin(across), np.cos(across)]])
    axes = axes[: 2 if across_deg is None else 1]
    seen = places @ axes.T
    steps = 2 * np.pi * _STEP_TURNS / np.maximum(np.ptp(seen, axis=0), finest_mm)
    lines = [np.arange(-np.ceil(reach / step), np.ceil(reach / step) + 1) * step for step in steps]
    lines[0] = lines[0][lines[0] >= 0]  # of dk and its opposite, one
    tried = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(axes))
    phase = tried @ seen.T
    total = np.exp(1j * phase).mean(axis=1)
    near = np.abs(total) > _LIKELY
    turns = np.round((phase[near] - np.angle(total[near])[:, None]) / (2 * np.pi))
    turns -= turns[:, :1]
    turns = np.unique(turns[turns.any(axis=1)], axis=0)  # the same whole number everywhere is the same wave
    basis = np.column_stack([seen, np.ones(len(seen))])
    solved = 2 * np.pi * turns @ np.linalg.pinv(basis).T
    apart = np.sqrt(((2 * np.pi * turns - solved @ basis.T) ** 2).mean(axis=1))
    per_mm = solved[:, : len(axes)] @ axes
    size = np.hypot(per_mm[:, 0], per_mm[:, 1])
    kept = np.flatnonzero((apart <= alike_rad) & (size <= reach) & (size > _SAME_PER_MM))
    kept = kept[np.argsort(size[kept], kind="stable")]
    return Rivals(per_mm[kept], apart[kept])
