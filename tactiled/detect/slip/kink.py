"""Onset of growth of a response: mean and width of its posterior over instant and shape.

A load may grow in proportion to time or to any power of it: a pull swells, a slide accelerates. The skin
responds to a travel x by Mindlin's curve, ``1 - (1 - x / X)^(3/2)`` (J. Appl. Mech. 16, 1949), which is
straight at first and flat when all of the contact slips at X. For each instant, power and X, level and size
are fitted by least squares; the likelihood is ``exp(-residual / (2 variance))`` (Kay, Fundamentals of
Statistical Signal Processing I, 1993, section 7.5). Shapes are averaged over, not chosen.

Real skins differ from these curves: taxels under unequal loads bend gradually, the voltage divider bends the
curve, and a held object rings. The difference is modelled as a part of the rise that adds to the noise, so
that readings near the onset have more weight than those far above it.

The onset is where the growth becomes larger than zero in the fitted curve. A load that swells from zero has
no earlier beginning that a reading could show.
"""

from typing import NamedTuple

import numpy as np

from tactiled.array import FloatArray

# Of the time since. Below 1 is what unequal taxels make of a drag; a beginning of more than 3 is flat for
# most of its time, and no reading tells it.
_POWERS = 2.0 ** np.linspace(-0.25, 1.5, 8)
# Before any reading a growth that is even is likeliest: a normal curve, an octave of the power wide.
_BEFOREHAND = np.exp(-(np.log2(_POWERS[:, np.newaxis, np.newaxis]) ** 2) / 2)
# When all slips, in times since the beginning: from where nothing of it is to be seen, to long ago.
_ALL_SLIPS = np.array([100.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.125, 0.03])
# Part of the rise that readings differ from the shape by. On seeds 1001 to 1024 of the physical families 70
# to 71 % of all onsets then lie within one sigma for each setting, be it two scans of a rise that it sees or
# all of it; with half of this 68 to 70 %, with twice 72 to 76 %.
_MISFIT = 0.1
_LATEST = 0.05  # scans ago: a rise that one scan shows may have begun just before it
_LEVEL_READINGS = 16  # the oldest, that tell the level roughly
_INSTANTS = 64  # tried over all that is searched, and again where the likelihood is
_FINEST_STEP = 0.06  # scans between them
_UNLIKELY = 1e-4  # of the best: instants that are not tried again
# What no fit to the few readings of a jolt shows, in scans: channels are sampled one after the other, over
# two thirds of a scan at 100 Hz.
_INSTANT_SD = 0.12
_PARAMETERS = 5  # of a fit: level, size, instant, power, when all slips


class KinkEstimate(NamedTuple):
    """Onset of growth, in scans before the newest, with its standard deviation."""

    delay_scans: float
    sd_scans: float


def find_kink(
    ago: FloatArray, series: FloatArray, noise: FloatArray, longest: float, least: float
) -> KinkEstimate:
    """Estimate the onset of growth of a response.

    Parameters
    ----------
    ago : (n,) float64
        Scans before the newest, falling to 0; at least four.
    series : (n,) float64
        The response there.
    noise : (n,) float64
        Its standard deviation, more than 0.
    longest : float
        Delay, in scans, beyond which it is not looked for.
    least : float
        How far it has risen when it has begun.
    """
    oldest = noise[:_LEVEL_READINGS] ** -2
    risen = np.maximum(series - (oldest @ series[:_LEVEL_READINGS]) / oldest.sum(), 0.0)
    weights = 1 / (noise**2 + (_MISFIT * risen) ** 2)
    delays = np.geomspace(_LATEST, max(2.0, longest), _INSTANTS)
    likely = np.flatnonzero(_likelihood(ago, series, weights, delays)[0].max(axis=(0, 1)) > _UNLIKELY)
    first, last = delays[max(likely[0] - 1, 0)], delays[min(likely[-1] + 1, _INSTANTS - 1)]
    delays = np.linspace(first, last, min(_INSTANTS, 2 + int((last - first) / _FINEST_STEP)))
    likelihood, sizes = _likelihood(ago, series, weights, delays)
    posterior = likelihood * _BEFOREHAND
    posterior /= posterior.sum()
    instants = np.maximum(delays * (1 - _reached(least / np.maximum(sizes, 1e-12))), 0.0)
    mean = float((posterior * instants).sum())
    variance = float((posterior * (instants - mean) ** 2).sum())
    step = float(delays[1] - delays[0])
    return KinkEstimate(mean, float(np.sqrt(variance + step**2 / 12 + _INSTANT_SD**2)))


def _likelihood(
    ago: FloatArray, series: FloatArray, weights: FloatArray, delays: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the likelihood of each shape and delay over the best, and the size of its initial rise.

    Both (powers, all slips, delays). A fall explains nothing.
    """
    total_weight = float(weights.sum())
    centred = series - weights @ series / total_weight
    since = np.maximum(1 - ago / delays[:, np.newaxis], 0.0)  # in delays
    shape = (len(_POWERS), len(_ALL_SLIPS), len(delays))
    explained, sizes = np.empty((2, *shape))
    for k, power in enumerate(_POWERS):
        grown = since**power
        for i, limit in enumerate(_ALL_SLIPS**power):
            left = np.maximum(1 - grown / limit, 0.0)
            curve = (1 - left * np.sqrt(left)) * limit / 1.5
            curve = curve - (curve @ weights / total_weight)[:, np.newaxis]
            overlap = np.maximum(curve @ (weights * centred), 0.0)
            energy = np.maximum(curve**2 @ weights, 1e-300)
            explained[k, i], sizes[k, i] = overlap**2 / energy, overlap / energy
    best = float(explained.max())
    # Where no shape fits, what is left is no white noise, but its size bounds what can be told.
    excess = (float(weights @ centred**2) - best) / max(len(series) - _PARAMETERS, 1)
    return np.exp((explained - best) / (2 * max(1.0, excess))), sizes


def _reached(part: FloatArray) -> FloatArray:
    """Return the time, in delays and at most 1, when each shape reaches a part of its straight rise."""
    power = _POWERS[:, np.newaxis, np.newaxis]
    limit = _ALL_SLIPS[:, np.newaxis] ** power
    grown = limit * (1 - np.maximum(1 - 1.5 * part / limit, 0.0) ** (2 / 3))
    return np.asarray(np.minimum(grown, 1.0) ** (1 / power))
