"""Pairs of gratings with nearly equal phases at all taxels of an array, from its geometry alone.

Two plane waves cannot be distinguished where their phase difference is the same at every taxel, up to whole
turns n. The phase difference at place r is ``dk . r``, where dk is the difference of the wave vectors. For
each set of integers n, linear least squares gives the dk whose ``dk . r`` is nearest to ``2 pi n`` plus a
constant. The result is a list of dk with their residuals, rms over taxels, which holds for every wave.

Where the motion is known, the frequency fixes the component of k along it, and dk is across it.
"""

from dataclasses import dataclass

import numpy as np

from tactiled.array import Array, FloatArray

_STEP_TURNS = 0.25  # over the array, from one dk to the next: fine enough to meet every set of integers
_RESULTANT = 0.9  # mean length of the phase vectors on that grid above which a fit is tried
_SAME_PER_MM = 1e-6  # radians per millimetre: a smaller dk is zero


@dataclass(frozen=True, eq=False)
class Rivals:
    """Differences of wave vectors that hardly change the phases; each stands for its negative too.

    Attributes
    ----------
    per_mm : (n, 2) float64
        Differences dk in radians per millimetre, shortest first.
    apart_rad : (n,) float64
        Phase difference, rms over taxels.
    """

    per_mm: FloatArray
    apart_rad: FloatArray


def rivals(array: Array, finest_mm: float, alike_rad: float, across_deg: float | None = None) -> Rivals:
    """Find all dk between allowed waves whose phases differ by at most `alike_rad`.

    Parameters
    ----------
    finest_mm : float
        Finest allowed period; wave vectors differ by at most ``4 pi / finest_mm``.
    alike_rad : float
        Largest phase difference, rms over taxels.
    across_deg : float, optional
        Direction across a known motion; left out, the motion is unknown.
    """
    places = np.stack([array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()], axis=1)
    reach = 4 * np.pi / finest_mm
    across = np.radians(0.0 if across_deg is None else across_deg)
    axes = np.array([[np.cos(across), np.sin(across)], [-np.sin(across), np.cos(across)]])
    axes = axes[: 2 if across_deg is None else 1]
    seen = places @ axes.T
    steps = 2 * np.pi * _STEP_TURNS / np.maximum(np.ptp(seen, axis=0), finest_mm)
    lines = [np.arange(-np.ceil(reach / step), np.ceil(reach / step) + 1) * step for step in steps]
    lines[0] = lines[0][lines[0] >= 0]  # one of dk and -dk
    tried = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(axes))
    phase = tried @ seen.T
    total = np.exp(1j * phase).mean(axis=1)
    near = np.abs(total) > _RESULTANT
    turns = np.round((phase[near] - np.angle(total[near])[:, None]) / (2 * np.pi))
    turns -= turns[:, :1]
    turns = np.unique(turns[turns.any(axis=1)], axis=0)  # equal integers mean the same wave
    basis = np.column_stack([seen, np.ones(len(seen))])
    solved = 2 * np.pi * turns @ np.linalg.pinv(basis).T
    apart = np.sqrt(((2 * np.pi * turns - solved @ basis.T) ** 2).mean(axis=1))
    per_mm = solved[:, : len(axes)] @ axes
    size = np.hypot(per_mm[:, 0], per_mm[:, 1])
    kept = np.flatnonzero((apart <= alike_rad) & (size <= reach) & (size > _SAME_PER_MM))
    kept = kept[np.argsort(size[kept], kind="stable")]
    return Rivals(per_mm[kept], apart[kept])
