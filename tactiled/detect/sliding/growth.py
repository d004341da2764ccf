"""Slip told by growth of shear or field, where no load is measured that it could be compared with.

Readings are averaged over hops. A growth is the mean of the newest hops less that of hops before, for three
lengths, over the noise of each channel. It is evidence of slip where

* it exceeds the largest growth of that length in the hold before, several times: creep, drift and tremor are
  in the hold, and a press is not once 1 s of hold follows it,
* every one of the newest hops has most of it, so that no tap counts,
* shear channels have most of it, where there are others: a press changes these more,
* and no single channel of several has nearly all of it.

The slip ends where growth stops. Its direction is unknown, as are axes and signs of many such sensors.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array
from tactiled.detect.signal.quantise import HeldReadings
from tactiled.detect.sliding.change import Change

_HOP_S = 0.02
_LENGTHS = (16, 32, 64)  # hops: half of them are averaged, half lie between the two means
_LASTS = 5  # hops, 0.1 s: longer than a tap
_KEPT = 300  # hops of the hold, 6 s
_AGO = 25  # hops: a slow slip must not be compared with its own beginning
_LEAST_HOLD = 50  # hops, 1 s
# Set on seeds 0 to 7 of `bench.sensors.worlds` ("hold" and "tug", magnetic pads).
GROWS = 9.0  # squared growth over the largest of the hold
# A growth so many times the largest since is a press: creep is a tenth of one. Of 9, 30 and 100, the last
# adds no slips in tremor that comes in bursts.
_PRESSES = 100.0
_STOPS, _STOPS_HOPS = 2.0, 15
_SHEAR_PART = 0.5  # of the change of a channel in shear over that of a normal channel, squared
_MANY, _MOST_OF_ONE = 4, 0.9  # channels, and the part of the growth above which one of them is at fault
_LEAST_NOISE = 1.0 / 12  # variance of rounding to a step
_SPANS = tuple(length + length // 2 for length in _LENGTHS)  # hops that a growth is of
_REACH = _SPANS[-1]


class GrowthTracker:
    """Track slips of an array by the growth of its shear channels.

    Parameters
    ----------
    array : Array
    rate_hz : float
    """

    def __init__(self, array: Array, rate_hz: float) -> None:
        kinds = np.array(array.channel_kind)
        self._shear = (kinds == "shear_x") | (kinds == "shear_y")
        self._normal = kinds == "normal"
        self._mean_of = max(1, round(_HOP_S * rate_hz))
        self._sum = np.zeros(array.n_channels)
        self._n_summed = 0
        self._means = np.zeros((_REACH, array.n_channels))
        self._n = 0  # hops
        self._noise = np.full(array.n_channels, _LEAST_NOISE)
        self._growths = np.full((_KEPT, len(_LENGTHS)), np.nan)  # of the hold
        self._n_slow = 0
        self._since_slip = 10 * _REACH  # hops
        self.slides = False

    def process(self, held: HeldReadings, _touches: NDArray[np.bool_]) -> list[Change]:
        """Return the changes that the scans complete."""
        changes = []
        for row, steps in enumerate(held.steps):
            self._sum = self._sum + steps
            self._n_summed += 1
            if self._n_summed < self._mean_of:
                continue
            self._means = np.concatenate([self._means[1:], self._sum[np.newaxis] / self._mean_of])
            self._sum, self._n_summed = np.zeros_like(self._sum), 0
            self._n += 1
            self._learn_noise()
            if self._n > _REACH and (change := self._look(row)):
                changes.append(change)
        return changes

    def _look(self, row: int) -> Change | None:
        growths, lasts = np.zeros(len(_LENGTHS)), np.zeros(len(_LENGTHS), dtype=np.bool_)
        for which, length in enumerate(_LENGTHS):
            growths[which], lasts[which] = self._growth(length)
        self._growths = np.concatenate([self._growths[1:], np.full((1, len(_LENGTHS)), np.nan)])
        hold = self._growths[:-_AGO]
        known = np.isfinite(hold[:, 0])
        self._since_slip = 0 if self.slides else self._since_slip + 1
        if self._since_slip >= _REACH:
            self._growths[-1] = growths
        if known.sum() < _LEAST_HOLD:
            return None
        largest = [_largest(hold[:, which], span) for which, span in enumerate(_SPANS)]
        over = growths / np.maximum(largest, 1e-12)
        if self.slides:
            self._n_slow = self._n_slow + 1 if over[0] < _STOPS else 0
            if self._n_slow >= _STOPS_HOPS:
                self.slides = False
                return Change(row, False, float(over[0]), 0)
            return None
        is_new = self._since_slip >= np.array(_SPANS)  # none of the slip before
        if not (found := np.flatnonzero((over > GROWS) & lasts & is_new)).size:
            return None
        self.slides, self._n_slow = True, 0
        before = _LENGTHS[int(found[0])] * self._mean_of // 2
        return Change(row, True, float(over[found[0]]), before, is_gross=False)

    def _learn_noise(self) -> None:
        """Follow the variance of each channel's hops, by their second differences."""
        if self.slides or self._n < 3:
            return
        bend = self._means[-1] - 2 * self._means[-2] + self._means[-3]
        power = np.maximum(bend**2 / 6, _LEAST_NOISE)
        self._noise = self._noise + (power - self._noise) / min(self._n - 2, _KEPT)

    def _growth(self, length: int) -> tuple[float, bool]:
        """Squared growth of the shear channels over their noise, and whether it lasts and is of shear."""
        half = length // 2
        before = self._means[-length - half : -length].mean(axis=0)
        grown = self._means[-half:].mean(axis=0) - before
        shear = self._shear
        scaled = grown[shear] / np.sqrt(self._noise[shear])
        squared = float(scaled @ scaled)
        newest = (self._means[-_LASTS:, shear] - before[shear]) / np.sqrt(self._noise[shear])
        lasts = bool((newest @ scaled > 0.5 * squared).all())
        if len(scaled) >= _MANY:
            lasts &= float((scaled**2).max()) < _MOST_OF_ONE * squared
        if self._normal.any():
            of_shear = float((grown[shear] ** 2).mean())
            lasts &= of_shear > _SHEAR_PART * float((grown[self._normal] ** 2).mean())
        return squared, lasts


def _largest(hold: NDArray[np.float64], span: int) -> float:
    """Largest growth of a hold (hops,), or of what follows its last press; NaN is unknown."""
    since = np.fmax.accumulate(hold[::-1])[::-1]
    n_since = np.isfinite(hold)[::-1].cumsum()[::-1]
    presses = (hold[:-span] > _PRESSES * since[span:]) & (n_since[span:] >= _LEAST_HOLD)
    return float(since[np.flatnonzero(presses)[-1] + span] if presses.any() else since[0])
