"""Ripple that travels over the taxels of a contact: proof of sliding, even where shear says nothing.

A ridge passes the taxels one after the other. What a hand does to a held object acts on a rigid body: loads
change in proportion to the load and to the place, along x and along y, and so do shears. The plane through
the loads and those through the shears, each taxel weighed by its load, are therefore left out. A line of
the spectrum is then taken for a travelling ripple where

1. it stands out of the other frequencies,
2. most of it is in what the planes leave,
3. its phases fill the circle: a part that shakes has phases of 0 and 180 degrees only, and
4. it is more than rounding makes: readings that creep step from one whole number of the converter to the
   next, all at one frequency, each with a phase of its own.

A line needs four periods, and a window that holds the beginning of the slide shows more than a line. So
windows of 2 to 16 s are looked at: the two shortest each half second, the others in turn.
"""

import functools

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.front_end import Reals, response_weights
from tactiled.detect.signal.median import median
from tactiled.detect.signal.pressure import ROUNDING, STOPPED

_HOP_S = 0.5  # choice
# choice: hops; each is longer by 1.4. One of the long ones at a time, since a look at 16 s takes a
# millisecond.
_SHORT, _LONG = (4, 6), (8, 12, 16, 24, 32)
_LEAST_CYCLES = 4  # prior: slower changes are of the hand
_FASTEST_HZ = 20.0  # choice: faster scans are averaged
_FEWEST = 6  # derived: taxels: a plane takes three of them, and phases need some more
# derived: power of the line over the median of all frequencies: 2.5 is the most of white noise in 18
# directions.
_STANDS_OUT = 10.0
# prior: power of the line over that of any other frequency but its lobe and harmonics: slow noise has no
# line.
_OVER_OTHERS = 8.0
_LOBE, _HARMONICS = 2, (2, 3)  # derived
_BEYOND_PLANES = 0.1  # derived: of the line's power: of a rigid motion, gains that differ by 15 % leave 0.05
_MOST_ALIKE = 0.7  # prior: mean of doubled phasors over their mean size: 0 of a wave, 1 of a part that shakes
# derived: variance of a sine over its power in a Hann window, times the number of samples squared
_HANN = 8.0
# choice: steps of a channel over those of most: a still channel that jumped has shown no step
_OF_USUAL = 2.0


class TravellingRipple:
    """Detect a ripple that travels over an array, at one scan rate.

    Parameters
    ----------
    array : Array
        With places, loads and shears.
    rate_hz : float
        Scan rate.
    least_steps : (channels,) float64
        Least difference between readings of two scans in a row, infinite before 16 scans were read: a view,
        which each look reads.
    unit_per_step : float
        Unit of the array for each of these steps.

    Attributes
    ----------
    seen_s : float
        Length of the window in which a ripple travels now; 0.0 where none does.
    """

    def __init__(self, array: Array, rate_hz: float, least_steps: Reals, unit_per_step: float = 1.0) -> None:
        self._n_mean = max(1, round(rate_hz / (2.5 * _FASTEST_HZ)))
        self._step_s = self._n_mean / rate_hz
        self._hop = max(4, round(_HOP_S / self._step_s))
        places = np.stack([np.ones(array.n_taxels), array.x_mm, array.y_mm])
        self._places = places / np.abs(places).max(axis=1, keepdims=True).clip(1e-9)
        self.can_tell = array.has_places and array.n_taxels >= _FEWEST
        self._least_steps = least_steps
        self._rounding = response_weights(array) ** 2 * (unit_per_step**2 * ROUNDING)
        self._scans = np.zeros((self._hop * self._n_mean, 3 * array.n_taxels))  # of the present hop
        self._means = np.zeros((_LONG[-1], self._hop, 3 * array.n_taxels))
        self.reset()

    def reset(self) -> None:
        """Forget what was seen: the contact is another one, or a gap came between."""
        self._n_scans = self._n_hops = 0
        self.seen_s = 0.0
        self._seen_in = 0  # hops

    def take(self, responses: FloatArray) -> float:
        """Take loads and shears (3 * taxels,) of a scan in contact; return `seen_s`."""
        if not self.can_tell:
            return 0.0
        self._scans[self._n_scans] = responses
        self._n_scans += 1
        if self._n_scans == len(self._scans):
            sums = self._scans.reshape(self._hop, self._n_mean, -1).sum(axis=1)
            self._means[self._n_hops % len(self._means)] = sums / self._n_mean
            self._n_scans = 0
            self._n_hops += 1
            self._look()
        return self.seen_s

    def _look(self) -> None:
        """Look at windows that are full; a ripple goes on until the window that showed it shows none."""
        hops = self._n_hops
        if self._seen_in:
            windows = [window for window in _SHORT if window < self._seen_in] + [self._seen_in]
        else:
            windows = [*_SHORT, _LONG[hops % len(_LONG)]]
        self._seen_in = next((w for w in windows if w <= hops and self._travels(w)), 0)
        self.seen_s = self._seen_in * self._hop * self._step_s

    def _travels(self, n_hops: int) -> bool:
        """Return True where a ripple travels in the newest means."""
        newest = np.arange(self._n_hops - n_hops, self._n_hops) % len(self._means)
        n = n_hops * self._hop
        responses = self._means[newest].reshape(n, 3, -1)
        load = np.maximum(responses[:, 0].mean(axis=0), 0.0)
        # What the planes leave, in directions that are orthogonal to them and to one another.
        beyond = np.linalg.qr((self._places * load).T, mode="complete")[0][:, len(self._places) :]
        line, hann = _bases(n)
        flat = responses.reshape(n, -1)
        flat -= line @ (line.T @ flat)
        own = flat.reshape(-1, len(load)) @ beyond
        series = np.ascontiguousarray(own.reshape(n, -1).T)
        lines = np.fft.rfft(hann * series)[:, : n // 2]
        power = (lines.real**2 + lines.imag**2).sum(axis=0)
        power[0] = 0.0
        cycles = np.arange(len(power))
        peak = int(power.argmax())
        if peak < _LEAST_CYCLES:
            return False
        others = np.abs(cycles - cycles[peak]) > _LOBE
        for harmonic in _HARMONICS:
            others &= np.abs(cycles - harmonic * cycles[peak]) > 1
        rest = max(_STANDS_OUT * float(median(power)), _OVER_OTHERS * float(power[others].max(initial=0.0)))
        if power[peak] <= rest:
            return False
        z = lines[:, peak]
        turns = hann * np.exp(-2j * np.pi * cycles[peak] * np.arange(n) / n)
        whole = float((np.abs(turns @ flat) ** 2).sum())
        if power[peak] < _BEYOND_PLANES * whole or abs((z**2).sum()) > _MOST_ALIKE * power[peak]:
            return False
        if _HANN * power[peak] <= n**2 * float(((self._of_rounding() * (load > 0)) @ beyond**2).sum()):
            return False
        # About their own mean: where the skin stops, readings keep the value that the ripple had there.
        newest = series[:, -n // 4 :].var(axis=1)
        return bool(newest.sum() > STOPPED * (series**2).mean(axis=1).sum())

    def _of_rounding(self) -> FloatArray:
        """Return the variance (3, taxels) that rounding adds to loads and shears."""
        steps = np.array(self._least_steps)
        is_known = np.isfinite(steps)
        if not is_known.any():
            return np.zeros(self._rounding.shape[:2])
        usual = float(median(steps[is_known]))
        return np.asarray(self._rounding @ np.where(is_known, np.minimum(steps, _OF_USUAL * usual), 0.0) ** 2)


@functools.lru_cache(maxsize=16)
def _bases(n: int) -> tuple[FloatArray, FloatArray]:
    """Return mean and slope (n, 2), orthonormal, and a Hann window (n,): other slow changes stay in view."""
    line = np.stack([np.ones(n), np.linspace(-1.0, 1.0, n)], axis=1)
    return line / np.sqrt((line**2).sum(axis=0)), np.hanning(n)
