"""Probabilities of all waves that the phases of a line allow.

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

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import (
    MAX_CANDIDATES,
    TINY,
    ChannelLayout,
    WaveMotion,
    distinct,
    period_and_angle,
)
from tactiled.detect.grooves.refine import RefinedWave
from tactiled.detect.grooves.ripple import Ripple
from tactiled.detect.grooves.search import search_wave_vectors
from tactiled.detect.grooves.solve import PlaneWaves
from tactiled.detect.worker import pause
from tactiled.events.types import Candidate

# choice: standard deviations of strays, radians: of a channel, about evenly spaced in the logarithm, and of a
# taxel. The largest are where phases tell nothing; below the smallest no noise is as low.
SIGMAS_C = np.array([0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.13, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5])
SIGMAS_T = np.array([0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3])  # choice
# physical: prior: median and log-spread of sigma_c, mean of an exponential sigma_t. Skins with physics stray
# by 0.05 to 0.2 radians, more between channels than between taxels.
_MEDIAN_C, _SPREAD_C, _MEAN_T = 0.08, 0.8, 0.05

_LOG_WEIGHT = -0.5 * (np.log(SIGMAS_C / _MEDIAN_C) / _SPREAD_C)[:, np.newaxis] ** 2 - SIGMAS_T / _MEAN_T
LOG_PRIOR = _LOG_WEIGHT - np.logaddexp.reduce(_LOG_WEIGHT, axis=None)
"""Logarithms of the prior probabilities of the standard deviations, (sigmas_c, sigmas_t)."""
# choice: standard deviation before a slide of phases (radians) and of corrections of k (radians per
# millimetre): larger than any, and small enough for a direction in which an array has no extent.
_ANY_CORRECTION = 10.0
# derived: tail probability at two standard deviations, at which intervals are matched.
_TAIL = 0.025
# derived: spread of the channels' positions. With less there are no delays to measure.
_LEAST_SPREAD_MM2 = 1e-6


@dataclass(frozen=True, eq=False)
class StrayPosterior:
    """Posterior of several waves and of the strays."""

    weights: FloatArray  # (waves,): probabilities of the waves; they sum to 1
    k: FloatArray  # (2,): the likeliest wave: mean over the standard deviations of strays
    covariance: FloatArray  # (2, 2): of k
    log_evidence: float  # logarithm of the probability density of the phases, mean over the waves
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
) -> StrayPosterior:
    """Weigh waves by the phases of one line.

    Parameters
    ----------
    z, variance : (channels,) complex128 and float64
        Phasors of the line, and the variance of noise in the real and in the imaginary part of each.
    k : (waves, 2) float64
        Local maxima of the likelihood, radians per millimetre.
    motion : WaveMotion
        With a known speed, `along` counts as an observation.
    along, along_sd : float
        Component of the wave vector along the motion, from frequency and speed, and its standard deviation
        apart from that of speed and direction; radians per millimetre.
    """
    noise = variance / np.maximum(np.abs(z) ** 2, TINY)
    residual = _residuals(z, noise, layout, k)
    design = np.concatenate([layout.is_kind, layout.xy_mm], axis=1)
    is_taxel = (layout.taxel[:, np.newaxis] == np.arange(len(layout.places_mm))).astype(np.float64)
    n = design.shape[1]
    weight = 1 / (noise + SIGMAS_C[:, np.newaxis] ** 2)  # (sigmas_c, channels)
    both = np.concatenate([design, residual], axis=1)
    products = (weight[:, np.newaxis] * design.T) @ both  # (sigmas_c, unknowns, unknowns and waves)
    squares = weight @ residual**2
    # A stray that the channels of a taxel share takes a rank-one part out of each product (Woodbury).
    sums = (weight[:, np.newaxis] * is_taxel.T) @ both  # (sigmas_c, taxels, unknowns and waves)
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
    unknown = inverse @ seen  # (sigmas_c, sigmas_t, unknowns, waves): phases of the kinds, corrections of k
    quadratic = squares - (seen * unknown).sum(axis=2)
    pause()
    # A known motion is one more observation of each wave (Sherman, Morrison 1950): its row, value and slack.
    row, off, slack = np.zeros((len(k), n)), np.zeros(len(k)), np.ones(len(k))
    if motion.has_speed:
        slack = np.hypot(motion.along_sd(k), along_sd)
        row[:, -2:] = motion.heading / slack[:, np.newaxis]
        off = (along - k @ motion.heading) / slack
    pull = inverse @ row.T
    spread = 1 + (row.T * pull).sum(axis=2)
    miss = off - (row.T * unknown).sum(axis=2)
    unknown = unknown + pull * (miss / spread)[:, :, np.newaxis]
    quadratic = quadratic + miss**2 / spread
    log_gram = np.linalg.slogdet(gram)[1][..., np.newaxis] + np.log(spread)
    log = -0.5 * (quadratic + log_det[..., np.newaxis] + log_gram) - np.log(slack)
    error_if_alike = 1 - float(special.softmax(log[0, 0]).max())
    log = log + LOG_PRIOR[..., np.newaxis]
    of_wave = np.logaddexp.reduce(log, axis=(0, 1))
    weights = special.softmax(of_wave)
    likeliest = int(weights.argmax())
    p = np.exp(log[:, :, likeliest] - of_wave[likeliest])
    moves, pull = unknown[:, :, -2:, likeliest], pull[:, :, -2:, likeliest]
    moved = np.einsum("st,sta->a", p, moves)
    within = inverse[:, :, -2:, -2:] - (
        pull[..., np.newaxis] * pull[..., np.newaxis, :] / spread[..., likeliest, np.newaxis, np.newaxis]
    )
    moves = moves - moved
    covariance = np.einsum("st,stab->ab", p, within + moves[..., np.newaxis] * moves[..., np.newaxis, :])
    return StrayPosterior(
        weights=weights,
        k=k[likeliest] + moved,
        covariance=covariance,
        log_evidence=float(np.logaddexp.reduce(of_wave)) - np.log(len(k)),
        stray_rad=float(np.sqrt((p * (SIGMAS_C[:, np.newaxis] ** 2 + SIGMAS_T**2)).sum())),
        error_if_alike=error_if_alike,
    )


def _residuals(
    z: NDArray[np.complex128], noise: FloatArray, layout: ChannelLayout, k: FloatArray
) -> FloatArray:
    """Chords (channels, waves) of the phases that waves leave, each kind about its mean direction.

    In that mean, channels are weighted by the inverse of noise and usual strays.
    """
    unit = np.exp(1j * (np.angle(z)[:, np.newaxis] - layout.xy_mm @ k.T))
    mean = layout.is_kind.T @ (unit / (noise + _MEDIAN_C**2)[:, np.newaxis])
    left = np.angle(unit * np.exp(-1j * (layout.is_kind @ np.angle(mean))))
    return np.asarray(2 * np.sin(left / 2))


def weigh_interpretations(
    best: RefinedWave, k: FloatArray, noise_inflation: float = 1.0, motion: WaveMotion | None = None
) -> StrayPosterior:
    """Probabilities of all waves k (waves, 2) that a line may be, of which `best` is the first one refined.

    `noise_inflation` is the ratio of the noise at the line to that of `best`. The motion is that of the
    window unless another one is given.
    """
    window, variance = best.window, best.variance * noise_inflation
    phase_rate, sd = best.equations.own_phase_rate(variance)
    return weigh_waves(
        best.equations.phasors(),
        2 * variance / window.n,
        window.layout,
        k,
        motion or window.motion,
        phase_rate / window.half_travel,
        sd / window.half_travel,
    )


def with_strays(best: RefinedWave, posterior: StrayPosterior, noise_inflation: float) -> RefinedWave:
    """The wave of a posterior: its wave vector and the channels' own frequency, with their covariance."""
    phase_rate, sd = best.equations.own_phase_rate(best.variance * noise_inflation)
    covariance = np.zeros((1, 3, 3))
    # Strays that taxels share are estimated from few taxels: their intervals are Student's. Phase and wave
    # vector spend three degrees of freedom.
    left = max(len(best.window.layout.places_mm) - 3, 1)
    wider = (special.stdtrit(left, _TAIL) / special.ndtri(_TAIL)) ** 2
    covariance[0, :2, :2], covariance[0, 2, 2] = wider * posterior.covariance, sd**2
    waves = replace(
        best.waves, k=posterior.k[np.newaxis], phase_rate=np.array([phase_rate]), covariance=covariance
    )
    return replace(best, waves=waves)


def contradicts_motion(best: RefinedWave, k: FloatArray) -> bool:
    """True where waves of another motion are far likelier than all waves k of the given motion.

    With a given speed that is 10 % too high, 12 of 12 windows are answered, and 4 without this.
    """
    window = best.window
    free = window.without_speed
    if not window.motion.has_speed or not best.is_uneven or not has_baseline(window.layout, free.motion):
        return False
    others = search_wave_vectors(Ripple(free, best.phase_rate, best.variance), 0.0).k
    if not len(others):
        return False
    tied, loose = weigh_interpretations(best, k), weigh_interpretations(best, others, motion=free.motion)
    # For waves of another motion, too, the component of k along the given one is an observation. Where the
    # true speed may be any within a factor of e of the given one, its density is one over the component. The
    # rate may be below zero: of an aliased line, and of a slow one.
    density = abs(window.half_travel / best.phase_rate)
    odds = loose.log_evidence + np.log(density) - tied.log_evidence
    return bool(odds > -np.log(window.params.error_probability))


def has_baseline(layout: ChannelLayout, motion: WaveMotion) -> bool:
    """True where channels of one kind are far enough apart in the directions that matter."""
    spread = np.zeros((2, 2))
    for kind in distinct(layout.kind):
        mine = layout.xy_mm[layout.kind == kind]
        spread += (mine - mine.mean(axis=0)).T @ (mine - mine.mean(axis=0))
    across = motion.across
    least = across @ spread @ across if motion.has_speed else np.linalg.eigvalsh(spread)[0]
    return bool(least > _LEAST_SPREAD_MM2)


def likely_gratings(found: PlaneWaves, weights: FloatArray) -> tuple[Candidate, ...]:
    """The likeliest gratings, with their weights."""
    shown = [i for i in np.argsort(-weights, kind="stable")[:MAX_CANDIDATES] if weights[i] > 1e-4]
    return tuple(
        Candidate(period_mm=period_mm, angle_deg=angle_deg, weight=float(weights[i]))
        for i in shown
        for period_mm, angle_deg in [period_and_angle(found.k[i])]
    )
