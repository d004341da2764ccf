"""Which lines of a spectrum are one wave's own: harmonics that are seen, and those that only look like it."""

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.basis import Tables, Window, tabulate
from tactiled.detect.grooves.linear import Waves
from tactiled.detect.grooves.lines import LEAST_VARIANCE
from tactiled.detect.grooves.model import Layout, WaveMotion, WaveParams
from tactiled.detect.grooves.search import best_score, phasors_at, score

_FALSE_LINE = 1e-6  # noise passes for one more line so often
_HIGHEST = 0.45  # of the scan rate: a harmonic above may fall on another
_FALSE_FOREIGN = 1e-6  # strays of a wave's own harmonic pass for another wave so often
_LEAST_FOREIGN = 0.05  # of a line's power: less is not worth a search for whose else it may be
_MOST_UNTIED = 0.4  # of a line's power: with more the wave does not explain it, whatever does


def n_seen(window: Window, turn: float, params: WaveParams) -> int:
    """The highest harmonic that is seen."""
    highest = min(params.max_harmonics, int(2 * np.pi * _HIGHEST / (turn * window.largest_step)))
    highest = next((h - 1 for h in range(2, highest + 1) if window.is_gone(h * turn)), highest)
    if highest < 2:
        return 1
    tables = tabulate(window, turn, highest)
    variance = noise_variance(window, tables)
    information = np.linalg.inv(tables.gram[:, : 2 * highest, : 2 * highest])
    parts = tables.phasors()
    level = special.chdtri(2 * len(parts), _FALSE_LINE)
    for h in range(highest, 1, -1):
        pair = slice(2 * h - 2, 2 * h)
        own = np.linalg.solve(information[:, pair, pair], parts[:, pair, np.newaxis])[..., 0]
        if float(((own * parts[:, pair]).sum(axis=1) / variance).sum()) > level:
            return h
    return 1


def noise_variance(window: Window, tables: Tables) -> FloatArray:
    """Of what the tables' own phasors leave of each channel."""
    rest = window.power - tables.explained()
    n_free = max(window.n - window.trend.shape[1] - 2 * tables.n_harmonics, 1)
    return np.asarray(np.maximum(rest / n_free, LEAST_VARIANCE))


def line_powers(tables: Tables, variance: FloatArray) -> FloatArray:
    """What each line explains, over the noise, as far as lines are apart: (harmonics,)."""
    parts = tables.phasors() ** 2 * np.einsum("gff->gf", tables.gram)[:, : 2 * tables.n_harmonics]
    return np.asarray((parts.T / variance).sum(axis=1).reshape(-1, 2).sum(axis=1))


def foreign_lines(
    window: Window,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
    waves: Waves,
    tables: Tables,
    variance: FloatArray,
) -> list[int]:
    """Which lines at multiples of a wave's frequency are not its own.

    A harmonic's phases go as many times as fast across the array as the fundamental's; those of noise, and of
    another grating whose ripple happens to be a multiple, do not. Strays are blamed for what is not tied,
    unless another wave vector explains it so much better that strays would not let it (likelihood ratio of
    the variances of the phases, over as many vectors as were tried).

    Parameters
    ----------
    waves : Waves
        One.
    tables : Tables
        With the lines in question.
    """
    power = window.n / 2  # of a line of amplitude 1
    n_channels = len(variance)
    level = special.chdtri(n_channels, _FALSE_LINE)
    n_free = max(n_channels - len(np.unique(layout.kind)) - 2, 1)
    foreign = []
    for h in range(1, tables.n_harmonics + 1):
        z = phasors_at(window, tables, h)
        free = power * float((np.abs(z) ** 2 / variance).sum())
        untied = free - power * score(z, layout, h * waves.k[0], variance)
        if untied < max(level, _LEAST_FOREIGN * free):
            continue
        if untied < _MOST_UNTIED * free:
            other, n_tried = best_score(z, h * tables.turn, window, layout, motion, params, variance)
            ratio = untied / max(free - power * other, n_channels)
            if n_free * np.log(ratio) < 2 * np.log(n_tried / _FALSE_FOREIGN):
                continue
        foreign.append(h)
    return foreign
