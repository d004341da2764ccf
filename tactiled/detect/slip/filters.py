"""Causal filters on the array's response: ramps detect an onset, a wavelet bank measures the noise.

Ramps. A response that begins to grow m scans ago is ``b + s k``, k = 0 over `N_BASELINE` scans before and
1..m since. The least-squares slope s is one filter whose weights sum to zero, and with white noise of known
size the squared slope over its variance is the likelihood ratio for "grows since m scans ago" against "does
not grow" (Kay, Fundamentals of Statistical Signal Processing II, 1998, section 7.4). Lengths grow by about
a half, so that any onset is within a quarter of some length; the ramp is one-sided, so the decision does not
wait for a peak. Lengths from two scans to `_LONGEST_S` catch slopes from a jolt to a creep.

The decision uses ramps and not levels of coif1 on all channels: coif1 has two vanishing moments, so it
responds to linear growth only at its beginning. Median (and 95 %) of the time from the beginning of shear to
the first event, for slips of the physical families at one false alarm an hour in noise of 0.3, 1, 3 and
10 mV: coif1 levels together 10 (17), 14 (39), 22 (129), 27 (332) ms; ramps 12 (22), 12 (22), 14 (30),
19 (89) ms (`bench.slip.levels`).

Bank. The coif1 levels of `wavelet` on the same response share the noise out by octaves: by the wavelet
variance (Percival and Walden, Wavelet Methods for Time Series Analysis, 2000, section 8.3) the variance of
any filter's output is the sum over octaves of its energy there times the noise's level there. White noise has
the same level in all octaves; hum and drift have a higher one in theirs, which raises the threshold only of
filters that respond there.

Exactness. Responses are whole within 2^25. Taps are whole multiples of 2^-24 with absolute sums up to 9.14;
ramps have whole weights with absolute sums below 2^28: every sum stays below 2^53.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.signal.wavelet import taps

N_BASELINE = 16  # scans before the ramp: with half as many a slope over 20 scans has 11 % more noise
LEVELS = (1, 2, 3, 4, 5)
_LONGEST_S = 1.28  # the slowest creep into slip is 12 s long; it grows by a tenth of friction in so long
_LONGEST_SCANS = 448  # keeps sums exact (see above) where scans come faster than at 350 Hz
_GROWTH = 1.5


class RampFilters:
    """Ramp and wavelet filters for one scan rate.

    Parameters
    ----------
    rate_hz : float

    Attributes
    ----------
    lengths : (ramps,) int64
    longest : int
    window : int
        Scans that the longest filter sees, the newest included.
    """

    def __init__(self, rate_hz: float) -> None:
        longest = int(np.clip(round(_LONGEST_S * rate_hz), 3, _LONGEST_SCANS))
        self.lengths = _lengths(longest)
        self.longest = longest
        ramps = [_ramp(int(m)) for m in self.lengths]
        self.window = max(len(taps(LEVELS[-1])), longest + N_BASELINE)
        # Newest scan last; each row ends at the newest scan.
        rows = [*ramps, *(taps(level)[::-1] for level in LEVELS)]
        self._matrix = np.stack([np.concatenate([np.zeros(self.window - len(r)), r]) for r in rows], axis=1)
        self.n_ramps = len(ramps)
        self.backwards = np.array([len(r) for r in rows]), np.concatenate([r[::-1] for r in rows])
        """Lengths of all filters, and their taps one after the other, each with the newest scan first."""
        rises = [r[N_BASELINE:] @ np.arange(1, len(r) - N_BASELINE + 1) for r in ramps]
        self.rise_scale = self.lengths / np.array(rises)
        """(ramps,) a ramp's output times this is how far the response has risen along it, in its own unit."""
        self._energy = np.array([r @ r for r in ramps])
        self._octaves = _octaves(ramps)

    def apply(self, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Apply all filters to responses.

        Parameters
        ----------
        seen : (window - 1 + n, columns) float64

        Returns
        -------
        ramps : (n, columns, ramps)
        details : (n, columns, levels)
        """
        out = self.filter(seen)
        return out[..., : self.n_ramps], out[..., self.n_ramps :]

    def filter(self, seen: FloatArray) -> FloatArray:
        """Apply all filters as `apply` does, and return ramps and details (n, columns, both) in one array."""
        seen = np.ascontiguousarray(seen)
        scan, column = seen.strides
        # As `sliding_window_view` has it, which takes longer than the filters of one scan.
        shape = (len(seen) - self.window + 1, seen.shape[1], self.window)
        return np.asarray(np.ndarray(shape, seen.dtype, seen, strides=(scan, column, scan)) @ self._matrix)

    def rise(self, ramp: int, seen: FloatArray) -> FloatArray:
        """Return the rise (columns,) of responses (window, columns) along one ramp."""
        return np.asarray(self._matrix[:, ramp] @ seen * self.rise_scale[ramp])

    def later(self, ramp: int, delay: float) -> float:
        """Return the relative growth per scan of a ramp's output for an onset `delay` > 0 scans ago."""
        scans = int(self.lengths[ramp])
        risen = np.maximum(np.arange(1 - scans, 1) + delay, 0.0)
        weights = self._matrix[-scans:, ramp]
        return float(weights[risen > 0].sum() / (weights @ risen))

    def ramp_sd(self, noise: FloatArray) -> FloatArray:
        """Standard deviation (columns, ramps) of the ramps' outputs under noise (levels, columns).

        Or under noise of each ramp's own, (ramps, levels, columns).
        """
        # Below the last octave noise may grow on as it did into that.
        last, before = noise[..., -1:, :], noise[..., -2:-1, :]
        octaves = np.concatenate([noise, last * np.maximum(last / before, 1.0)], axis=-2) ** 2
        if octaves.ndim == 2:
            return np.asarray(np.sqrt(octaves.T @ self._octaves * self._energy))
        return np.asarray(np.sqrt(np.einsum("rlc,lr->cr", octaves, self._octaves) * self._energy))


def lasting(seen: FloatArray) -> FloatArray:
    """Remove spikes of one scan from responses (n, columns); the newest scan is kept.

    The median of three leaves what only rises, or only falls, as it is (Tukey, Exploratory Data Analysis,
    1977, chapter 7).
    """
    before, now, after = seen[:-2], seen[1:-1], seen[2:]
    middle = np.maximum(np.minimum(before, now), np.minimum(np.maximum(before, now), after))
    return np.concatenate([seen[:1], middle, seen[-1:]])


def _lengths(longest: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    lengths = [2]
    while lengths[-1] < longest:
        lengths.append(min(longest, round(lengths[-1] * _GROWTH)))
    return np.array(lengths)


def _ramp(m: int) -> FloatArray:
    """Whole weights of the slope of a ramp that began m scans ago, oldest scan first."""
    k = np.concatenate([np.zeros(N_BASELINE), np.arange(1.0, m + 1)])
    return np.asarray(len(k) * k - k.sum())


def _octaves(ramps: list[FloatArray]) -> FloatArray:
    """Return the share (levels + 1, ramps) of each ramp's energy in each octave, and below them all."""
    bank = [taps(j) for j in LEVELS]
    # Below 13 Hz the longest ramp is shorter than the bank.
    n = 1 << (max(map(len, [*ramps, *bank])) * 4).bit_length()
    power = np.abs(np.fft.rfft(np.stack([np.pad(r, (0, n - len(r))) for r in ramps]))) ** 2
    power[:, 1:-1] *= 2  # both signs of frequency
    power /= power.sum(axis=1, keepdims=True)
    bands = [
        np.abs(np.fft.rfft(np.pad(t, (0, n - len(t))))) ** 2 / 2**j for j, t in zip(LEVELS, bank, strict=True)
    ]
    shares = power @ np.stack(bands, axis=1)
    return np.concatenate([shares, 1 - shares.sum(axis=1, keepdims=True)], axis=1).T
