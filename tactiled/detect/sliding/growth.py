"""Slip told by growth of shear or field, or by load that moves over the array, where no ratio is measured.

Readings are averaged over hops. A growth is the mean of the newest hops less that of hops before, for three
lengths, over the noise of each channel. It is evidence of slip where

* it exceeds the largest growth of that length in the hold before, several times: creep, drift and tremor are
  in the hold, and a press is not once 1 s of hold follows it; of a hold that is not known for 1 s yet, creep
  and tremor are taken to be large,
* every one of the newest hops has most of it, so that no tap counts,
* shear channels have a part of it, where there are others: a press changes these more on many skins,
* and no single channel of several has nearly all of it.

Where all channels are loads, what counts is the load that moves over a pad: a press raises all taxels, a
slip takes load from some of them to others. So does a body that rocks or is tugged: the slip is "incipient".
So does a hand that closes: growth that reaches back into the first second after a touch or a release is left
out.

A press may grow as a tug does: which axes of a magnetic skin it changes depends on where its magnets are. On
one public recording it changed x and y twice as much as z, where tugs changed z twice as much as x and y. The
slip ends where growth stops. Its direction is unknown, as are axes and signs of many such sensors.
"""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.pressure import ROUNDING
from tactiled.detect.signal.quantise import HeldReadings
from tactiled.detect.sliding.tracker import Change

_HOP_S = 0.02  # choice: as the looks at a contact
_LENGTHS_S = (0.32, 0.64, 1.28)  # choice: half of them is averaged, half lies between the two means
_LASTS_S = 0.1  # prior: longer than a tap
_KEPT_S = 6.0  # prior: of the hold
_AGO_S = 0.5  # prior: a slow slip must not be compared with its own beginning
_LEAST_HOLD_S = 1.0  # prior: after which a hold shows its own creep and tremor
# prior: squared growth of a channel, over the noise of its hops, that a hold may have of which less is known:
# a prior, ten standard deviations of each channel.
_UNKNOWN_HOLD = 100.0
# tuned: squared growth over the largest of the hold. Set on seeds 0 to 7 of the worlds of `sensors` in
# research/README.md ("hold" and "tug", magnetic pads).
GROWS = 9.0
# tuned: a growth so many times the largest since is a press: creep is a tenth of one. Of 9, 30 and 100, the
# last adds no slips in tremor that comes in bursts (the same worlds).
_PRESSES = 100.0
# prior: of the largest growth of the hold: below it for so long, a slip is over
_STOPS, _STOPS_S = 2.0, 0.3
# tuned: of the change of a channel in shear over that of a normal channel, squared. Of tugs on a public
# recording of a magnetic skin, 95 % have more; a press that is felt by the normal channels alone has less.
_SHEAR_PART = 0.2
# tuned: of loads that move: squared growth over the noise that an onset exceeds in any hold. Set on a public
# recording of an electrode finger (BioTacSP-DoS), where all but one of its eleven objects get it from the
# others: 400 finds 242 of 262 slips and is wrong in 4 of 44 touches, 450 finds 239 and is wrong in 3, 500
# finds 228 and is wrong in 2.
HOLDS_MOVE = 450.0
# choice: standard deviations of a hop's noise; the noise of many channels that do not move adds up
_MOVED = 2.0
# prior: channels, and the part of the growth above which one of them is at fault
_MANY, _MOST_OF_ONE = 4, 0.9


class GrowthTracker:
    """Track slips of an array by the growth of its shear channels, or by its loads where it has no shear."""

    def __init__(self, array: Array, rate_hz: float) -> None:
        kinds = np.array(array.channel_kind)
        self._compared = (kinds == "shear_x") | (kinds == "shear_y")
        self._normal = kinds == "normal"
        self._moves = not self._compared.any()  # all channels are loads
        if self._moves:
            self._compared = np.ones(len(kinds), dtype=np.bool_)
        of_channel = array.pad[array.channel_taxel]
        self._pads = [own for pad in np.unique(of_channel) if (own := of_channel == pad).sum() >= _MANY]
        self._sign = array.sign
        self._mean_of = max(1, round(_HOP_S * rate_hz))
        hops_s = rate_hz / self._mean_of
        halves = [max(1, round(0.5 * length_s * hops_s)) for length_s in _LENGTHS_S]
        self._lengths = tuple(2 * half for half in halves)
        self._spans = np.array([3 * half for half in halves])  # hops that a growth is of
        self._n_lasts, self._n_ago = max(1, round(_LASTS_S * hops_s)), max(1, round(_AGO_S * hops_s))
        self._n_kept, self._n_hold = round(_KEPT_S * hops_s), max(2, round(_LEAST_HOLD_S * hops_s))
        self._n_stops = max(1, round(_STOPS_S * hops_s))
        self._reach = int(self._spans[-1])
        self._sum = np.zeros(array.n_channels)
        self._n_summed = 0
        self._means = np.zeros((self._reach, array.n_channels))
        self._unread = np.zeros(array.n_channels, dtype=np.int64)  # hops in a row with scans that it lacks
        self._lacks = np.zeros(array.n_channels, dtype=np.bool_)  # a scan of this hop
        self._n = 0  # hops
        self._noise = np.full(array.n_channels, ROUNDING)
        self._growths = np.full((self._n_kept, len(halves)), np.nan)  # of the hold
        self._n_slow = 0
        self._since_slip = 10 * self._reach  # hops
        self._since_touch = 10 * self._reach  # hops since the contact began or ended
        self._was_touching: bool | None = None
        self.slides = False

    def process(self, held: HeldReadings, touches: NDArray[np.bool_]) -> list[Change]:
        """Return the changes that the scans complete; `touches` (n,) says which are in contact."""
        changes = []
        for row, steps in enumerate(held.steps):
            if self._moves and bool(touches[row]) != self._was_touching:
                self._since_touch = self._since_touch if self._was_touching is None else 0
                self._was_touching = bool(touches[row])
            if not held.all_ok:
                self._lacks |= ~held.ok[row]
            self._sum = self._sum + steps
            self._n_summed += 1
            if self._n_summed < self._mean_of:
                continue
            self._means = np.concatenate([self._means[1:], self._sum[np.newaxis] / self._mean_of])
            self._sum, self._n_summed = np.zeros_like(self._sum), 0
            self._unread = np.where(self._lacks, self._unread + 1, 0)
            self._lacks[:] = False
            self._n += 1
            self._since_touch += 1
            self._learn_noise()
            if self._n > self._spans[0] and (change := self._look(row)):
                changes.append(change)
        return changes

    def _look(self, row: int) -> Change | None:
        growths, lasts = np.full(len(self._spans), np.nan), np.zeros(len(self._spans), dtype=np.bool_)
        for which, length in enumerate(self._lengths):
            if self._n > self._spans[which]:
                growths[which], lasts[which] = self._growth(length)
        self._growths = np.concatenate([self._growths[1:], np.full((1, len(growths)), np.nan)])
        hold = self._growths[: -self._n_ago]
        self._since_slip = 0 if self.slides else self._since_slip + 1
        # While a hand closes, load comes to some cells and leaves others, as in a slip: that is none, and no
        # part of the hold that slips are compared with.
        is_held = self._since_touch >= self._spans + self._n_hold
        if self._since_slip >= self._reach:
            self._growths[-1] = np.where(is_held, growths, np.nan)
        largest = [self._largest(hold[:, which], span) for which, span in enumerate(self._spans)]
        over = growths / np.maximum(largest, 1e-12)
        if self.slides:
            self._n_slow = self._n_slow + 1 if over[0] < _STOPS else 0
            if self._n_slow >= self._n_stops:
                self.slides = False
                return Change(row, False, float(over[0]), 0, is_gross=False)
            return None
        is_new = is_held & (self._since_slip >= self._spans)  # none of the slip before
        if not (found := np.flatnonzero((over > GROWS) & lasts & is_new)).size:
            return None
        self.slides, self._n_slow = True, 0
        before = self._lengths[int(found[0])] * self._mean_of // 2
        return Change(row, True, float(over[found[0]]), before, is_gross=False)

    def _largest(self, hold: FloatArray, span: int) -> float:
        """Largest growth of a hold (hops,), or of what follows its last press; NaN is unknown."""
        if self._moves:
            return max(HOLDS_MOVE / GROWS, float(np.nanmax(hold, initial=0.0)))
        is_known = np.isfinite(hold)
        n_known = int(is_known.sum())
        unknown = _UNKNOWN_HOLD * float(self._compared.sum()) if n_known < self._n_hold else 0.0
        if not n_known:
            return unknown
        since = np.fmax.accumulate(hold[::-1])[::-1]
        n_since = is_known[::-1].cumsum()[::-1]
        presses = (hold[:-span] > _PRESSES * since[span:]) & (n_since[span:] >= self._n_hold)
        return max(unknown, float(since[np.flatnonzero(presses)[-1] + span] if presses.any() else since[0]))

    def _learn_noise(self) -> None:
        """Follow the variance of each channel's hops, by their second differences."""
        if self.slides or self._n < 3:
            return
        bend = self._means[-1] - 2 * self._means[-2] + self._means[-3]
        power = np.maximum(bend**2 / 6, ROUNDING)
        self._noise = self._noise + (power - self._noise) / min(self._n - 2, self._n_kept)

    def _growth(self, length: int) -> tuple[float, bool]:
        """Squared growth of the channels over their noise, and whether it lasts and is that of a slip."""
        half = length // 2
        before = self._means[-length - half : -length].mean(axis=0)
        grown = self._means[-half:].mean(axis=0) - before
        compared = self._compared
        scaled = grown[compared] / np.sqrt(self._noise[compared])
        squared = float(scaled @ scaled)
        newest = (self._means[-self._n_lasts :, compared] - before[compared]) / np.sqrt(self._noise[compared])
        lasts = bool((newest @ scaled > 0.5 * squared).all())
        if self._moves:
            loads = scaled * self._sign
            is_read = self._unread < length + half  # at least once in these hops
            live = [own for pad in self._pads if (own := pad & is_read).sum() >= _MANY]
            return max((_moved(loads[own]) for own in live), default=0.0), lasts
        if len(scaled) >= _MANY:
            lasts &= float((scaled**2).max()) < _MOST_OF_ONE * squared
        if self._normal.any():
            of_shear = float((grown[compared] ** 2).mean())
            lasts &= of_shear > _SHEAR_PART * float((grown[self._normal] ** 2).mean())
        return squared, lasts


def _moved(growth: FloatArray) -> float:
    """Squared growth of the loads of one pad (channels,), over their noise, as far as load moves over it.

    Geometric mean of all of it and of twice the smaller of what rises and what falls: 0 where all rise.
    """
    rises = float((growth[growth > _MOVED] ** 2).sum())
    falls = float((growth[growth < -_MOVED] ** 2).sum())
    return float(np.sqrt(2.0 * min(rises, falls) * (rises + falls)))
