"""Slip told by roughness and ripple: windows of readings to the beginning and the end of sliding.

Log odds of windows (`evidence`) add up, between 0 and a bound. Sliding begins where the sum exceeds a
threshold, and ends where it is spent, or at once where readings change far less from scan to scan than they
did in the slide. Windows in which the contact begins or ends tell nothing.
What the sensor does at rest is learnt from windows without evidence, in this contact where there was a hold.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.median import median
from tactiled.detect.signal.quantise import HeldReadings
from tactiled.detect.sliding.evidence import Spectra, log_odds, own_power, ripple_odds, spectra

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
_LEAST_STEPS = 1.0 / 12  # derived: variance of rounding to whole steps
_ROUNDING = 1.0 / 6  # derived: of the square of the smallest change: twice that of even rounding


class Change(NamedTuple):
    """Beginning or end of sliding at a scan."""

    row: int  # scan of the block
    is_onset: bool
    statistic: float
    scans_before: int  # scans from the onset to this scan, about
    is_gross: bool = True  # False where it may be that only a part of the contact slips


class _Rest:
    """Noise and own changes of the channels, from windows at rest; see `own_power`."""

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
        self._partial = np.empty((0, array.n_channels))
        self._window = np.zeros((self._size, array.n_channels))
        self._is_good = np.zeros((self._size, array.n_channels), dtype=np.bool_)
        self._partial_ok = np.empty((0, array.n_channels), dtype=np.bool_)
        self._touching = np.zeros(self._size, dtype=np.bool_)
        self._n = 0  # means so far
        self._was_touching = False
        self._unchanged = 0  # scans since contact began or ended
        self._rest = _Rest(array.n_channels)
        self._odds, self._since_hop = 0.0, 0
        self._activities: list[float] = []
        self._n_stopped = 0
        self.slides = False

    def process(self, held: HeldReadings, touches: NDArray[np.bool_]) -> list[Change]:
        """Return the changes that the scans complete; `touches` (n,) says which are in contact."""
        changes: list[Change] = []
        done, n = 0, len(held.steps)
        while done < n:
            take = min(self._mean_of - len(self._partial), n - done)
            rows = slice(done, done + take)
            self._partial = np.concatenate([self._partial, held.steps[rows]])
            self._partial_ok = np.concatenate([self._partial_ok, held.ok[rows]])
            for row in range(done, done + take):
                is_same = bool(touches[row]) == self._was_touching
                self._unchanged = self._unchanged + 1 if is_same else 0
                if self.slides and self._was_touching and not touches[row]:
                    changes.append(self._end(row))
                self._was_touching = bool(touches[row])
            done += take
            if len(self._partial) < self._mean_of:
                continue
            if change := self._add(bool(touches[done - 1]), done - 1):
                changes.append(change)
        return changes

    def _add(self, touches: bool, row: int) -> Change | None:
        place = self._n % self._size
        self._window[place] = self._partial.sum(axis=0) / self._mean_of
        self._is_good[place] = self._partial_ok.all(axis=0)
        self._touching[place] = touches
        self._partial = self._partial[:0]
        self._partial_ok = self._partial_ok[:0]
        self._n += 1
        if self._n < self._size or self._n % self._hop:
            return None
        return self._look(row)

    def _look(self, row: int) -> Change | None:
        """Look at the window, which is full and ends at a scan."""
        order = np.arange(self._n, self._n + self._size) % self._size
        readings, good = self._window[order], self._is_good[order]
        touching = self._touching[order]
        if self._stops(readings):
            return self._end(row)
        if touching.any() != touching.all():
            return None
        used = good.mean(axis=0) > 0.9
        if not used.any():
            return None
        readings = readings[:, used]
        change = np.abs(np.diff(readings, axis=0))
        smallest = np.where(change > 0, change, np.inf).min(axis=0)
        rounding = np.maximum(np.where(np.isfinite(smallest), smallest, 0.0) ** 2 * _ROUNDING, _LEAST_STEPS)
        found = spectra(readings, rounding)
        rest = self._rest
        noise = rest.noise(used, found.noise)
        gained = self._log_odds(found, noise)
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
            rest.learn(used, found.noise, own_power(found, noise))
        return None

    def _log_odds(self, found: Spectra, noise: FloatArray) -> float:
        rest = self._rest
        if rest.n < _KNOWN_HOPS:
            return ripple_odds(found) or _NO_RIPPLE
        over_rest = log_odds(found, own_power(found, noise), rest.own)
        if rest.is_of_contact:
            return over_rest
        return min(over_rest, log_odds(found, own_power(found, found.noise), None))

    def _stops(self, readings: FloatArray) -> bool:
        """Return True where the newest readings of a slide change far less than those before."""
        if not self.slides:
            return False
        newest = np.diff(readings[-self._hop :], axis=0)
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
