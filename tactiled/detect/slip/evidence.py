"""Detection of shear that grows by more than noise, pressure and elastic deformation explain.

Every ramp of `slip.filters` is tested at every scan. A ramp that passes all of these tests is evidence of
slip:

1. Likelihood ratio. The sum over x, y and turn of (output / its standard deviation)^2 is, under noise, a
   chi-square variable with one degree of freedom for each axis. Its threshold follows from the permitted
   false alarms an hour, with `_LOOKS_A_SCAN` independent tests a scan. The standard deviations come from the
   noise floor (`slip.noise_floor`), octave by octave.
2. Size. Together with the shear already present in its direction, the rise reaches `least_shear` of the
   pressure, and by itself a fifth of that. A tenth of the contact slips at a shear of 15 % of the friction
   limit (Mindlin's curve at x = 0.1); on the 2019 array that is a shear over pressure of 0.07 at a friction
   coefficient of 0.3, and of 0.25 at 0.9. Smaller changes of shear happen without any slip, and no feature
   of the signal gives the friction coefficient beforehand: `least_shear` trades early against certain. A
   rise against the shear already present must be twice as large (Masing 1926: on reversal, a loaded joint
   follows its first curve, doubled).
3. Opposed. The rise is larger than what the rise of pressure over the same ramp can leak into it: a part of
   it (`slip.rises`) through unequal resistors, and the shear already present, which is proportional to
   pressure.
4. New. The ramp also passes the first test with the noise of the scans just before it, so that a hum that
   swells, an arm that shakes, and noise that grew suddenly are compared with themselves before the noise
   floor has followed.
5. Shared. The taxels agree on the rise, and it is not confined to a few of many: a spike, a loose wire or a
   stuck reading is no slip of the contact.
6. Lasting. The rise is as large without what came and went within one scan, because a spike in the middle of
   a ramp may look shared.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect import special
from tactiled.detect.signal.quantise import HeldReadings
from tactiled.detect.slip.filters import N_BASELINE, lasting
from tactiled.detect.slip.friction_limit import FrictionLimitTest
from tactiled.detect.slip.response import AXES, motion, moved
from tactiled.detect.slip.rises import RiseTest, length
from tactiled.detect.slip.segments import BEFORE_SCANS, ResponseSegmenter, TaxelSetSegment

# Ramps of all lengths overlap from scan to scan: measured on white noise
# (tests/detect/test_detect_slip_parts.py).
_LOOKS_A_SCAN = 1.5
# Of 1575 onsets of the physical families, seeds 1001 to 1006, at 0.3 to 10 mV, the least kept 0.90; of 16
# that spikes raised in holds of the same seeds the most kept 0.69.
_LASTS = 0.8
# A spike on all channels has no common direction: of nine random ones a third agrees, seldom more than this.
_AGREE = 0.6
_MEAN_OF_NORMAL = 0.798  # mean size over standard deviation
# Levels that measure the noise before a ramp; coarser ones still respond to earlier loads.
_FINE_LEVELS = 3
# Of the taxels that bear at least this part of the mean load, a third must take part beyond the first: a rise
# of one taxel alone, or of two that share a disturbance, is a fault of those taxels.
_LOADED, _TAKE_PART = 0.25, 1 / 3


@dataclass(frozen=True, eq=False)
class ShearGrowth:
    """Growth of shear at a scan, from the ramp with the largest statistic.

    Attributes
    ----------
    ramp, scans : int
        Number of the ramp, and its length in scans.
    rise : (3,) float64
        Rise of x, y and turn.
    change : (channels,) float64
        Rise of each reading, in steps.
    statistic : float
    """

    ramp: int
    scans: int
    rise: FloatArray
    change: FloatArray
    statistic: float


class ShearEvidence:
    """Test whether shear grows at the newest scans.

    Parameters
    ----------
    array : Array
    rate_hz : float
    noise_per_hour : float
        False alarms that noise alone may raise.
    least_shear : float

    Attributes
    ----------
    shear_weights : (2, taxels, channels) float64
        Readings to each taxel's own response.
    window : int
        Scans that are kept.
    longest : int
        Scans of the longest ramp.
    """

    def __init__(self, array: Array, rate_hz: float, noise_per_hour: float, least_shear: float) -> None:
        self._array = array
        self.shear_weights = array.shear_weights()
        self._normal_weights = array.normal_weights()
        self._chance = noise_per_hour / (3600 * rate_hz * _LOOKS_A_SCAN)
        self._segmenter = ResponseSegmenter(array, rate_hz, RiseTest(least_shear))
        self._filters = self._segmenter.filters
        self.window, self.longest = self._filters.window, self._filters.longest
        self._ramp_sd = self._filters.ramp_sd(self._segmenter.axes_sd)

    @property
    def taxels(self) -> NDArray[np.bool_]:
        """Taxels (taxels,) included in the response now."""
        return self._segmenter.taxels

    @property
    def weights(self) -> FloatArray:
        """Weights (7, channels) from readings to the response."""
        return self._segmenter.weights

    @property
    def even(self) -> FloatArray:
        """Response (7,) of an even pressure of 1."""
        return self._segmenter.even

    @property
    def threshold(self) -> float:
        """Threshold of the statistic."""
        axes = int((motion(self.weights.T) != 0).any(axis=0).sum())
        return _threshold(self._chance, max(1, axes))

    def segments(self, held: HeldReadings) -> Iterator[TaxelSetSegment]:
        """Take in the scans of a block, each of which must be learnt from before the next segment."""
        return self._segmenter.cut(held)

    def growth(self, segment: TaxelSetSegment, scan: int, since: int, least: float) -> ShearGrowth | None:
        """Return the growth of shear at a scan of a segment, or None.

        Parameters
        ----------
        segment : TaxelSetSegment
        scan : int
        since : int
            Number of newest scans that may count; earlier ones were reported.
        least : float
            Least rise, in steps.
        """
        if not segment.any_fits[scan]:
            return None
        fits = segment.fits[scan] & (self._filters.lengths + N_BASELINE <= since)
        if not fits.any():
            return None
        rises = segment.rises[scan]
        fits &= length(rises[np.newaxis, :AXES])[0] >= least
        power = segment.ramps[scan] ** 2
        statistic = np.where(fits, (power / self._ramp_sd**2).sum(axis=0), 0.0)
        threshold = self.threshold
        if statistic.max() < threshold:
            return None
        sd = np.maximum(self._filters.ramp_sd(self._noise_before(segment, scan)), self._ramp_sd)
        statistic = np.where(fits, (power / sd**2).sum(axis=0), 0.0)
        best = int(np.argmax(statistic))
        if statistic[best] < threshold:
            return None
        seen = segment.seen[scan : scan + self.window]
        scans = int(self._filters.lengths[best])
        # A ramp laid through a swing is a fifth steeper than the swing is high.
        if least > 0 and length(moved(seen[-1 - scans], seen[-1])[np.newaxis])[0] < least:
            return None
        whole = self._filters.rise(best, seen)
        lasts, is_of = motion(self._filters.rise(best, lasting(seen))), motion(whole)
        if lasts @ is_of < _LASTS * (is_of @ is_of):
            return None
        rise = moved(seen[-1] - whole, seen[-1])
        change = self._filters.rise(best, segment.steps[scan : scan + self.window])
        if not self.is_shared(rise, change, segment.steps[scan + self.window - 1]):
            return None
        return ShearGrowth(best, scans, rise, change, float(statistic[best]))

    def _noise_before(self, segment: TaxelSetSegment, scan: int) -> FloatArray:
        """Return the standard deviation (ramps, levels, 3) of the noise just before each ramp began."""
        newest = len(segment.details) - len(segment.fits) + scan
        before = newest - self._filters.lengths[:, np.newaxis] - np.arange(BEFORE_SCANS)
        details = segment.details[before, :AXES]
        sizes = np.abs(details).mean(axis=1) / _MEAN_OF_NORMAL  # (ramps, 3, levels)
        sizes[..., _FINE_LEVELS:] = 0.0
        return np.asarray(np.maximum(sizes.swapaxes(1, 2), self._segmenter.axes_sd))

    def without_skew(self, growth: ShearGrowth, delay: float, late: FloatArray) -> ShearGrowth:
        """Correct a growth for the sampling times `late` (channels,), in scans, within each taxel.

        Of a slip that began one or two scans ago, the later of two pairs shows a tenth more. A slip counts as
        at least as old as the largest skew, or the correction would exceed the growth.
        """
        taxel = self._array.channel_taxel
        mean = np.bincount(taxel, weights=late) / np.bincount(taxel)
        skew = late - mean[taxel]
        if not skew.any():
            return growth
        less = growth.change * self._filters.later(growth.ramp, max(delay, float(np.abs(skew).max()))) * skew
        weights = motion(self.weights.T).T
        return replace(growth, rise=growth.rise - weights @ less, change=growth.change - less)

    def newest(self, n: int) -> FloatArray:
        """Return the last n readings (n, channels)."""
        return self._segmenter.newest(n)

    def shares(self, along: FloatArray, change: FloatArray) -> FloatArray:
        """Return the taxels' shares (taxels,) of a change of the readings (channels,) along a vector (3,)."""
        weights = along @ motion(self.weights.T).T
        taxel = self._array.channel_taxel
        return np.asarray(np.bincount(taxel, weights=weights * change, minlength=self._array.n_taxels))

    def limit(self, start: FloatArray, late: FloatArray) -> FrictionLimitTest:
        """Make the friction limit test of a slip that began at readings (channels,) sampled at `late`."""
        numbers = np.flatnonzero(self.taxels & self._array.has_shear)
        taxels = np.eye(self._array.n_taxels)[numbers]
        each = taxels[:, self._array.channel_taxel]
        return FrictionLimitTest(self.weights, numbers, each, taxels @ self._normal_weights, start, late)

    def is_shared(self, rise: FloatArray, change: FloatArray, steps: FloatArray) -> bool:
        """Return True if the taxels agree on a rise and not only a few of many show it.

        Shares that are equal on n taxels and nothing elsewhere have ``sum^2 / sum of squares = n``.
        """
        shares = self.shares(rise, change)
        total = float(shares.sum())
        if total <= 0 or total < _AGREE * float(np.abs(shares).sum()):
            return False
        load = self._normal_weights @ steps
        n_loaded = int((load > _LOADED * load[self.taxels].mean()).sum())
        taking_part = total**2 / float(shares @ shares)
        return n_loaded < 2 or taking_part >= 1 + _TAKE_PART * (n_loaded - 1)

    @property
    def n_to_group(self) -> int:
        """Scans until the noise floor changes."""
        return self._segmenter.n_to_group

    def learn(self, segment: TaxelSetSegment, row: int, n: int = 1, *, disturbed: bool) -> None:
        """Update the noise floor by n scans of a segment; `disturbed` while a slip is active.

        Not more than `n_to_group` scans.
        """
        if self._segmenter.learn(segment, row, n, disturbed=disturbed):
            self._ramp_sd = self._filters.ramp_sd(self._segmenter.axes_sd)

    def noise(self, along: FloatArray) -> float:
        """Return the standard deviation of a scan's response along a unit vector (3,)."""
        part = along * self._segmenter.axes_sd[0]
        return float(np.sqrt(part @ part))


@functools.cache
def _threshold(chance: float, axes: int) -> float:
    return special.chi_square_quantile(axes, chance)
