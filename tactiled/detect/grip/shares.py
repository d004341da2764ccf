"""Likelihood of each friction hypothesis, from how the taxels share the shear.

Before any slip the shear of a taxel goes with its stiffness; when all slips it goes with its load. How far
the shares have moved from the one to the other tells friction before gross slip. Three nuisances of each
taxel are followed for each hypothesis by a Kalman filter: its gain, the softening (a taxel that is stiffer
than its load says slips sooner), and an offset that goes with its load. What is left is the model's misfit,
with the tails of Student's t.

Only new places count. A look is taken where the ratio of shear over load differs from all ratios at which
one was taken before: swings at one level repeat the same misfit and are no new evidence.
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import MISFIT, TEMPER
from tactiled.detect.grip.rings import MINDLIN_POWER

_GAIN_SD = 0.15  # of gains and stiffness of taxels: 10 % each is usual for printed and cast sensors, a prior
_SOFTENING_SD = 0.10  # of a taxel's softening, relative to its shear: stiffness and friction of taxels differ
_OFFSET_SD = 0.02  # of a taxel's shear over its load, which the zero of the contact leaves
_PLACE = 0.03  # relative distance of ratios that makes a new place: shares move by less within it
_LEAST_RATIO = 0.03  # below, offsets are larger than what softens
_NOISES = 4.0  # standard deviations of its noise that the total must exceed
_DEGREES = 3.0  # of freedom of Student's t: tails of a few taxels in a hundred looks
_EVEN = 0.2  # part of the misfit that does not go with the load: neighbours pull at a taxel without load
_MEETS = 0.02  # relative difference from the measured total that Newton steps leave
_N_PLACES = 64  # remembered
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
        self._nuisance = np.zeros((3, *shape))
        self._cov = np.zeros((3, 3, *shape))
        for k, sd in enumerate((_GAIN_SD, _SOFTENING_SD, _OFFSET_SD)):
            self._cov[k, k] = sd**2
        self._places = np.full((_N_PLACES, 3), np.inf)
        self._n = 0

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
            None where the ratio is at a known place.
        """
        size = float(np.sqrt(ratio @ ratio))
        if size < max(_LEAST_RATIO, _NOISES * noise_sd / np.sqrt(shear.shape[1])):
            return None
        if float(((self._places - ratio) ** 2).sum(axis=1).min()) < (_PLACE * size) ** 2:
            return None
        self._places[self._n % _N_PLACES] = ratio
        self._n += 1

        # A hypothesis that slides predicts how the shear is shared, and not how much there is of it.
        scale = size / np.maximum(borne, _TINY)
        scale = np.where(np.abs(scale - 1.0) < _MEETS, 1.0, scale)[:, np.newaxis]
        force = np.maximum(np.sqrt((predicted**2).sum(axis=0)), _TINY)
        along = (shear[0] * predicted[0] + shear[1] * predicted[1]) / force
        model = force * scale
        offset = np.broadcast_to(part_of_load, model.shape)
        direction = np.stack([model, model * self._softening(force, part_of_load), offset])
        expected = model + (self._nuisance * direction).sum(axis=0)
        spread = np.einsum("abjt,bjt->ajt", self._cov, direction)
        known = (spread * direction).sum(axis=0)
        misfit = noise_sd**2 + (MISFIT * size) ** 2 * (_EVEN + (1.0 - _EVEN) * part_of_load)
        residual = along - expected
        variance = known + misfit
        relative = residual**2 / variance
        found = -(
            0.5 * (_DEGREES + 1) * np.log1p(relative / _DEGREES) + 0.5 * np.log(variance / size**2)
        ).sum(axis=1)
        # A measurement whose variance is that of the misfit over its weight, less where it lies in the tails.
        robust = (_DEGREES + 1) / (_DEGREES + relative)
        gain = spread / (known + misfit / (TEMPER * robust))
        self._nuisance += gain * residual
        self._cov -= gain[:, np.newaxis] * spread[np.newaxis]
        return np.asarray(TEMPER * found)

    def _softening(self, force: FloatArray, part_of_load: FloatArray) -> FloatArray:
        """Return the part of a taxel's shear by which it falls short of its stiffness times the travel.

        With Q / mu P = 1 - (1 - x)^p the shear's derivative by the logarithm of the stiffness is
        mu P p x (1 - x)^(p - 1).
        """
        limit = np.maximum(self._friction * part_of_load, _TINY)
        used = np.clip(force / limit, 1e-6, 1.0)
        left = (1.0 - used) ** (1.0 / MINDLIN_POWER)
        return np.asarray(1.0 - MINDLIN_POWER * (1.0 - left) * left ** (MINDLIN_POWER - 1.0) / used)
