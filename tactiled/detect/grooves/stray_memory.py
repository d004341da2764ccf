"""Strays of an array's channels that repeat from slide to slide, learnt as hypotheses.

The stray of channel c on a slide with wave vector k (radians per millimetre) and ripple omega (radians per
second) is modelled as linear in three constants of the skin, plus a part that is new at each slide:

    stray_c = a_c + k . d_c + omega t_c + new part,

with a phase a_c (loss angle of rubber, which hardly depends on frequency), an offset d_c (mm; a misplaced
chip) and a delay t_c (s). How the variance is shared between the three is unknown, so that four cases are
followed side by side (a bank of Kalman filters: Magill, IEEE Trans. Automatic Control 10, 1965): each alone,
and all three in equal parts. All channels have the same variances, so that one gain serves all. Waves that a
slide left possible are followed as hypotheses of their own: strays that were computed from a wrong wave
cannot make the next answer surer than that one was.

What repeats is also asked: a slide whose strays no hypothesis foresaw makes the probability smaller that
strays repeat at all, and begins new hypotheses. On an array whose strays are drawn anew for each slide,
nothing but their standard deviations is used.

A phase of each kind and a gradient of strays over the array look like another phase of the wave and another
wave vector. Each slide absorbs them (`strays.weigh_waves`), so that they are neither learnt nor needed to
tell waves apart.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from tactiled.array import FloatArray

# Standard deviations of strays, radians: of a channel, about evenly spaced in the logarithm, and of a taxel.
# The largest are where phases tell nothing; below the smallest no noise is as low.
SIGMAS_C = np.array([0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.13, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5])
SIGMAS_T = np.array([0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3])
# Variances of channel and taxel together, (sigmas_c, sigmas_t), radians^2.
VARIANCES = SIGMAS_C[:, np.newaxis] ** 2 + SIGMAS_T**2
# Prior of an array that has not slid yet: median and log-spread of sigma_c, mean of an exponential sigma_t.
# Skins with physics stray by 0.05 to 0.2 radians, more between channels than between taxels.
_MEDIAN_C, _SPREAD_C, _MEAN_T = 0.08, 0.8, 0.05
# Part of the prior that remains when the next slide is on another surface or under another load.
_FORGOTTEN = 0.1
# Grid cells to either side over which a carried posterior is spread: a factor of 1.3 in sigma.
_SPREAD = (0.25, 0.5, 0.25)
# Probability, before any slide, that strays repeat: nobody knows. Bounds keep it able to change.
_REPEAT, _LEAST_REPEAT = 0.5, 0.02
# Probability that the strays of an array change between two slides, as under another load.
_CHANGED = 0.05
# Part of their first variance that the constants of a channel regain from slide to slide.
_WALK = 0.01
# Parts of the variance that are new at each slide, equally likely before the second slide.
_NEW_PARTS = (0.003, 0.01, 0.03, 0.1, 0.3)
# Cases: variance shares of phase, offset and delay.
_CASES = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1 / 3, 1 / 3, 1 / 3]])
# Hypotheses that are kept: four cases of four waves.
MOST_MODELS = 16
# Probability of all hypotheses that were dropped. The true one may be among them, and would then be missed by
# every later slide; a slide that would exceed this teaches nothing.
_MOST_LOST = 2e-3
# Divisor in place of zero, for a wave without frequency.
_TINY = 1e-300


def _log_prior() -> FloatArray:
    log = -0.5 * (np.log(SIGMAS_C / _MEDIAN_C) / _SPREAD_C)[:, np.newaxis] ** 2 - SIGMAS_T / _MEAN_T
    return np.asarray(log - np.logaddexp.reduce(log, axis=None))


# Logarithms of the prior probabilities of the grid, (sigmas_c, sigmas_t).
LOG_PRIOR = _log_prior()


def _spreading(n: int) -> FloatArray:
    """Matrix that spreads probabilities over neighbouring cells: (n, n)."""
    before, same, behind = _SPREAD
    spread = same * np.eye(n) + before * np.eye(n, k=-1) + behind * np.eye(n, k=1)
    spread[0, 0] += before
    spread[-1, -1] += behind
    return spread


_OVER_C, _OVER_T = _spreading(len(SIGMAS_C)), _spreading(len(SIGMAS_T))


def carried(log_sigmas: FloatArray) -> FloatArray:
    """Prior for the next slide after a slide with this posterior: (sigmas_c, sigmas_t)."""
    probability = _OVER_C @ np.exp(log_sigmas) @ _OVER_T.T
    probability = probability / probability.sum()
    return np.asarray(np.log((1 - _FORGOTTEN) * probability + _FORGOTTEN * np.exp(LOG_PRIOR)))


class GridPlaces(NamedTuple):
    """Places between the nodes of a grid: the node below, and the part of the way to the next one."""

    below: NDArray[np.intp]
    part: FloatArray


def _places(x: FloatArray, nodes: FloatArray) -> GridPlaces:
    at = np.interp(x, nodes, np.arange(len(nodes)))
    below = np.minimum(at.astype(np.intp), len(nodes) - 2)
    return GridPlaces(below, at - below)


def _places_c(variance: FloatArray) -> GridPlaces:
    return _places(0.5 * np.log(variance), np.log(SIGMAS_C))


def _places_t(variance: FloatArray) -> GridPlaces:
    return _places(np.sqrt(variance), SIGMAS_T)


def _smaller_sigmas() -> list[tuple[FloatArray, FloatArray]]:
    """For each of `_NEW_PARTS`, matrices that move probabilities to the sigmas of the new part."""
    moves = []
    for part in _NEW_PARTS:
        pair = []
        for places in (_places_c(part * SIGMAS_C**2), _places_t(part * SIGMAS_T**2)):
            move = np.zeros((len(places.part), len(places.part)))
            rows = np.arange(len(places.part))
            move[rows, places.below] = 1 - places.part
            move[rows, places.below + 1] += places.part
            pair.append(move)
        moves.append((pair[0], pair[1]))
    return moves


_SMALLER = _smaller_sigmas()


@dataclass(frozen=True, eq=False)
class StrayModel:
    """One hypothesis of the constants behind an array's strays.

    Attributes
    ----------
    log_weight : float
        Logarithm of its probability.
    constants : (channels, 4) float64
        Mean of phase (radians), offset along x and y (mm) and delay (s) of each channel.
    covariance : (4, 4) float64
        Of these, as parts of `variance`.
    prior : (4,) float64
        The same before the first slide: its diagonal.
    variance : (2,) float64
        Variance on the first slide of what channels and of what taxels stray by, radians^2.
    log_sigmas : (sigmas_c, sigmas_t) float64
        Logarithms of the probabilities of the standard deviations of the part that is new at each slide.
    is_new : bool
        True before the first slide.
    """

    log_weight: float
    constants: FloatArray
    covariance: FloatArray
    prior: FloatArray
    variance: FloatArray
    log_sigmas: FloatArray
    is_new: bool = True

    def mean(self, slides: FloatArray) -> FloatArray:
        """Strays to expect: (channels, slides), radians; `slides` are rows of `slide_terms`."""
        return np.asarray(self.constants @ slides.T)

    def places(self, slides: FloatArray) -> tuple[GridPlaces, GridPlaces]:
        """Places of the sigmas about that mean on their grids: (slides, sigmas_c) and (slides, sigmas_t)."""
        unknown = np.einsum("wa,ab,wb->w", slides, self.covariance, slides)[:, np.newaxis]
        unknown = np.maximum(unknown, 0.0)  # against rounding
        return (
            _places_c(SIGMAS_C**2 + unknown * self.variance[0]),
            _places_t(SIGMAS_T**2 + unknown * self.variance[1]),
        )

    def learn(
        self, slide: FloatArray, off: FloatArray, noise: float, log_sigmas: FloatArray, log_weight: float
    ) -> "StrayModel":
        """The hypothesis after a slide that differs by `off` (channels,) from the mean; not normalised."""
        new = (float((np.exp(log_sigmas) * VARIANCES).sum()) + noise) / self.variance.sum()
        pull = self.covariance @ slide
        size = float(slide @ pull)
        # Before the first slide nothing is expected of what it shows. A prior would shrink strays, those of a
        # wrong wave more, and would then count as evidence on every later slide.
        gain = pull / (size if self.is_new else size + new)
        kept = np.eye(len(slide)) - np.outer(gain, slide)
        return replace(
            self,
            log_weight=log_weight,
            constants=self.constants + np.outer(off, gain),
            covariance=(1 - _WALK) * (kept @ self.covariance @ kept.T + new * np.outer(gain, gain))
            + _WALK * np.diag(self.prior),
            log_sigmas=carried(log_sigmas),
            is_new=False,
        )


def slide_terms(k: FloatArray, omega: float) -> FloatArray:
    """Factors of phase, offset and delay in the strays of waves (waves, 2) at `omega`: (waves, 4)."""
    return np.column_stack([np.ones(len(k)), k, np.full(len(k), omega)])


def begin_models(
    slide: FloatArray, off: FloatArray, noise: float, log_sigmas: FloatArray, log_weight: float
) -> list[StrayModel]:
    """Hypotheses after a first slide, one for each case of what may repeat.

    All waves of the slide get the same `log_sigmas`. With sigmas of their own, the wave with the smallest
    strays would gain at every later slide, although strays that repeat do not tell waves apart.
    """
    probability = np.exp(log_sigmas)
    variance = np.array(
        [
            (probability.sum(axis=1) * SIGMAS_C**2).sum(),
            (probability.sum(axis=0) * SIGMAS_T**2).sum(),
        ]
    )
    new = sum(by_c.T @ probability @ by_t for by_c, by_t in _SMALLER) / len(_SMALLER)
    with np.errstate(divide="ignore"):
        log_new = np.log(new)
    size = np.array([1.0, slide[1] ** 2 + slide[2] ** 2, slide[3] ** 2])
    models = []
    for case in _CASES:
        prior = (case / np.maximum(size, _TINY))[[0, 1, 1, 2]]
        nothing = StrayModel(
            log_weight - np.log(len(_CASES)),
            np.zeros((len(off), len(prior))),
            np.diag(prior),
            prior,
            variance,
            log_new,
        )
        models.append(nothing.learn(slide, off, noise, log_new, nothing.log_weight))
    return models


@dataclass(frozen=True, eq=False)
class LearntStrays:
    """Knowledge from slides about the strays of an array's channels.

    Attributes
    ----------
    channel : (channels,) int64
        Numbers of the channels that were used. Slides that use others begin anew.
    log_sigmas : (sigmas_c, sigmas_t) float64
        Logarithms of the probabilities of the standard deviations of strays of which nothing else is known.
    repeat : float
        Probability that strays repeat.
    models : tuple of StrayModel
        Hypotheses of what repeats, with weights that sum to 1.
    lost : float
        Probability of the hypotheses that were dropped.
    """

    channel: NDArray[np.int64]
    log_sigmas: FloatArray
    repeat: float = _REPEAT
    models: tuple[StrayModel, ...] = ()
    lost: float = 0.0

    def among(self, channel: NDArray[np.int64]) -> "LearntStrays":
        """Return the memory of a part of the channels; without hypotheses if others are among them."""
        if np.array_equal(channel, self.channel):
            return self
        rows = np.searchsorted(self.channel, channel)
        is_known = len(rows) and rows[-1] < len(self.channel) and (self.channel[rows] == channel).all()
        kept = self.models if is_known else ()
        models = tuple(replace(model, constants=model.constants[rows]) for model in kept)
        return replace(self, channel=channel, models=models)

    @property
    def log_weights(self) -> FloatArray:
        """Return log probabilities of strays of which nothing else is known, and of each model."""
        if not self.models:
            return np.zeros(1)
        known = self.repeat * (1 - _CHANGED)
        return np.array([np.log1p(-known), *(np.log(known) + model.log_weight for model in self.models)])

    def after(
        self,
        log_sigmas: FloatArray,
        alone: float,
        known: float,
        begun: list[StrayModel],
        learnt: list[StrayModel],
    ) -> "LearntStrays":
        """Return the memory after a slide.

        Parameters
        ----------
        log_sigmas : (sigmas_c, sigmas_t) float64
            Posterior of the slide alone.
        alone, known : float
            Logarithms of the evidence of the slide alone and of that given the hypotheses, over all waves.
        begun, learnt : list of StrayModel
            Hypotheses that begin with this slide and those that continue, each weighed with the evidence of
            the slide (begun) and with that times the earlier weight (learnt); the likeliest of them.
        """
        repeat, total = self.repeat, alone
        if self.models:
            changed, same = np.log(_CHANGED), np.log1p(-_CHANGED)
            total = float(np.logaddexp(same + known, changed + alone))
            repeat = special.expit(float(np.log(repeat) - np.log1p(-repeat) + total - alone))
            begun = [replace(model, log_weight=model.log_weight + changed) for model in begun]
            learnt = [replace(model, log_weight=model.log_weight + same) for model in learnt]
        kept = sorted([*begun, *learnt], key=lambda model: -model.log_weight)[:MOST_MODELS]
        kept_total = float(np.logaddexp.reduce([model.log_weight for model in kept]))
        # What was dropped matters as long as the strays of the array have not changed since.
        before = (1 - _CHANGED) * self.lost
        lost = before + max(0.0, 1 - float(np.exp(kept_total - total)))
        if lost > _MOST_LOST:
            return replace(self, log_sigmas=carried(log_sigmas), lost=before)
        return LearntStrays(
            self.channel,
            carried(log_sigmas),
            float(np.clip(repeat, _LEAST_REPEAT, 1 - _LEAST_REPEAT)),
            tuple(replace(model, log_weight=model.log_weight - kept_total) for model in kept),
            lost,
        )
