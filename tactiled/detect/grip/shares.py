"""Likelihood of each friction hypothesis, from how the taxels share the shear.

Before any slip the shear of a taxel goes with its stiffness; when all slips it goes with its load. How far
the shares have moved from the one to the other tells friction before gross slip. Nuisances of each taxel are
followed for each hypothesis by a Kalman filter: its gains along x and y, the softening (a taxel that is
stiffer than its load says slips sooner), and offsets along x and y that go with its load. Gains that were
learnt along one direction are not those of another: a pull that turns brings new ones. What is left is the
model's misfit, with the tails of Student's t.

Only new places count. A look is taken where the ratio of shear over load is near its largest and differs from
all ratios at which one was taken before: swings at one level repeat the same misfit and are no new evidence,
and on the way back the shares depend on more of the past than the rings remember. At a known place a look
counts by the part of its variance that is noise, since noise is new each time.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import MISFIT, TEMPER
from tactiled.detect.grip.elementary import cbrt, length, log, sum_in_order
from tactiled.detect.grip.rings import MINDLIN_POWER

# Of a taxel: its stiffness, common to both axes, and its gain along one of them. 10 % each is usual for
# printed and cast sensors, a prior.
_GAIN_SD, _COMMON = 0.15, 0.5  # standard deviation of both; part of the variance that is common
# Standard deviations on an array whose loads are uneven: a taxel's softening, relative to its shear, because
# stiffness and friction of taxels differ; and a taxel's shear over its load, which the zero leaves.
_SOFTENING_SD, _OFFSET_SD = 0.15, 0.02
# Under one flat object a taxel's load goes as its height and stiffness. Loads that are even to some part show
# that the taxels are, and taxels that are alike share the shear evenly by any law of contact.
_UNEVEN = 0.15  # standard deviation of log loads from which on nothing is known of how alike the taxels are
_LEAST_UNEVEN = 0.2  # of the above: what even loads leave
_PLACE = 0.03  # relative distance of ratios that makes a new place: shares move by less within it
_NOISY = 0.1  # part of a look's variance that is noise, below which it says nothing new at a known place
_GROWN = 0.9  # of the largest ratio so far, below which the contact is on its way back
_LEAST_RATIO = 0.03  # below, offsets are larger than what softens
_NOISES = 4.0  # standard deviations of its noise that the total must exceed
_DEGREES = 3.0  # of freedom of Student's t: tails of a few taxels in a hundred looks
_LOADED = 0.1  # of the mean load: taxels with less say nothing of how even the loads are
_EVEN = 0.2  # part of the misfit that does not go with the load: neighbours pull at a taxel without load
_MEETS = 0.02  # relative difference from the measured total that Newton steps leave
_N_PLACES = 64  # remembered
_LEAST_USED = 1e-6  # part of its limit that a taxel bears, below which nothing softens
_TINY = 1e-9


class ShareEvidence:
    """Evidence of one contact.

    Parameters
    ----------
    friction : (hypotheses,) float64
    n_taxels : int
    """

    def __init__(self, friction: FloatArray, n_taxels: int) -> None:
        shape = (len(friction), n_taxels)
        self._friction = friction[:, np.newaxis]
        self._nuisance = np.zeros((5, *shape))
        self._cov = np.zeros((5, 5, *shape))
        self._uneven = 0.0  # part of the scatter of taxels that are nothing alike; 0 before the first look
        self._places = np.full((_N_PLACES, 3), np.inf)
        self._n = 0
        self._largest = 0.0

    def log_likelihood(
        self,
        shear: FloatArray,
        predicted: FloatArray,
        borne: FloatArray,
        part_of_load: FloatArray,
        ratio: FloatArray,
        noise_sd: float,
    ) -> FloatArray | None:
        """Compare measured with predicted shear.

        Parameters
        ----------
        shear : (2, taxels) float64
            Measured shear over the mean load of a taxel.
        predicted : (2, hypotheses, taxels) float64
            In the same unit.
        borne : (hypotheses,) float64
            Length of the predicted total, in the unit of `ratio`.
        part_of_load : (taxels,) float64
            Load over the mean load.
        ratio : (3,) float64
            Shear and moment of the array, over the load.
        noise_sd : float
            Of one entry of `shear`.

        Returns
        -------
        (hypotheses,) float64 or None
            None where the look says nothing new.
        """
        size = length(ratio)
        self._largest = max(self._largest, size)
        least = max(_LEAST_RATIO, _NOISES * noise_sd / np.sqrt(shear.shape[1]), _GROWN * self._largest)
        if size < least:
            return None
        if not self._uneven:
            self._begin(part_of_load)
        misfit = MISFIT * self._uneven * size
        unexplained = misfit * misfit
        temper = TEMPER
        if float(((self._places - ratio) ** 2).sum(axis=1).min()) < _PLACE * size * (_PLACE * size):
            part = noise_sd * noise_sd / (noise_sd * noise_sd + unexplained)
            if part < _NOISY:
                return None
            temper *= part
        else:
            self._places[self._n % _N_PLACES] = ratio
            self._n += 1

        return self._weigh(shear, predicted, borne, part_of_load, size, noise_sd, unexplained, temper)

    def _weigh(
        self,
        shear: FloatArray,
        predicted: FloatArray,
        borne: FloatArray,
        part_of_load: FloatArray,
        size: float,
        noise_sd: float,
        unexplained: float,
        temper: float,
    ) -> FloatArray:
        """Return the log likelihood of a look that counts by `temper`, and learn the nuisances from it."""
        # A hypothesis that slides predicts how the shear is shared, and not how much there is of it.
        scale = size / np.maximum(borne, _TINY)
        scale = np.where(np.abs(scale - 1.0) < _MEETS, 1.0, scale)[:, np.newaxis]
        force = np.maximum(np.sqrt((predicted**2).sum(axis=0)), _TINY)
        along = (shear[0] * predicted[0] + shear[1] * predicted[1]) / force
        model = force * scale
        to_x, to_y = predicted / force
        softening = model * self._softening(force, part_of_load)
        direction = np.stack(
            [model * to_x * to_x, model * to_y * to_y, softening, part_of_load * to_x, part_of_load * to_y]
        )
        expected = model + (self._nuisance * direction).sum(axis=0)
        spread = (self._cov * direction).sum(axis=1)
        known = (spread * direction).sum(axis=0)
        misfit = noise_sd * noise_sd + unexplained * (_EVEN + (1.0 - _EVEN) * part_of_load)
        residual = along - expected
        variance = known + misfit
        relative = residual**2 / variance
        # What no hypothesis explains (slopes of a groove, a hum) is misfit of this look.
        mean_square = np.add.accumulate(relative, axis=1)[:, -1] / relative.shape[1]
        unmodelled = max(float(mean_square.min()), 1.0)
        relative, variance = relative / unmodelled, variance * unmodelled
        misfit = variance - known
        # Student's t with three degrees of freedom: (1 + r / 3)^-2 over the standard deviation.
        found = np.add.accumulate(log((1.0 + relative / _DEGREES) ** 2 * np.sqrt(variance) / size), axis=1)
        # A measurement whose variance is that of the misfit over its weight, less where it lies in the tails.
        robust = (_DEGREES + 1) / (_DEGREES + relative)
        precision = 1.0 / (known + misfit / (temper * robust))
        self._nuisance += spread * precision * residual
        self._cov -= spread[:, np.newaxis] * spread[np.newaxis] * precision
        return np.asarray(-temper * found[:, -1])

    def loosen(self, taxels: NDArray[np.bool_]) -> None:
        """Forget the gains of some taxels (taxels,), which are read otherwise from now on."""
        if self._uneven:  # taxels that are alike change alike
            sd = _GAIN_SD * self._uneven
            for axis in range(2):
                self._cov[axis, axis][:, taxels] += sd * sd

    def _begin(self, part_of_load: FloatArray) -> None:
        """Set the spread of the nuisances, from how uneven the loads are."""
        loaded = part_of_load[part_of_load > _LOADED]
        spread = _scatter(log(loaded)) if len(loaded) > 1 else _UNEVEN
        self._uneven = max(_LEAST_UNEVEN, min(1.0, spread / _UNEVEN))
        softening_sd, offset_sd = _SOFTENING_SD * self._uneven, _OFFSET_SD * self._uneven
        for k, sd in enumerate((_GAIN_SD, _GAIN_SD, softening_sd, offset_sd, offset_sd)):
            self._cov[k, k] = sd * sd
        self._cov[0, 1] = self._cov[1, 0] = _COMMON * _GAIN_SD * _GAIN_SD

    def _softening(self, force: FloatArray, part_of_load: FloatArray) -> FloatArray:
        """Return the part of a taxel's shear by which it falls short of its stiffness times the travel.

        With Q / mu P = 1 - (1 - x)^p the shear's derivative by the logarithm of the stiffness is
        mu P p x (1 - x)^(p - 1). With p = 3/2 the root of 1 - x is the cubic root of the limit that is left.
        """
        limit = np.maximum(self._friction * part_of_load, _TINY)
        used = np.clip(force / limit, _LEAST_USED, 1.0)
        root = cbrt(1.0 - used)
        return np.asarray(1.0 - MINDLIN_POWER * (1.0 - root * root) * root / used)


def _scatter(values: FloatArray) -> float:
    """Return the standard deviation of values (n,)."""
    off = values - sum_in_order(values) / len(values)
    return math.sqrt(sum_in_order(off * off) / len(values))


def shares_numbers() -> FloatArray:
    """Return the constants of `ShareEvidence` in the order of `struct places_numbers`."""
    spreads = _GAIN_SD, _COMMON, _SOFTENING_SD, _OFFSET_SD, _UNEVEN, _LEAST_UNEVEN
    looks = _PLACE, _NOISY, _GROWN, _LEAST_RATIO, _NOISES, _LOADED, MISFIT, TEMPER, _N_PLACES
    weight = _TINY, _MEETS, _LEAST_USED, MINDLIN_POWER, _EVEN, _DEGREES
    return np.array([*spreads, *looks, *weight])
