"""Responses of opposed channel pairs (R1 - R3, R2 - R4), summed over the taxels in contact."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.events.types import UNKNOWN_SD_DEG

# derived: weights are multiples of 2^-20, so that sums of weighted readings (whole steps within 2^23, some
# hundreds of channels) stay below 2^53 and exact. It costs a millionth of a response.
_WEIGHT_SCALE = 2.0**20
# derived: a voltage divider saturates: with x = G R at rest and a swing e of each resistor's force, R1 - R3
# goes as e / ((1 + x)^2 - (x e)^2), more than in proportion for the pair that moves more. That bends a
# direction towards the nearer axis by up to (x / (1 + x))^2 e^2 / 4 radians: 1.5 degrees at 1.2 V of 3.3 V
# and e = 0.9.
_MODEL_SD_DEG = 1.5
# derived: one taxel shows no spread; resistors that are 5 % unequal turn it by so much
_ONE_TAXEL_SD_DEG = 3.0


def whole_weights(weights: FloatArray) -> FloatArray:
    """Round weights to the grid on which sums of readings are exact."""
    return np.asarray(np.rint(weights * _WEIGHT_SCALE) / _WEIGHT_SCALE)


def mean_response(weights: FloatArray, steps: FloatArray) -> FloatArray:
    """Mean response (axes,) over some scans of readings: sums of whole numbers, exact in any order."""
    return np.asarray(weights @ steps.sum(axis=0) / len(steps))


class PairResponse:
    """Opposed (shear) and common (pressure) response of an array's channels."""

    def __init__(self, array: Array) -> None:
        self._weights = whole_weights(array.shear_weights())  # (2, taxels, channels)
        self._sizes = np.abs(self._weights).sum(axis=2)  # (2, taxels)
        self._common = array.normal_weights()  # (taxels, channels)
        # A taxel with one resistor of a pair missing would take pressure for shear.
        self._needs = (self._weights != 0).any(axis=0).astype(np.float64)

    def whole_taxels(self, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the taxels (taxels,) whose shear channels are all usable (channels,)."""
        complete: NDArray[np.bool_] = (self._needs @ ~usable) == 0
        return complete

    def motion_weights(self, taxels: NDArray[np.bool_]) -> FloatArray:
        """Return the weights (2, channels) of the summed response (x, y) of some taxels."""
        return np.asarray(self._weights[:, taxels].sum(axis=1))

    def direction_sd_deg(
        self, moved: FloatArray, taxels: NDArray[np.bool_], along: FloatArray, noise_sd_deg: float
    ) -> float:
        """Return the standard deviation of the direction of some taxels' summed response.

        Parameters
        ----------
        moved : (channels,) float64
            Change of the readings that makes the response.
        taxels : (taxels,) bool
        along : (2,) float64
            Unit vector of the direction.
        noise_sd_deg : float
            Standard deviation from noise alone.

        Notes
        -----
        Root sum of squares of the noise; of the spread of the taxels, whose resistors are unequal, across the
        direction (the standard error of a sum, n / (n - 1) times the sum of squares); and of the model.
        """
        x, y = (self._weights @ moved)[:, taxels]
        size = float(np.hypot(x.sum(), y.sum()))
        if size == 0:
            return UNKNOWN_SD_DEG
        spread_deg = _ONE_TAXEL_SD_DEG
        if (n := len(x)) > 1:
            across = along[0] * y - along[1] * x
            spread_deg = float(np.degrees(np.sqrt(n / (n - 1) * (across**2).sum()) / size))
        return min(UNKNOWN_SD_DEG, float(np.sqrt(noise_sd_deg**2 + spread_deg**2 + _MODEL_SD_DEG**2)))

    def opposed_and_common(self, volts: FloatArray, taxels: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the size of the opposed and of the common part, each as a mean over its channels.

        Parameters
        ----------
        volts : (channels,) float64
            One coefficient or reading for each channel.
        taxels : (taxels,) bool
            Taxels to include.
        """
        responses = (self._weights @ volts)[:, taxels].sum(axis=1)
        opposed = responses / np.maximum(self._sizes[:, taxels].sum(axis=1), 1e-12)
        common = (self._common @ volts)[taxels].sum() / max(int(taxels.sum()), 1)
        return float(np.hypot(*opposed)), abs(float(common))
