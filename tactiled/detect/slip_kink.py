"""When a response began to grow: maximum likelihood over the instant and two shapes.

A skin that is dragged at once, or a load that grows evenly, makes a ramp; one that gathers speed, or a pull
that swells, begins as a parabola. Each instant and shape is one least-squares fit with a free level and size;
the best has the smallest residual (Kay, Fundamentals of Statistical Signal Processing I, 1993, section 7.5).
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray

_SHAPES = (1, 2)
_LEVEL_SCANS = 8  # before the earliest instant that is tried
# Scans between the instants that are tried: two or three scans of a ramp tell its shape from a parabola's
# only when neither is rounded to whole scans. And how many there are at most.
_FINEST_STEP, _MOST_STEPS = 0.25, 256
_SCAN_SD = 1 / np.sqrt(12)  # an instant between two scans
# What real beginnings differ from both shapes: part of the time since. Set where 68 % of onsets on physical
# scenes (emulator/families, seeds 0 to 11) lie within one sigma.
# The likelihood's width is that of a known shape; with the shape chosen by the same data it is wider.
_UNKNOWN_SHAPE = 1.5
_SHAPE_SD_PART = 0.02


class Kink(NamedTuple):
    """How far back from the newest scan, in scans."""

    delay_scans: float
    sd_scans: float


def find_kink(course: FloatArray, longest: int, noise: float, least: float = 0.0) -> Kink:
    """Where a response began to rise.

    Parameters
    ----------
    course : (n,) float64
        The response, newest last; at least four scans.
    longest : int
        Delay, in scans, beyond which it is not looked for.
    noise : float
        Standard deviation of the response.
    least : float
        How far it must have risen to have begun: less is nobody's load.
    """
    n = len(course)
    latest = max(2, min(longest, n - _LEVEL_SCANS))
    step = max(_FINEST_STEP, latest / _MOST_STEPS)
    delays = np.arange(1.0, latest + step, step)
    since = np.maximum(np.arange(n) - (n - 1 - delays[:, np.newaxis]), 0.0)
    centred = course - course.mean()
    sizes = np.stack([_size(since**power, centred) for power in _SHAPES])  # (shapes, 2, delays)
    explained = sizes[:, 0]
    shape, best = np.unravel_index(int(np.argmax(explained)), explained.shape)
    row = explained[shape]
    left = float(centred @ centred) - float(row[best])
    variance = max(noise**2, left / max(n - 3, 1))
    delay, sd = float(delays[best]), latest / 8
    if 0 < best < len(delays) - 1:
        bend = float(2 * row[best] - row[best - 1] - row[best + 1])
        if bend > 0:
            delay += step * float(row[best + 1] - row[best - 1]) / (2 * bend)
            # The log likelihood is `explained / (2 variance)`; its curvature is the information.
            sd = min(_UNKNOWN_SHAPE * step * float(np.sqrt(2 * variance / bend)), latest / 2)
    size = float(sizes[shape, 1, best])
    unseen = (least / size) ** (1 / _SHAPES[shape]) if size > 0 else 0.0
    delay = max(delay - unseen, 0.0)
    return Kink(delay, float(np.sqrt(sd**2 + _SCAN_SD**2 + (_SHAPE_SD_PART * delay) ** 2)))


def _size(shapes: FloatArray, centred: FloatArray) -> FloatArray:
    """Of a rise of each shape (shapes, n): the sum of squares that it takes away, and its size (2, shapes).

    A fall takes nothing away.
    """
    shapes = shapes - shapes.mean(axis=1, keepdims=True)
    overlap, energy = np.maximum(shapes @ centred, 0.0), (shapes**2).sum(axis=1)
    return np.stack([overlap**2 / energy, overlap / energy])
