"""Scores of the contact filter on worlds whose truth is known."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.report import rms
from bench.worlds.world import World
from tactiled.array import FloatArray
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.learnt import Learnt

RECALL = 0.8
_EARLY_S, _LATE_S = 0.1, 0.3  # before and after the beginning of gross slip: an alarm then finds it
_OFF_S = 0.08
_ANNOUNCED_S = 0.02  # between values that a hand announces
_NEW_S = 2.0  # from the beginning of a slide: later, the object has left the hand, or slides where it should
_USED = 0.5  # utilisation from which its error counts
_RANKS, _RESAMPLES = 1000, 400  # the area differs by less than 0.001 from that of all ranks


@dataclass(frozen=True, eq=False)
class Course:
    """Answers for one world, by scan in contact, beside the truth."""

    world: World
    at: NDArray[np.int64]
    p_sliding: FloatArray
    quantiles: FloatArray
    p_gross_300ms: FloatArray
    told_gross: NDArray[np.bool_]
    ratio: FloatArray

    @property
    def slides(self) -> NDArray[np.bool_]:
        """Truth."""
        return self.world.gross[self.at]

    @property
    def slid_before(self) -> NDArray[np.bool_]:
        """A slide came and went before the scan."""
        ends = np.diff(self.slides.astype(int), prepend=0) < 0
        return np.logical_or.accumulate(ends)

    @property
    def has_new(self) -> NDArray[np.bool_]:
        """Scans without a slide, or in the first seconds of one.

        A few worlds slide evenly for half a minute, and have most of the time that slides.
        """
        gross, scans = self.world.gross, np.arange(len(self.world.gross))
        begun = np.maximum.accumulate(np.where(np.diff(gross.astype(int), prepend=0) > 0, scans, 0))
        return np.asarray(~gross | (scans - begun < _NEW_S * self.world.rate_hz))[self.at]

    @property
    def utilisation(self) -> FloatArray:
        """Truth; 1 while all slides."""
        return self.world.used(self.at)

    @property
    def soon(self) -> NDArray[np.bool_]:
        """Gross slip begins within 300 ms."""
        return self.world.ahead_s(self.at) <= 0.3


def course(
    world: World, learnt: Learnt | None = None, params: GripParams | None = None, *, announces: bool = False
) -> Course:
    """Run the contact filter over a world, with the shipped trees where none are given.

    A hand that announces does so with its acceleration, where the world has one.
    """
    detector = GripDetector(world.array, params, learnt)
    if announces:
        at = np.flatnonzero(np.isfinite(world.acceleration_m_s2))[
            :: max(1, round(_ANNOUNCED_S * world.rate_hz))
        ]
        if len(at):
            detector.motion.announce(world.block.time_s[at], world.acceleration_m_s2[at])
    rows, scans = [], []
    for scan, event in enumerate(detector.scans(world.block)):
        contact = detector.contact
        if contact is None or event is None or event.state == "none":
            continue
        scans.append(scan)
        used = event.utilisation_low, event.utilisation, event.utilisation_high
        p = contact.p_sliding_now
        rows.append((p, *used, event.p_gross_300ms, event.state == "gross", contact.size))
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 7)
    seen = np.array(scans, dtype=np.int64)
    return Course(world, seen, table[:, 0], table[:, 1:4], table[:, 4], table[:, 5] > 0, table[:, 6])


class Score(NamedTuple):
    """Scores of many worlds."""

    auc: float  # of the probability of sliding, scan by scan
    auc_interval: tuple[float, float]  # of 90 %, for other worlds of the same generator
    auc_new: float  # in the first seconds of slides
    skill_300ms: float  # Brier skill of gross slip in 300 ms, where nothing slides and nothing is said to
    # used_rms, coverage: utilisation from 0.5: error of the median, part within the interval of 90 %
    used_rms: float
    friction_rms: float  # the same error of the ratio over the true friction of the scan, without any filter
    used_rms_later: float  # the same error after a first slide in the world; NaN without one
    coverage: float
    told_gross: float  # part of the sliding time in which the state is gross
    told_gross_new: float  # of the first seconds of slides
    rests_while_gross: float  # part of the time with that state in which not all of the contact slides
    # false gross slips in an hour of contact at a recall of 80 %; NaN where that is never reached
    false_per_h: float
    # gross slips an hour at the setting, in worlds that never use half of the limit
    resting_false_per_h: float


def score(courses: Sequence[Course]) -> Score:
    """Score courses of one generator."""
    from sklearn.metrics import roc_auc_score  # takes seconds to load

    p = np.concatenate([c.p_sliding for c in courses])
    slides = np.concatenate([c.slides for c in courses])
    used = np.concatenate([c.utilisation for c in courses])
    quantiles = np.concatenate([c.quantiles for c in courses])
    told = np.concatenate([c.told_gross for c in courses])
    asked = ~slides & ~told  # while a gross slip is open, nothing is forecast
    ahead = np.concatenate([c.p_gross_300ms for c in courses])[asked]
    soon = np.concatenate([c.soon for c in courses])[asked]
    new = np.concatenate([c.has_new for c in courses])
    later = np.concatenate([c.slid_before for c in courses])
    high = used >= _USED
    error = quantiles[high, 1] - used[high]
    inside = (quantiles[high, 0] - 1e-9 <= used[high]) & (used[high] <= quantiles[high, 2] + 1e-9)
    by_friction = np.concatenate([np.minimum(c.ratio / c.world.friction[c.at], 1.0) for c in courses])
    calm = [c for c in courses if len(c.at) and c.utilisation.max() < _USED]
    hours = sum(len(c.at) / c.world.rate_hz for c in calm) / 3600
    return Score(
        auc=float(roc_auc_score(slides, p)),
        auc_interval=_auc_interval(courses),
        auc_new=float(roc_auc_score(slides[new], p[new])),
        skill_300ms=_skill(ahead, soon),
        used_rms=rms(error),
        friction_rms=float(np.sqrt(np.nanmean((by_friction[high] - used[high]) ** 2))),
        used_rms_later=rms(error[later[high]]),
        coverage=float(np.mean(inside)),
        told_gross=float(told[slides].mean()),
        told_gross_new=float(told[slides & new].mean()),
        rests_while_gross=float((told & ~slides).sum() / max(told.sum(), 1)),
        false_per_h=_false_per_h(courses),
        resting_false_per_h=sum(int(np.sum(np.diff(c.told_gross.astype(int), prepend=0) > 0)) for c in calm)
        / max(hours, 1e-9),
    )


def _auc_interval(courses: Sequence[Course]) -> tuple[float, float]:
    """Return the interval of 90 % of the area, by resampling whole worlds (bootstrap; Efron 1979).

    Scans of one world are alike, and a few worlds have most of the time that slides.
    """
    bounds = np.quantile(np.concatenate([c.p_sliding for c in courses]), np.linspace(0, 1, _RANKS + 1)[1:-1])
    counts = np.zeros((len(courses), 2, _RANKS))  # scans at rest and in slides, by rank of the probability
    for c, of_world in zip(courses, counts, strict=True):
        np.add.at(of_world, (c.slides.astype(int), np.searchsorted(bounds, c.p_sliding)), 1)
    n = len(courses)
    picked = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), size=_RESAMPLES)
    rests, slides = np.moveaxis(np.tensordot(picked, counts, 1), 1, 0)
    below = np.cumsum(rests, axis=1) - rests / 2
    areas = (slides * below).sum(axis=1) / np.maximum(slides.sum(axis=1) * rests.sum(axis=1), 1)
    low, high = np.quantile(areas, (0.05, 0.95))
    return float(low), float(high)


def _skill(p: FloatArray, truth: NDArray[np.bool_]) -> float:
    base = truth.mean()
    return float(1 - np.mean((p - truth) ** 2) / max(base * (1 - base), 1e-12))


def _false_per_h(courses: Sequence[Course]) -> float:
    """Return the fewest false gross slips an hour of the thresholds that reach the recall."""
    hours = sum(len(c.at) / c.world.rate_hz for c in courses) / 3600
    n = sum(len(c.world.gross_s) for c in courses)
    points = []
    for threshold in (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95):
        found, wrong = np.sum([_alarms(c, threshold) for c in courses], axis=0)
        points.append((found / max(n, 1), wrong / hours))
    return min((false for recall, false in points if recall >= RECALL), default=float("nan"))


def _alarms(c: Course, threshold: float) -> tuple[int, int]:
    """Return true slips that an alarm finds, and alarms without a slip."""
    rate = c.world.rate_hz
    n_off = max(1, round(_OFF_S * rate))
    alarms: list[int] = []  # first scan of each
    is_open, low, last = False, 0, -1
    for at, p in zip(c.at.tolist(), c.p_sliding.tolist(), strict=True):
        is_open = is_open and at == last + 1  # another contact ends it
        last = at
        if is_open:
            low = low + 1 if p < threshold / 2 else 0
            is_open = low < n_off
        elif p >= threshold:
            is_open, low = True, 0
            alarms.append(at)
    begin = np.array(alarms) / rate
    found = sum(bool(np.any((begin >= t - _EARLY_S) & (begin <= t + _LATE_S))) for t in c.world.gross_s)
    reach = round(_LATE_S * rate)
    gross = c.world.gross
    wrong = sum(not gross[max(0, a - reach) : a + reach + 1].any() for a in alarms)
    return found, wrong
