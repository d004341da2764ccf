"""Posterior of plane waves where the phases of channels stray from the wave, by amounts that are unknown.

No two taxels of a skin are alike: the phase of a channel differs from that of the wave by a stray of its own
(standard deviation `sigma_c`), and the channels of a taxel share one (`sigma_t`). Large strays make a wrong
wave vector look as good as the true one. Both standard deviations are therefore integrated out over a grid:

    phase_c = phase of the kind + k . place_c + stray_c + stray of the taxel + noise
    evidence of k = integral over both sigmas of p(sigmas) N(residual; 0, Sigma(sigmas)),

with the phases of the kinds and small corrections of k integrated out as Gaussian unknowns (restricted
likelihood: Harville, J. Am. Stat. Assoc. 72, 1977). A known motion is one more observation, of the component
of k along it. Because phases are angles, the chord ``2 sin(residual / 2)`` stands for a residual; it equals
the residual where that is small and makes the likelihood that of von Mises where it is large.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import TINY, ChannelLayout, WaveMotion
from tactiled.detect.worker import pause

# choice: standard deviations of strays, radians: of a channel, about evenly spaced in the logarithm, and of a
# taxel. The largest are where phases tell nothing; below the smallest no noise is as low.
SIGMAS_C = np.array([0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.13, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5])
SIGMAS_T = np.array([0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3])  # choice
# derived: variances of channel and taxel together, (sigmas_c, sigmas_t), radians^2.
_VARIANCES = SIGMAS_C[:, np.newaxis] ** 2 + SIGMAS_T**2
# physical: prior: median and log-spread of sigma_c, mean of an exponential sigma_t. Skins with physics stray
# by 0.05 to 0.2 radians, more between channels than between taxels.
_MEDIAN_C, _SPREAD_C, _MEAN_T = 0.08, 0.8, 0.05


def _log_prior() -> FloatArray:
    log = -0.5 * (np.log(SIGMAS_C / _MEDIAN_C) / _SPREAD_C)[:, np.newaxis] ** 2 - SIGMAS_T / _MEAN_T
    return np.asarray(log - np.logaddexp.reduce(log, axis=None))


LOG_PRIOR = _log_prior()
"""Logarithms of the prior probabilities of the standard deviations, (sigmas_c, sigmas_t)."""
# physical: residuals are weighted by the inverse of noise and this variance to find the phase of a kind,
# radians^2.
_TYPICAL_VARIANCE = 0.1**2
# choice: standard deviation before a slide of phases (radians) and of corrections of k (radians per
# millimetre): larger than any, and small enough for a direction in which an array has no extent.
_ANY_CORRECTION = 10.0


@dataclass(frozen=True, eq=False)
class StrayPosterior:
    """Posterior of several waves and of the strays."""

    weights: FloatArray  # (waves,): probabilities of the waves; they sum to 1
    k: FloatArray  # (2,): the likeliest wave: mean over the standard deviations of strays
    # Root of the mean variance of strays, of channel and taxel together, given the likeliest wave
    stray_rad: float
    # Probability of the waves other than the likeliest if the channels of a kind were alike
    error_if_alike: float


def weigh_waves(
    z: NDArray[np.complex128],
    variance: FloatArray,
    layout: ChannelLayout,
    k: FloatArray,
    motion: WaveMotion,
    along: float,
    along_sd: float,
    log_prior: FloatArray = LOG_PRIOR,
) -> StrayPosterior:
    """Weigh waves by the phases of one line.

    Parameters
    ----------
    z : (channels,) complex128
        Phasors of the line.
    variance : (channels,) float64
        Of noise in the real and in the imaginary part of each.
    k : (waves, 2) float64
        Local maxima of the likelihood, radians per millimetre.
    motion : WaveMotion
        With a known speed, `along` counts as an observation.
    along, along_sd : float
        Component of the wave vector along the motion, from frequency and speed, and its standard deviation
        apart from that of speed and direction; radians per millimetre.
    log_prior : (sigmas_c, sigmas_t) float64
        Logarithms of the probabilities of the standard deviations.
    """
    noise = variance / np.maximum(np.abs(z) ** 2, TINY)
    place = layout.xy_mm
    design = np.concatenate([layout.is_kind, place], axis=1)
    residual = _residuals(z, noise, layout, place, k)
    log, best = _evidence(residual, noise, design, layout, _tie(motion, k, along, along_sd, design.shape[1]))
    error_if_alike = 1 - float(special.softmax(log[0, 0]).max())
    log = log + log_prior[..., np.newaxis]
    of_wave = np.logaddexp.reduce(log, axis=(0, 1))
    weights = special.softmax(of_wave)
    likeliest = int(weights.argmax())
    p = np.exp(log[:, :, likeliest] - of_wave[likeliest])
    moved = np.einsum("st,sta->a", p, best[:, :, likeliest, -2:])
    return StrayPosterior(
        weights, k[likeliest] + moved, float(np.sqrt((p * _VARIANCES).sum())), error_if_alike
    )


def _evidence(
    residual: FloatArray,
    noise: FloatArray,
    design: FloatArray,
    layout: ChannelLayout,
    tie: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Weigh residuals (channels, waves); each wave has its row of the tie.

    Returns
    -------
    log : (sigmas_c, sigmas_t, waves) float64
        Evidence at each pair of standard deviations.
    best : (sigmas_c, sigmas_t, waves, unknowns) float64
        Phases of the kinds and corrections of k.
    """
    row, off, log_slack = tie
    is_taxel = (layout.taxel[:, np.newaxis] == np.arange(len(layout.places_mm))).astype(np.float64)
    n = design.shape[1]
    weight = 1 / (noise + SIGMAS_C[:, np.newaxis] ** 2)  # (sigmas_c, channels)
    both = np.concatenate([design, residual], axis=1)
    products = (weight[:, np.newaxis] * design.T) @ both  # (sigmas_c, unknowns, unknowns and columns)
    squares = weight @ residual**2
    # A stray that the channels of a taxel share takes a rank-one part out of each product (Woodbury).
    sums = (weight[:, np.newaxis] * is_taxel.T) @ both  # (sigmas_c, taxels, unknowns and columns)
    total = weight @ is_taxel
    shared = SIGMAS_T[:, np.newaxis] ** 2 / (1 + SIGMAS_T[:, np.newaxis] ** 2 * total[:, np.newaxis, :])
    pause()
    shared_sums = shared[:, :, np.newaxis] * sums[:, np.newaxis, :, :n].swapaxes(2, 3)
    products = products[:, np.newaxis] - shared_sums @ sums[:, np.newaxis]
    squares = squares[:, np.newaxis] - shared @ sums[..., n:] ** 2
    log_det = -np.log(weight).sum(axis=1)[:, np.newaxis] - np.log(
        shared / np.maximum(SIGMAS_T[:, np.newaxis] ** 2, TINY), where=shared > 0, out=np.zeros_like(shared)
    ).sum(axis=2)
    pause()
    gram, seen = products[..., :n] + _ANY_CORRECTION**-2 * np.eye(n), products[..., n:]
    inverse = np.linalg.inv(gram)
    best = inverse @ seen
    quadratic = squares - (seen * best).sum(axis=2)
    pause()
    # The tie is one more observation of each column (Sherman, Morrison 1950).
    pull = inverse @ row.T
    spread = 1 + (row.T * pull).sum(axis=2)
    miss = off - (row.T * best).sum(axis=2)
    best = best + pull * (miss / spread)[:, :, np.newaxis]
    quadratic = quadratic + miss**2 / spread
    log_gram = np.linalg.slogdet(gram)[1][..., np.newaxis] + np.log(spread)
    log = -0.5 * (quadratic + log_det[..., np.newaxis] + log_gram) - log_slack
    return log, best.swapaxes(2, 3)


def _residuals(
    z: NDArray[np.complex128],
    noise: FloatArray,
    layout: ChannelLayout,
    place: FloatArray,
    k: FloatArray,
) -> FloatArray:
    """Chords (channels, waves) of the phases that waves leave, each kind about its mean direction."""
    unit = np.exp(1j * (np.angle(z)[:, np.newaxis] - place @ k.T))
    mean = layout.is_kind.T @ (unit / (noise + _TYPICAL_VARIANCE)[:, np.newaxis])
    left = np.angle(unit * np.exp(-1j * (layout.is_kind @ np.angle(mean))))
    return np.asarray(2 * np.sin(left / 2))


def _tie(
    motion: WaveMotion, k: FloatArray, along: float, along_sd: float, n: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Known motion as an observation of corrections of each k: its row, its value, the log of its sigma."""
    row = np.zeros((len(k), n))
    if not motion.has_speed:
        return row, np.zeros(len(k)), np.zeros(len(k))
    here, slack = k @ motion.heading, np.hypot(motion.along_sd(k), along_sd)
    row[:, -2:] = motion.heading / slack[:, np.newaxis]
    return row, (along - here) / slack, np.log(slack)
