"""When a response began to grow: the mean and width of its posterior, over instant and shape.

A skin that is dragged at once, or a load that grows evenly, makes a ramp; one that gathers speed, or a pull
that swells, begins as some power of the time since. Each instant and power is one least-squares fit with a
free level and size; in white noise the likelihood of both is ``exp(-residual / (2 variance))`` (Kay,
Fundamentals of Statistical Signal Processing I, 1993, section 7.5). A swelling load is over the noise long
after it began, and only its shape tells when that was; so shapes are averaged over, not chosen.

"Began to grow" is itself a span, from the first growth to a load that anyone would call one: on a swelling
load tens of milliseconds. The instant stated is its middle, and half of it is part of the sigma.
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray

# Powers of the time since, evenly in their logarithm. Below 1 is what Mindlin's curve makes of a drag; beyond
# 3 a beginning is flat for most of its time, and no reading tells it.
_POWERS = 2.0 ** np.linspace(-0.5, 1.5, 17)
# Before any reading a growth that is even is likeliest: a normal curve, an octave of the power wide.
_BEFOREHAND = np.exp(-(np.log2(_POWERS[:, np.newaxis]) ** 2) / 2)
_LATEST = 0.05  # scans ago: a rise that one scan shows may have begun just before it
_LEVEL_SCANS = 8  # before the earliest instant that is tried
_INSTANTS = 64  # tried over all that is searched, and again where the likelihood is
_FINEST_STEP = 0.125  # scans between them
_UNLIKELY = 1e-4  # of the best: instants that are not tried again
# What real beginnings differ from all powers, in scans: no fit to the few readings of a jolt shows it.
_SHAPE_SD = 0.15
# Of the variance of the span's half: of tuning scenes, whose loads reach from jolts to swells, two thirds
# then lie within one sigma.
_SPAN = 0.8
_PARAMETERS = 4  # of a fit: level, size, instant, power


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
        How far it has risen when anyone would call it begun.
    """
    latest = float(max(2, min(longest, len(course) - _LEVEL_SCANS)))
    centred = course - course.mean()
    delays = np.linspace(_LATEST, latest, _INSTANTS)
    likely = np.flatnonzero(_likelihood(centred, delays, noise)[0].max(axis=0) > _UNLIKELY)
    first, last = max(likely[0] - 2, 0), min(likely[-1] + 2, _INSTANTS - 1)
    span = float(delays[last] - delays[first])
    delays = np.linspace(delays[first], delays[last], min(_INSTANTS, 2 + int(span / _FINEST_STEP)))
    likelihood, sizes = _likelihood(centred, delays, noise)
    weights = likelihood * _BEFOREHAND
    weights /= weights.sum()
    since = (np.maximum(least / np.maximum(sizes, 1e-12), 0.0)) ** (1 / _POWERS[:, np.newaxis])
    unseen = np.minimum(since, delays) / 2
    instants = delays - unseen
    mean = float((weights * instants).sum())
    variance = float((weights * ((instants - mean) ** 2 + _SPAN * unseen**2)).sum())
    step = span / (len(delays) - 1)
    sd = np.sqrt(variance + step**2 / 12 + _SHAPE_SD**2)
    return Kink(mean, float(sd))


def _likelihood(centred: FloatArray, delays: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    """Of each power and delay, over the best; and the size of the rise, a power of scans (powers, delays).

    A fall explains nothing.
    """
    n = len(centred)
    since = np.maximum(np.arange(n) - (n - 1 - delays[:, np.newaxis]), 0.0)
    explained, sizes = np.empty((2, len(_POWERS), len(delays)))
    for k, power in enumerate(_POWERS):
        shapes = since**power
        shapes -= shapes.mean(axis=1, keepdims=True)
        overlap, energy = np.maximum(shapes @ centred, 0.0), np.maximum((shapes**2).sum(axis=1), 1e-12)
        explained[k], sizes[k] = overlap**2 / energy, overlap / energy
    total = float(centred @ centred)
    best = float(explained.max())
    # Where no shape fits, what is left is no white noise, but its size bounds what can be told.
    variance = max(noise**2, (total - best) / max(n - _PARAMETERS, 1), 1e-12 * total, 1e-12)
    return np.exp((explained - best) / (2 * variance)), sizes
