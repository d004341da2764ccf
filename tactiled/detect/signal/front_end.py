"""Front end of a contact: loads and shears of the taxels from readings, scan by scan.

Channels that are stuck (`StuckChannels`) or that jump (`Jumps`) are found, wavelet filters (`Bank`) show the
noise (`NoiseFloor`), and what is left becomes loads and shears of the taxels at one instant (`Readings`),
also where a side has lost its load (`RelievedSides`). `stuck_channels`, `wavelet` and
`tactiled.detect.contact.readings` make these objects for an array.

The file is plain Python, which Cython compiles with the types of `front_end.pxd` (`tactiled.compiled`). Both
forms have the same bits: one operation after the other, without fused multiply-add and without functions
other than `sqrt`, which IEEE 754 defines exactly. Arrays are dense and flat, with the last index moving
fastest.
"""

from array import array
from collections.abc import MutableSequence
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray

Reals = MutableSequence[float] | FloatArray
Flags = NDArray[np.uint8]
Whole = NDArray[np.int64]

_INFINITE = float("inf")
_UNKNOWN = float("nan")
# Noise of a channel: see `NOISE_LEVELS` of `tactiled.detect.contact.readings`.
_CLIP = 3.0  # choice: standard deviations: a coefficient beyond counts as this much, since it is signal
_CLIPPED_AFTER = 20  # prior: scans: before, the mean is too uncertain to clip by
_ROUNDING = sqrt(12.0)  # derived: rounding to steps of q has a standard deviation of q / sqrt(12)
_MEAN_ABS = 0.7978845608028654  # derived: sqrt(2 / pi): of a normal variable of unit variance
# prior: jumps, from scan to scan: of the mean load of a taxel, below which a jump changes the total shear by
# less than the zero; standard deviations of noise; times the change of the median taxel, whose load may be a
# third.
_LEAST_JUMP, _JUMP_NOISES, _JUMP_TIMES = 0.02, 10.0, 10.0
_LOADED = 0.1  # prior: of the largest load: taxels with less need not move with the others
_FEWEST_LOADED = 4  # derived: taxels, of which most are right
_MOST_JUMP = 0.4  # derived: of them that may jump at once: six neighbouring channels are of three taxels
# physical: part of the pressed side's reading, below which the opposite one has lost its load: it then reads
# 0.41 to 0.48 of it (finite elements of the 2019 taxel under 8 to 16 N).
_RELIEVED = 0.5
# physical: of the mean of all sides over the load, where some are relieved: 1.02 to 1.16 on the same.
_MOST_SPREAD = 1.3
# prior: of the load, by which a side must be pressed for its part of the shear to be known
_LEAST_PRESSED = 0.1
_TINY = 1e-12  # derived
_SPARE = 64  # choice: scans after which those that the filters need move to the front


def _zeros(n: int) -> "array[float]":
    return array("d", bytes(8 * n))


def _counts(n: int) -> "array[int]":
    return array("q", bytes(8 * n))


def _flags(n: int) -> "array[int]":
    return array("B", bytes(n))


class StuckChannels:
    """Search for channels that do not follow the load; `stuck_channels` states the rule.

    Parameters
    ----------
    sign : (channels,) float64
        Of the pressure.
    others : (channels * sides,) int64
        The other sides of a channel's taxel.
    judged : (channels,) uint8
        1 where these are enough.
    pressed : float
        Steps by which a press moves a side.
    history, turned, long : int
        Scans; see there.
    most_resting : float
        Channels that may rest at once.
    """

    def __init__(
        self,
        sign: FloatArray,
        others: Whole,
        judged: Flags,
        pressed: float,
        history: int,
        turned: int,
        long: int,
        most_resting: float,
    ) -> None:
        n = len(sign)
        self.n_channels, self.n_sides = n, len(others) // n
        self.sign, self.others, self.judged = array("d", sign), array("q", others), array("B", judged)
        self.pressed, self.history, self.turned, self.long = pressed, history, turned, long
        self.most_resting = most_resting
        self.is_begun, self.position = False, 0
        self.last, self.way, self.began = _zeros(n), _zeros(n), _zeros(n * self.n_sides)
        self.run, self.n_turns = _counts(n), _counts(n)
        self.turns, self.noisy, self.stayed = _flags(n * history), _flags(n), _flags(n)

    def take(self, n: int, first: int, steps: Reals, stuck: Any) -> bool:
        """Mark the stuck readings of n scans, which begin at `first` of `steps`; True if there is any."""
        channels, sides, any_stuck = self.n_channels, self.n_sides, False
        if not self.is_begun and n > 0:
            self.is_begun = True
            for c in range(channels):
                self.last[c] = steps[first + c]
            for k in range(channels * sides):
                self.began[k] = steps[first + self.others[k]] * self.sign[self.others[k]]
        for i in range(n):
            at, turn, resting = first + i * channels, self.position * channels, 0
            self.position = (self.position + 1) % self.history
            for c in range(channels):
                step = steps[at + c]
                way = 1.0 if step > self.last[c] else -1.0 if step < self.last[c] else 0.0
                self.n_turns[c] -= self.turns[turn + c]
                self.turns[turn + c] = 1 if way * self.way[c] < 0.0 else 0
                self.n_turns[c] += self.turns[turn + c]
                self.way[c], self.last[c] = way, step
                if way != 0.0:
                    self.run[c] = 0
                    self.noisy[c] = 1 if self.n_turns[c] >= self.turned else 0
                    self.stayed[c] = 0
                else:
                    self.run[c] += 1
                if self.run[c] >= self.long // 2:
                    resting += 1
                n_up = n_down = 0
                for s in range(c * sides, (c + 1) * sides):
                    reading = steps[at + self.others[s]] * self.sign[self.others[s]]
                    if way != 0.0:
                        self.began[s] = reading
                    if reading - self.began[s] >= self.pressed:
                        n_up += 1
                    elif reading - self.began[s] <= -self.pressed:
                        n_down += 1
                if self.judged[c] != 0 and (n_up == sides or n_down == sides):
                    self.stayed[c] = 1
            for c in range(channels):
                is_long = self.noisy[c] != 0 and self.run[c] >= self.long and resting <= self.most_resting
                stuck[i * channels + c] = 1 if is_long or self.stayed[c] != 0 else 0
                if stuck[i * channels + c] != 0:
                    any_stuck = True
        return any_stuck


class Bank:
    """Wavelet filters of several lengths.

    Parameters
    ----------
    taps : sequence of (taps,) float64
        Of each filter, that of the newest scan first.
    """

    def __init__(self, n_channels: int, taps: list[FloatArray]) -> None:
        self.n_channels, self.n_filters = n_channels, len(taps)
        self.lengths = array("q", [len(one) for one in taps])
        self.taps = array("d", [tap for one in taps for tap in one.tolist()])

    def take(self, n: int, first: int, steps: Reals, out: Reals) -> None:
        """Filter n scans, which begin at row `first` of `steps`, into `out` (n, filters, channels)."""
        channels, to = self.n_channels, 0
        for i in range(n):
            tap = 0
            for f in range(self.n_filters):
                for c in range(channels):
                    out[to + c] = 0.0
                at = (first + i) * channels
                for _ in range(self.lengths[f]):
                    for c in range(channels):
                        out[to + c] += self.taps[tap] * steps[at + c]
                    tap += 1
                    at -= channels
                to += channels


class Jumps:
    """Channels that jump while their contact rests: a spark on the cable, a bit that sticks, a loose wire.

    What moves a skin moves several taxels, and takes some scans. A reading that leaves the last one by far
    more than those of most loaded taxels do, from one scan to the next, is a fault of its channel until it
    is back.

    Parameters
    ----------
    taxel_channels : (taxels * channels,) uint8
        1 where a channel is part of a taxel.

    Attributes
    ----------
    accepted : (channels,) array of float
        Newest readings that did not jump.
    found : (channels,) array of int
        1 where a channel jumps, or did so one scan before.
    """

    def __init__(self, taxel_channels: Flags, n_taxels: int) -> None:
        n = len(taxel_channels) // n_taxels
        self.n_channels, self.n_taxels = n, n_taxels
        self.own = array("B", taxel_channels)
        self.accepted, self.change, self.usual = _zeros(n), _zeros(n), _zeros(n_taxels)
        self.found, self.out, self.jumps, self.is_loaded = _flags(n), _flags(n), _flags(n), _flags(n_taxels)
        self.is_out = False

    def take(self, readings: Reals, first: int, loads: Reals, noise: Reals, press_is_over: bool) -> None:
        """Take the readings of a scan; until `press_is_over`, none is called a jump.

        A press moves taxels one by one. The loads of the scan before begin at `first` of `loads`.
        """
        n, taxels, largest = self.n_channels, self.n_taxels, 0.0
        for c in range(n):
            self.found[c] = 0
            self.change[c] = abs(readings[c] - self.accepted[c])
            largest = max(largest, self.change[c])
        total, heaviest = 0.0, loads[first]
        for t in range(taxels):
            total += loads[first + t]
            heaviest = max(heaviest, loads[first + t])
        least = _LEAST_JUMP * total / taxels
        if not press_is_over or (not self.is_out and largest <= least):
            for c in range(n):
                self.accepted[c] = readings[c]
            self.is_out = False
            return
        self._find(first, loads, least, heaviest, noise)
        any_jumps = False
        for c in range(n):
            if self.jumps[c] != 0 or (self.is_out and self.out[c] != 0):
                self.found[c] = 1
            if self.jumps[c] != 0:
                any_jumps = True
            else:
                self.accepted[c] = readings[c]
            self.out[c] = self.jumps[c]
        self.is_out = any_jumps

    def _find(self, first: int, loads: Reals, least: float, heaviest: float, noise: Reals) -> None:
        n, n_loaded, n_struck = self.n_channels, 0, 0
        for c in range(n):
            self.jumps[c] = 0
        for t in range(self.n_taxels):
            self.is_loaded[t] = 1 if loads[first + t] > _LOADED * heaviest else 0
            if self.is_loaded[t] != 0:
                moved = 0.0
                for c in range(n):
                    if self.own[t * n + c] != 0:
                        moved = max(moved, self.change[c])
                at = n_loaded  # in ascending order
                while at > 0 and self.usual[at - 1] > moved:
                    self.usual[at] = self.usual[at - 1]
                    at -= 1
                self.usual[at] = moved
                n_loaded += 1
        if n_loaded < _FEWEST_LOADED:
            return
        median = (self.usual[(n_loaded - 1) // 2] + self.usual[n_loaded // 2]) / 2.0
        most = max(_JUMP_TIMES * median, least)
        for c in range(n):
            self.jumps[c] = 1 if self.change[c] > max(_JUMP_NOISES * noise[c], most) else 0
        for t in range(self.n_taxels):
            is_struck = False
            for c in range(n):
                if self.jumps[c] != 0 and self.own[t * n + c] != 0:
                    is_struck = True
            if is_struck and self.is_loaded[t] != 0:
                n_struck += 1
        if n_struck > _MOST_JUMP * n_loaded:
            for c in range(n):
                self.jumps[c] = 0


class RelievedSides:
    """Loads and shears of taxels of which one side has lost its load.

    Shear presses one side of a taxel and relieves the opposite one. From where that side bears nothing it
    reads what spreads under its electrodes from its neighbours: its reading then grows with theirs, so that
    the difference of the two sides bends, and their mean grows though the load does not. Friction would bend
    the shear in the same way. The pressed side goes on as before. So from then on, the shear of that axis is
    taken from the pressed side alone, in the proportion that it had, and the load from the other pair of
    sides. Where that pair has a relieved side, too, the load stays where it was.

    Parameters
    ----------
    own, weights : (n * 4 * taxels,)
        Channels that make the sides (half, axis, taxel), and their weights.
    even : (4 * taxels,) float64
        Readings of the sides under an even load of 1.

    Attributes
    ----------
    relieved : (2 * taxels,) array of int
        1 for the pairs, by axis and taxel, that are read from one side.
    """

    def __init__(self, own: Whole, weights: FloatArray, even: FloatArray) -> None:
        self.n_taxels = len(even) // 4
        self.n_own = len(own) // len(even)
        self.own, self.weights, self.even = array("q", own), array("d", weights), array("d", even)
        self.load, self.side, self.high = _zeros(self.n_taxels), _zeros(4), _zeros(2)
        self.proportion, self.weight = _zeros(2 * self.n_taxels), _zeros(2 * self.n_taxels)
        self.relieved = _flags(2 * self.n_taxels)
        self.reset()

    def reset(self) -> None:
        """Forget the contact."""
        for k in range(2 * self.n_taxels):
            self.relieved[k] = 0
            self.proportion[k], self.weight[k] = 2.0, _TINY
        for t in range(self.n_taxels):
            self.load[t] = 0.0

    def correct(self, readings: Reals, first: int, response: Reals) -> None:
        """Replace loads and shears, from `first` on, where readings (channels,) show a relieved side."""
        n, side, high = self.n_taxels, self.side, self.high
        for t in range(n):
            other = _INFINITE
            for s in range(4):
                side[s] = 0.0
                for k in range(self.n_own):
                    i = (4 * k + s) * n + t
                    side[s] += self.weights[i] * readings[self.own[i]]
                side[s] /= self.even[s * n + t]
            for a in range(2):
                high[a] = max(side[a], side[2 + a])
                low = min(side[a], side[2 + a])
                # A taxel that is lifted has no pressed side: its sides read noise, each less than half of
                # the other.
                is_relieved = low < _RELIEVED * high[a] and high[a] > _LEAST_PRESSED * self.load[t]
                self.relieved[a * n + t] = 1 if is_relieved else 0
                if not is_relieved:
                    other = min(other, (side[a] + side[2 + a]) / 2.0)
            if self.relieved[t] == 0 and self.relieved[n + t] == 0:
                self.load[t] = response[first + t]
            else:
                other = other if other < _INFINITE else self.load[t]
                self.load[t] = max(response[first + t] / _MOST_SPREAD, other)
            for a in range(2):
                # Beyond the load that the other pair reads: the same one before and after a side is relieved.
                even = (side[1 - a] + side[3 - a]) / 2.0
                pressed = high[a] - (self.load[t] if self.relieved[(1 - a) * n + t] != 0 else even)
                k = a * n + t
                if self.relieved[k] != 0:
                    sign = 1.0 if side[a] >= side[2 + a] else -1.0
                    response[first + n + k] = sign * self.proportion[k] * max(pressed, 0.0)
                elif pressed > _LEAST_PRESSED * self.load[t]:
                    # Least squares over the contact: the error of one scan would last while a side is
                    # relieved.
                    self.weight[k] += pressed * pressed
                    moved = pressed * (abs(response[first + n + k]) - self.proportion[k] * pressed)
                    self.proportion[k] += moved / self.weight[k]
            response[first + t] = self.load[t]


class NoiseFloor:
    """Standard deviation of each channel's noise, from details of the wavelet bank.

    It is no less than the rounding of the converter, whose step is the smallest between two readings: at
    rest a coarse converter shows no noise, and in motion it shows its steps.

    Parameters
    ----------
    least : float
        No noise is below it.
    n_scans : float
        Averaging time in scans.
    """

    def __init__(self, n_channels: int, n_levels: int, least: float, n_scans: float) -> None:
        self.n_channels, self.n_levels, self.least, self.n_scans = n_channels, n_levels, least, n_scans
        self.mean_abs = _zeros(n_levels * n_channels)
        self.last = array("d", [_UNKNOWN] * n_channels)
        self.step = array("d", [_INFINITE] * n_channels)
        self.sd = array("d", [least] * n_channels)
        self.n = 0

    def take(self, readings: Reals, details: Reals) -> None:
        """Take readings (channels,) and details (levels, channels) of a scan whose filters are full."""
        self.n += 1
        part = 1.0 / min(1.0 * self.n, self.n_scans)
        clip = _CLIP if self.n > _CLIPPED_AFTER else _INFINITE
        for c in range(self.n_channels):
            moved = abs(readings[c] - self.last[c])
            self.last[c] = readings[c]
            if 0.0 < moved < self.step[c]:
                self.step[c] = moved
            most = clip * self._known(c)
            for level in range(self.n_levels):
                k = level * self.n_channels + c
                self.mean_abs[k] += part * (min(abs(details[k]), most) - self.mean_abs[k])
            self.sd[c] = self._known(c)

    def _known(self, channel: int) -> float:
        largest = 0.0
        for level in range(self.n_levels):
            largest = max(largest, self.mean_abs[level * self.n_channels + channel])
        noise = largest / _MEAN_ABS
        rounding = self.step[channel] / _ROUNDING if self.step[channel] < _INFINITE else 0.0
        return max(sqrt(noise * noise + rounding * rounding), self.least)


class Readings:
    """Loads and shears of the taxels, scan by scan: at one instant, and without bad channels.

    Parameters
    ----------
    stuck, bank, jumps, floor
        Of the array.
    relief : RelievedSides or None
        None for arrays whose taxels have no opposed sides.
    own, weights : (n * 3 * taxels,)
        Channels that make load, shear along x and along y of the taxels, and their weights.
    n_hold : int
        Scans for which a bad channel waits before it takes its taxel out.
    most_dropped : float
        Taxels that may be out.
    n_border : int
        Scans before the filters are full.
    history : (n * 3 * taxels,) float64
        Gets loads and shears of the newest scans.
    dropped : (taxels,) uint8
        Gets the taxels that are out.

    Attributes
    ----------
    load : float
        Mean load of the taxels in the newest scan.
    shear_sd, total_sd, load_sd : float
        Noise of a taxel's shear, of the total shear and of the mean load.
    is_read : bool
        All taxels that are not out can be read, and they are enough.
    is_lost : bool
        A taxel was taken out during the contact.
    """

    def __init__(
        self,
        stuck: StuckChannels,
        bank: Bank,
        jumps: Jumps,
        floor: NoiseFloor,
        relief: RelievedSides | None,
        own: Whole,
        weights: FloatArray,
        rate_hz: float,
        volts_per_step: float,
        n_hold: int,
        most_dropped: float,
        n_border: int,
        history: FloatArray,
        dropped: Flags,
    ) -> None:
        channels, taxels = stuck.n_channels, len(dropped)
        self.stuck, self.bank, self.jumps, self.floor = stuck, bank, jumps, floor
        self.has_sides = relief is not None
        none = np.zeros(0, dtype=np.int64)
        self.relief = relief or RelievedSides(none, none.astype(float), np.zeros(4 * taxels))
        self.n_channels, self.n_taxels, self.n_own = channels, taxels, len(own) // (3 * taxels)
        self.own, self.weights = array("q", own), array("d", weights)
        self.rate_hz, self.volts_per_step = rate_hz, volts_per_step
        self.n_hold, self.most_dropped, self.n_border = n_hold, most_dropped, n_border
        self.history, self.dropped = history, dropped
        self.n_history = len(history) // (3 * taxels)
        self.remainders = _zeros(self.n_history)
        self.rows, self.row = _zeros((n_border + _SPARE) * channels), n_border
        self.details, self.bent = _zeros(bank.n_filters * channels), _zeros(3 * taxels)
        self.baseline, self.readings, self.pressed = _zeros(channels), _zeros(channels), _zeros(channels)
        self.older, self.oldest, self.remainder = _zeros(channels), _zeros(channels), _zeros(channels)
        self.ok, self.is_stuck, self.is_out = _flags(channels), _flags(channels), _flags(channels)
        self.n_good, self.n_bad = _counts(channels), _counts(channels)
        self.begin(np.zeros(0), np.zeros(0, dtype=np.uint8), np.zeros(channels))
        self.is_begun = False
        self.load = self.shear_sd = self.total_sd = self.load_sd = 0.0
        self.is_read = self.is_lost = False

    def begin(self, steps: FloatArray, read: Flags, offset_s: FloatArray) -> None:
        """Take a block, whose scans are then taken one by one.

        Parameters
        ----------
        steps : (scans * channels,) float64
            Readings that are held, in whole steps.
        read : (scans * channels,) uint8
            0 where an older one is held.
        offset_s : (channels,) float64
            Instants of the channels after that of their scan.
        """
        self.steps, self.read, self.offset_s = steps, read, offset_s

    def take(self, scan: int, in_contact: bool, press_is_over: bool) -> None:
        """Take a scan of the block, in a contact whose press may be over."""
        channels, taxels = self.n_channels, self.n_taxels
        if scan < 0 or (scan + 1) * channels > len(self.steps):
            raise IndexError("there is no such scan in the block")
        self._take_steps(scan * channels)
        before = (self.n_history - 1) * 3 * taxels
        self.jumps.take(self.readings, before, self.history, self.floor.sd, press_is_over)
        self._take_instant()
        self._take_out(in_contact)
        is_full = True
        for c in range(channels):
            if self.n_good[c] <= self.n_border and self.is_out[c] == 0:
                is_full = False
        if is_full:
            self.floor.take(self.readings, self.details)
        self._respond(in_contact)
        self.is_begun = True
        self._take_noise()

    def rest(self, part: float) -> None:
        """Let the baseline follow the readings of a scan without contact, by a part of their difference."""
        for c in range(self.n_channels):
            self.baseline[c] += part * (self.older[c] - self.baseline[c])

    def release(self) -> None:
        """Forget which sides of taxels the contact relieved."""
        self.relief.reset()

    def interrupt(self) -> None:
        """Let no window reach back before a gap."""
        self.is_begun = False
        for c in range(self.n_channels):
            self.n_good[c] = 0

    def _take_steps(self, at: int) -> None:
        """Take the scan whose steps begin at a place: find stuck channels, and filter."""
        channels, border = self.n_channels, self.n_border
        if self.row == border + _SPARE:
            for k in range(border * channels):
                self.rows[k] = self.rows[_SPARE * channels + k]
            self.row = border
        first = self.row * channels
        for c in range(channels):
            self.rows[first + c] = self.steps[at + c]
            self.readings[c] = self.steps[at + c] * self.volts_per_step
            self.ok[c] = self.read[at + c]
            self.n_good[c] = self.n_good[c] + 1 if self.ok[c] != 0 else 0
        if not self.is_begun:
            for i in range(1, border + 1):
                for c in range(channels):
                    self.rows[first - i * channels + c] = self.steps[at + c]
        self.stuck.take(1, at, self.steps, self.is_stuck)
        self.bank.take(1, self.row, self.rows, self.details)
        self.row += 1

    def _take_instant(self) -> None:
        """Interpolate the readings to the beginning of the scan, less the baseline.

        A board reads its channels one after the other. While shear grows, the taxels that are read last have
        grown the most, by several times what partial slip changes of their shares. Linear interpolation
        leaves half of the second derivative times the times to both readings (Abramowitz and Stegun, 25.2.3).
        """
        for c in range(self.n_channels):
            now = self.readings[c]
            older = self.older[c] if self.is_begun else now
            oldest = self.oldest[c] if self.is_begun else now
            back = min(max(self.offset_s[c] * self.rate_hz, 0.0), 1.0)
            is_jump = self.jumps.found[c] != 0
            self.ok[c] = 1 if self.ok[c] != 0 and self.is_stuck[c] == 0 and not is_jump else 0
            self.oldest[c], self.older[c] = older, now
            instant = self.jumps.accepted[c] if is_jump else now - back * (now - older)
            self.pressed[c] = instant - self.baseline[c]
            self.remainder[c] = 0.5 * back * (1.0 - back) * ((now - older) - (older - oldest))

    def _take_out(self, in_contact: bool) -> None:
        """Take out taxels with a channel that is bad for long.

        A taxel stays out until the contact ends, because its zero and its share are no longer known.
        """
        channels, n_bad, n_dropped, waits = self.n_channels, 0, 0, False
        for c in range(channels):
            self.is_out[c] = 0
            self.n_bad[c] = 0 if self.ok[c] != 0 else self.n_bad[c] + 1
            n_bad += 1 if self.ok[c] == 0 else 0
        for t in range(self.n_taxels):
            n_dropped += 1 if self.dropped[t] != 0 else 0
        self.is_lost, self.is_read = False, True
        if n_bad == 0 and n_dropped == 0:
            return
        n_dropped = 0
        for t in range(self.n_taxels):
            is_bad = is_late = False
            for c in range(channels):
                if self.jumps.own[t * channels + c] != 0 and self.ok[c] == 0:
                    is_late = True
                    if self.n_bad[c] > self.n_hold:
                        is_bad = True
            was_dropped = self.dropped[t] != 0
            if in_contact and is_bad and not was_dropped:
                self.is_lost = True
            is_dropped = is_bad or (in_contact and was_dropped)
            self.dropped[t] = 1 if is_dropped else 0
            if not is_dropped:
                waits = waits or is_late
                continue
            n_dropped += 1
            for c in range(channels):
                if self.jumps.own[t * channels + c] != 0:
                    self.is_out[c] = 1
        self.is_read = not waits and n_dropped <= self.most_dropped

    def _responses(self, readings: Reals, first: int, out: Reals) -> None:
        """Make load, shear x and shear y (3, taxels) of readings (channels,), from `first` of `out` on."""
        n = 3 * self.n_taxels
        for i in range(n):
            total = 0.0
            for j in range(self.n_own):
                k = j * n + i
                total += self.weights[k] * readings[self.own[k]]
            out[first + i] = total

    def _respond(self, in_contact: bool) -> None:
        """Append loads and shears to the history, and the mean square of shears that interpolation leaves."""
        taxels, row, last = self.n_taxels, 3 * self.n_taxels, self.n_history - 1
        for k in range(last * row):
            self.history[k] = self.history[k + row]
        for i in range(last):
            self.remainders[i] = self.remainders[i + 1]
        first = last * row
        self._responses(self.pressed, first, self.history)
        if in_contact and self.has_sides:
            self.relief.correct(self.pressed, first, self.history)
        total = 0.0
        for t in range(taxels):
            if self.dropped[t] != 0:
                for k in range(3):
                    self.history[first + k * taxels + t] = 0.0
            total += self.history[first + t]
        self.load = total / taxels
        self._responses(self.remainder, 0, self.bent)
        square = 0.0
        for k in range(taxels, row):
            square += self.bent[k] * self.bent[k]
        self.remainders[last] = square / (2 * taxels)
        if not self.is_begun:  # no window straddles a gap
            for i in range(self.n_history):
                self.remainders[i] = 0.0
            for k in range(last * row):
                self.history[k] = self.history[first + k % row]

    def _take_noise(self) -> None:
        """Noise of the loads and shears, by that of the channels and what interpolation leaves."""
        taxels, variance, loads, largest = self.n_taxels, 0.0, 0.0, 0.0
        for kind in range(3):
            total = 0.0
            for i in range(kind * taxels, (kind + 1) * taxels):
                square = 0.0
                for j in range(self.n_own):
                    k = j * 3 * taxels + i
                    sd = self.weights[k] * self.floor.sd[self.own[k]]
                    square += sd * sd
                total += square
            if kind == 0:
                loads = total
            else:
                variance += total
        for i in range(self.n_history):
            largest = max(largest, self.remainders[i])
        shear_sd = sqrt(variance / (2 * taxels))
        self.shear_sd = sqrt(shear_sd * shear_sd + largest)
        self.total_sd = sqrt(variance / 2.0)
        self.load_sd = sqrt(loads) / taxels
