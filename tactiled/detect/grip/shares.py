"""Likelihood of each friction hypothesis, from how the taxels share the shear.

Before any slip the shear of a taxel goes with its stiffness; when all slips it goes with its load. How far
the shares have moved from the one to the other tells friction before gross slip. Taxels have unequal gains:
a static gain of each is a Gaussian nuisance, followed for each hypothesis by a scalar Kalman filter. The
model is a little wrong: the variance of the misfit is learnt from the residuals of the contact itself.
Residuals have tails (Student's t), and successive ones repeat each other: a look is taken when the shear has
moved, not as time passes, and its logarithm counts with a weight below one (tempering).
"""

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grip.constants import MISFIT, TEMPER

_GAIN_SD = 0.15  # of gains and stiffness of taxels: 10 % each is usual for printed and cast sensors, a prior
_LOOK = 0.05  # relative change of the shear that makes a new look at the shares
_NOISES = 4.0  # standard deviations of the total that it must have moved besides, or noise makes looks
_DEGREES = 4.0  # of freedom of Student's t: tails of a few taxels in a hundred looks
_EVEN = 0.2  # part of the misfit that does not go with the load: neighbours pull at a taxel without load
_MISFIT_LOOKS = 4.0  # looks that the prior of the misfit is worth


class ShareEvidence:
    """Evidence of one contact.

    Parameters
    ----------
    n_hypotheses, n_taxels : int
    """

    def __init__(self, n_hypotheses: int, n_taxels: int) -> None:
        self._gain = np.zeros((n_hypotheses, n_taxels))
        self._gain_var = np.full((n_hypotheses, n_taxels), _GAIN_SD**2)
        self._looks = _MISFIT_LOOKS
        self._misfit_sum = _MISFIT_LOOKS * MISFIT**2
        self._looked_at = np.zeros(3)

    @property
    def misfit(self) -> float:
        """Standard deviation of what the model does not explain, relative to the mean shear of a taxel."""
        return float(np.sqrt(self._misfit_sum / self._looks))

    def log_likelihood(
        self,
        shear: FloatArray,
        predicted: FloatArray,
        part_of_load: FloatArray,
        total: FloatArray,
        noise_sd: float,
        weights: FloatArray,
    ) -> FloatArray | None:
        """Compare measured with predicted shear.

        Parameters
        ----------
        shear : (2, taxels) float64
            Measured shear over the mean load of a taxel.
        predicted : (2, hypotheses, taxels) float64
            In the same unit.
        part_of_load : (taxels,) float64
            Load over the mean load.
        total : (3,) float64
            Shear and moment of the array, over the load.
        noise_sd : float
            Of one entry of `shear`.
        weights : (hypotheses,) float64
            Posterior so far, by which the misfit is learnt.

        Returns
        -------
        (hypotheses,) float64 or None
            None where the shear has hardly moved since the last look.
        """
        size = float(np.sqrt(total @ total))
        moved = float(np.sqrt(((total - self._looked_at) ** 2).sum()))
        if moved < _LOOK * size + _NOISES * noise_sd / np.sqrt(shear.shape[1]):
            return None
        self._looked_at = total
        weight = TEMPER
        floor = noise_sd**2 + (self.misfit * size) ** 2 * (_EVEN + part_of_load)
        found = np.zeros(predicted.shape[1])
        squares = np.zeros(predicted.shape[1])
        for measured, model in zip(shear, predicted, strict=True):
            variance = model**2 * self._gain_var + floor
            residual = measured - (1.0 + self._gain) * model
            relative = residual**2 / variance
            found -= (
                0.5 * (_DEGREES + 1) * np.log1p(relative / _DEGREES) + 0.5 * np.log(variance / floor)
            ).sum(axis=1)
            robust = (_DEGREES + 1) / (_DEGREES + relative)
            squares += (np.minimum(residual**2, 9 * variance) - noise_sd**2).mean(axis=1)
            # Kalman gain of a measurement whose variance is floor / (weight robust).
            part = weight * robust * self._gain_var * model
            part = part / (part * model + floor)
            self._gain = self._gain + part * residual
            self._gain_var = self._gain_var * (1.0 - part * model)
        if size > 3 * noise_sd:
            self._looks += 1
            self._misfit_sum += max(0.0, float(weights @ squares)) / size**2 / (1 + _EVEN)
        return np.asarray(weight * found)
