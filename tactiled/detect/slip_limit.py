"""Where a load's growth stops: has friction reached its limit, or does the load just stay?

Both stand still at once, and the size of the shear tells only on surfaces of known friction. The taxels tell.
All move as one while the contact holds, so a taxel under more load takes no more of the shear than it is
stiffer for; at the limit each takes its own load's part. By Mindlin's curve, with travel x over the travel of
gross slip, which grows as ``N^(2/3)`` of a ball's load,

    d log T / d log N = 1 - x sqrt(1 - x) / (1 - (1 - x)^(3/2)),

a third at first, 0.45 when friction bears two thirds of its limit, 1 when all slips. So between the first
part of the rise and its end the taxels' shares of the shear shift towards the loaded ones: their logarithms,
over those of the loads, by two thirds on a surface that slips, by a tenth on one that holds. Gains of taxels
fall out, since each is compared with itself. The slope's own residuals say how well it is known; where that
is too little (few taxels, even loads and much noise, a rise within some scans, which are not of one instant)
nothing is said, and what stops counts as slip.
"""

from typing import NamedTuple, Self

import numpy as np

from tactiled.array import FloatArray

_FIRST_PART = 0.4  # of the rise: Mindlin's shares have shifted by a tenth of all by then
# Between a load that stays at two thirds of the limit and one that slips. Measured where the slope is known
# to `_MOST_SD`, on seeds 1001 to 1012 of the physical families and of loads at 0.3 to 0.8 of the limit that
# rest there: slips 0.32 to 1.3, loads -0.55 to 0.5.
_SLIPS = 0.33
# A skin that is dragged evenly has risen to 0.4 in 0.72 of the time that a straight rise takes to it: what
# bends like that is no load that grew evenly and stopped.
_STRAIGHT = 0.86
_SDS, _MOST_SD = 1.0, 0.4  # how sure it must be that a load only stays
_MARK_STEP = 1.2  # a mark each time the rise has grown by this
# Residuals of fewer tell too little: of slips on four, 1 to 9 % seemed to hold, on nine under 1 %.
_LEAST_TAXELS = 7
_EVEN = 1e-9  # of log loads: taxels that differ by less bear the same, and rounding tells no slope
_LOADED = 0.3  # of the mean load: taxels with less have shares that are mostly noise


class _Mark(NamedTuple):
    risen: float
    scans: float
    shears: FloatArray  # (taxels,)


class Limit:
    """Follows the taxels' shares of a growing shear.

    Parameters
    ----------
    along : (taxels, channels) float64
        Readings to each taxel's shear along the slip; only taxels that are read.
    load : (taxels, channels) float64
        Readings to each taxel's load.
    start : (channels,) float64
        Readings before the shear grew.
    late : (taxels,) float64
        When in a scan each is read, in scans.
    """

    def __init__(self, along: FloatArray, load: FloatArray, start: FloatArray, late: FloatArray) -> None:
        self._along, self._load, self._late = along, load, late
        self._start = along @ start
        self._marks: list[_Mark] = []

    @classmethod
    def of_nothing(cls, n_channels: int) -> Self:
        """Where the rise was not seen: never sure."""
        none = np.zeros((0, n_channels))
        return cls(none, none, np.zeros(n_channels), np.zeros(0))

    def give_up(self) -> None:
        """Taxels come or go: what they shared is no measure any more."""
        self._along, self._start, self._load = self._along[:0], self._start[:0], self._load[:0]
        self._late, self._marks = self._late[:0], []

    def take(self, risen: float, scans: float, steps: FloatArray) -> None:
        """Newest readings (n, channels), and how far the array's shear has risen in how many scans."""
        if risen > (_MARK_STEP * self._marks[-1].risen if self._marks else 0.0):
            shears = self._along @ steps.T - self._start[:, np.newaxis]
            whole, now = shears.sum(axis=0), shears.mean(axis=1)
            # What grows has grown on by the time that a later taxel is read.
            growth = (whole[-1] - whole[0]) / max(len(whole) - 1, 1)
            ahead = growth * self._late * now / now.sum() if now.sum() > 0 else 0.0
            self._marks.append(_Mark(risen, scans, now - ahead))

    def holds(self, risen: float, scans: float, steps: FloatArray) -> bool:
        """Whether it is sure that the contact still holds where a rise stopped, of readings since then."""
        if not self._marks or len(self._along) < _LEAST_TAXELS:
            return False
        mark = min(self._marks, key=lambda mark: abs(mark.risen - _FIRST_PART * risen))
        if mark.scans < _STRAIGHT * scans * mark.risen / risen:
            return False
        first = mark.shears
        readings = steps.mean(axis=0)
        now, load = self._along @ readings - self._start, self._load @ readings
        told = (first > 0) & (now > 0) & (load > _LOADED * load.mean()) & (load > 0)
        if told.sum() < _LEAST_TAXELS:
            return False
        shift, sd = _slope(np.log(load[told]), np.log(now[told] / first[told]))
        return sd < _MOST_SD and shift + _SDS * sd < _SLIPS


def _slope(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Least-squares slope of y over x with its standard deviation; infinite where x does not vary."""
    x, y = x - x.mean(), y - y.mean()
    energy = float(x @ x)
    if energy < _EVEN:
        return 0.0, np.inf
    slope = float(x @ y) / energy
    left = y - slope * x
    return slope, float(np.sqrt(left @ left / (len(x) - 2) / energy))
