"""Slip told by roughness and ripple: windows of readings to the beginning and the end of sliding.

A surface that moves under the skin loads each taxel on its own. A hand that trembles, a motor that hums, a
tap and a change of grip act on a rigid body: on the load and on its two tilts, which are three patterns over
the channels. Without the three strongest patterns of a window, a channel at rest is left with its own noise.

1. Spectra of the window: a cubic trend removed, under a Hann window, over the noise of each channel.
2. Roughness: the largest mean of three neighbouring bins of what the three strongest patterns leave, over the
   same at rest. Where rest was seen out of contact alone, it must exceed white noise at the level of the
   window's quietest quarter of bins, too. What happens in one quarter of the window, such as a tap, does not
   count. Before rest was seen, roughness says nothing: noise at rest has a spectrum of its own.
3. Ripple: the strongest line that travels, whose phases differ between channels. A ridge passes the taxels
   one after the other, so that the phases of its ripple fill the circle. A hum of the gripper or a tremor of
   the hand shakes the load and tilts it: phasors in phase, and phasors of both signs in quadrature to these.
   Then either the phases have a mean, or twice the phases have. Places of the taxels are not needed. Ridges
   as far apart as twice the array, or as the taxels, are not told from a hum.
4. Log odds of sliding: both over what windows at rest reach, bounded, so that no single window decides. They
   add up, between 0 and a bound. Sliding begins where the sum exceeds a threshold, and ends where it is
   spent, or at once where readings change far less from scan to scan than they did in the slide. Windows in
   which the contact begins or ends tell nothing.

What the sensor does at rest is learnt from windows without evidence, in this contact where there was a hold.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.swings import LEAST_CYCLES, LOBE, apart_from, swing_spectrum
from tactiled.detect.signal.median import median
from tactiled.detect.signal.pressure import ROUNDING
from tactiled.detect.signal.quantise import HeldReadings

_FINEST_HZ = 100.0  # choice: faster scans are averaged: ridges pass at less than half of this rate
_WINDOW_S = 2.0  # choice
# derived: bins enough for the noise beside a line, and scans enough for three patterns.
_LEAST_WINDOW = 72
_HOPS = 8  # choice: in a window
BEGINS, _BOUND, _SPENT = 3.0, 5.0, 0.5  # choice: log odds; two windows at least, four to forget
_LEARNS_BELOW = 1.0  # prior: log odds of sliding up to which a window shows the rest
_NO_RIPPLE = -1.0  # prior: log odds, before rest was seen: what does not travel is taken for rest
_KNOWN_HOPS = 4  # choice: at rest, before their mean counts
_MEMORY_HOPS = 32  # choice: 8 s
_STOPPED = 0.25  # prior: power of changes from scan to scan, over the median of the slide
_STOPPED_HOPS = 2  # choice
_PATTERNS = 3  # derived: load, and tilt in two directions
_CHANNELS_OF_PATTERN = 3  # prior: at least, for each pattern that is left out
_FEW = 4  # derived: channels, of which hum and roughness cannot be told apart
_SMOOTH = np.ones(3) / 3  # choice
_QUIET_PART = 0.25  # prior: of the bins, which show the noise
# tuned: set on seeds 0 to 7 of the worlds of `sensors` in research/README.md (16 taxels, 35.6 Hz). Largest of
# some ten independent groups of bins, in standard deviations of their logarithm, with a margin for noise that
# is not quite even.
_AT_REST, _AT_REST_SDS = 0.4, 3.5
_SLOPE = 4.0  # tuned: on the same seeds; log odds for each unit of log power beyond
_LINE_AT_REST = 0.7  # tuned: twice the most at rest on the same seeds, in logarithms
_ONCE = 0.6  # derived: of the excess: a slide through the window has a quarter in each
_MOST = 1.4  # tuned: on the same seeds; log odds of one window by either: less than sliding needs

# derived: mean phasor over mean size of phasors, of the phases or of twice the phases: 0 for phases that fill
# the circle, at least 0.45 for a hum in any proportion of load and tilt on a row of taxels.
_MOST_ALIKE = 0.4
# derived: phases of fewer that are noise fill the circle by chance, or have a mean by chance
_LEAST_CHANNELS = 6


class Change(NamedTuple):
    """Beginning or end of sliding at a scan."""

    row: int  # scan of the block
    is_onset: bool
    statistic: float
    scans_before: int  # scans from the onset to this scan, about
    is_gross: bool = True  # False where it may be that only a part of the contact slips


def travelling_line(z: NDArray[np.complex128], first_cycles: int) -> float:
    """Logarithm of the power of the strongest bin over that of any other, except its lobe and harmonics.

    Where the first bin is the strongest, also over what creep would leave there.

    Of spectra (bins, channels) under a Hann window, each channel over its own standard deviation, whose first
    bin has `first_cycles` periods in the window; 0 where the line does not travel.
    """
    if z.shape[1] < _LEAST_CHANNELS:
        return 0.0
    power = (np.abs(z) ** 2).sum(axis=1)
    cycles = np.arange(len(z)) + first_cycles
    peak = int(np.argmax(power))
    size = np.abs(z[peak])
    doubled = z[peak] ** 2 / np.maximum(size, 1e-30)
    if max(abs(z[peak].sum()), abs(doubled.sum())) > _MOST_ALIKE * float(size.sum()):
        return 0.0
    others = apart_from(cycles, int(cycles[peak]))
    if not others.any():
        return 0.0
    background = max(float(power[others].max()), 1e-30)
    if peak == 0:
        # Channels that creep, each on its own, have most in the first bin: power that falls with the square
        # of frequency, as that of a random walk. What the bins beside the lobe show of it is no line.
        beside = slice(LOBE + 1, 2 * LOBE + 2)
        of_creep = power[beside] * (cycles[beside] / cycles[0]) ** 2
        background = max(background, float(of_creep.mean()))
    return float(np.log(max(power[peak], 1e-30) / background))


class _Spectra(NamedTuple):
    """Spectra of a window."""

    z: NDArray[np.complex128]  # (bins, channels)
    noise: FloatArray  # (channels,): power of each channel's noise in a bin, at the quietest quarter of bins
    readings: FloatArray  # (n, channels): without their trend


def _spectra(readings: FloatArray, rounding_power: FloatArray) -> _Spectra:
    """Compute spectra of readings (n, channels); `rounding_power` (channels,) is the least noise of each."""
    n, found = len(readings), swing_spectrum(readings)
    z = found.values[LEAST_CYCLES : n // 2]
    power = np.sort(np.abs(z) ** 2, axis=0)[int(_QUIET_PART * len(z))]
    least = rounding_power * float((np.hanning(n) ** 2).sum())
    return _Spectra(z, np.maximum(power, np.maximum(least, 1e-12)), found.readings)


def _own_power(found: _Spectra, noise: FloatArray) -> FloatArray:
    """Power (bins,) over the noise that the strongest patterns of a window leave, mean over channels."""
    z, strongest = found.z / np.sqrt(noise), _strongest_patterns(found, noise)
    own = z - z @ strongest @ strongest.T
    return np.asarray((np.abs(own) ** 2).sum(axis=1) / (z.shape[1] - strongest.shape[1]))


def _strongest_patterns(found: _Spectra, noise: FloatArray) -> FloatArray:
    """Strongest patterns over the noise, as unit vectors: (channels, left out).

    Where fewer channels change than patterns are left out, there are fewer: what only rounding has made is
    any direction, and must not be left out of the readings.
    """
    z = found.z / np.sqrt(noise)
    parts = np.concatenate([z.real, z.imag])
    _, sizes, patterns = np.linalg.svd(parts, full_matrices=False)
    rank = int((sizes > sizes[:1] * max(parts.shape) * np.finfo(np.float64).eps).sum())
    return np.asarray(patterns[: min(_n_patterns(z.shape[1]), rank)].T)


def _happens_once(found: _Spectra) -> bool:
    """Return True where most of what exceeds the noise is in one quarter of the window, as of a tap."""
    n = len(found.readings)
    readings, strongest = found.readings / np.sqrt(found.noise), _strongest_patterns(found, found.noise)
    own = readings - readings @ strongest @ strongest.T
    power = (own**2).mean(axis=1)[: n // 4 * 4].reshape(4, -1).mean(axis=1)
    # A quarter of exponentially distributed power is below 0.29 of its mean; a Hann window has 3/8 of n.
    noise = 1 / (-np.log(1 - _QUIET_PART) * 0.375 * n)
    excess = np.maximum(power - noise, 0.0)
    return bool(excess.max() > _ONCE * excess.sum())


def _n_patterns(channels: int) -> int:
    """Number of patterns that are left out."""
    return min(_PATTERNS, channels // _CHANNELS_OF_PATTERN)


def _log_odds(found: _Spectra, own: FloatArray, at_rest: FloatArray | None) -> float:
    """Log odds of sliding, given the `_own_power` (bins,) of a window and that at rest, where it is known."""
    bins, channels = found.z.shape
    n_free = channels - _n_patterns(channels)
    if channels < _FEW:
        return -_MOST
    sd = float(1 / np.sqrt(2 * n_free))
    if at_rest is None:
        level = np.sort(own)[int(_QUIET_PART * bins)]
        ratio = np.convolve(own, _SMOOTH, "valid") / max(float(level), 1e-12)
    else:
        ratio = np.convolve(own, _SMOOTH, "valid") / np.convolve(at_rest, _SMOOTH, "valid").clip(1e-12)
    growth = float(np.log(max(float(ratio.max()), 1e-12)))
    rough = float(np.clip(_SLOPE * (growth - _AT_REST - _AT_REST_SDS * sd), -_MOST, _MOST))
    if rough > 0 and _happens_once(found):
        rough = 0.0
    ripple = _ripple_odds(found)
    return rough if ripple <= 0 else max(rough, 0.0) + ripple


def _ripple_odds(found: _Spectra) -> float:
    """Log odds of sliding that the ripple of a window gives; 0 where no line travels."""
    size = np.maximum(found.readings.std(axis=0), np.sqrt(found.noise / len(found.z)))
    line = travelling_line(found.z / size, LEAST_CYCLES) - _LINE_AT_REST
    return float(np.clip(_SLOPE * line, 0.0, _MOST))


class _Rest:
    """Noise and own changes of the channels, from windows at rest; see `_own_power`."""

    def __init__(self, n_channels: int) -> None:
        self.n = 0
        self.is_of_contact = False
        self._noise = np.full(n_channels, np.nan)
        self.own: FloatArray | None = None

    def noise(self, used: NDArray[np.bool_], now: FloatArray) -> FloatArray:
        """Noise of the channels that are used; that of `now` where none is known."""
        known = self._noise[used]
        return np.where(np.isfinite(known), known, now)

    def learn(self, used: NDArray[np.bool_], noise: FloatArray, own: FloatArray) -> None:
        """Take in a window at rest: noise of the channels that are used, and their own changes."""
        self.n = min(self.n + 1, _MEMORY_HOPS)
        before = self.noise(used, noise)
        self._noise[used] = before + (noise - before) / self.n
        self.own = own if self.own is None else self.own + (own - self.own) / self.n


class SlidingTracker:
    """Track the sliding of one array at one scan rate."""

    def __init__(self, array: Array, rate_hz: float) -> None:
        self._mean_of = max(1, round(rate_hz / _FINEST_HZ))
        n = max(_LEAST_WINDOW, round(_WINDOW_S * rate_hz / self._mean_of))
        self._hop = n // _HOPS
        self._size = self._hop * _HOPS
        self._sum = np.zeros(array.n_channels)
        self._n_summed = 0
        self._is_read = np.ones(array.n_channels, dtype=np.bool_)  # in all scans of the sum
        self._window = np.zeros((self._size, array.n_channels))
        self._is_good = np.zeros((self._size, array.n_channels), dtype=np.bool_)
        self._touching = np.zeros(self._size, dtype=np.bool_)
        self._n = 0  # means so far
        self._was_touching = False
        self._unchanged = 0  # scans since contact began or ended
        self._rest = _Rest(array.n_channels)
        self._odds, self._since_hop = 0.0, 0
        self._activities: list[float] = []
        self._n_stopped = 0
        self.slides = False

    def process(
        self, held: HeldReadings, touches: NDArray[np.bool_], swings: NDArray[np.bool_]
    ) -> list[Change]:
        """Return the changes that the scans complete.

        Parameters
        ----------
        touches : (n,)
            Which are in contact.
        swings : (n,)
            Which are in none, while taxels are known to swing at rest: what they show is rest.
        """
        changes: list[Change] = []
        for row, steps in enumerate(held.steps):
            touching = bool(touches[row])
            self._unchanged = self._unchanged + 1 if touching == self._was_touching else 0
            if self.slides and self._was_touching and not touching:
                changes.append(self._end(row))
            self._was_touching = touching
            self._sum = self._sum + steps
            self._is_read = self._is_read & held.ok[row]
            self._n_summed += 1
            if self._n_summed == self._mean_of and (change := self._add(row, bool(swings[row]))):
                changes.append(change)
        return changes

    def _add(self, row: int, swings: bool) -> Change | None:
        place = self._n % self._size
        self._window[place] = self._sum / self._mean_of
        self._is_good[place] = self._is_read
        self._touching[place] = self._was_touching
        self._sum, self._n_summed, self._is_read = np.zeros_like(self._sum), 0, np.ones_like(self._is_read)
        self._n += 1
        if self._n < self._size or self._n % self._hop:
            return None
        return self._look(row, swings)

    def _look(self, row: int, swings: bool) -> Change | None:
        """Look at the window, which is full and ends at a scan."""
        order = np.arange(self._n, self._n + self._size) % self._size
        readings, good = self._window[order], self._is_good[order]
        touching = self._touching[order]
        if self._stops(readings, good):
            return self._end(row)
        if touching.any() != touching.all():
            return None
        used = good.mean(axis=0) > 0.9
        if not used.any():
            return None
        readings = readings[:, used]
        change = np.abs(np.diff(readings, axis=0))
        smallest = np.where(change > 0, change, np.inf).min(axis=0)
        # Twice that of even rounding to the smallest change.
        rounding = np.where(np.isfinite(smallest), smallest, 0.0) ** 2 * (2 * ROUNDING)
        found = _spectra(readings, np.maximum(rounding, ROUNDING))
        rest = self._rest
        noise = rest.noise(used, found.noise)
        gained = _NO_RIPPLE if swings else self._gained(found, noise)
        self._odds = float(np.clip(self._odds + gained, 0.0, _BOUND))
        if self._odds == 0.0:
            self._since_hop = self._n
        if self.slides:
            if self._odds <= _SPENT:
                return self._end(row)
        elif self._odds >= BEGINS:
            self.slides = True
            self._n_stopped, self._activities = 0, []
            n = (self._n - self._since_hop + self._size // 2) * self._mean_of
            return Change(row, True, self._odds, min(n, self._unchanged))
        elif gained < 0 and self._odds < _LEARNS_BELOW:
            if touching.all() != rest.is_of_contact:  # the new state soon outweighs the old
                rest.n, rest.is_of_contact = min(rest.n, _KNOWN_HOPS), bool(touching.all())
            rest.learn(used, found.noise, _own_power(found, noise))
        return None

    def _gained(self, found: _Spectra, noise: FloatArray) -> float:
        """Log odds of the window, as far as rest is known."""
        rest = self._rest
        if rest.n < _KNOWN_HOPS:
            return _ripple_odds(found) or _NO_RIPPLE
        over_rest = _log_odds(found, _own_power(found, noise), rest.own)
        if rest.is_of_contact:
            return over_rest
        return min(over_rest, _log_odds(found, _own_power(found, found.noise), None))

    def _stops(self, readings: FloatArray, good: NDArray[np.bool_]) -> bool:
        """Return True where the newest readings of a slide change far less than those before.

        Held readings of channels that are not read do not change, which shows no stop.
        """
        is_read = good[-self._hop :].all(axis=0)
        if not self.slides or not is_read.any():
            return False
        newest = np.diff(readings[-self._hop :, is_read], axis=0)
        activity = float((newest**2).mean())
        self._activities = [*self._activities[-_MEMORY_HOPS:], activity]
        is_still = activity < _STOPPED * float(median(np.array(self._activities)))
        self._n_stopped = self._n_stopped + 1 if is_still else 0
        return self._n_stopped >= _STOPPED_HOPS

    def _end(self, row: int) -> Change:
        self.slides = False
        odds, self._odds = self._odds, 0.0
        # The window still holds the slide.
        self._n = self._since_hop = self._n % self._hop
        self._touching[:] = False
        return Change(row, False, odds, 0)
