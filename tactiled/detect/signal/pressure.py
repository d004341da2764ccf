"""Contact gate: readings as whole steps, noise at rest and pressure of a block in one call, contact by scan.

`contact_gate` explains the rules. The file is plain Python, which
Cython compiles with the types of `pressure.pxd`, with the same bits (`tactiled.compiled`). Arrays are dense
and flat.
"""

from array import array
from collections.abc import Sequence
from math import ceil, exp, expm1, log2, sqrt
from typing import Any

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.front_end import LEAST_SIDES, Flags, Reals, counts, flags, zeros
from tactiled.events.types import ContactState

# derived: a number of less than 2^51, plus and minus this one, is rounded to the nearest whole number, halves
# to even.
_TO_WHOLE = 1.5 * 2.0**52
_INFINITE, _NO_NUMBER = float("inf"), float("nan")
# choice: a side is clipped to this multiple of the mean of the other sides of its taxel. With two sides fully
# relieved and their load on the third, the multiple would be three.
_ONE_SIDE = 5.0
READING_BITS = 23  # derived: with 24-bit filter coefficients, sums stay below 2^53: see `wavelet`
_UNKNOWN = 2.0**READING_BITS  # derived: full scale, in steps: no reading stands out of noise of that size
_GROUP_SCANS = 16  # choice
# derived: groups, of which a mean counts: chance states the noise of one group of white noise five times too
# small in two hours at 100 Hz, and that of 128 scans less than two times in a year.
_GROUPS = 8
# prior: wandering of readings at rest is measured over eight times as long: a second, and a hand leaves the
# skin alone for so long somewhere.
_MEAN_S = 0.16
_FEWEST_OF_MEAN = 4  # derived: scans, of which a mean has half of their noise
# prior: of the noise before it is known, that wandering is at most: 1/128 of the range
_WANDER_OF_EARLY = 0.5
_SECOND_DIFFERENCE = 6.0  # derived: variance of v[k] - 2 v[k + 1] + v[k + 2] over that of v, for white noise
ROUNDING = 1.0 / 12  # derived: variance of rounding to a step
_MEDIAN = 0.6745  # derived: of |x| of a normal variable of unit variance
# derived: second differences, of all channels, before their median counts: that of eight is less than a sixth
# of the true one once in 2,000 draws.
_FEWEST = 8
# derived: three standard deviations of the logarithm of that median, 1.63 each over the root of the second
# differences; neighbours among them share readings, which counts for half of them.
_LOG_DOUBT = 3.0 * 1.63
_MOST_POOLED = 36  # choice: channels whose second differences are sorted: 500 tell their median to 7 %
# derived: the noise of groups is stated up to two times too small, and levels allow for that.
_STATED_SMALL = 2.0
_MEANS = 8  # choice: whose second differences tell how far readings wander at rest
# choice: levels where neither the parameters nor the array file give any. Noise at rest is stated up to two
# times too small (`RestNoise`): this leaves 6 standard deviations.
CONTACT_SDS = 12.0
# derived: standard deviations of a swing of the readings that are no contact: as many as are left of noise
_SWING_SDS = CONTACT_SDS / _STATED_SMALL
# prior: a swing is of several hertz: within a second it passes this part of the level of contact above zero,
# below and above again, or the other way round. A press does so only on a zero that was taken under load;
# noise below zero does not.
_TURN, _LEAST_TURNS = 0.75, 2
# prior: a swing leaves its mean to both sides, to either by this part of the other at least, and its peak has
# at most so many standard deviations: short taps have more.
_BOTH_SIDES, _CREST = 0.5, 3.0
_SWING_S = 1.0  # choice: in which a swing at rest is looked for: one of 2 Hz shows both sides twice
_MOST_RESTS = 8  # choice: seconds at rest of which the swing is the mean
STOPPED = 0.25  # choice: of the power of an oscillation: less shows that it has stopped
_RELEASE_OF_CONTACT = 0.6  # choice: as the levels of the 2019 array, 0.15 V of 0.25 V
# physical: per second. Creep of rubber in a hold is below 1 % of the load per second; the slowest press of
# the 2019 paper, 20 N in 8 s, is 12 % of its final load per second.
_LOADING_OF_LOAD = 0.03
_LOADING_OF_CONTACT = 0.12  # choice: per second; as on the 2019 array, 0.03 V/s of 0.25 V
_LOADING_SDS = 10.0  # choice: of the slope by the noise at rest, which may be stated two times too small
_SLOPE_WINDOW_S = 0.3  # choice: window of the slope's line fit
SETTLE_S = 0.2  # choice: the load is steady for so long before it is a hold
# tuned: what a soft skin keeps of a press, where the array file gives no level and no shear over load says
# that a light load is held. Printed lattices kept 3 to 12 % of a press of 20 s for a minute, foil and
# silicone read 3 to 15 % of any press beside their zero for seconds, and filtered readings wander by as
# much. It is the set of a taxel, and the least contact as a part of the pad's largest load of late. For
# the latter, 0.05, 0.1 and 0.15 were tried on recordings of foil, of lattices and of an optical finger.
_SET_OF_LOAD = 0.15
_SET_S = 30.0  # tuned: on eFlesh, too; creep has no single time, this one is between presses and holds
_LARGEST_S = 300.0  # choice: what is done with an object takes minutes; 60 s and for ever were tried, too
# choice: the largest load follows within this time and twenty scans, so that a reading that is wrong once
# moves it by a twentieth
_RISE_S, _RISE_OF_SCAN = 0.2, 0.05
# prior: the same where shear over load says that a light load is held: solid rubber keeps a few percent, and
# what is left of a load below this part of it is rather an object that was lost.
_SET_OF_SHEARED = 0.05


class Hold:
    """Readings rounded to whole steps; one that is not ok is the last good one of its channel, or zero.

    Readings beyond `full_scale_volts` are not ok.
    """

    def __init__(self, pad: Array) -> None:
        self.n_channels = pad.n_channels
        self.full_scale_volts = 2.0 ** ceil(log2(pad.full_scale))
        self.volts_per_step = self.full_scale_volts / 2.0**READING_BITS
        self.last = zeros(self.n_channels)

    def take(self, n: int, readings: FloatArray, valid: Flags, steps: Reals, ok: Any) -> bool:
        """Round n scans of `readings` to `steps`; mark what is `ok`; True if all is."""
        at, n_bad = 0, 0
        for _ in range(n):
            for c in range(self.n_channels):
                reading = readings[at]
                if valid[at] != 0 and abs(reading) <= self.full_scale_volts:  # no NaN is
                    self.last[c] = self.rounded(reading)
                    ok[at] = 1
                else:
                    ok[at] = 0
                    n_bad += 1
                steps[at] = self.last[c]
                at += 1
        return n_bad == 0

    def rounded(self, reading: float) -> float:
        """Return a reading in whole steps, clipped to the limit; 0 for NaN."""
        if reading != reading:
            return 0.0
        limit = self.full_scale_volts
        return min(max(reading, -limit), limit) / self.volts_per_step + _TO_WHOLE - _TO_WHOLE


class Quietest:
    """Least mean power of each channel over so many groups; of single groups until there is one.

    The least of single groups falls without bound with time. Where it is the only one known, it is stated up
    to two times too small.
    """

    def __init__(self, n_channels: int, n_wanted: int, most: float) -> None:
        self.n_wanted, self.power = n_wanted, array("d", [most] * n_channels)
        self.sum, self.n = zeros(n_channels), counts(n_channels)
        self.is_mean = flags(n_channels)

    def take(self, c: int, power: float) -> None:
        """Take the power of a group of one channel."""
        self.sum[c] = self.sum[c] + power if self.n[c] > 0 else power
        self.n[c] += 1
        if self.n[c] == self.n_wanted:
            allowed = 1.0 if self.is_mean[c] != 0 else _STATED_SMALL * _STATED_SMALL
            self.power[c] = min(allowed * self.power[c], self.sum[c] / self.n_wanted)
            self.n[c], self.is_mean[c] = 0, 1
        elif self.is_mean[c] == 0:
            self.power[c] = min(self.power[c], power)


class RestNoise:
    """Noise of readings at rest, from second differences in groups of scans.

    Loads, creep and drift are straight lines over a few scans and leave second differences alone; contact and
    sliding only add to the noise. The quietest groups so far are therefore the noise at rest, whatever came
    first. It is no less than the rounding noise of the smallest step between two readings.

    Filtered readings wander slowly, and differ little from scan to scan. The same of eight means of some
    scans each therefore counts, too, where it is more than that of the scans; means of white noise are less.
    A hand that moves without rest looks alike, which is why `most_wander` is the most that counts.

    Before a channel has a whole group, its noise is taken to be that of the channels together, or its own so
    far if that is more than twice as much: a press moves few channels at a time, or all of them in few scans,
    which medians do not see. It is full scale before that can be told.

    Parameters
    ----------
    early : float
        Least standard deviation in steps of a channel without a group.
    n_mean : int
        Scans of a mean; 0 where scans come too slowly to tell wandering from noise.
    most_wander : float
        Most standard deviation in steps that is taken for wandering.

    Attributes
    ----------
    noise : (channels,) array of float
        Standard deviation in steps.
    n_known : int
        Channels that have a group, -1 while nothing can be told.
    """

    def __init__(self, n_channels: int, early: float, n_mean: int, most_wander: float) -> None:
        n = n_channels
        self.n_channels, self.early, self.n_mean, self.most_wander = n, early, n_mean, most_wander
        self.steps, self.ok = zeros(n * _GROUP_SCANS), flags(n * _GROUP_SCANS)
        self.quietest, self.least_step = Quietest(n, _GROUPS, _UNKNOWN**2), array("d", [_INFINITE] * n)
        self.early_noise, self.noise = array("d", [_UNKNOWN] * n), array("d", [_UNKNOWN] * n)
        self.means, self.n_good = zeros(n * _MEANS), counts(n)
        self.slowest, self.wander = Quietest(n, _GROUPS * _MEANS, _INFINITE), zeros(n)
        self.n_scans, self.n_known, self.is_early = 0, -1, True
        self.n_summed, self.n_means = 0, 0

    def interrupt(self) -> None:
        """Begin a group anew after missing scans."""
        self.n_scans, self.n_summed, self.n_means = 0, 0, 0

    def take(self, first: int, steps: Reals, ok: Sequence[int] | Flags) -> bool:
        """Take a scan, from `first` on.

        Returns
        -------
        bool
            More of the noise became known, or readings wander less than was thought: a pressure below a level
            before may be above it now.
        """
        n, at = self.n_channels, self.n_scans * self.n_channels
        for c in range(n):
            self.steps[at + c] = steps[first + c]
            self.ok[at + c] = ok[first + c]
        self.n_scans += 1
        if self.n_mean > 0:
            self._take_mean(at)
        if self.is_early:
            self._take_early()
        elif self.n_scans < _GROUP_SCANS:
            return False
        if self.n_scans == _GROUP_SCANS:
            self._take_group()
            self.n_scans, self.is_early = 0, False
        n_known, can_tell, falls = 0, False, False
        for c in range(n):
            is_own = self.quietest.power[c] < _UNKNOWN * _UNKNOWN
            can_tell = can_tell or self.early_noise[c] < _UNKNOWN
            n_known += 1 if is_own else 0
            noise = self.early_noise[c]
            if is_own:
                step = self.least_step[c] if self.least_step[c] < _INFINITE else 0.0
                noise = sqrt(max(self.quietest.power[c], step * step * ROUNDING))
                wandered = self.wander[c]
                if self.slowest.power[c] < _INFINITE:
                    self.wander[c] = min(sqrt(self.slowest.power[c]), self.most_wander)
                falls = falls or wandered > max(noise, self.wander[c])
                noise = max(noise, self.wander[c])
            self.noise[c] = noise
        before, self.n_known = self.n_known, n_known if can_tell else -1
        return falls or self.n_known > before

    def _take_mean(self, newest: int) -> None:
        """Take the newest scan into the present mean of each channel, and the mean into those before it."""
        n, place = self.n_channels, (self.n_means % _MEANS) * self.n_channels
        for c in range(n):
            if self.n_summed == 0:
                self.means[place + c] = 0.0
            self.means[place + c] += self.steps[newest + c] / self.n_mean
            self.n_good[c] = self.n_good[c] + 1 if self.ok[newest + c] != 0 else 0
        self.n_summed += 1
        if self.n_summed < self.n_mean:
            return
        self.n_summed = 0
        self.n_means += 1
        if self.n_means < _MEANS:
            return
        for c in range(n):
            if self.n_good[c] < _MEANS * self.n_mean:
                continue
            power = 0.0
            for k in range(self.n_means - _MEANS, self.n_means - 2):
                first, second = self.means[k % _MEANS * n + c], self.means[(k + 1) % _MEANS * n + c]
                bend = (second - first) - (self.means[(k + 2) % _MEANS * n + c] - second)
                power += bend * bend
            self.slowest.take(c, power / (_MEANS - 2) / _SECOND_DIFFERENCE)

    def _take_group(self) -> None:
        """Take what a whole group shows of the channels that it read."""
        n, steps = self.n_channels, self.steps
        for c in range(n):
            power, step, is_read = 0.0, _INFINITE, True
            for k in range(_GROUP_SCANS):
                at = k * n + c
                if self.ok[at] == 0:
                    is_read = False
                if k >= 1:
                    change = abs(steps[at] - steps[at - n])
                    step = min(step, change) if change > 0.0 else step
                if k >= 2:
                    bend = (steps[at] - steps[at - n]) - (steps[at - n] - steps[at - 2 * n])
                    power += bend * bend
            if is_read:
                power = power / (_GROUP_SCANS - 2) / _SECOND_DIFFERENCE
                self.quietest.take(c, power)
                self.least_step[c] = min(self.least_step[c], step)

    def _take_early(self) -> None:
        """Take the noise of the channels from the scans of an incomplete group.

        The more second differences of all channels there are, the less it is stated too small: less is left
        for the levels to allow for.
        """
        read = np.where(np.asarray(self.ok), np.asarray(self.steps), np.nan).reshape(_GROUP_SCANS, -1)
        steps = read[: self.n_scans]
        change, bends = np.abs(np.diff(steps, axis=0)), np.abs(np.diff(steps, 2, axis=0))
        step = float(change[change > 0.0].min(initial=_INFINITE))
        half = 0.5 * step if step < _INFINITE else 0.0
        every = (self.n_channels + _MOST_POOLED - 1) // _MOST_POOLED
        pooled = bends[:, ::every].reshape(-1, 1)
        n_all = int(np.isfinite(pooled).sum())
        if n_all < _FEWEST:
            self.early_noise = array("d", [_UNKNOWN] * self.n_channels)
            return
        scale = _MEDIAN * sqrt(_SECOND_DIFFERENCE)
        common = float(_median_of_rounded(pooled, half)[0]) / scale
        allowed = min(exp(_LOG_DOUBT / sqrt(n_all)) / _STATED_SMALL, 1.0)
        own = _median_of_rounded(bends, half) / scale
        noise = np.where(own > _STATED_SMALL * common, own, common * allowed)  # no NaN is
        self.early_noise = array("d", np.maximum(noise, self.early))


def _median_of_rounded(values: FloatArray, half: float) -> FloatArray:
    """Return the medians of columns of values that were rounded to a step, by half of that; NaN is left out.

    Values that are equal are taken as spread evenly over the step: of noise below a step, the plain median
    is 0 or the whole step.
    """
    ordered, n = np.sort(values, axis=0), np.isfinite(values).sum(axis=0)
    places = np.stack([np.maximum(n - 1, 0) // 2, n // 2]).clip(max=len(values) - 1)
    middle = np.take_along_axis(ordered, places, axis=0).sum(axis=0) / 2.0
    n_below, n_same = (values < middle).sum(axis=0), (values == middle).sum(axis=0)
    low = np.maximum(middle - half, 0.0)
    spread = low + (middle + half - low) * (0.5 * n - n_below) / np.maximum(n_same, 1)
    return np.asarray(np.where(n_same > 0, spread, middle))


class RestSwing:
    """Swing of the pressures of taxels at rest, as standard deviation about the mean of a second.

    Some skins swing at several hertz while nothing touches them, by several times what differs from scan to
    scan: their noise at rest has a spectrum. On a right zero, no press makes a pressure pass a level above
    zero and one below zero several times in a second. The second in which a taxel does that is one of rest,
    and the spread of its readings is what the taxel swings by. A spread that the differences from scan to
    scan explain is noise, and no swing. Once a taxel is known to swing, seconds in which it stays below its
    level of contact count, too. A second with a much smaller spread, of a rest or of a hold, shows that the
    swing has stopped: it is forgotten.

    The mean of the taxels is another unit, the last one.

    Attributes
    ----------
    value : (taxels + 1,) array of float
        Pressures of the scan that `take` takes.
    power : (taxels + 1,) array of float
        Variance of the swing, mean over seconds at rest.
    is_seen : bool
        Some taxel swings.
    n_rests : (taxels + 1,) array of int
        Number of these, `_MOST_RESTS` at most; 0 for a taxel that was never seen to swing.
    """

    def __init__(self, pad: Array, rate_hz: float) -> None:
        n = pad.n_taxels + 1
        self.n_taxels, self.n_window, self.n_scans = pad.n_taxels, max(3, round(_SWING_S * rate_hz)), 0
        # Scans at the beginning that are of rest by the array file: in these, a swing passes its levels once.
        self.n_declared = round(pad.zero_first_s * rate_hz)
        self.early, self.is_seen = 0.0, False
        self.value, self.last, self.older = zeros(n), zeros(n), zeros(n)
        self.sum, self.square, self.bend = zeros(n), zeros(n), zeros(n)
        self.highest, self.lowest, self.power = zeros(n), zeros(n), zeros(n)
        self.side, self.turns, self.n_rests = counts(n), counts(n), counts(n)

    def interrupt(self) -> None:
        """Begin a second anew after missing scans."""
        self.n_scans = 0

    def level(self, k: int) -> float:
        """Return what a swing at rest does not reach: of a taxel, or of the mean of all.

        The fewer seconds it is known from, the more is left for those in which it swings more. Before a taxel
        has one, it is taken to swing as the one that does most.
        """
        if self.n_rests[k] == 0:
            return _SWING_SDS * _STATED_SMALL * sqrt(self.early)
        return _SWING_SDS * (1.0 + 1.0 / self.n_rests[k]) * sqrt(self.power[k])

    def take(self, levels: Reals) -> None:
        """Take a scan, whose pressures (taxels,) are in `value`, beside levels of contact by noise alone."""
        n, total, total_level = self.n_taxels, 0.0, 0.0
        for t in range(n):
            total += self.value[t]
            total_level += levels[t]
        self.value[n] = total / n
        self.n_scans += 1
        self.n_declared = max(0, self.n_declared - 1)
        for k in range(n + 1):
            # The noise of the mean is that of a taxel over the root of their number.
            level = levels[k] if k < n else total_level / n / sqrt(1.0 * n)
            self._take_one(k, self.value[k], level)
        self.early, self.is_seen = 0.0, False
        for t in range(n):
            self.is_seen = self.is_seen or self.power[t] > 0.0
            self.early = max(self.early, self.power[t] if self.n_rests[t] == 0 else 0.0)
        if self.n_scans == self.n_window:
            self.n_scans = 0

    def _take_one(self, k: int, value: float, level: float) -> None:
        if self.n_scans == 1:
            self.sum[k], self.square[k], self.bend[k] = 0.0, 0.0, 0.0
            self.highest[k], self.lowest[k], self.side[k], self.turns[k] = value, value, 0, 0
        self.sum[k] += value
        self.square[k] += value * value
        self.highest[k], self.lowest[k] = max(self.highest[k], value), min(self.lowest[k], value)
        if self.n_scans > 2:
            bend = (value - self.last[k]) - (self.last[k] - self.older[k])
            self.bend[k] += bend * bend
        self.older[k], self.last[k] = self.last[k], value
        side = 1 if value > _TURN * level else -1 if value < -_TURN * level else 0
        if side != 0:
            self.turns[k] += 1 if side * self.side[k] < 0 else 0
            self.side[k] = side
        is_whole, is_known = self.n_scans == self.n_window, self.n_rests[k] > 0
        has_turned = self.turns[k] >= (1 if self.n_declared > 0 else _LEAST_TURNS)
        if self.n_scans > 2 and (is_whole or (has_turned and not is_known)):
            mean = self.sum[k] / self.n_scans
            variance = max(self.square[k] / self.n_scans - mean * mean, 0.0)
            white = self.bend[k] / (self.n_scans - 2) / _SECOND_DIFFERENCE
            above, below = self.highest[k] - mean, mean - self.lowest[k]
            is_even = above <= _CREST * sqrt(variance) and above <= below / _BOTH_SIDES
            is_spread = variance > _STATED_SMALL * _STATED_SMALL * white
            if is_known and variance < STOPPED * self.power[k]:
                self.n_rests[k], self.power[k] = 0, 0.0
            elif is_spread and ((has_turned and is_even) or (is_known and self.highest[k] <= level)):
                self.n_rests[k] = min(self.n_rests[k] + 1, _MOST_RESTS) if is_whole else 0
                self.power[k] += (variance - self.power[k]) / max(1, self.n_rests[k])
            elif is_known and self.highest[k] <= level:
                self.power[k] -= self.power[k] / _MOST_RESTS
            elif not is_known:  # what the first scans of a second showed was no swing
                self.power[k] = 0.0


def _part(n_scans: float) -> float:
    """Return the part of the way that an average over so many scans goes in one."""
    return -expm1(-1.0 / n_scans)


class Levels:
    """Levels of contact, release and loading, given or derived, in the unit of the array.

    Parameters
    ----------
    contact, release, loading : float
        As given; 0.0 where a level is derived.
    least_contact : float
        Least level of contact that is derived.
    """

    def __init__(self, contact: float, release: float, loading: float, least_contact: float) -> None:
        self.contact, self.release, self.loading = contact, release, loading
        self.least_contact = least_contact
        self.all_given = contact > 0.0 and release > 0.0 and loading > 0.0

    def contact_at(self, noise: float, swing: float) -> float:
        """Return the level of contact of a taxel for the noise of its channels, and what a swing reaches."""
        derived = max(max(self.least_contact, CONTACT_SDS * noise), swing)
        return self.contact if self.contact > 0.0 else derived

    def release_at(self, noise: float, swing: float) -> float:
        """Return the level of release of a taxel, which is below the level of contact in any case."""
        if self.release > 0.0 and self.contact > 0.0:
            return self.release
        derived = _RELEASE_OF_CONTACT * self.contact_at(noise, swing)
        return min(self.release, derived) if self.release > 0.0 else derived

    def loading_at(self, load: float, slope_sd: float) -> float:
        """Return the slope above which the load rises, for the load of a taxel and the noise of slopes."""
        if self.loading > 0.0:
            return self.loading
        least = _LOADING_OF_CONTACT * self.least_contact
        return max(max(least, _LOADING_OF_LOAD * load), _LOADING_SDS * slope_sd)


class Pressure:
    """Contact of an array: readings as steps, pressure of the taxels beside levels, and the state.

    A soft skin keeps a part of its deformation for a while after a press, its set. It follows the pressure as
    in a standard linear solid; only what is beyond it is compared with the levels. A magnet of a skin moves
    with the skin around it: the set of a field follows the mean pressure of the taxels where that is more
    than the taxel's own. What a skin keeps, for seconds or minutes, and how far it wanders is in proportion
    to what presses it: beside the level of the noise, contact is a part of the pad's largest load of late.

    A saturated reading still means "pressed": the pressure uses every number that is read. Slope and noise
    use held readings, since a channel that drops out is no change of load.

    Parameters
    ----------
    early : float
        Least noise of a channel whose noise is not known yet, in the unit of the array.

    Attributes
    ----------
    steps, ok : (scans * channels,) array of float and of int
        Readings of the newest block that are held, and 0 where an older one is.
    all_ok : bool
        No reading of the newest block is an older one.
    slope, loading : (scans,) array of float
        Slope for each taxel in contact, NaN where nothing is read, and slope above which the load rises.
    touches, released, may_be_old : (scans,) array of int
        Some taxel touches; all are released; the noise became known, or a load that was hidden is found
        without a press: a contact that is seen from this scan on may have begun before.
    touched : (scans * taxels,) array of int
        Taxels that touch.
    lost : (scans,) array of int
        All taxels are released, the last of them because it has not been read for too long.
    swings : (scans,) array of int
        A taxel is known to swing at rest.
    state, previous : str
        State of the contact, and the one before the newest change.
    """

    def __init__(self, pad: Array, rate_hz: float, levels: Levels, early: float) -> None:
        weights = pad.normal_weights()
        own = [np.flatnonzero(row) for row in weights]
        n_own = [len(row) for row in own]
        self.hold, self.levels, self.rate_hz = Hold(pad), levels, rate_hz
        self.volts_per_step = self.hold.volts_per_step
        n_mean = round(_MEAN_S * rate_hz) if _MEAN_S * rate_hz >= _FEWEST_OF_MEAN else 0
        early /= self.volts_per_step
        self.rest = RestNoise(pad.n_channels, early, n_mean, _WANDER_OF_EARLY * early)
        self.swing = RestSwing(pad, rate_hz)
        self.n_channels, self.n_taxels, self.n_sides = pad.n_channels, pad.n_taxels, max(1, *n_own)
        self.own = array("q", np.concatenate([np.resize(row, self.n_sides) for row in own]).astype(np.int64))
        self.counts = array("q", n_own)
        self.sign = array("d", np.sign(weights).sum(axis=0))  # a channel is of one taxel
        # Taxels may have different numbers of pressure channels: a common denominator keeps weights whole.
        denominator = float(np.lcm.reduce(np.maximum(n_own, 1)))
        self.total_weights = array("d", np.rint(weights.sum(axis=0) * denominator))
        # Least-squares slope of n even samples: sum (k - mean) v / sum (k - mean)^2, here with whole weights.
        n = max(3, round(_SLOPE_WINDOW_S * rate_hz))
        line = 2.0 * np.arange(n, dtype=np.float64) - (n - 1)
        self.line, self.totals = array("d", line), zeros(n - 1)
        self.slope_scale = self.volts_per_step / denominator * rate_hz * 2 / float(line @ line)
        # of the slope, for noise of 1 of the total
        self.slope_noise = self.slope_scale * sqrt(sum(weight * weight for weight in line.tolist()))
        self.is_field = pad.is_field
        self.set_of_load = _SET_OF_SHEARED if pad.measures_ratio else _SET_OF_LOAD
        self.of_largest = 0.0 if pad.measures_ratio else _SET_OF_LOAD
        if levels.contact > 0.0:  # contact is what exceeds that level, whatever was pressed before
            self.set_of_load = self.of_largest = 0.0
        self.set_per_scan, self.forget_per_scan = _part(_SET_S * rate_hz), _part(_LARGEST_S * rate_hz)
        self.rise_per_scan = min(_part(_RISE_S * rate_hz), _RISE_OF_SCAN)
        n = pad.n_taxels
        self.set, self.pressure, self.taxel_noise = zeros(n), zeros(n), zeros(n)
        self.of_noise = zeros(n)  # levels of contact by noise alone
        self.pads = array("q", np.unique(pad.pad, return_inverse=True)[1].astype(np.int64))
        self.n_pads = max(self.pads) + 1
        self.largest, self.heaviest = zeros(self.n_pads), zeros(self.n_pads)
        self.is_begun, self.n_hidden = False, 0
        self.unread, self.is_free = counts(n), flags(n)
        self.n_settle = max(1, round(SETTLE_S * rate_hz))
        self.make_room(1)
        self.forget_contact()

    def make_room(self, n: int) -> None:
        """Make room for blocks of n scans."""
        self.n_room, self.n_scans, channels = n, 0, self.n_channels
        self.steps, self.ok = zeros(n * channels), flags(n * channels)
        self.slope, self.loading = zeros(n), zeros(n)
        self.touches, self.swings = flags(n), flags(n)
        self.released, self.lost = flags(n), flags(n)
        self.may_be_old, self.touched = flags(n), flags(n * self.n_taxels)

    def forget_contact(self) -> None:
        """Begin without a contact; one that the next scan shows was not seen to begin."""
        none: ContactState = "none"
        self.state, self.previous = none, none
        self.is_first, self.n_steady = True, 0

    def interrupt(self, n_missing: int) -> None:
        """Pass over missing scans: forget the contact; keep the noise, and what is left of the set."""
        gap_s = n_missing / self.rate_hz
        self.is_begun = False
        self.rest.interrupt()
        self.swing.interrupt()
        for t in range(self.n_taxels):
            self.set[t] *= exp(-gap_s / _SET_S)
            self.unread[t] = 0
        for p in range(self.n_pads):
            self.largest[p] *= exp(-gap_s / _LARGEST_S)
        self.forget_contact()

    def take(self, n: int, readings: FloatArray, valid: Flags) -> None:
        """Measure the n scans of a block, `readings` and `valid` (n * channels,); `step` then takes each."""
        if n > self.n_room:
            self.make_room(n)
        self.n_scans = n
        self.all_ok = self.hold.take(n, readings, valid, self.steps, self.ok)
        for i in range(n):
            self._measure(i, readings)

    def _measure(self, i: int, readings: FloatArray) -> None:
        taxels, n_line, row = self.n_taxels, len(self.line), i * self.n_channels
        steps, ok, levels, noise = self.steps, self.ok, self.levels, self.rest.noise
        n_touching, n_released, array_total, load = 0, 0, 0.0, 0.0
        loads, is_hidden, is_read, is_lost = 0.0, False, False, False
        for p in range(self.n_pads):
            self.heaviest[p] = 0.0
        becomes_known = self.rest.take(row, steps, ok) and not levels.all_given
        for t in range(taxels):
            total, largest, smallest, held_total = 0.0, -_INFINITE, _INFINITE, 0.0
            taxel_noise, is_ok, n_read, n_ok = 0.0, True, 0, 0
            for s in range(t * self.n_sides, t * self.n_sides + self.counts[t]):
                c = self.own[s]
                step = steps[row + c]
                held_total += step * self.total_weights[c]
                n_ok += ok[row + c]
                if ok[row + c] == 0:
                    is_ok = False
                    step = self.hold.rounded(readings[row + c])
                if ok[row + c] != 0 or readings[row + c] == readings[row + c]:
                    n_read += 1
                one = step * self.sign[c]
                total += one
                largest, smallest = max(largest, one), min(smallest, one)
                taxel_noise = max(taxel_noise, noise[c])
            array_total += abs(held_total) if self.is_field else held_total
            is_read = is_read or n_ok > 0
            self.unread[t] = 0 if n_ok > 0 or self.counts[t] == 0 else self.unread[t] + 1
            self.swing.value[t] = total * self.volts_per_step / max(n_read, 1)
            if self.is_field and total < 0.0:
                total, largest = -total, -smallest
            rest_total = total - largest
            if n_read >= LEAST_SIDES:
                total = rest_total + min(largest, _ONE_SIDE / (n_read - 1) * rest_total)
            self.pressure[t] = total * self.volts_per_step / max(n_read, 1)
            self.taxel_noise[t] = taxel_noise * self.volts_per_step
            self.of_noise[t] = levels.contact_at(self.taxel_noise[t], 0.0)
            loads += max(self.pressure[t], 0.0)
            if is_ok:
                self.heaviest[self.pads[t]] = max(self.heaviest[self.pads[t]], self.pressure[t])
        for p in range(self.n_pads):
            self.largest[p] -= self.forget_per_scan * self.largest[p]
            self.largest[p] += self.rise_per_scan * max(self.heaviest[p] - self.largest[p], 0.0)
        if not levels.all_given:
            self.swing.take(self.of_noise)
        shared = loads / taxels if self.is_field else 0.0
        for t in range(taxels):
            pressed = max(max(self.pressure[t], shared), 0.0)
            self.set[t] += self.set_per_scan * (self.set_of_load * pressed - self.set[t])
            pressure, taxel_noise = self.pressure[t] - self.set[t], self.taxel_noise[t]
            swing = 0.0 if levels.all_given else self.swing.level(t)
            least = self.of_largest * self.largest[self.pads[t]]
            is_above = pressure > levels.contact_at(taxel_noise, swing)
            touches, is_hidden = is_above and self.pressure[t] > least, is_hidden or is_above
            self.touched[i * taxels + t] = 1 if touches else 0
            if touches:
                n_touching += 1
                load += pressure
            is_released = pressure < levels.release_at(taxel_noise, swing)
            is_released = is_released or self.pressure[t] < _RELEASE_OF_CONTACT * least
            # No reading is no release, for as long as the slope looks back.
            if self.unread[t] == 0 or self.unread[t] > n_line:
                is_lost = is_lost or (is_released and self.unread[t] > 0 and self.is_free[t] == 0)
                self.is_free[t] = 1 if is_released else 0
            n_released += self.is_free[t]
        if not self.is_begun:
            self.is_begun = True
            for k in range(n_line - 1):
                self.totals[k] = array_total
        risen = array_total * self.line[n_line - 1]
        for k in range(n_line - 1):
            risen += self.totals[k] * self.line[k]
            self.totals[k] = self.totals[k + 1] if k < n_line - 2 else array_total
        self.touches[i] = 1 if n_touching > 0 else 0
        self.swings[i] = 1 if self.swing.is_seen else 0
        self.released[i] = 1 if n_released == taxels else 0
        self.lost[i] = 1 if is_lost and n_released == taxels else 0
        of_each = max(1.0, 1.0 * n_touching)
        slope = risen * self.slope_scale / of_each
        loading = levels.loading_at(load / of_each, self._total_noise() * self.slope_noise / of_each)
        self.slope[i], self.loading[i] = slope if is_read else _NO_NUMBER, loading
        # What was hidden for longer than a press takes did not begin when it is found without a press.
        is_found = self.n_hidden >= n_line and n_touching > 0 and slope <= loading
        self.may_be_old[i] = 1 if becomes_known or is_found else 0
        self.n_hidden = self.n_hidden + 1 if is_hidden and n_touching == 0 else 0

    def step(self, scan: int) -> bool:
        """Process a scan of the block; return whether the state of the contact changed."""
        if scan < 0 or scan >= self.n_scans:
            raise IndexError("there is no such scan in the block")
        slope, loading, touches = self.slope[scan], self.loading[scan], self.touches[scan] != 0
        if slope == slope:  # something is read
            self.n_steady = self.n_steady + 1 if abs(slope) <= loading else 0
        is_first = self.is_first or self.may_be_old[scan] != 0
        self.is_first = False
        if self.state == "none":
            if touches and is_first:
                self.go("unknown")
                return True
            self.n_steady = 0  # a steady signal before the touch is no hold
            if touches:
                self.go("loading")
            return touches
        if self.released[scan] != 0:
            self.go("none")
        elif self.state == "loading" and self.n_steady >= self.n_settle:
            self.go("holding")
        elif self.state == "holding" and slope > loading:
            self.go("loading")
        else:
            return False
        return True

    def go(self, state: ContactState) -> None:
        """Enter a state. Sliding cannot be seen from pressure: the slip detector says so."""
        self.previous, self.state = self.state, state

    def _total_noise(self) -> float:
        """Return the standard deviation of the array's total by the noise at rest, in steps."""
        if self.levels.loading > 0.0:
            return 0.0
        square = 0.0
        for c in range(self.n_channels):
            one = self.rest.noise[c] * self.total_weights[c]
            square += one * one
        return sqrt(square)
