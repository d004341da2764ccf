"""Front end of a contact: loads and shears of the taxels from readings, scan by scan.

Channels that are stuck (`StuckChannels`) or that jump (`Jumps`) are found, wavelet filters (`Bank`) show the
noise (`NoiseFloor`), and what is left becomes loads and shears of the taxels at one instant (`Readings`),
also where a side has lost its load (`RelievedSides`).

The file is plain Python, which Cython compiles with the types of `front_end.pxd` (`tactiled.compiled`). Both
forms have the same bits: one operation after the other, without fused multiply-add and without functions
other than `sqrt`, which IEEE 754 defines exactly. Arrays are dense and flat, with the last index moving
fastest.
"""

from array import array
from collections.abc import MutableSequence
from math import pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.bridge import BRIDGE_S
from tactiled.detect.signal.wavelet import border_scans, taps

if TYPE_CHECKING:
    from tactiled.detect.signal.pressure import Pressure

Reals = MutableSequence[float] | FloatArray
Flags = NDArray[np.uint8]

_INFINITE = float("inf")
_UNKNOWN = float("nan")
LEAST_SIDES = 3  # derived: of two readings that differ, the wrong one cannot be identified
_HISTORY, _TURNED = 128, 52  # derived: 0.4 of all: 3.3 standard deviations above a last bit that flips
_LONG = 40  # derived: 0.4^40 is 1e-16
_MOST_RESTING = 1.0 / 3.0  # prior: of the channels: where more rest, the noise has stopped
_PRESSED_OF_RANGE = 0.01  # physical: where the array file has no pressure that ends a contact (0.15 of +-8 V)
# choice: the standard deviation of the noise is read off the detail coefficients of the two finest levels of
# the stationary coif1 transform: all its filters have unit energy, so that white noise has the same standard
# deviation in each (Mallat, A Wavelet Tour of Signal Processing, 3rd ed., 5.5).
_NOISE_LEVELS = 2
AVERAGED_S = 1.0  # choice: averaging time of noise, and of the readings without contact
_CLIP = 3.0  # choice: standard deviations: a coefficient beyond counts as this much, since it is signal
_CLIPPED_AFTER = 20  # prior: scans: before, the mean is too uncertain to clip by
_ROUNDING = sqrt(12.0)  # derived: rounding to steps of q has a standard deviation of q / sqrt(12)
_MEAN_ABS = sqrt(2.0 / pi)  # derived: of a normal variable of unit variance
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
_SPARE = 64  # choice: scans after which those that the filters need move to the front
# prior: in which what interpolation between channels leaves counts as noise: the length of a jerk
_JERK_S = 0.06
_LEAST_KEPT = 0.75  # choice: of the taxels; with fewer, the messages are not valid


def zeros(n: int) -> "array[float]":
    """Return an array of n zeros, whose elements compiled code reads without Python objects."""
    return array("d", bytes(8 * n))


def counts(n: int) -> "array[int]":
    """Return n whole numbers that are zero."""
    return array("q", bytes(8 * n))


def flags(n: int) -> "array[int]":
    """Return n flags that are not set."""
    return array("B", bytes(n))


def response_weights(pad: Array) -> FloatArray:
    """Return weights (3, taxels, channels) that make load, shear along x and along y of the taxels.

    Shear is the force of the object on the skin, so that it opposes the motion of the skin.
    """
    return np.concatenate([pad.normal_weights()[np.newaxis], -pad.shear_weights()])


def _own_channels(weights: FloatArray) -> "tuple[array[int], array[float]]":
    """Return the few channels that make each response, and their weights, as flat arrays (n, responses).

    A weight is 0 where a response has fewer channels; `weights` are (responses, channels).
    """
    n_most = max(1, int(np.count_nonzero(weights, axis=1).max(initial=0)))
    own = np.argsort(weights == 0, axis=1, kind="stable")[:, :n_most].T
    own_weights = np.take_along_axis(weights.T, own, axis=0)
    return array("q", own.ravel()), array("d", own_weights.ravel())


def _other_sides(pad: Array) -> NDArray[np.int64]:
    """Return the other sides (channels, others) of a channel's taxel, itself where it has none."""
    is_side = np.array(pad.channel_kind) == "side"
    channels = np.arange(pad.n_channels)
    same = (pad.channel_taxel[:, np.newaxis] == pad.channel_taxel) & is_side & is_side[:, np.newaxis]
    others = [np.flatnonzero(same[c] & (channels != c)) for c in channels]
    most = max(1, *(len(row) for row in others))
    return np.array([np.resize(row if len(row) else c, most) for c, row in enumerate(others)])


class StuckChannels:
    """Search for stuck channels, whose valid readings do not follow the load.

    A wire that came off, an input that is held by its neighbour, a multiplexer that does not switch: the
    reading stays where it is. Two things tell it from a quiet channel, whose converter lawfully repeats a
    code for as long as noise and load stay within it.

    1. It had noise. Of the `_HISTORY` scans before the code began to repeat, readings turned back from one
       scan to the next in `_TURNED` or more. White noise of a last bit or more turns back in half of all
       scans and repeats a code in at most 0.4 of them, so that `_LONG` repeats in a row come by chance once
       in 1e15 scans; noise that only flips the last bit turns back in a quarter at most. Where noise stops
       everywhere, as when a motor stops, most channels rest, and none is stuck.
    2. It stayed while a press moved the others of its taxel, all of them and one way, by the pressure that
       ends a contact or more. Shear moves two of four sides and leaves two, and relief leaves 0.4 of a side;
       a press leaves none.

    A channel works again with its first reading that differs, and not because the press is over.
    """

    def __init__(self, pad: Array, volts_per_step: float) -> None:
        sides, n = _other_sides(pad), pad.n_channels
        pressed = _PRESSED_OF_RANGE * (pad.high - pad.low) if pad.contact is None else pad.contact.below
        judged = [len({*row} - {c}) >= LEAST_SIDES - 1 for c, row in enumerate(sides.tolist())]
        self.n_channels, self.n_sides = n, sides.shape[1]
        self.sign, self.others = array("d", pad.sign), array("q", sides.ravel())
        self.judged = array("B", judged)
        self.pressed, self.most_resting = pressed / volts_per_step, _MOST_RESTING * n
        self.is_begun, self.position = False, 0
        self.last, self.way, self.began = zeros(n), zeros(n), zeros(n * self.n_sides)
        self.run, self.n_turns = counts(n), counts(n)
        self.turns, self.noisy, self.stayed = flags(n * _HISTORY), flags(n), flags(n)

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
            self.position = (self.position + 1) % _HISTORY
            for c in range(channels):
                step = steps[at + c]
                way = 1.0 if step > self.last[c] else -1.0 if step < self.last[c] else 0.0
                self.n_turns[c] -= self.turns[turn + c]
                self.turns[turn + c] = 1 if way * self.way[c] < 0.0 else 0
                self.n_turns[c] += self.turns[turn + c]
                self.way[c], self.last[c] = way, step
                if way != 0.0:
                    self.run[c] = 0
                    self.noisy[c] = 1 if self.n_turns[c] >= _TURNED else 0
                    self.stayed[c] = 0
                else:
                    self.run[c] += 1
                if self.run[c] >= _LONG // 2:
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
                is_long = self.noisy[c] != 0 and self.run[c] >= _LONG and resting <= self.most_resting
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

    Attributes
    ----------
    own : (taxels * channels,) array of int
        1 where a channel makes load or shear of a taxel.
    accepted : (channels,) array of float
        Newest readings that did not jump.
    found : (channels,) array of int
        1 where a channel jumps, or did so one scan before.
    """

    def __init__(self, pad: Array) -> None:
        n, n_taxels = pad.n_channels, pad.n_taxels
        self.n_channels, self.n_taxels = n, n_taxels
        self.own = array("B", np.any(response_weights(pad) != 0, axis=0).ravel().view(np.uint8))
        self.accepted, self.change, self.usual = zeros(n), zeros(n), zeros(n_taxels)
        self.found, self.out, self.jumps, self.is_loaded = flags(n), flags(n), flags(n), flags(n_taxels)
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

    Attributes
    ----------
    is_due : bool
        All taxels have opposed sides.
    relieved : (2 * taxels,) array of int
        1 for the pairs, by axis and taxel, that are read from one side.
    """

    def __init__(self, pad: Array) -> None:
        shear = -pad.shear_weights() * (np.array(pad.channel_kind) == "side")
        # Channels that make the sides (half, axis, taxel), and their readings under an even load of 1.
        sides = np.concatenate([np.maximum(shear, 0.0), np.maximum(-shear, 0.0)]).reshape(-1, pad.n_channels)
        even = sides.sum(axis=1)
        self.is_due = bool(np.all(even > 0))
        self.own, self.weights = _own_channels(sides)
        self.even, self.n_taxels = array("d", even), pad.n_taxels
        self.n_own = len(self.own) // len(even)
        self.load, self.side, self.high = zeros(self.n_taxels), zeros(4), zeros(2)
        self.proportion, self.weight = zeros(2 * self.n_taxels), zeros(2 * self.n_taxels)
        self.relieved = flags(2 * self.n_taxels)
        self.reset()

    def reset(self) -> None:
        """Forget the contact."""
        for k in range(2 * self.n_taxels):
            self.relieved[k] = 0
            self.proportion[k], self.weight[k] = 2.0, 1e-12
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
    """

    def __init__(self, n_channels: int, least: float, rate_hz: float) -> None:
        self.n_channels, self.least, self.n_scans = n_channels, least, max(2.0, AVERAGED_S * rate_hz)
        self.mean_abs = zeros(_NOISE_LEVELS * n_channels)
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
            for level in range(_NOISE_LEVELS):
                k = level * self.n_channels + c
                self.mean_abs[k] += part * (min(abs(details[k]), most) - self.mean_abs[k])
            self.sd[c] = self._known(c)

    def _known(self, channel: int) -> float:
        largest = 0.0
        for level in range(_NOISE_LEVELS):
            largest = max(largest, self.mean_abs[level * self.n_channels + channel])
        noise = largest / _MEAN_ABS
        rounding = self.step[channel] / _ROUNDING if self.step[channel] < _INFINITE else 0.0
        return max(sqrt(noise * noise + rounding * rounding), self.least)


class Readings:
    """Loads and shears of the taxels, scan by scan: at one instant, and without bad channels.

    Attributes
    ----------
    recent : (n, 3, taxels) float64
        Load, shear along x and along y of the newest scans.
    load : float
        Mean load of the taxels in the newest scan.
    shear_sd, total_sd, load_sd : float
        Noise of a taxel's shear, of the total shear and of the mean load.
    is_read : bool
        All taxels that are not out can be read, and they are enough.
    keeps_enough : bool
        So many taxels are not out that what is said of the contact is valid.
    is_lost : bool
        A taxel was taken out during the contact.
    """

    def __init__(self, pad: Array, rate_hz: float, volts_per_step: float) -> None:
        channels, taxels, weights = pad.n_channels, pad.n_taxels, response_weights(pad)
        self.stuck = StuckChannels(pad, volts_per_step)
        self.bank = Bank(channels, [taps(k + 1) * volts_per_step for k in range(_NOISE_LEVELS)])
        self.jumps, self.relief = Jumps(pad), RelievedSides(pad)
        self.floor = NoiseFloor(channels, volts_per_step, rate_hz)
        self.own, self.weights = _own_channels(weights.reshape(-1, channels))
        self.n_channels, self.n_taxels, self.n_own = channels, taxels, len(self.own) // (3 * taxels)
        self.rate_hz, self.volts_per_step = rate_hz, volts_per_step
        self.n_hold, self.most_dropped = max(1, round(BRIDGE_S * rate_hz)), (1 - _LEAST_KEPT) * taxels
        self.n_border, self.n_history = border_scans(_NOISE_LEVELS), max(1, round(_JERK_S * rate_hz))
        self.recent = np.zeros((self.n_history, 3, taxels))
        self.history, self.remainders = self.recent.reshape(-1), zeros(self.n_history)
        self.rows, self.row = zeros((self.n_border + _SPARE) * channels), self.n_border
        self.details, self.bent = zeros(_NOISE_LEVELS * channels), zeros(3 * taxels)
        self.baseline, self.readings, self.pressed = zeros(channels), zeros(channels), zeros(channels)
        self.older, self.oldest, self.remainder = zeros(channels), zeros(channels), zeros(channels)
        self.ok, self.is_stuck, self.is_out = flags(channels), flags(channels), flags(channels)
        self.n_good, self.n_bad, self.dropped = counts(channels), counts(channels), flags(taxels)
        self.steps, self.read, self.n_room = zeros(0), flags(0), 0
        self.offset_of: FloatArray | None = None
        self.is_begun = self.is_read = self.is_lost = False
        self.keeps_enough = True
        self.load = self.shear_sd = self.total_sd = self.load_sd = 0.0

    def follow(self, gate: "Pressure", channel_offset_s: FloatArray) -> None:
        """Take the scans of a block from where the contact gate holds them, one by one.

        `channel_offset_s` are the instants (channels,) of the channels after that of their scan.
        """
        # Each view takes a microsecond.
        if gate.n_room != self.n_room or channel_offset_s is not self.offset_of:
            self.steps, self.read, self.offset_s = gate.steps, gate.ok, channel_offset_s
            self.n_room, self.offset_of = gate.n_room, channel_offset_s

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
        self.is_lost, self.is_read, self.keeps_enough = False, True, True
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
        self.keeps_enough = n_dropped <= self.most_dropped
        self.is_read = not waits and self.keeps_enough

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
        if in_contact and self.relief.is_due:
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
