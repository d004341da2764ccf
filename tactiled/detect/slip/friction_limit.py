"""Test whether shear that stopped growing has reached the friction limit or is a steady load.

Both stand still at once, and the size of the shear tells only on surfaces of known friction. The taxels tell:
while the contact holds they move as one, and their shares of the shear stay; where it slips, the shares turn
towards what each taxel's load bears. By Mindlin's curve (Mindlin, J. Appl. Mech. 16, 1949), with s the shear
over friction's limit and ``x = 1 - (1 - s)^(2/3)`` the travel over that of gross slip, which grows as
``N^(2/3)`` of a ball's load,

    d log T / d log N = 1 - x sqrt(1 - x) / s,

a third at first, 0.46 when friction bears two thirds of its limit, 1 when all slips. So a taxel's shear is

    T = c s (1 + y h(s)),    h(s) = 3/2 (2/3 - x sqrt(1 - x) / s),

with a gain c of its own. c and y are a least-squares fit to the whole rise, s being the shear over where it
ended. If that was the limit, y is 2/3 of the logarithm of the taxel's load over the mean's, and strays from
that as much again, since pads tilt and are no balls; if it was not, y is next to nothing. The odds are those
of two normal distributions of all taxels' y, with what noise makes of them.

A skin that is dragged evenly rises ever slower; that speaks for slip too, if less. Few taxels, even
loads or a rise within some scans tell nothing. Taxels that share the shear by their loads from the start, as
in prescribed scenes of the emulator, have no such bend: their slips look like steady loads.
"""

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.slip.response import COLUMNS, PRESSURE, motion, moved, rising_half, unit


class _BendPrior(NamedTuple):
    """Prior of the taxels' y: slope over log load, and standard deviations of the scatter."""

    slope: float
    slope_sd: float
    strays: tuple[float, ...]  # standard deviations, each as likely


# Rounded from seeds 1001 to 1012 of loads that rest at 0.2 to 0.9 of the limit, that come evenly and at once,
# swing, ease off and come in two steps; and of seeds 1001 to 1006 of the physical families. There slopes are
# -0.1 to 0.2 and 0.1 to 1.1 (tenth to last tenth), strays 0.002 to 0.01 and 0.01 to 0.04.
_HOLDS = _BendPrior(0.05, 0.15, (0.003, 0.01))
_SLIPS = _BendPrior(0.5, 0.3, (0.012, 0.035))
# A rise has come to 0.4 of its end in 0.4 / 0.95 of the time to 0.95 if it is straight; by Mindlin's curve an
# evenly dragged skin in 0.7 of that. On the same seeds slips at even speed lie at 0.65 to 0.84, loads that
# come evenly at 0.87 to 1.03; loads may ease off as they like, so it counts for little.
_BENT, _BENT_ODDS = 0.86, 0.5
_EARLY, _LATE = 0.4, 0.95
START_SCANS = 9  # averaged before a rise
_LEAST_TAXELS = 7  # fewer tell too little of how they stray
_LEAST_ROWS = 5  # of a rise: what is faster is not of one instant
# Standard deviation of log loads below which all bear the same, and no share need turn where they slip: on
# physical families 0.012 to 0.06.
_EVEN = 0.008
_LOADED = 0.3  # of the mean load: taxels with less have shares that are mostly noise
_SEEN = 0.08  # of the rise: less is mostly noise, and hardly bends
# A side that loses its load ends at about half of the reading of the opposite side (`slip.response`). Below
# this part of it, its curve bends for that reason; then only the rising side is used, at twice the noise.
_BENDS_BELOW_PART = 0.6
_MOST_ROWS = 128  # kept of a rise: then two become one
_START_ROW = np.array([[0.0, 0.0, math.sqrt(START_SCANS)]])


class FrictionLimitTest:
    """Compare the taxels' shares of a growing shear with those at the friction limit.

    Parameters
    ----------
    weights : (7, channels) float64
        Readings to responses (`slip.response`), of the taxels that are read.
    numbers : (taxels,) int64
        Of the taxels that are read.
    taxels : (taxels, channels) float64
        1 where a channel is of a taxel.
    load : (taxels, channels) float64
        Readings to each taxel's load.
    start : (channels,) float64
        Readings before the shear grew, the mean of `START_SCANS`.
    late : (channels,) float64
        When in a scan each is read, in scans.
    """

    def __init__(
        self,
        weights: FloatArray,
        numbers: NDArray[np.int64],
        taxels: FloatArray,
        load: FloatArray,
        start: FloatArray,
        late: FloatArray,
    ) -> None:
        self._weights, self._numbers, self._taxels, self._load = weights, numbers, taxels, load
        self._start, self._late = start, late
        self._rows: list[FloatArray] = []  # scans since the start, readings
        self._sum = np.zeros(1 + len(start))
        self._n_summed, self._each = 0, 1  # scans that are a row

    @classmethod
    def unobserved(cls, n_channels: int) -> Self:
        """Make a test without data, for a rise that was not observed."""
        numbers, none, start = np.zeros(0, dtype=np.int64), np.zeros((0, n_channels)), np.zeros(n_channels)
        return cls(np.zeros((COLUMNS, n_channels)), numbers, none, none, start, start)

    def keep(self, read: NDArray[np.bool_]) -> None:
        """Keep only the taxels that are still read, by a mask (all,) of all taxels."""
        kept = read[self._numbers]
        self._numbers, self._taxels, self._load = self._numbers[kept], self._taxels[kept], self._load[kept]
        self._weights = self._weights * self._taxels.sum(axis=0)

    def take(self, scans: float, readings: FloatArray) -> None:
        """Add the readings (channels,) of a scan, `scans` after the onset of growth."""
        self._sum[0] += scans
        self._sum[1:] += readings
        self._n_summed += 1
        if self._n_summed < self._each:
            return
        self._rows.append(self._sum / self._each)
        self._sum, self._n_summed = np.zeros_like(self._sum), 0
        if len(self._rows) == _MOST_ROWS:
            pairs = zip(self._rows[::2], self._rows[1::2], strict=True)
            self._rows = [(first + second) / 2 for first, second in pairs]
            self._each *= 2

    def odds(self, rest: FloatArray) -> float | None:
        """Return the log odds of gross slip from the readings (n, channels) since the rise stopped.

        None if the data do not decide.
        """
        if len(self._rows) < _LEAST_ROWS or len(self._load) < _LEAST_TAXELS:
            return None
        rows = np.stack(self._rows)
        load = self._load @ np.concatenate([rows[:, 1:], rest]).mean(axis=0)
        shear = self._shear_to(rest.mean(axis=0))
        after = (rest - self._start) @ shear.T
        end = after.mean(axis=0)
        told = (end > 0) & (load > _LOADED * load.mean()) & (load > 0)
        if told.sum() < _LEAST_TAXELS or end.sum() <= 0:
            return None
        log_load = np.log(load[told])
        log_load -= log_load.mean()
        if log_load.std() < _EVEN:
            return None
        at, rise = rows[:, 0], self._without_skew(rows[:, 0], rows[:, 1:] - self._start, shear)
        risen = np.minimum(rise.sum(axis=1) / end.sum(), 1.0)
        seen = risen > _SEEN
        s = np.concatenate([risen[seen], np.ones(len(rest))])
        scans = np.concatenate([np.full(seen.sum(), float(self._each)), np.ones(len(rest))])
        bends = _fitted(s, np.concatenate([rise[seen], after])[:, told], scans)
        if bends is None:
            return None
        odds = _log_density(bends, log_load, _SLIPS) - _log_density(bends, log_load, _HOLDS)
        reached = np.interp([_EARLY, _LATE], np.maximum.accumulate(risen), at)
        is_bent = reached[0] / _EARLY < _BENT * reached[1] / _LATE
        return odds + (_BENT_ODDS if is_bent else 0.0)

    def _shear_to(self, now: FloatArray) -> FloatArray:
        """Weights (taxels, channels) of each taxel's shear along all that has come up to the readings now."""
        along = unit(moved(self._weights @ self._start, self._weights @ now))
        both = along @ motion(self._weights.T).T
        rising = rising_half(along) @ self._weights[:PRESSURE]
        bears_both = (rising - both) @ now >= _BENDS_BELOW_PART * (rising @ now)
        return self._taxels * (both if bears_both else 2 * rising)

    def _without_skew(self, at: FloatArray, risen: FloatArray, shear: FloatArray) -> FloatArray:
        """Correct the shear (rows, taxels) for the sampling times of the channels within a scan."""
        each = risen @ shear.T
        whole = each.sum(axis=1, keepdims=True)
        part = np.divide(each, whole, where=whole != 0, out=np.zeros_like(each))
        size = np.abs(shear)
        late = size @ self._late / np.maximum(size.sum(axis=1), 1e-9)
        return np.asarray(each - np.gradient(whole, at, axis=0) * part * late)


def _fitted(s: FloatArray, shear: FloatArray, scans: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Each taxel's y of the module's docstring, and what variance noise gives it: (taxels,) each.

    Parameters
    ----------
    s : (rows,) float64
    shear : (rows, taxels) float64
    scans : (rows,) float64
        That each row is the mean of.

    Returns
    -------
    None where a taxel's shear does not grow.
    """
    x = 1 - (1 - s) ** (2 / 3)
    bend = 1 - 1.5 * x * np.sqrt(1 - x) / s
    weight = np.sqrt(scans)[:, np.newaxis]
    # The start has noise, too: an offset, known as well as its scans tell.
    model = np.concatenate([np.stack([s, s * bend, np.ones_like(s)], axis=1) * weight, _START_ROW])
    seen = np.concatenate([shear * weight, np.zeros((1, shear.shape[1]))])
    inverse = np.linalg.pinv(model.T @ model)
    own, bent, offset = inverse @ (model.T @ seen)
    if (own <= 0).any():
        return None
    left = seen - model @ np.stack([own, bent, offset])
    variance = (left**2).sum() / (left.shape[1] * max(len(left) - len(model.T), 1))
    return bent / own, variance * inverse[1, 1] / own**2


def _log_density(fitted: tuple[FloatArray, FloatArray], log_load: FloatArray, bends: _BendPrior) -> float:
    """Return the log density of all taxels' y up to a constant, with a free common offset."""
    y, variance = fitted
    common = 1.0 + bends.slope_sd**2 * np.outer(log_load, log_load)
    off = y - bends.slope * log_load
    each = []
    for stray in bends.strays:
        covariance = np.diag(variance + stray**2) + common
        spread = float(np.linalg.slogdet(covariance)[1])
        each.append(-0.5 * (float(off @ np.linalg.solve(covariance, off)) + spread))
    return float(np.logaddexp.reduce(each) - math.log(len(each)))
