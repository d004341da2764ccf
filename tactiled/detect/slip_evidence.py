"""Has shear begun to grow, over all the array and beyond noise, pressure and elastic play?

At every scan and for every ramp of `slip_filters` the question is put anew; a ramp that passes all of these
is evidence of slip:

1. Likelihood ratio. The sum over x, y and turn of (output / its standard deviation)^2 is, under noise, a
   chi-square variable with one degree of freedom an axis. Its threshold follows from the false alarms an hour
   that the user allows, counting `_LOOKS_A_SCAN` independent looks a scan. What the ramp's standard deviation
   is, the noise floor says (`slip_floor`), octave by octave.
2. Size. With the shear there already in its direction, the rise reaches `least_shear` of the pressure, and a
   fifth of that by itself. A tenth of the contact slips when shear has
   reached 15 % of what friction bears (Mindlin's curve at x = 0.1), which on the 2019 array is a shear over
   pressure of 0.07 at friction 0.3 and of 0.25 at 0.9. Below, shear may grow and go with nothing slipping,
   and no feature of the signal tells friction beforehand: this is the setting's trade of early against
   sure. Back from shear that is there already it takes twice as much (Masing 1926: reversed, a loaded joint
   follows its first curve doubled).
3. Opposed. The rise is larger than what the pressure's rise over the same ramp can leak into it: `_COMMON`
   of it by unequal resistors, and the shear there already, which goes with the pressure.
4. Shared. The taxels agree on it, and no few of many have it alone: a spike, a loose wire or a reading that
   sticks is no slip of the contact.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tactiled.array import Array, FloatArray
from tactiled.detect.quantise import Held
from tactiled.detect.slip_filters import LEVELS, N_BASELINE, Filters
from tactiled.detect.slip_floor import NoiseFloor
from tactiled.detect.slip_limit import Limit
from tactiled.detect.slip_response import AXES, PRESSURE, Response, motion, moved, responses

# Ramps of all lengths overlap from scan to scan: measured on white noise
# (tests/detect/test_detect_slip_parts.py).
_LOOKS_A_SCAN = 4.0
# Resistors of a hand-made array are 5 % unequal; one taxel alone then leaks 0.07 of the pressure, and a
# tilting load leaks more than an even one.
_COMMON = 0.25
_UNEQUAL = 0.07  # what such resistors show of shear, over pressure, where there is none
_NEWS = 0.2  # a load that has grown slowly, over more than the longest ramp, still grows by so much of it
# A spike on all channels has no common direction: of nine random ones a third agrees, seldom more than this.
_AGREE = 0.6
# Of the taxels that are pressed by this part of the mean or more, a third must take part beyond the first:
# what one shows alone, or two that share a spark, is a fault of their own.
_LOADED, _TAKE_PART = 0.25, 1 / 3


@dataclass(frozen=True, eq=False)
class Stretch:
    """Scans between which no taxel comes or goes.

    Attributes
    ----------
    scans : slice
        Of the block.
    jump : (7,) float64
        By which the response at one and the same scan differs from that of the stretch before.
    steps : (window - 1 + n, channels) float64
    seen : (window - 1 + n, 7) float64
        Their responses.
    """

    scans: slice
    jump: FloatArray
    steps: FloatArray
    seen: FloatArray
    ramps: FloatArray  # (n, 3, ramps)
    rises: FloatArray  # (n, 4, ramps): what rose along each ramp; the last is the pressure
    fits: NDArray[np.bool_]  # (n, ramps): large and opposed enough
    details: FloatArray  # (n, 3, levels)


@dataclass(frozen=True, eq=False)
class Growth:
    """Evidence of slip at a scan: the ramp that shows it best.

    Attributes
    ----------
    scans : int
        Length of the ramp.
    rise : (3,) float64
        Of x, y and turn.
    change : (channels,) float64
        What each reading rose, in steps.
    statistic : float
    """

    scans: int
    rise: FloatArray
    change: FloatArray
    statistic: float


class Evidence:
    """The response of the newest scans, and what rises in it.

    Parameters
    ----------
    array : Array
    rate_hz : float
    false_alarms_per_hour, least_shear : float

    Attributes
    ----------
    shear_weights : (2, taxels, channels) float64
        Readings to each taxel's own response.
    taxels : (taxels,) bool
        Those that make the response now.
    weights : (7, channels) float64
    even : (7,) float64
        Response of an even pressure of 1.
    threshold : float
        Of the statistic.
    window : int
        Scans that are kept.
    """

    def __init__(
        self, array: Array, rate_hz: float, false_alarms_per_hour: float, least_shear: float
    ) -> None:
        self._response = Response(array)
        self._array = array
        self.shear_weights = array.shear_weights()
        self._normal_weights = array.normal_weights()
        self._chance = false_alarms_per_hour / (3600 * rate_hz * _LOOKS_A_SCAN)
        self._least = least_shear
        self._filters = Filters(rate_hz)
        self.window = self._filters.window
        self._floor = NoiseFloor(len(LEVELS), AXES, rate_hz)
        self._ramp_sd = self._filters.ramp_sd(self._floor.sd)
        self._steps = np.zeros((0, array.n_channels))
        self._newest_bad = np.full(array.n_taxels, -self.window - 1)
        self._n_seen = 0
        self._choose(np.zeros(array.n_taxels, dtype=np.bool_))

    def _choose(self, taxels: NDArray[np.bool_]) -> None:
        self.taxels = taxels
        self.weights = self._response.weights(taxels)
        axes = max(1, int((motion(self.weights.T) != 0).any(axis=0).sum()))
        self.even = self.weights @ self._response.pressed
        self.threshold = float(chi2.isf(self._chance, axes))

    def stretches(self, held: Held) -> Iterator[Stretch]:
        """Take in the scans of a block."""
        if not len(self._steps):
            self._steps = np.repeat(held.steps[:1], self.window - 1, axis=0)
        clean = self._clean(held.ok)
        changes = np.flatnonzero((clean[1:] != clean[:-1]).any(axis=1)) + 1
        bounds = [0, *changes.tolist(), len(clean)]
        for a, b in itertools.pairwise(bounds):
            yield self._stretch(slice(a, b), held.steps[a:b], clean[a])

    def _clean(self, ok: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Taxels (n, taxels) whose channels are good, and were for as long as the filters see."""
        whole = self._response.whole_taxels(ok)
        scans = np.arange(self._n_seen, self._n_seen + len(ok))[:, np.newaxis]
        self._n_seen += len(ok)
        newest_bad = np.maximum.accumulate(np.where(whole, self._newest_bad, scans), axis=0)
        self._newest_bad = newest_bad[-1].copy()
        return np.asarray(scans - newest_bad > self.window)

    def _stretch(self, scans: slice, steps: FloatArray, taxels: NDArray[np.bool_]) -> Stretch:
        jump = np.zeros(self.weights.shape[0])
        if (taxels != self.taxels).any():
            before = responses(self.weights, self._steps[-1:])
            self._choose(taxels)
            jump = (responses(self.weights, self._steps[-1:]) - before)[0]
        n = len(steps)
        steps = np.concatenate([self._steps, steps])
        self._steps = steps[n:]
        seen = responses(self.weights, steps)
        axes = np.concatenate([motion(seen), seen[:, PRESSURE:]], axis=1)
        ramps, details = self._filters.apply(axes)
        rises = ramps * self._filters.rise_scale
        fits = self._fits(rises, axes[self.window - 1 :])
        return Stretch(scans, jump, steps, seen, ramps[:, :AXES], rises, fits, details[:, :AXES])

    def _fits(self, rises: FloatArray, now: FloatArray) -> NDArray[np.bool_]:
        rise = rises[:, :AXES]
        pressure = np.maximum(now[:, AXES:], 1.0)
        start = now[:, :AXES, np.newaxis] - rise
        size, there = _size(rise), _size(start)
        along = (start * rise).sum(axis=1) / np.maximum(size * there, 1.0)  # cosine
        is_back = (along < -0.5) & (there > self._least * pressure)
        reached = size + np.where(along > 0.5, np.maximum(there - _UNEQUAL * pressure, 0.0), 0.0)
        leak = _COMMON + there / pressure
        return np.asarray(
            (reached >= self._least * pressure * np.where(is_back, 2.0, 1.0))
            & (size >= _NEWS * self._least * pressure)
            & (size >= leak * np.abs(rises[:, AXES]))
        )

    def growth(self, stretch: Stretch, scan: int, since: int, least: float) -> Growth | None:
        """Evidence at a scan of a stretch.

        Parameters
        ----------
        stretch : Stretch
        scan : int
        since : int
            Scans that may count: what was before is told already.
        least : float
            Least rise, in steps.
        """
        fits = stretch.fits[scan] & (self._filters.lengths + N_BASELINE <= since)
        if not fits.any():
            return None
        rises = stretch.rises[scan]
        fits &= _size(rises[np.newaxis, :AXES])[0] >= least
        statistic = np.where(fits, ((stretch.ramps[scan] / self._ramp_sd) ** 2).sum(axis=0), 0.0)
        best = int(np.argmax(statistic))
        if statistic[best] < self.threshold:
            return None
        seen = stretch.seen[scan : scan + self.window]
        rise = moved(seen[-1] - self._filters.rise(best, seen), seen[-1])
        change = self._filters.rise(best, stretch.steps[scan : scan + self.window])
        if not self._is_shared(rise, change, stretch.steps[scan + self.window - 1]):
            return None
        return Growth(int(self._filters.lengths[best]), rise, change, float(statistic[best]))

    def shares(self, along: FloatArray, change: FloatArray) -> FloatArray:
        """What each taxel (taxels,) adds to a change of the readings (channels,), along a vector (3,)."""
        weights = along @ motion(self.weights.T).T
        taxel = self._array.channel_taxel
        return np.asarray(np.bincount(taxel, weights=weights * change, minlength=self._array.n_taxels))

    def limit(self, along: FloatArray, start: FloatArray, late: FloatArray) -> Limit:
        """Of a slip along a unit vector (3,) that began at readings (channels,), each so late in a scan."""
        weights = along @ motion(self.weights.T).T
        each = np.eye(self._array.n_taxels)[:, self._array.channel_taxel] * weights
        felt = self.taxels & self._array.has_shear
        size = np.abs(each[felt])
        mean_late = size @ late / np.maximum(size.sum(axis=1), 1e-9)
        return Limit(each[felt], self._normal_weights[felt], start, mean_late)

    def _is_shared(self, rise: FloatArray, change: FloatArray, steps: FloatArray) -> bool:
        """Whether the taxels agree, and not a few of many have it alone.

        Shares that are equal on n taxels and nothing elsewhere have ``sum^2 / sum of squares = n``.
        """
        shares = self.shares(rise, change)
        total = float(shares.sum())
        if total < _AGREE * float(np.abs(shares).sum()):
            return False
        load = self._normal_weights @ steps
        n_loaded = int((load > _LOADED * load[self.taxels].mean()).sum())
        taking_part = total**2 / float(shares @ shares)
        return n_loaded < 2 or taking_part >= 1 + _TAKE_PART * (n_loaded - 1)

    def learn(self, details: FloatArray, disturbed: bool) -> None:
        """Noise of a scan: its details (3, levels), and whether something happened."""
        if self._floor.take(details, disturbed):
            self._ramp_sd = self._filters.ramp_sd(self._floor.sd)

    def noise(self, along: FloatArray) -> float:
        """Standard deviation of a scan's response along a unit vector (3,)."""
        return float(np.sqrt((along * self._floor.sd[0]) @ (along * self._floor.sd[0])))


def _size(axes: FloatArray) -> FloatArray:
    """Length of vectors (n, 3, ramps)."""
    return np.asarray(np.sqrt((axes**2).sum(axis=1)))
