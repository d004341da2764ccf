"""Shear that pressing alone makes: zero of the taxels' shear, as a multiple of their load.

Unequal gains of the channels and a skin that is mounted at an angle turn a part of the load into shear. It is
measured from touch on, until the shear leaves it by more than it can vary, or `_PRESS_S` have passed: hands
that grasp and lift begin to pull a tenth of a second after touch. A zero that shear left is measured anew
where the load has doubled since and the shear is small: the first scans of a touch, at small loads, measure
it badly. Each taxel's part is unknown by itself, so that the part of the whole array is small; a press at a
slant, whose shear is larger, loads the contact.

The first shear of a contact that was not seen to begin is shear that it bears, as far as anybody can tell:
the weight of an object in the hand is several times what gains and mounting make. Its zero is taken for 0,
until the load has doubled within the time of a press.

What is not known of the zero may be shear that the contact bears: the load that a controller needs counts it.
"""

import math

import numpy as np

from tactiled.array import Array, FloatArray

_PRESS_S = 0.6  # prior: of a press that shear does not end, after which the zero is known
# derived: standard deviations over load: resistors that are 5 % unequal turn so much of a taxel's load into
# shear, and an array that is mounted at 2 degrees so much of all of it.
_TAXEL_SD, _MOUNTED_SD = 0.07, 0.03
# tuned: the same of three-axis chips whose counts nobody calibrated: 0.06 to 0.26 of the load is shear on a
# public skin (uSkin). 0.1 costs utilisation on our own worlds three times as much, and finds as many slips
# there.
_CROSSTALK_SD = 0.05
_SDS = 2.0  # choice: that the zero of the whole array may have
_LEFT_SDS = 3.0  # choice: by which shear must leave the zero to be of a pull
_SEEN = 2.0  # choice: times the load of the zero: more than half of the contact was seen to begin since


class PressZero:
    """Zero of one contact.

    Parameters
    ----------
    least_load : float
        Of a taxel, on the mean: where a contact begins. Smaller loads say little of the zero.
    is_seen : bool
        The contact was seen to begin. Otherwise it may have borne shear before.

    Attributes
    ----------
    parts : (2, taxels) float64
        Shear over load.
    whole_sd : float
        Standard deviation of what is unknown of the part of the whole array.
    is_measured : bool
        True once the press is over.
    is_seen : bool
        The contact was seen to begin, or most of its load was seen to come.
    pull_began : bool
        The newest shear is no more that of the press, but of a pull.
    """

    def __init__(self, array: Array, rate_hz: float, least_load: float, *, is_seen: bool) -> None:
        n_taxels = array.n_taxels
        self._n_press = max(2, round(_PRESS_S * rate_hz))
        crosstalk_sd = _CROSSTALK_SD * (array.unit == "count")
        mounted_sd = math.hypot(_TAXEL_SD / math.sqrt(n_taxels), _MOUNTED_SD, crosstalk_sd)
        self._whole_sd = self.whole_sd = mounted_sd * array.shear_per_friction
        self._least_load = least_load
        self.is_seen = is_seen
        self._largest = 0.0  # sum of the loads of which the zero is made; of the first scan where not seen
        self._n = self._n_taken = 0  # scans, and those of which the zero is made
        self._crossed = np.zeros((2, n_taxels))  # sums of shear times load
        self._squares = np.zeros(n_taxels)  # and of load squared
        self.parts = np.zeros((2, n_taxels))
        self.is_measured = self.pull_began = False

    def take(self, load: FloatArray, shear: FloatArray, shear_sd: float, total_sd: float) -> None:
        """Take loads (taxels,) and shears (2, taxels) of a scan of the press, with their noise."""
        whole = max(float(load.sum()), 1e-9)
        self._n += 1
        self.is_measured = self._n >= self._n_press
        most = _LEFT_SDS * math.hypot(self._whole_sd, total_sd / whole)
        has_doubled = self._n > 1 and whole > _SEEN * self._largest
        is_small = math.hypot(*shear.sum(axis=1)) <= most * whole
        if has_doubled and (not self.is_seen or (self.pull_began and is_small)):
            self._forget()
        if not self.is_seen:
            self._largest = self._largest or whole
            return
        if self.pull_began:
            return
        if self._n > 1:
            left = (shear - self.parts * load).sum(axis=1) / whole
            self.pull_began = math.hypot(*left) > most
            if self.pull_began:
                return
        self._largest = max(self._largest, whole)
        self._n_taken += 1
        self._crossed += shear * load
        self._squares += load**2
        # Noise, and what a small load does not tell, keep taxels without load from a zero that is made of it.
        silent = self._n_taken * shear_sd**2 + self._least_load**2
        parts = self._crossed / np.maximum(self._squares + silent, 1e-300)
        parts_of_whole = (parts * load / whole).sum(axis=1, keepdims=True)
        size = math.hypot(*parts_of_whole[:, 0])
        parts -= parts_of_whole * max(0.0, 1.0 - _SDS * self._whole_sd / max(size, 1e-12))
        self.whole_sd = self._whole_sd * (1.0 - self._n_taken / self._n_press)
        self.parts = parts

    def _forget(self) -> None:
        """Measure anew, as in a contact that was seen to begin."""
        self.is_seen, self.pull_began = True, False
        self._n_taken = 0
        self._crossed[:], self._squares[:], self.parts = 0.0, 0.0, np.zeros_like(self.parts)
        self.whole_sd = self._whole_sd
