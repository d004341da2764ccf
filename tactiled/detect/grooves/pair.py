"""Whether two waves share one frequency: crossed grooves, a knurl, or a vibration at the ripple's frequency.

Amplitudes are each channel's own, so the sum of two waves may pass for one between them whose channels differ
in gain, and phase a little. But then gains and phases are no accident: a second wave with the same motion
explains them. Both readings are given gains and phases that stray (`wave_phasors`); their likelihoods say
which it is (with the penalty of Schwarz 1978 for the second wave's unknowns).

Waves of one frequency and one motion differ across the motion alone. Where its direction is not quite known,
nor is which way that is; where its speed is not, nor is what they have in common along it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import Layout, WaveMotion, WaveParams
from tactiled.detect.grooves.pair_search import search_pairs
from tactiled.detect.grooves.phasors import Phasors

_SAME_RAD = 0.3  # at the rim: two refined pairs that are this close are one


@dataclass(frozen=True, eq=False)
class Pair:
    """Two waves of one frequency.

    Attributes
    ----------
    k : (2, 2) float64
        Wave vectors, the stronger first; zeros for a vibration that all channels feel at once.
    share : (2,) float64
        Of the power of both.
    second : (channels,) complex128
        Phasors of the weaker.
    weight : float
        Probability that it is this pair, and not another or one wave.
    """

    k: FloatArray
    share: FloatArray
    second: NDArray[np.complex128]
    weight: float


def find_pairs(
    z: FloatArray,
    variance: FloatArray,
    layout: Layout,
    motion: WaveMotion,
    params: WaveParams,
    k: FloatArray,
    along: FloatArray,
) -> list[Pair]:
    """Pairs of waves that explain what one does not, the likeliest first; none where one does.

    Parameters
    ----------
    z : (channels,) complex128
        Phasors of the line.
    variance : (channels,) float64
        Of noise in either part of each.
    k : (2,) float64
        Of the one wave.
    along : (lines,) float64
        What both may have as component along the motion, radians per millimetre, or nearly.
    """
    phasors = Phasors(z, variance, layout)
    # Unknowns of the second wave; and those that one wave leaves open.
    n_more = 2 * phasors.is_kind.shape[1] + 1 + int(motion.direction_sd_deg > 0)
    if len(z) < 2 * n_more + 1 or phasors.is_one(k):
        return []
    alone = float(phasors.likelihood(k[np.newaxis, np.newaxis])[0]) + n_more / 2 * np.log(2 * len(z))
    if alone > -np.log(phasors.variance).sum():  # nothing left at all would not be likelier
        return []
    tried = search_pairs(phasors, motion, params, along, layout.rim_mm)
    if not len(tried.along):
        return []
    pairs = tried.k(motion.heading)
    prior = np.zeros(len(pairs))
    if motion.direction_sd_deg > 0:
        prior -= (np.degrees(np.arctan(tried.turned)) / motion.direction_sd_deg) ** 2 / 2
    likelihood = phasors.likelihood(pairs) + prior
    if likelihood.max() <= alone:
        return []
    odds_alone = np.exp(alone - likelihood.max())
    # Against each other, pairs are held to how alike the channels show to be.
    phasors.expect_no_more_strays(pairs[likelihood.argmax()])
    likelihood = phasors.likelihood(pairs) + prior
    order = np.argsort(-likelihood, kind="stable")
    likelihood = likelihood[order]
    fitted = phasors.fit(pairs[order])
    power = (np.abs(fitted) ** 2).mean(axis=1)
    stronger = np.argsort(-power, axis=1)
    pairs = np.take_along_axis(pairs[order], stronger[..., np.newaxis], axis=1)
    power = np.take_along_axis(power, stronger, axis=1)
    distinct: list[int] = []
    for i, pair in enumerate(pairs):
        if all(np.abs(pair - pairs[j]).max() * layout.rim_mm > _SAME_RAD for j in distinct):
            distinct.append(i)
    odds = np.exp(likelihood[distinct] - likelihood[0])
    odds /= odds.sum() + odds_alone
    return [
        Pair(pairs[i], power[i] / power[i].sum(), fitted[i, :, stronger[i, 1]], float(weight))
        for i, weight in zip(distinct, odds, strict=True)
    ]
