"""Ripple that travels over the taxels of a contact: proof of sliding, even where shear says nothing.

A ridge passes the taxels one after the other. What a hand does to a held object acts on a rigid body: loads
change in proportion to the load and to the place, along x and along y, and so do shears. The plane through
the loads and those through the shears, each taxel weighed by its load, are therefore left out. A line of
the spectrum is then taken for a travelling ripple where

1. it stands out of the other frequencies,
2. most of it is in what the planes leave, and
3. its phases fill the circle: a part that shakes has phases of 0 and 180 degrees only.

A line needs four periods, and a window that holds the beginning of the slide shows more than a line. So
windows of 2 to 16 s are looked at, each again when a quarter of it is new.
"""

import numpy as np

from tactiled.array import Array, FloatArray

_HOP_S = 0.5
_WINDOWS = (4, 6, 8, 12, 16, 24, 32)  # hops; each is longer by 1.4
_OVERLAP = 4  # looks in the length of a window
_LEAST_CYCLES = 4  # slower changes are of the hand
_FASTEST_HZ = 20.0  # faster scans are averaged
_FEWEST = 6  # taxels: a plane takes three of them, and phases need some more
# Power of the line over the median of all frequencies: 2.5 is the most of white noise in 18 directions.
_STANDS_OUT = 10.0
# Power of the line over that of any other frequency but its lobe and harmonics: slow noise has no line.
_OVER_OTHERS = 8.0
_LOBE, _HARMONICS = 2, (2, 3)
_BEYOND_PLANES = 0.15  # of the line's power; gains that differ by 15 % leave a part of 0.05 of a rigid motion
_MOST_ALIKE = 0.5  # mean of doubled phasors over their mean size: 0 of a wave, 1 of a part that shakes
_STOPPED = 0.25  # power of the newest quarter over that of the window


class TravellingRipple:
    """Tell whether a ripple travels over the array; one array at one scan rate.

    Parameters
    ----------
    array : Array
        With places, loads and shears.
    rate_hz : float

    Attributes
    ----------
    seen_s : float
        Length of the window in which a ripple travels now; 0.0 where none does.
    """

    def __init__(self, array: Array, rate_hz: float) -> None:
        shear = array.shear_weights()
        self._weights = np.concatenate([array.normal_weights()[np.newaxis], shear])  # (3, taxels, channels)
        self._n_mean = max(1, round(rate_hz / (2.5 * _FASTEST_HZ)))
        self._step_s = self._n_mean / rate_hz
        self._hop = max(4, round(_HOP_S / self._step_s))
        places = np.stack([np.ones(array.n_taxels), array.x_mm, array.y_mm])
        self._places = places / np.abs(places).max(axis=1, keepdims=True).clip(1e-9)
        self.can_tell = array.has_places and array.n_taxels >= _FEWEST
        self._past = np.zeros((_WINDOWS[-1] * self._hop, 3, array.n_taxels))
        self._partial: list[FloatArray] = []
        self.reset()

    def reset(self) -> None:
        """Forget what was seen: the contact is another one, or a gap came between."""
        self._n = 0
        self._partial.clear()
        self.seen_s = 0.0
        self._seen_in = 0  # hops

    def take(self, readings: FloatArray) -> float:
        """Take the readings (channels,) of a scan in contact; return `seen_s`."""
        if not self.can_tell:
            return 0.0
        self._partial.append(readings)
        if len(self._partial) < self._n_mean:
            return self.seen_s
        self._past[self._n % len(self._past)] = self._weights @ np.mean(self._partial, axis=0)
        self._partial.clear()
        self._n += 1
        if self._n % self._hop == 0:
            self._look(self._n // self._hop)
        return self.seen_s

    def _look(self, hops: int) -> None:
        """Look at the windows that are full and a quarter of which is new.

        A ripple that was seen in a window goes on until that window shows none.
        """
        for window in _WINDOWS:
            if window > hops or hops % (window // _OVERLAP) or (self._seen_in and window > self._seen_in):
                continue
            if self._travels(self._newest(window * self._hop)):
                self._seen_in, self.seen_s = window, window * self._hop * self._step_s
                return
            if window == self._seen_in:
                self._seen_in, self.seen_s = 0, 0.0

    def _newest(self, n: int) -> FloatArray:
        return self._past[np.arange(self._n - n, self._n) % len(self._past)]

    def _travels(self, responses: FloatArray) -> bool:
        """Return True where a ripple travels in loads and shears (n, 3, taxels) of a window."""
        n = len(responses)
        load = np.maximum(responses[:, 0].mean(axis=0), 0.0)
        planes = np.linalg.qr((self._places * load).T)[0]
        centred = _without_line(responses.reshape(n, -1)).reshape(responses.shape)
        own = centred - (centred @ planes) @ planes.T
        hann = np.hanning(n)[:, np.newaxis, np.newaxis]
        lines = np.fft.rfft(hann * own, axis=0)[: n // 2]
        power = (np.abs(lines) ** 2).sum(axis=(1, 2))
        power[0] = 0.0
        cycles = np.arange(len(power))
        peak = int(power.argmax())
        if peak < _LEAST_CYCLES:
            return False
        others = np.abs(cycles - cycles[peak]) > _LOBE
        for harmonic in _HARMONICS:
            others &= np.abs(cycles - harmonic * cycles[peak]) > 1
        rest = max(
            _STANDS_OUT * float(np.median(power)), _OVER_OTHERS * float(power[others].max(initial=0.0))
        )
        if power[peak] <= rest:
            return False
        z = lines[peak]
        turns = np.exp(-2j * np.pi * cycles[peak] * np.arange(n) / n)
        whole = float((np.abs(np.tensordot(turns * hann[:, 0, 0], centred, 1)) ** 2).sum())
        if power[peak] < _BEYOND_PLANES * whole or abs((z**2).sum()) > _MOST_ALIKE * power[peak]:
            return False
        newest = own[-n // 4 :]
        return bool((newest**2).mean() > _STOPPED * (own**2).mean())


def _without_line(series: FloatArray) -> FloatArray:
    """Return series (n, m) without mean and slope; what else is slow shows in the lowest frequencies."""
    basis = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(series)), 1))[0]
    return np.asarray(series - basis @ (basis.T @ series))
