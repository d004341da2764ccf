"""What becomes of a fit where another wave of the same frequency is beside it.

Where the pairs that may be true (`wave_pair`) have one wave for the stronger by far, that of the fit, the
weaker is taken out of the window, and what it moved is added to the sigma. Elsewhere the pairs are named.
"""

from dataclasses import replace

import numpy as np

from tactiled.detect.grooves.answer import answer
from tactiled.detect.grooves.basis import Window
from tactiled.detect.grooves.linear import Waves
from tactiled.detect.grooves.model import Layout, WaveFit, WaveMotion, WaveParams
from tactiled.detect.grooves.pair import Pair, find_pairs
from tactiled.detect.grooves.refine import Refined, refine
from tactiled.detect.grooves.search import phasors_at

_MOST_ALONG = 3  # readings of a line, whose components along the motion two waves of its frequency may share
_SAME_RAD = 0.3  # of phase at the rim of the array: two readings of one grating, not two gratings
_DOUBT = 0.1  # of the weight of all pairs: their likelihoods are no better
_MOST_BESIDE = 0.1  # of the power of two waves: the stronger of less unlike ones is not sure to be the one


def pairs_of(
    colour: float,
    best: Refined,
    found: Waves,
    window: Window,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
) -> list[Pair]:
    """Two waves of one frequency, where they explain the line and one does not."""
    along = best.waves.turn / window.half_way
    if not motion.has_speed:
        along = np.concatenate([best.waves.k @ motion.heading, found.k[:_MOST_ALONG] @ motion.heading])
        along = along[np.unique(np.round(along * np.ptp(layout.x_mm)), return_index=True)[1]]
    variance = 2 * best.variance * colour / window.n
    z = phasors_at(window, best.tables, 1)
    return find_pairs(z, variance, layout, motion, params, best.waves.k[0], along)


def agree(pairs: list[Pair], best: Refined, layout: Layout) -> bool:
    """Whether the pairs that may be true have one wave for the stronger by far, that of the fit."""
    rim_mm = max(float(np.hypot(layout.x_mm, layout.y_mm).max()), 0.5)
    others = 0.0
    for pair in pairs:
        off_rad = np.abs(pair.k[0] - best.waves.k[0]).max() * rim_mm
        others += pair.weight * (pair.share[1] > _MOST_BESIDE or off_rad > _SAME_RAD)
    return others <= _DOUBT


def cleared(
    fit: WaveFit, best: Refined, window: Window, layout: Layout, motion: WaveMotion, params: WaveParams
) -> WaveFit:
    """The fit to a window without the weaker wave; as unsure as what that one moved."""
    anew = refine(window, layout, motion, params, best.waves)
    if not anew.is_wave:
        return fit
    alone = answer(fit, anew, window, layout, motion)
    turned = np.radians((alone.angle_deg - fit.angle_deg + 90) % 180 - 90)
    off = np.array([alone.period_mm - fit.period_mm, turned, alone.speed_mm_s - fit.speed_mm_s])
    return replace(alone, covariance=alone.covariance + np.outer(off, off))
