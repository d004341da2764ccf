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

What earlier slides told of the strays enters as hypotheses (`stray_memory`), each with strays to expect at a
wave vector and with a prior of the standard deviations about them. All hypotheses are summed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from tactiled.array import FloatArray
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion
from tactiled.detect.grooves.stray_memory import (
    LOG_PRIOR,
    MOST_MODELS,
    SIGMAS_C,
    SIGMAS_T,
    VARIANCES,
    GridPlaces,
    LearntStrays,
    begin_models,
    slide_terms,
)
from tactiled.detect.worker import pause

# Residuals are weighted by the inverse of noise and this variance to find the phase of a kind, radians^2.
_TYPICAL_VARIANCE = 0.1**2
# Standard deviation before a slide of phases (radians) and of corrections of k (radians per millimetre):
# larger than any, and small enough for a direction in which an array has no extent.
_ANY_CORRECTION = 10.0
# Variance of a phase by noise, radians^2. A channel with more tells nothing of its stray.
_LARGEST_NOISE = 0.1
# Logarithm of the least probability, relative to the likeliest, of a wave and a hypothesis that are followed.
_LEAST_PAIR = np.log(1e-5)
# Divisor in place of zero, for channels without any ripple.
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class StrayPosterior:
    """Posterior of several waves and of the strays.

    Attributes
    ----------
    weights : (waves,) float64
        Probabilities of the waves; they sum to 1.
    k : (2,) float64
        The likeliest wave: mean over the standard deviations of strays.
    log_sigmas : (sigmas_c, sigmas_t) float64
        Logarithms of the probabilities of the standard deviations, given the likeliest wave, of strays of
        which nothing else is known.
    error_if_alike : float
        Probability of the waves other than the likeliest if the channels of a kind were alike.
    learn : callable
        Computes what is known of the strays after this slide.
    """

    weights: FloatArray
    k: FloatArray
    log_sigmas: FloatArray
    error_if_alike: float
    learn: Callable[[], LearntStrays]

    @property
    def stray_rad(self) -> float:
        """Root of the mean variance of strays, of channel and taxel together."""
        return float(np.sqrt((np.exp(self.log_sigmas) * VARIANCES).sum()))


def weigh_waves(
    z: FloatArray,
    variance: FloatArray,
    layout: ChannelLayout,
    k: FloatArray,
    motion: WaveMotion,
    along: float,
    along_sd: float,
    omega: float,
) -> StrayPosterior:
    """Weigh waves by the phases of one line.

    Parameters
    ----------
    z : (channels,) complex128
        Phasors of the line.
    variance : (channels,) float64
        Of noise in the real and in the imaginary part of each.
    layout : ChannelLayout
        Its `strays` are what earlier slides told.
    k : (waves, 2) float64
        Local maxima of the likelihood, radians per millimetre.
    motion : WaveMotion
        With a known speed, `along` counts as an observation.
    along, along_sd : float
        Component of the wave vector along the motion, from frequency and speed, and its standard deviation
        apart from that of speed and direction; radians per millimetre.
    omega : float
        Frequency of the line, radians per second.

    Returns
    -------
    StrayPosterior
    """
    noise = variance / np.maximum(np.abs(z) ** 2, _TINY)
    place = np.stack([layout.x_mm, layout.y_mm], axis=1)
    design = np.concatenate([layout.is_kind, place], axis=1)
    channel = np.arange(len(z)) if layout.channel is None else layout.channel
    learnt = LearntStrays(channel, LOG_PRIOR) if layout.strays is None else layout.strays
    slides = slide_terms(k, omega)
    expected = [np.zeros((len(z), len(k))), *(model.mean(slides) for model in learnt.models)]
    residual = _residuals(z, noise, layout, place, k, expected)
    tie = _tie(motion, k, along, along_sd, design.shape[1], len(expected))
    evidence = _evidence(residual, noise, design, layout, tie)
    log = evidence.log.reshape(*evidence.log.shape[:2], len(expected), len(k))
    error_if_alike = 1 - float(special.softmax(log[0, 0, 0]).max())
    each = [log[:, :, 0] + learnt.log_sigmas[..., np.newaxis]]
    for number, model in enumerate(learnt.models, 1):
        pause()
        about_mean = _between(log[:, :, number], *model.places(slides))
        each.append(about_mean + model.log_sigmas[..., np.newaxis])
    # (hypotheses, waves)
    of_wave = np.stack([np.logaddexp.reduce(one, axis=(0, 1)) for one in each])
    joint = of_wave + learnt.log_weights[:, np.newaxis]
    weights = special.softmax(np.logaddexp.reduce(joint, axis=0))
    likeliest = int(weights.argmax())
    log_sigmas = each[0][:, :, likeliest] - of_wave[0, likeliest]
    moved = np.einsum("st,sta->a", np.exp(log_sigmas), evidence.best[:, :, likeliest, -2:])

    def learn() -> LearntStrays:
        typical_noise = float(np.median(noise))
        pairs = joint.ravel()
        most = np.argsort(-pairs, kind="stable")[:MOST_MODELS]
        begun, later = [], []
        alone = np.logaddexp.reduce(of_wave[0], axis=None)
        of_any_wave = np.logaddexp.reduce(each[0], axis=2) - alone
        for pair in most[pairs[most] > pairs[most[0]] + _LEAST_PAIR]:
            pause()
            number, wave = divmod(int(pair), len(k))
            log_weight, slide = float(of_wave[number, wave]), slides[wave]
            own = each[number][:, :, wave] - log_weight
            off = evidence.left(residual, design, own, int(pair)) * (noise < _LARGEST_NOISE)
            if number:
                model = learnt.models[number - 1]
                later.append(model.learn(slide, off, typical_noise, own, model.log_weight + log_weight))
            else:
                begun += begin_models(slide, off, typical_noise, of_any_wave, log_weight)
        known = -np.inf
        if learnt.models:
            weight = np.array([[model.log_weight] for model in learnt.models])
            known = float(np.logaddexp.reduce(of_wave[1:] + weight, axis=None))
        return learnt.after(of_any_wave, float(alone), known, begun, later)

    return StrayPosterior(weights, k[likeliest] + moved, log_sigmas, error_if_alike, learn)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Evidence of columns of residuals at each pair of standard deviations.

    Attributes
    ----------
    log : (sigmas_c, sigmas_t, columns) float64
    best : (sigmas_c, sigmas_t, columns, unknowns) float64
        Phases of the kinds and corrections of k.
    """

    log: FloatArray
    best: FloatArray

    def left(
        self, residual: FloatArray, design: FloatArray, log_sigmas: FloatArray, column: int
    ) -> FloatArray:
        """Residuals of a column less what a wave explains, at the likeliest sigmas: (channels,)."""
        at = np.unravel_index(int(log_sigmas.argmax()), log_sigmas.shape)
        return np.asarray(residual[:, column] - design @ self.best[(*at, column)])


def _evidence(
    residual: FloatArray,
    noise: FloatArray,
    design: FloatArray,
    layout: ChannelLayout,
    tie: tuple[FloatArray, FloatArray, FloatArray],
) -> _Evidence:
    """Evidence of residuals (channels, columns); each column has its row of the tie."""
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
        shared / np.maximum(SIGMAS_T[:, np.newaxis] ** 2, _TINY), where=shared > 0, out=np.zeros_like(shared)
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
    return _Evidence(log, best.swapaxes(2, 3))


def _between(log: FloatArray, c: GridPlaces, t: GridPlaces) -> FloatArray:
    """Evidence between the nodes of the grid, linear in its places: (sigmas_c, sigmas_t, waves)."""
    wave = np.arange(log.shape[2])[:, np.newaxis]
    log = log.transpose(2, 0, 1)
    part = c.part[..., np.newaxis]
    log = (1 - part) * log[wave, c.below] + part * log[wave, c.below + 1]  # (waves, sigmas_c, sigmas_t)
    log, part = log.swapaxes(1, 2), t.part[..., np.newaxis]
    log = (1 - part) * log[wave, t.below] + part * log[wave, t.below + 1]
    return np.asarray(log.transpose(2, 1, 0))


def _residuals(
    z: FloatArray,
    noise: FloatArray,
    layout: ChannelLayout,
    place: FloatArray,
    k: FloatArray,
    expected: list[FloatArray],
) -> FloatArray:
    """Chords of the phases that waves and expected strays leave, each kind about its mean direction.

    Returns
    -------
    (channels, hypotheses times waves) float64
    """
    alone = np.angle(z)[:, np.newaxis] - place @ k.T
    unit = np.exp(1j * np.concatenate([alone - strays for strays in expected], axis=1))
    mean = layout.is_kind.T @ (unit / (noise + _TYPICAL_VARIANCE)[:, np.newaxis])
    left = np.angle(unit * np.exp(-1j * (layout.is_kind @ np.angle(mean))))
    return np.asarray(2 * np.sin(left / 2))


def _tie(
    motion: WaveMotion, k: FloatArray, along: float, along_sd: float, n: int, times: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Known motion as an observation of corrections of k: its row, its value and the log of its sigma.

    For each of the waves, repeated a number of times.
    """
    row = np.zeros((len(k), n))
    if not motion.has_speed:
        return np.tile(row, (times, 1)), np.zeros(times * len(k)), np.zeros(times * len(k))
    here = k @ motion.heading
    across = motion.heading[0] * k[:, 1] - motion.heading[1] * k[:, 0]
    sd = np.radians(motion.direction_sd_deg)
    by_speed = here * motion.speed_sd_mm_s / motion.speed_mm_s
    # Error of cos(tilt + error) to first and second order, as `WaveSolver` has it.
    slack = np.linalg.norm([across * sd, here * np.sqrt(3) / 2 * sd**2, by_speed], axis=0)
    slack = np.hypot(slack, along_sd)
    row[:, -2:] = motion.heading / slack[:, np.newaxis]
    return np.tile(row, (times, 1)), np.tile((along - here) / slack, times), np.tile(np.log(slack), times)
